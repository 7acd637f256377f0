"""Whether an adapter learns: a toy one, on vehicles of embedded streets, judged on a street it has not seen.

The backbone is random and stays so; the codec is a cosine transform that keeps low frequencies, since a toy cannot have
Wan's. What this shows is that conditions, objective, loop and sampling belong together. It shows no picture's quality.
"""

import math
import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch
from diffusers import WanVACETransformer3DModel
from safetensors.torch import save_file
from torch import Tensor

from benchmarks.metric import Metric
from dwgs.metrics.image import psnr
from dwgs.street import build_street
from generator.conditions.raster import GREY
from generator.training.cache import Cache, write_cache
from generator.training.clips import TrainingClip, clips_of
from generator.training.config import ClipConfig, TrainingConfig
from generator.training.loop import Stepped, Trainer
from generator.wan.adapter import PointAdapter, shape_of
from generator.wan.clip import Clip
from generator.wan.encode import Codec
from generator.wan.folder import config_of
from generator.wan.network import Network
from generator.wan.settings import Sampling
from generator.wan.weights import PROMPT_FILE, Backbone

WIDTH, HEIGHT, FRAMES = 96, 64, 25
CLIPS = ClipConfig(frames=9, strides=(1,), hop=4)
HELD_OUT_STREET = 1000
SAMPLING = Sampling("euler", 8, shift=1.0, guidance=1.5)


def run(steps: int, streets: int) -> list[Metric]:
    """Train, generate, compare."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        backbone = toy_backbone(root / "backbone")
        held_out = street_clips(HELD_OUT_STREET)[::3]
        teaching = [clip for seed in range(streets) for clip in street_clips(seed)]
        codec = Codec(CosineCodec(Clip.of(teaching[0].frames).video))
        (root / "latents").mkdir()
        write_cache(teaching, codec, CLIPS, root / "latents")
        cache = Cache(root / "latents")
        config = TrainingConfig(steps, 8, 8, 2e-3, 20, ema=0.98, precision="no", checkpoint_every=steps)
        trainer = Trainer(cache, backbone, config, root / "run")
        text = backbone.load_text()
        bare = Network(backbone.load_transformer(), codec, text, "vace", knows_points=False)
        adapted = Network(trainer.transformer.eval(), codec, text, "group", knows_points=True)
        clips = [Clip.of(clip.frames) for clip in held_out]
        rows = {"zero_shot": score(bare, clips), "start": score(adapted, clips)}
        curve = [event.loss for event in trainer.run() if isinstance(event, Stepped)]
        with trainer.averaged():
            rows["trained"] = score(adapted, clips)
        rows["points"] = [masked_psnr(c.point_image, c) for c in clips]
        rows["grey"] = [masked_psnr(np.full_like(c.video, GREY), c) for c in clips]
        rows["codec"] = [masked_psnr(codec.decode(codec.encode(c.video, np.ones_like(c.point_mask))), c) for c in clips]
        identical = resumes(cache, backbone, config, root)
    metrics = [Metric("generator.adapter_parameters_14b", float(parameters_14b()), "")]
    for name, values in rows.items():
        spread = float(np.std(values) / math.sqrt(len(values)))
        metrics.append(Metric(f"generator.tiny.masked_psnr_{name}_db", float(np.mean(values)), "dB", spread))
    for before in ("start", "zero_shot"):
        gains = np.subtract(rows["trained"], rows[before])
        key = (
            "generator.tiny.masked_psnr_gain_db"
            if before == "start"
            else "generator.tiny.masked_psnr_over_zero_shot_db"
        )
        metrics.append(Metric(key, float(gains.mean()), "dB", float(gains.std() / math.sqrt(len(gains)))))
    metrics.append(Metric("generator.tiny.clips", float(len(cache)), ""))
    metrics.append(Metric("generator.tiny.held_out_clips", float(len(clips)), ""))
    metrics.append(Metric("generator.tiny.loss_first", float(np.mean(curve[:20])), ""))
    metrics.append(Metric("generator.tiny.loss_last", float(np.mean(curve[-20:])), ""))
    metrics.append(Metric("generator.tiny.resume_identical", float(identical), ""))
    return metrics


def parameters_14b() -> int:
    """Of the adapter for the paper's backbone, built without weights."""
    with torch.device("meta"):
        backbone = WanVACETransformer3DModel()
        return PointAdapter(shape_of(backbone.config), "none", list(backbone.config["vace_layers"])).num_parameters()


def street_clips(seed: int) -> list[TrainingClip]:
    """Clips of the vehicles of one street."""
    scene = build_street(seed, FRAMES, WIDTH, HEIGHT).scene()
    return list(clips_of(scene, CLIPS))


def score(network: Network, clips: list[Clip]) -> list[float]:
    """PSNR [dB] of each clip's generated pixels inside its reactive masks."""
    return [masked_psnr(network.generate(clip, SAMPLING, seed), clip) for seed, clip in enumerate(clips)]


def masked_psnr(images: np.ndarray, clip: Clip) -> float:
    """Against the recording, over all frames at once."""
    flat = (-1, images.shape[2], 3)
    ours, truth = (a.reshape(flat) / np.float32(255) for a in (images, clip.video))
    return psnr(ours, truth, clip.reactive_mask.reshape(flat[:2]))


def resumes(cache: Cache, backbone: Backbone, config: TrainingConfig, root: Path) -> bool:
    """Whether four steps are bit by bit two and then two."""
    learnt = []
    for run, stops in (("straight", (4,)), ("halved", (2, 4))):
        for stop in stops:
            trainer = Trainer(cache, backbone, replace(config, steps=stop, checkpoint_every=2), root / run)
            for _ in trainer.run():
                pass
        learnt.append(list(trainer.parameters.values()))
    return all(torch.equal(a, b) for a, b in zip(*learnt, strict=True))


def toy_backbone(folder: Path) -> Backbone:
    """A random transformer whose latents are `CosineCodec`'s."""
    torch.manual_seed(0)
    transformer = WanVACETransformer3DModel(
        num_attention_heads=4,
        attention_head_dim=48,
        in_channels=len(KEPT),
        out_channels=len(KEPT),
        text_dim=16,
        freq_dim=64,
        ffn_dim=512,
        num_layers=6,
        vace_layers=[0, 1, 2, 3],
        vace_in_channels=2 * len(KEPT) + 64,
    )
    transformer.save_pretrained(folder / "transformer")
    save_file({name: torch.zeros(1, 2, 16) for name in ("prompt", "empty")}, folder / PROMPT_FILE)
    return Backbone(folder, config_of(folder / "transformer"))


KEPT = [
    (channel, t, y, x)
    for channel, reach in ((0, 4), (1, 2), (2, 2))
    for t, y, x in product(range(4), range(8), range(8))
    if x + y + (t if channel == 0 else 2 * t) <= reach
]
"""Cosines (luma or chroma, t, y, x) that a latent channel stands for."""


class CosineCodec:
    """Blocks of 4 frames x 8 x 8 pixels as their lowest frequencies, called as Wan's autoencoder is.

    Args:
        like: Images [T, H, W, 3] whose latents set each channel's scale.
    """

    def __init__(self, like: np.ndarray) -> None:
        self.device, self.dtype = torch.device("cpu"), torch.float32
        self._in_time, self._in_space = cosines(4), cosines(8)
        video = torch.from_numpy(like / np.float32(127.5) - 1).permute(3, 0, 1, 2)[None]
        latents = self.encode(video)[0].mode()
        std = latents.std((0, 2, 3, 4)).clamp(min=0.02)
        self.config = {"latents_mean": [0.0] * len(KEPT), "latents_std": std.tolist()}

    def encode(self, video: Tensor, return_dict: bool = False) -> tuple:
        """[1, 3, T, H, W] in [-1, 1]; the first frame stands alone, as if it had been there before."""
        ycc = torch.einsum("ij,bjthw->bithw", LUMA, video)
        whole = torch.cat([ycc[:, :, :1].expand(-1, -1, 3, -1, -1), ycc], 2)
        blocks = whole.unflatten(2, (-1, 4)).unflatten(4, (-1, 8)).unflatten(6, (-1, 8))
        spectrum = torch.einsum("bctihywx,ji,ky,lx->bcjklthw", blocks, self._in_time, self._in_space, self._in_space)
        latents = torch.stack([spectrum[:, c, j, k, n] for c, j, k, n in KEPT], 1)
        return (SimpleNamespace(mode=lambda: latents),)

    def decode(self, latents: Tensor, return_dict: bool = False) -> tuple:
        """[1, 3, T, H, W]."""
        batch, _, time, height, width = latents.shape
        spectrum = latents.new_zeros(batch, 3, 4, 8, 8, time, height, width)
        for channel, (c, j, k, n) in enumerate(KEPT):
            spectrum[:, c, j, k, n] = latents[:, channel]
        blocks = torch.einsum("bcjklthw,ji,ky,lx->bctihywx", spectrum, self._in_time, self._in_space, self._in_space)
        ycc = blocks.flatten(6, 7).flatten(4, 5).flatten(2, 3)[:, :, 3:]
        return (torch.einsum("ij,bjthw->bithw", torch.linalg.inv(LUMA), ycc),)


LUMA = torch.tensor([[0.299, 0.587, 0.114], [-0.1687, -0.3313, 0.5], [0.5, -0.4187, -0.0813]])
"""Red, green, blue to luma and two chromas."""


def cosines(n: int) -> Tensor:
    """Orthonormal [n, n]: one frequency per row, scaled so that a constant keeps its value in the first."""
    k, i = torch.arange(n)[:, None], torch.arange(n)[None] + 0.5
    basis = torch.cos(math.pi * k * i / n) * math.sqrt(2 / n)
    basis[0] /= math.sqrt(2)
    return basis
