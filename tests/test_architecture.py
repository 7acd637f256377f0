"""The tree holds what the contracts promise."""

import subprocess
import sys

import pytest


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
