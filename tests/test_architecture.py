"""The tree holds what the contracts promise."""

import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, check=False)


def test_imports_keep_their_contracts():
    result = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout


def test_code_is_lint_free_and_formatted():
    for command in (("ruff", "check", "."), ("ruff", "format", "--check", ".")):
        result = run(*command)
        assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize("light", ["dwgs.cli", "dwgs.scene", "dwgs.formats", "viewer"])
def test_light_packages_never_load_torch_or_warp(light):
    code = f"import sys, {light}; print([m for m in ('torch', 'warp', 'pyvista', 'trimesh') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_nothing_that_is_installed_for_work_or_tests_brings_torchvision():
    """It is linked against CUDA, cannot load beside a CPU torch, and transformers imports it where it is there."""
    project = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    waiting = [Requirement(line) for line in project["dependencies"] + extras["wan"] + extras["dev"]]
    needed: set[str] = set()
    while waiting:
        requirement = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        if requirement.name in needed or requirement.name == "dwgs":
            continue
        needed.add(requirement.name)
        try:
            waiting += map(Requirement, requires(requirement.name) or [])
        except PackageNotFoundError:
            continue  # for another system
    assert {"torch", "diffusers", "pytest"} <= needed
    assert not needed & {"torchvision", "lpips", "torch-fidelity", "timm"}
