"""GLSL sources: how they become one, and how their uniforms get values."""

from importlib.resources import files

import moderngl

from dwgs.scene import Camera


def source(*names: str) -> str:
    """The named ``.glsl`` files one after the other, under the version that the viewer needs."""
    texts = [files(__name__).joinpath(f"{name}.glsl").read_text(encoding="utf-8") for name in names]
    return "\n".join(["#version 430 core", *texts])


def set_uniforms(program: moderngl.Program | moderngl.ComputeShader, **values: object) -> None:
    """Set uniforms by name; matrices are flat and column by column."""
    for name, value in values.items():
        program[name] = value


def intrinsics(camera: Camera) -> tuple[float, float, float, float]:
    """(fx, fy, cx, cy) [px]: the uniform of that name."""
    return camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
