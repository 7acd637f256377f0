import numpy as np
import torch

from benchmarks.workloads.generator import KEPT, CosineCodec, parameters_14b
from generator.wan.encode import Codec


def test_the_toy_codec_keeps_what_its_latents_can_say():
    codec = CosineCodec(np.random.default_rng(0).integers(0, 256, (9, 32, 48, 3), np.uint8))
    latents = torch.randn(1, len(KEPT), 3, 4, 6, generator=torch.Generator().manual_seed(0))
    latents[:, [i for i, kept in enumerate(KEPT) if kept[1]], 0] = 0  # the first frame does not move
    again = codec.encode(codec.decode(latents)[0])[0].mode()
    torch.testing.assert_close(again, latents, atol=1e-4, rtol=0)
    flat = np.full((9, 32, 48, 3), (40, 120, 200), np.uint8)
    wrapped = Codec(codec)
    assert np.abs(wrapped.decode(wrapped.encode(flat, np.ones((9, 32, 48), bool))).astype(int) - flat).max() <= 1


def test_the_adapter_of_the_papers_backbone_is_counted():
    assert parameters_14b() == 3_050_412_032
