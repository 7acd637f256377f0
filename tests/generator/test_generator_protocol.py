import subprocess
import sys
from inspect import signature

import pytest

from dwgs.scene import InputError
from generator import Generator, backend


def test_an_unknown_backend_is_refused_with_those_that_exist():
    with pytest.raises(InputError, match="no backend is called 'wan-point'; there is composite"):
        backend("wan-point")


def test_the_default_backend_keeps_the_protocol():
    composite: Generator = backend("composite")
    assert composite.name == "composite"
    assert composite.capabilities.deterministic
    assert not composite.capabilities.needs_weights
    assert list(signature(composite.generate).parameters)[:2] == ["conditions", "seed"]


def test_the_package_starts_without_torch_or_warp():
    code = "import sys, generator; print([m for m in ('torch', 'warp', 'trimesh') if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
