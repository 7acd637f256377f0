"""Pixels and masks to latents and back; network layout [B, C, T, H, W] begins and ends here."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from diffusers import AutoencoderKLWan
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from generator.conditions.raster import GREY
from generator.long_video import STRIDE
from generator.wan.clip import Clip
from generator.wan.memory import TILE
from generator.wan.settings import MaskTime

SPACE = 8
"""Pixels along each side of a latent pixel."""
MASK_CHANNELS = SPACE * SPACE
"""A mask keeps every pixel: those of a latent pixel become channels."""


class Codec:
    """Wan's video autoencoder between images and normalised latents."""

    def __init__(self, vae: AutoencoderKLWan) -> None:
        self.vae = vae
        self._mean = _per_channel(vae.config["latents_mean"]).to(vae.device)
        self._std = _per_channel(vae.config["latents_std"]).to(vae.device)
        self._grey: dict[tuple[int, ...], Tensor] = {}

    def work_in_tiles(self) -> None:
        """Take less memory for images larger than a tile: the same up to blended seams."""
        self.vae.enable_tiling(TILE, TILE, TILE * 3 // 4, TILE * 3 // 4)

    @torch.no_grad()
    def encode(self, images: NDArray[np.uint8], shown: NDArray[np.bool_]) -> Tensor:
        """Latents [1, z, 1 + (T - 1) / 4, H / 8, W / 8] float32: the mode, normalised per channel.

        Args:
            images: [T, H, W, 3] sRGB, T = 1 + 4 k, H and W multiples of 16.
            shown: [T, H, W]; other pixels are mid-grey, which is 0 to the network.
        """
        video = torch.from_numpy(images.astype(np.float32) / 127.5 - 1) * torch.from_numpy(shown)[..., None]
        video = video.permute(3, 0, 1, 2)[None].to(self.vae.device, self.vae.dtype)
        latents = self.vae.encode(video, return_dict=False)[0].mode()
        return (latents.float() - self._mean) / self._std

    def encode_grey(self, shape: tuple[int, ...]) -> Tensor:
        """Latents of a video [T, H, W] without anything in it: not zero. Encoded once per shape."""
        if shape not in self._grey:
            self._grey[shape] = self.encode(np.zeros((*shape, 3), np.uint8), np.zeros(shape, bool))
        return self._grey[shape]

    @torch.no_grad()
    def decode(self, latents: Tensor) -> NDArray[np.uint8]:
        """Images [T, H, W, 3] sRGB of latents [1, z, T', h, w]."""
        latents = latents.to(self.vae.device) * self._std + self._mean
        video = self.vae.decode(latents.to(self.vae.dtype), return_dict=False)[0][0]
        pixels = (video.float().clamp(-1, 1) + 1) * 127.5
        return pixels.round().to(torch.uint8).permute(1, 2, 3, 0).cpu().numpy()


@dataclass(frozen=True)
class ControlLatents:
    """A clip's conditions as the network sees them, [1, C, T', h, w] each."""

    inactive: Tensor
    """Latents of the recording, grey where the network may paint."""
    points: Tensor
    """Latents of the point image."""
    reactive_mask: Tensor
    """64 channels."""
    point_mask: Tensor
    """64 channels."""

    @staticmethod
    def of(clip: Clip, codec: Codec, mask_time: MaskTime) -> "ControlLatents":
        """Encode a clip; a point image shows what is not canvas."""
        device = codec.vae.device
        return ControlLatents(
            codec.encode(clip.video, ~clip.reactive_mask),
            codec.encode(clip.point_image, (clip.point_image != GREY).any(-1)),
            pack_mask(clip.reactive_mask, mask_time).to(device),
            pack_mask(clip.point_mask, mask_time).to(device),
        )

    def without_points(self, grey: Tensor) -> "ControlLatents":
        """The null of guidance and of training dropout: the latents of grey pixels, and no point mask."""
        return replace(self, points=grey.expand_as(self.points), point_mask=torch.zeros_like(self.point_mask))

    def for_adapter(self) -> Tensor:
        """[1, 2 z + 128, T', h, w] in the order of `adapter.CHANNELS`."""
        return torch.cat([self.inactive, self.points, self.reactive_mask, self.point_mask], 1)

    def for_vace(self) -> Tensor:
        """[1, 2 z + 64, T', h, w]: what Wan2.1-VACE knows; the points stand where its reactive video does."""
        return torch.cat([self.inactive, self.points, self.reactive_mask], 1)


def pack_mask(mask: NDArray[np.bool_], mask_time: MaskTime) -> Tensor:
    """A mask [T, H, W], T = 1 + 4 k, as float32 [1, 64, 1 + k, H / 8, W / 8], without losing a pixel."""
    frames, height, width = mask.shape
    grid = torch.from_numpy(mask.astype(np.float32))
    grid = grid.view(frames, height // SPACE, SPACE, width // SPACE, SPACE)
    channels = grid.permute(2, 4, 0, 1, 3).flatten(0, 1)[None]
    size = (1 + (frames - 1) // STRIDE, height // SPACE, width // SPACE)
    if mask_time == "vace":
        return functional.interpolate(channels, size=size, mode="nearest-exact")
    first = channels[:, :, :1].expand(-1, -1, STRIDE - 1, -1, -1)  # latent 0 encodes frame 0 alone
    return torch.cat([first, channels], 2).unflatten(2, (size[0], STRIDE)).amax(3)


def _per_channel(values: list[float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float32).view(1, -1, 1, 1, 1)
