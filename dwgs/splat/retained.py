"""Pictures of one cloud, drawn again and again while it changes: what a launch takes is packed once.

What `render` and autograd do, without either: a step of a fit on a CPU is over before Python has packed its arguments.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import torch
import warp as wp
from torch import Tensor

from dwgs.splat import crew
from dwgs.splat.constants import TILE
from dwgs.splat.kernels import composite_cpu as kernels
from dwgs.splat.kernels.among_cpu import Among
from dwgs.splat.kernels.gather import slot10
from dwgs.splat.ops.among import deal
from dwgs.splat.ops.binned import Binned
from dwgs.splat.ops.composite import PLANES, canvas_of, gradient_of
from dwgs.splat.ops.composite_cpu import run_size
from dwgs.splat.ops.project import Subject, SubjectGradient, as_records
from dwgs.splat.parallel import load
from dwgs.splat.splats import Layers, Objects, Projected, Splats, View, whole_tiles

_GROWTH = 1.25
_ROOM = 4
"""Intersections per Gaussian that there is room for at first."""


class RetainedCloud:
    """Splats on a CPU and the memory that all pictures of them share, of which one is drawn at a time.

    Args:
        splats: Contiguous leaves, changed in place. Their ``grad`` is what the last adjoint left.
        threads: That draw one picture.
        moves: Whether cameras move, so that a gradient by their poses is wanted.
    """

    def __init__(self, splats: Splats, threads: int = 2, *, moves: bool = False) -> None:
        load(wp.get_device("cpu"))
        self.splats, self.threads, self.moves = splats, threads, moves
        self.leaves = [getattr(splats, f.name) for f in fields(Splats)]
        self.gradients = [torch.zeros_like(leaf, requires_grad=False) for leaf in self.leaves]
        self.room = _ROOM * len(splats)
        """For intersections."""
        self.generation = 0
        """Changes whenever memory has moved."""
        self._memory: dict[str, Tensor] = {}

    def picture(self, view: View, layers: Layers | None = None, among: Projected | None = None) -> "Picture":
        """What a single ``view`` sees of the cloud, see `render`; what is ``among`` it is dealt out once, here."""
        return Picture(self, view, layers, among)

    def memory(self, sizes: dict[str, int], dtype: torch.dtype) -> dict[str, Tensor]:
        """So many elements each, which any picture may overwrite."""
        for name, size in sizes.items():
            if name not in self._memory or len(self._memory[name]) < size:
                self._memory[name] = torch.empty(int(size * _GROWTH), dtype=dtype)
                self.generation += 1
        return {name: self._memory[name][:size] for name, size in sizes.items()}


class Picture:
    """One view of a `RetainedCloud`."""

    def __init__(self, cloud: RetainedCloud, view: View, layers: Layers | None, among: Projected | None) -> None:
        self._cloud, self._view, self._layers = cloud, view, layers
        self._among = Among() if among is None else deal(among, view, layers)
        self.viewmat = view.viewmat.detach().clone()
        """[4, 4] to be changed in place where the camera moves."""
        self.v_viewmat = torch.zeros(4, 4)
        """[4, 4] its gradient, from the last adjoint, where cameras move."""
        self._total = torch.zeros(1, dtype=torch.int32)
        self._packed: _Packed | None = None
        self._memory()

    def draw(self) -> "Drawing":
        """The image as the splats are now, in memory that the next picture is drawn in."""
        cloud = self._cloud
        while True:
            packed = self._packed
            if packed is None or (packed.generation, packed.room) != (cloud.generation, cloud.room):
                packed = self._packed = self._pack()
            packed.draw()
            total = int(self._total)
            if total <= packed.room:
                return packed.drawing
            cloud.room = int(total * _GROWTH)

    def adjoint(self) -> None:
        """Of the picture drawn last, by the gradients in its drawing: leave those of the splats and of the pose."""
        assert self._packed is not None, "nothing was drawn"
        self._packed.adjoint()
        for leaf, gradient in zip(self._cloud.leaves, self._cloud.gradients, strict=True):
            leaf.grad = gradient
        if self._cloud.moves:
            torch.sum(self._packed.v_spans, (0, 1), out=self.v_viewmat)

    def _memory(self) -> dict[str, Tensor]:
        """What it is drawn in."""
        cloud, view, room = self._cloud, self._view, self._cloud.room
        n, tiles = len(cloud.splats), view.tiles[0] * view.tiles[1]
        sizes = {"isects": room, "spare_isects": room, "gaussians": room, "ends": n, "ranges": 2 * tiles}
        whole = cloud.memory(sizes | {"places": self._runs * tiles}, torch.int32)
        sizes = {"depths": room, "spare_depths": room, "slots": 10 * room, "records": 16 * n, "v_records": 16 * n}
        sizes |= {"image": PLANES * tiles * TILE**2, "v_image": PLANES * view.height * view.width}
        return whole | cloud.memory(sizes, torch.float32)

    @property
    def _runs(self) -> int:
        count = len(self._cloud.splats)
        return -(-count // run_size(count, self._cloud.threads))

    def _pack(self) -> "_Packed":
        cloud, view, own = self._cloud, self._view, self._memory()
        n, height, width = len(cloud.splats), view.height, view.width
        planes = (PLANES, *whole_tiles(height, width))
        records, image = own["records"].view(1, n, 16), own["image"].view(1, *planes)
        shown, v_image = image[0, :, :height, :width], own["v_image"].view(PLANES, height, width)
        images = shown[:3].movedim(0, -1), shown[3], shown[4]
        v_images = v_image[:3].movedim(0, -1), v_image[3], v_image[4]

        moving = View(self.viewmat, view.intrinsics, width, height)
        tensors = (*(leaf.detach() for leaf in cloud.leaves), self.viewmat[None, None])
        subject = Subject.of(moving, Objects((n,), torch.eye(4)[None]), False, tensors)
        bins = Binned(own["ends"], own["gaussians"], own["isects"], own["ranges"].view(-1, 2)).to_warp()
        canvas = canvas_of(view, records, self._layers, torch.zeros(n, 0))
        ends, flat = wp.from_torch(own["ends"]), wp.from_torch(own["image"])
        run = run_size(n, cloud.threads)
        outputs = [as_records(records), ends, wp.from_torch(own["places"].view(self._runs, -1))]
        outputs += [wp.from_torch(own[name]) for name in ("depths", "spare_depths", "spare_isects")]
        outputs += [flat, wp.from_torch(self._total)]
        draw = crew.pack(
            kernels.composite, [subject.cloud, subject.lens, canvas, bins, run, self._among, *outputs], cloud.threads
        )

        v_subject = SubjectGradient.of(subject, tensors, cloud.moves, cloud.gradients)
        v_in = gradient_of((*v_images, None), (1, PLANES, height, width), records.device)
        inputs = [subject.cloud, subject.lens, canvas, bins, as_records(records), self._among]
        inputs += [flat, v_in, n, ends, v_subject.spans]
        outputs = [wp.from_torch(own["slots"].view(-1, 10), dtype=slot10), wp.from_torch(torch.zeros(0))]
        outputs += [
            as_records(own["v_records"]),
            wp.from_torch(torch.zeros(0, 0)),
            v_subject.v_cloud,
            v_subject.out_spans,
        ]
        adjoint = crew.pack(kernels.composite_adjoint, [*inputs, *outputs], cloud.threads)
        drawing = Drawing(*images, *v_images)
        return _Packed(cloud.generation, cloud.room, draw, adjoint, v_subject.v_spans, drawing)


@dataclass(frozen=True)
class Drawing:
    """A picture as it was drawn, and the gradients by it, to be filled before its adjoint."""

    rgb: Tensor
    """[H, W, 3]."""
    depth: Tensor
    """[H, W] sum of weight times centre depth [m]."""
    alpha: Tensor
    """[H, W]."""
    v_rgb: Tensor
    v_depth: Tensor
    v_alpha: Tensor


@dataclass(frozen=True)
class _Packed:
    generation: int
    room: int
    """For intersections."""
    draw: Callable[[], None]
    adjoint: Callable[[], None]
    v_spans: Tensor
    """[1, spans, 4, 4] by the pose."""
    drawing: Drawing
