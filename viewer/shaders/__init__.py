"""GLSL sources, and how they become one."""

from importlib.resources import files


def source(*names: str) -> str:
    """The named ``.glsl`` files one after the other, under the version that the viewer needs."""
    return "\n".join(
        ["#version 430 core", *(files(__name__).joinpath(f"{n}.glsl").read_text() for n in names)]
    )
