"""Backbone and adapter on one device: a clip goes in, its pixels come out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from diffusers import WanVACETransformer3DModel
from numpy.typing import NDArray

from dwgs.scene.errors import InputError
from generator.wan.clip import Clip
from generator.wan.denoise import Side, denoise
from generator.wan.encode import Codec, ControlLatents
from generator.wan.memory import MemoryPlan
from generator.wan.settings import MaskTime, Sampling
from generator.wan.weights import Text


@dataclass(frozen=True)
class Network:
    """A transformer with its autoencoder and the fixed text."""

    transformer: WanVACETransformer3DModel
    codec: Codec
    text: Text
    mask_time: MaskTime
    """How masks of frames become masks of latent frames."""
    knows_points: bool
    """Whether a PointAdapter is attached: guidance is then on the points; else, as in VACE, on the text."""

    def generate(
        self, clip: Clip, sampling: Sampling, seed: int, on_step: Callable[[int], None] | None = None
    ) -> NDArray[np.uint8]:
        """Pixels [T, H, W, 3]: the network's inside the reactive masks, the recording's, bit for bit, around."""
        device = self.codec.vae.device
        control = ControlLatents.of(clip, self.codec, self.mask_time)
        blind = control.without_points(self.codec.encode_grey(clip.reactive_mask.shape))
        if self.knows_points:
            condition = Side(control.for_adapter(), self.text.prompt)
            null = Side(blind.for_adapter(), self.text.prompt)
        else:
            condition = Side(blind.for_vace(), self.text.prompt)
            null = Side(blind.for_vace(), self.text.empty)
        random = torch.Generator().manual_seed(seed)  # on the CPU: the same noise on every device
        noise = torch.randn(control.inactive.shape, generator=random).to(device)
        latents = denoise(self.transformer, noise, condition, null, sampling, on_step)
        return clip.restored(self.codec.decode(latents))


def require_attention(name: str, device: str) -> None:
    """Raise `InputError` unless one of diffusers' attention backends works on a device."""
    from diffusers.models.attention_dispatch import attention_backend, dispatch_attention_fn

    dtype = torch.float32 if device == "cpu" else torch.bfloat16
    head = torch.zeros(1, 16, 1, 128, dtype=dtype, device=device)  # as wide as Wan's
    try:
        with attention_backend(name):
            dispatch_attention_fn(head, head, head)
    except Exception as error:  # each backend's package fails in its own way
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise InputError(f"attention '{name}' does not work on {device} ({reason}); leave --attention out") from None


def place(transformer: WanVACETransformer3DModel, device: str, memory: MemoryPlan, attention: str | None) -> None:
    """Bring a transformer, its branch attached, to a device in the way that was planned.

    Args:
        transformer: In host memory.
        device: Where it works.
        memory: What is done with the weights.
        attention: Name of one of diffusers' attention backends; None is PyTorch's.
    """
    if attention is not None:
        transformer.set_attention_backend(attention)
    if memory.weights == "streamed":
        transformer.enable_group_offload(
            onload_device=torch.device(device),
            offload_device=torch.device("cpu"),
            offload_type="block_level",
            num_blocks_per_group=1,
            use_stream=device.startswith("cuda"),
        )
        return
    if memory.weights == "float8":
        transformer.enable_layerwise_casting(
            torch.float8_e4m3fn, transformer.dtype, skip_modules_pattern=("vace_blocks", "^proj_out$")
        )
    torch.nn.Module.to(transformer, device)
