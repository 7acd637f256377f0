"""What a mesh looks like at a point of it: textures, materials, vertex colours, and glass."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from trimesh import Trimesh
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.color import uv_to_interpolated_color
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from dwgs.scene import InputError
from dwgs.scene.color import linear_from_srgb, srgb_from_linear

CABIN = np.array([20, 22, 24], np.uint8)
"""sRGB of what is seen through a window. Glass is drawn as if painted with it: interiors are not modelled."""

GREY = 127
"""Of what has no colour."""

MAX_TEXTURE = 64 << 20
"""Pixels in a texture; a larger one is refused before it is decoded."""


@dataclass(frozen=True)
class Spots:
    """Points on a mesh."""

    face: NDArray[np.int64]
    """[P] face that each lies on."""
    weights: NDArray[np.float64]
    """[P, 3] barycentric."""

    def __len__(self) -> int:
        return len(self.face)

    def interpolate(self, mesh: Trimesh, of_vertex: NDArray) -> NDArray[np.float64]:
        """Values [P, D] between those of the vertices [V, D]."""
        return np.einsum("pc,pcd->pd", self.weights, of_vertex[mesh.faces[self.face]].astype(np.float64))


def paint(mesh: Trimesh, spots: Spots, name: str) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Colours [P, 3] sRGB, and whether there is any surface [P] (a material may cut holes).

    Args:
        mesh: As trimesh read it.
        spots: Where.
        name: What messages call the file.

    Raises:
        InputError: A texture is too large or cannot be decoded.
    """
    visual = mesh.visual
    whole = np.ones(len(spots), bool)
    rgb = np.full((len(spots), 3), GREY / 255)
    if isinstance(visual, TextureVisuals):
        if isinstance(visual.material, PBRMaterial):
            rgb, whole = _paint_pbr(mesh, visual, visual.material, spots, name)
        elif isinstance(visual.material, SimpleMaterial):
            rgb = _paint_simple(mesh, visual, visual.material, spots, name)
    elif isinstance(visual, ColorVisuals) and visual.kind == "face":
        rgb = visual.face_colors[spots.face, :3] / 255
    elif isinstance(visual, ColorVisuals) and visual.kind == "vertex":
        rgb = spots.interpolate(mesh, visual.vertex_colors[:, :3]) / 255
    return np.rint(rgb.clip(0, 1) * 255).astype(np.uint8), whole


def _paint_pbr(
    mesh: Trimesh, visual: TextureVisuals, material: PBRMaterial, spots: Spots, name: str
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """glTF 2.0, 3.9.2: base colour = factor x texture, multiplied as linear light."""
    factor = material.baseColorFactor
    factor = np.ones(4) if factor is None else np.asarray(factor, np.float64) / 255
    rgb, alpha = np.tile(factor[:3], (len(spots), 1)), np.full(len(spots), factor[3])
    if material.baseColorTexture is not None and visual.uv is not None:
        texels = _texture(material.baseColorTexture, spots.interpolate(mesh, visual.uv), name)
        rgb, alpha = rgb * linear_from_srgb(texels[:, :3]), alpha * texels[:, 3]
    rgb, whole = srgb_from_linear(rgb), np.ones(len(spots), bool)
    if material.alphaMode == "MASK":
        whole = alpha >= (0.5 if material.alphaCutoff is None else material.alphaCutoff)
    if material.alphaMode == "BLEND":
        rgb = _before_cabin(rgb, alpha)
    return rgb, whole


def _paint_simple(
    mesh: Trimesh, visual: TextureVisuals, material: SimpleMaterial, spots: Spots, name: str
) -> NDArray[np.float64]:
    """An MTL material. The map takes the place of Kd: exporters leave an arbitrary grey there."""
    rgb = np.tile(np.asarray(material.diffuse, np.float64)[:3] / 255, (len(spots), 1))
    if material.image is not None and visual.uv is not None:
        rgb = _texture(material.image, spots.interpolate(mesh, visual.uv), name)[:, :3]
    try:
        dissolve = float(material.kwargs.get("d", ["1"])[0])
    except (ValueError, IndexError, TypeError):
        dissolve = 1.0
    return _before_cabin(rgb, np.full(len(spots), np.clip(dissolve, 0, 1)))


def _texture(image: Image.Image, uv: NDArray, name: str) -> NDArray[np.float64]:
    """Texels [P, 4] in [0, 1] at ``uv`` [P, 2] (v up, repeating), bilinear."""
    if image.width * image.height > MAX_TEXTURE:
        size = f"{image.width}x{image.height}"
        raise InputError(f"a texture has at most {MAX_TEXTURE >> 20} Mpx, one of {name} has {size}; shrink it")
    if not np.isfinite(uv).all():
        raise InputError(f"texture coordinates are finite, some of {name} are not; repair the mesh")
    try:
        image = image.convert("RGBA")
    except Exception as error:  # a decoder given a stranger's file may raise anything
        raise InputError(f"a texture of {name} cannot be decoded: {error}") from None
    return np.asarray(uv_to_interpolated_color(uv, image), np.float64) / 255


def _before_cabin(rgb: NDArray, alpha: NDArray) -> NDArray[np.float64]:
    return alpha[:, None] * rgb + (1 - alpha[:, None]) * (CABIN / 255)
