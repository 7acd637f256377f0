"""What the splatter takes and gives: clouds, views, layers, records, images."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.scene import Camera, Gaussians, InputError
from dwgs.scene.gaussians import SH_COUNTS
from dwgs.splat.constants import TILE


@dataclass(frozen=True, eq=False)
class Splats:
    """A cloud of Gaussians as tensors, activated; any of them may require a gradient."""

    means: Tensor
    """[N, 3] [m]."""
    quats: Tensor
    """[N, 4] wxyz, of any length but zero."""
    scales: Tensor
    """[N, 3] standard deviations [m]."""
    opacities: Tensor
    """[N] in [0, 1]."""
    sh: Tensor
    """[N, K, 3] spherical harmonics, DC first, K of 1, 4, 9, 16, in this cloud's own frame."""

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"Splats.{name} has shape {shape}, got {tuple(getattr(self, name).shape)}")
        if self.sh.ndim != 3 or len(self.sh) != n or self.sh.shape[1] not in SH_COUNTS or self.sh.shape[2] != 3:
            raise InputError(f"Splats.sh has shape ({n}, 1|4|9|16, 3), got {tuple(self.sh.shape)}")

    def __len__(self) -> int:
        return len(self.means)

    @staticmethod
    def from_gaussians(gaussians: Gaussians, device: torch.device | str = "cpu") -> "Splats":
        """Copies of the arrays, on ``device``."""
        arrays = {f.name: np.ascontiguousarray(getattr(gaussians, f.name)) for f in fields(Splats)}
        return Splats(**{name: torch.tensor(array, device=device) for name, array in arrays.items()})

    def to_gaussians(self) -> Gaussians:
        """Detached copies, quaternions normalised."""
        arrays = {f.name: getattr(self, f.name).detach().cpu().float().numpy().copy() for f in fields(self)}
        arrays["quats"] /= np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
        return Gaussians(**arrays)

    @staticmethod
    def cat(clouds: "list[Splats]") -> "Splats":
        """One cloud of several in the same frame; lower SH degrees are padded with zeros."""
        count = max(c.sh.shape[1] for c in clouds)
        sh = torch.cat([torch.nn.functional.pad(c.sh, (0, 0, 0, count - c.sh.shape[1])) for c in clouds])
        names = ("means", "quats", "scales", "opacities")
        return Splats(**{name: torch.cat([getattr(c, name) for c in clouds]) for name in names}, sh=sh)


@dataclass(frozen=True, eq=False)
class View:
    """A pinhole camera as a cloud of Gaussians meets it; or V of them with images of one size."""

    viewmat: Tensor
    """[4, 4] ``camera_from_splats``, [V, 4, 4] in a batch; may require a gradient."""
    intrinsics: tuple[float, ...] | tuple[tuple[float, ...], ...]
    """fx, fy, cx, cy [px]; pixel centres at +0.5. V of them in a batch."""
    width: int
    """[px]."""
    height: int
    """[px]."""

    @staticmethod
    def from_camera(
        camera: Camera, world_from_splats: NDArray | None = None, device: torch.device | str = "cpu"
    ) -> "View":
        """What ``camera`` sees of a cloud that stands at ``world_from_splats`` [4, 4] (default: world)."""
        viewmat = camera.camera_from_world
        if world_from_splats is not None:
            viewmat = viewmat @ world_from_splats
        K = camera.K
        intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
        tensor = torch.tensor(viewmat, dtype=torch.float32, device=device)
        return View(tensor, intrinsics, camera.width, camera.height)

    @staticmethod
    def batch(views: "Sequence[View]") -> "View":
        """Views of one size as one; what is rendered of it has one image more per view, in front."""
        sizes = {(view.width, view.height) for view in views}
        if len(sizes) != 1 or any(view.is_batch for view in views):
            raise InputError(f"a batch holds single views of one size, got {len(views)} of sizes {sorted(sizes)}")
        first = views[0]
        return View(
            torch.stack([view.viewmat for view in views]),
            tuple(tuple(view.lenses[0].tolist()) for view in views),
            first.width,
            first.height,
        )

    @property
    def is_batch(self) -> bool:
        """Whether images and records have a first axis for the views."""
        return self.viewmat.ndim == 3

    @property
    def viewmats(self) -> Tensor:
        """[V, 4, 4], of a single view too."""
        return self.viewmat if self.is_batch else self.viewmat[None]

    @cached_property
    def lenses(self) -> Tensor:
        """[V, 4] fx, fy, cx, cy, of a single view too, where the viewmats are."""
        return torch.tensor(self.intrinsics, dtype=torch.float32, device=self.viewmat.device).view(-1, 4)

    @property
    def tiles(self) -> tuple[int, int]:
        """Tiles across and down one image."""
        height, width = whole_tiles(self.height, self.width)
        return width // TILE, height // TILE


@dataclass(frozen=True, eq=False)
class Objects:
    """A scene of rigid bodies in one cloud: whose Gaussians are whose, and where each stands."""

    counts: tuple[int, ...]
    """[K] Gaussians of each object; those of the first come first."""
    world_from_object: Tensor
    """[K, 4, 4] poses; may require a gradient."""

    def __post_init__(self) -> None:
        if self.world_from_object.shape != (len(self.counts), 4, 4) or min(self.counts, default=0) < 0:
            raise InputError(
                f"each object has a count and a pose [4, 4], got counts {self.counts} "
                f"and poses {tuple(self.world_from_object.shape)}"
            )

    @cached_property
    def object_from_gaussian(self) -> Tensor:
        """[N] int32; empty where there is only one object."""
        where = self.world_from_object.device
        if len(self.counts) == 1:
            return torch.zeros(0, dtype=torch.int32, device=where)
        numbers = torch.arange(len(self.counts), dtype=torch.int32, device=where)
        return numbers.repeat_interleave(torch.tensor(self.counts, device=where))


@dataclass(frozen=True, eq=False)
class Layers:
    """A frozen scene cut in two by centre depth: what lies in front of the Gaussians to come, and behind.

    Kept as the renderer reads them, plane by plane. For a batch of views every image has one axis more in front.
    """

    front: Tensor | None
    """[5, H', W'] of whole tiles: r, g, b, depth, all premultiplied, and transmittance; 0 outside the image. None:
    there is nothing."""
    back: Tensor
    """[5, H', W'] r, g, b, over whatever ends the world (premultiplied where nothing does), depth, premultiplied, and
    alpha."""
    height: int
    """Of the image in them [px]."""
    width: int

    @staticmethod
    def of(front: tuple[Tensor, Tensor, Tensor] | None, back: tuple[Tensor, Tensor, Tensor]) -> "Layers":
        """From images [H, W, 3], [H, W] and [H, W]: colours, depths, and what the last plane holds."""
        height, width = back[1].shape[-2:]
        return Layers(None if front is None else _planes(*front), _planes(*back), height, width)

    @staticmethod
    def between(front: "Rendering", back: "Rendering") -> "Layers":
        """Layers of two renderings over black, detached."""
        alpha = front.alpha.detach()
        before = (front.rgb.detach(), front.depth.detach(), 1 - alpha) if alpha.any() else None
        return Layers.of(before, (back.rgb.detach(), back.depth.detach(), back.alpha.detach()))

    def crop(self, rows: slice, columns: slice) -> "Layers":
        """Only this part of the images."""
        part = ..., rows, columns

        def cut(rgb: Tensor, depth: Tensor, last: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            return rgb.movedim(-1, -3)[part].movedim(-3, -1), depth[part], last[part]

        before = None if self.front is None else cut(self.front_rgb, self.front_depth, self.front_transmittance)
        return Layers.of(before, cut(self.back_rgb, self.back_depth, self.back_alpha))

    @property
    def front_rgb(self) -> Tensor:
        """[H, W, 3] premultiplied."""
        return self._image(self._before[..., :3, :, :]).movedim(-3, -1)

    @property
    def front_depth(self) -> Tensor:
        """[H, W] premultiplied [m]."""
        return self._image(self._before[..., 3, :, :])

    @property
    def front_transmittance(self) -> Tensor:
        """[H, W]."""
        return self._image(self._before[..., 4, :, :])

    @property
    def back_rgb(self) -> Tensor:
        """[H, W, 3]."""
        return self._image(self.back[..., :3, :, :]).movedim(-3, -1)

    @property
    def back_depth(self) -> Tensor:
        """[H, W] premultiplied [m]."""
        return self._image(self.back[..., 3, :, :])

    @property
    def back_alpha(self) -> Tensor:
        """[H, W]."""
        return self._image(self.back[..., 4, :, :])

    @property
    def _before(self) -> Tensor:
        """The front, all clear where there is none."""
        if self.front is not None:
            return self.front
        clear = torch.zeros_like(self.back)
        clear[..., 4, : self.height, : self.width] = 1
        return clear

    def _image(self, planes: Tensor) -> Tensor:
        """Without what fills the last tiles."""
        return planes[..., : self.height, : self.width]


@dataclass(frozen=True, eq=False)
class Projected:
    """Gaussians as a view sees them, one record each; not drawn where the radii are zero.

    For a batch of views all has one axis more in front.
    """

    records: Tensor
    """[N, 16] mean x, y [px]; conic xx, xy, yy [px^-2]; opacity; r, g, b; depth z [m]; extent x, y [px]; ln opacity;
    tilt, summit, waist.

    Gradients flow through the first ten. The rest describes the ellipse alpha = 1/255, dx and dy off the mean: it is
    exactly ``extent`` wide and high, highest (dy = extent y) at dx = summit, and at any dx it lies between
    ``tilt dx - h`` and ``tilt dx + h`` with ``h = waist sqrt(1 - (dx / extent x)^2)``. Where the extent is zero the
    13th is 1 for a Gaussian that is not finite.
    """

    def __len__(self) -> int:
        return self.records.shape[-2]

    def __getitem__(self, index) -> "Projected":
        """The records that a mask or index over [N] selects."""
        return Projected(self.records[..., index, :])

    def detach(self) -> "Projected":
        """The same records without a gradient."""
        return Projected(self.records.detach())

    @property
    def means2d(self) -> Tensor:
        """[N, 2] centres [px]."""
        return self.records[..., 0:2]

    @property
    def depths(self) -> Tensor:
        """[N] centre depths z [m], of Gaussians that are not drawn too (0 where not finite)."""
        return self.records[..., 9]

    @property
    def radii(self) -> Tensor:
        """[N, 2] half extents [px]; zero: not drawn."""
        return self.records[..., 10:12]

    @property
    def visible(self) -> Tensor:
        """[N] whether drawn."""
        return self.records[..., 10] > 0

    @property
    def broken(self) -> Tensor:
        """[N] whether not drawn because some number of the Gaussian is not finite."""
        return (self.records[..., 10] == 0) & (self.records[..., 12] != 0)


@dataclass(frozen=True, eq=False)
class Rendering:
    """An image of Gaussians; of a batch of views, all has one axis more in front."""

    rgb: Tensor
    """[H, W, 3], premultiplied: over black, or over ``Layers.back``."""
    depth: Tensor
    """[H, W] sum of weight times centre depth [m]."""
    alpha: Tensor
    """[H, W] sum of weights."""
    features: Tensor
    """[H, W, F] sums of weight times feature, of the Gaussians drawn between any layers; F may be 0."""
    intersections: Tensor
    """[] int64 how many tiles all the Gaussians touched; those beyond a capacity are missing."""

    @property
    def expected_depth(self) -> Tensor:
        """[H, W] mean centre depth [m] of what the pixel sees."""
        return self.depth / self.alpha.clamp_min(1e-10)

    def over(self, background: Tensor) -> Tensor:
        """[H, W, 3] the colours over a ``background`` of that shape, or of one colour [3]."""
        return self.rgb + (1 - self.alpha)[..., None] * background


def _planes(rgb: Tensor, depth: Tensor, last: Tensor) -> Tensor:
    """[..., 5, H', W'] of whole tiles from [..., H, W, 3] and twice [..., H, W]; zeros outside."""
    height, width = depth.shape[-2:]
    out = rgb.new_zeros(*depth.shape[:-2], 5, *whole_tiles(height, width))
    out[..., :3, :height, :width] = rgb.movedim(-1, -3)
    out[..., 3, :height, :width] = depth
    out[..., 4, :height, :width] = last
    return out


def whole_tiles(height: int, width: int) -> tuple[int, int]:
    """Both rounded up [px]."""
    return -(-height // TILE) * TILE, -(-width // TILE) * TILE
