"""What makes the pixels, as a person chooses it."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from dwgs.cli.stage import fingerprint
from dwgs.scene import InputError

if TYPE_CHECKING:
    from generator import Generator


@dataclass(frozen=True)
class BackendChoice:
    """Which backend makes the pixels, and how; all but the first two are for ``wan`` and ``vace``."""

    backend: str = "composite"
    """composite (the vehicle in the street's light), asset (Gaussians drawn as they are; neither needs weights,
    and both run on any machine), wan (the paper's: Wan2.1-VACE with a PointAdapter), or vace (the same network
    without points)."""
    asset: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Asset folder that the backend asset draws; by default one is made of the vehicle's points."""
    backbone: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of Wan2.1-VACE in diffusers' layout."""
    adapter: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of a PointAdapter, from `dwgs train`."""
    lora: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FILE[:STRENGTH]...")] = ()
    """Safetensors files that change the backbone, such as those that let Wan2.1 work in 4 to 8 steps; these want
    --guidance 1 and --shift 5."""
    strategy: Literal["global-to-local", "autoregressive", "single"] = "global-to-local"
    """How a video longer than 49 frames is made: anchors first and then what lies between, segment after
    segment, or all at once."""
    sampler: Literal["unipc", "euler"] = "unipc"
    """How noise becomes pixels."""
    sampling_steps: int = 30
    """Steps from noise to pixels."""
    shift: float = 3.0
    """Of the noise levels towards noise."""
    guidance: float = 2.5
    """How much the points (for vace: the text) are stressed; 1 is not at all."""
    guided: float = 1.0
    """Share of the steps that are guided; 0.5 saves a quarter of the time."""
    device: tuple[str, ...] = ()
    """cpu, cuda, or several such as cuda:0 cuda:1, which share the work; by default the first GPU."""
    weights: Literal["resident", "streamed", "float8"] | None = None
    """Where the weights live: on the device, fetched block by block, or there with 8 bits; by default what
    fits and changes no picture."""
    tiles: bool = False
    """Let the autoencoder work in tiles: less memory where images are large or the backbone is small."""
    attention: str | None = None
    """One of diffusers' attention backends, such as flash; by default PyTorch's."""
    whole_frame: bool = False
    """Paint whole images, told of by the LiDAR points of the whole street, and paste nothing recorded back:
    StreetCrafter's way, for an adapter of `dwgs train --whole-frame`."""

    def open(self, parts: Path | None = None) -> "Generator":
        """The backend; what can be wrong with its files is found now.

        Args:
            parts: Folder for finished parts of a video.
        """
        from generator import backend
        from generator.wan.settings import Lora, Sampling, WanSettings

        if self.whole_frame and self.backend in ("composite", "asset"):
            raise InputError(
                f"'{self.backend}' paints the vehicle into the recorded frame: leave --whole-frame out, or take wan"
            )
        if self.backbone is None or self.backend in ("composite", "asset"):
            return backend(self.backend, asset=self.asset)
        sampling = Sampling(self.sampler, self.sampling_steps, self.shift, self.guidance, self.guided)
        settings = WanSettings(
            self.backbone,
            self.adapter,
            self.strategy,
            sampling,
            self.device,
            self.weights,
            self.attention,
            self.whole_frame,
        )
        settings = replace(settings, loras=tuple(map(Lora.of, self.lora)), tiled=self.tiles)
        return backend(self.backend, settings, parts)

    def key(self) -> dict[str, Any]:
        """Everything that the pixels depend on."""
        from generator.wan.settings import Lora

        given = [self.asset, self.backbone, self.adapter, *(Lora.of(text).path for text in self.lora)]
        folders = [fingerprint(path) for path in given if path]
        return {**asdict(self), "folders": folders}


BackendOptions = Annotated[BackendChoice, tyro.conf.arg(name="")]
"""They stand beside those of the verb."""
