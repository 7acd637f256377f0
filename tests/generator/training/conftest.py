"""Nine recorded vehicles as clips, and their latents."""

import pytest

from generator.training.cache import Cache, write_cache
from generator.training.clips import TrainingClip
from generator.training.config import ClipConfig
from generator.wan.encode import Codec
from generator.wan.tiny import tiny_vae


@pytest.fixture(scope="session")
def clip_config():
    return ClipConfig(frames=9, hop=1)


@pytest.fixture(scope="session")
def codec():
    return Codec(tiny_vae())


@pytest.fixture(scope="session")
def clips(conditions):
    """Nine vehicles, one clip each, every third of stride 4."""
    frames = conditions(44).frames["front"]
    strides = [4 if i % 3 == 2 else 1 for i in range(9)]
    return [TrainingClip("noise", f"car-{i}", k, frames[i : i + 8 * k + 1 : k]) for i, k in enumerate(strides)]


@pytest.fixture(scope="session")
def cache(clips, codec, clip_config, tmp_path_factory):
    folder = tmp_path_factory.mktemp("latents")
    write_cache(clips, codec, clip_config, folder)
    return Cache(folder)
