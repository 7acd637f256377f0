"""dwgs evaluate: systems compared over a list of drives, as one table."""

import json
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from dwgs.cli.backend import BackendOptions
from dwgs.cli.cases import Case, read_cases
from dwgs.cli.options import Clip
from dwgs.cli.progress import say
from dwgs.cli.stage import versions
from dwgs.cli.systems import SYSTEMS, System
from dwgs.cli.trial import Effort, Trial
from dwgs.files import new_file
from dwgs.scene import InputError

if TYPE_CHECKING:
    from dwgs.evaluation import Measured, Table
    from dwgs.metrics.network import NetworkFile

STREETS = ("street:0", "street:1", "street:2")
"""Evaluated where nothing else is named."""
NETWORKS = ("fid", "fvd", "lpips")
"""Options that name a network; columns that need it are called the same."""
JOINT = ("joint_psnr", "joint_ssim")
"""Columns that --joint fills."""


@dataclass(frozen=True)
class Evaluate:
    """Compare systems over a list of drives: the paper's measures, and what needs no weights, in one table."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the table, its plot and all that it comes from; what has not changed is not made again."""
    effort: Annotated[Effort, tyro.conf.arg(name="")]
    given: BackendOptions
    scenes: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")] = STREETS
    """Embedded streets ('street:0', 'street:1', ...), whose truth is known; or JSON files that list drives with
    their vehicles: [{"scene": DIR, "vehicle": CAR, "ahead": 14, "left": 3.3, "frames": "30-78"}, ...]."""
    systems: tuple[str, ...] = SYSTEMS
    """Rows of the table; -D is the distillation of the system before it."""
    trained: Annotated[dict[str, Path], tyro.conf.arg(metavar="SYSTEM DIR ...")] = field(default_factory=dict)
    """Folders of `dwgs train` with the weights that a system has of its own: streetcrafter and the ablations
    wan-finetuned, wan-pixels, wan-autoregressive; wan takes those of --adapter, or its own, too."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="FIRST-LAST")] = None
    """First and last frame where a drive does not say; by default all."""
    size: Annotated[str | None, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = None
    """Width x height [px] to work at where a drive does not say; by default 720x480, the paper's."""
    fid: Annotated[str | None, tyro.conf.arg(metavar="FILE:SHA256")] = None
    """TorchScript network of image features, and its hash."""
    fvd: Annotated[str | None, tyro.conf.arg(metavar="FILE:SHA256")] = None
    """TorchScript network of clip features, and its hash."""
    lpips: Annotated[str | None, tyro.conf.arg(metavar="FILE:SHA256")] = None
    """TorchScript network of perceptual distance, and its hash."""

    def run(self) -> None:
        """Leave table.md, table.json, table.png and sheet.png."""
        from dwgs.evaluation import tabulate
        from dwgs.evaluation.sheet import draw_sheet

        systems = [System.of(name, self.given, self.trained) for name in dict.fromkeys(self.systems)]
        networks = self._networks()
        cases = read_cases(self.scenes, Clip("", frames=self.frames, size=self.size))
        absent = {system.name: system.obstacle for system in systems if system.obstacle}
        results: dict[str, list[Measured]] = {system.name: [] for system in systems}
        stills: dict[str, list[NDArray[np.uint8]]] = {system.name: [] for system in systems}
        for case in cases:
            say(f"[bold]{case.name}")
            trial = Trial.prepare(case, self.out / case.name, self.effort, networks)
            for name, system in ((s.name, s) for s in systems if s.name not in absent):
                say(f"[bold]{case.name} {name}")
                try:
                    measured = trial.judge(system)
                except InputError as error:  # the other systems' table is not lost by it
                    absent[name] = f"{case.name}: {error}"
                    say(f"{name} cannot go on: {error}")
                    continue
                if measured:
                    results[name].append(measured)
                    stills[name].append(trial.still(system))
        table = tabulate(
            {name: absent.get(name) or results[name] for name in results},
            self._missing(networks),
            self.effort.seed,
        )
        self._write(table, cases)
        draw_sheet(stills, self.out / "sheet.png")
        say(f"look at {self.out / 'table.png'}, {self.out / 'sheet.png'}")

    def _networks(self) -> "dict[str, NetworkFile]":
        """The files that are given, by the key of their column; each is loaded once before anything runs."""
        from dwgs.metrics.network import Network, NetworkFile

        given = {key: getattr(self, key) for key in NETWORKS if getattr(self, key) is not None}
        networks = {key: NetworkFile.parse(text) for key, text in given.items()}
        for file in networks.values():
            Network(file)
        return networks

    def _missing(self, networks: "dict[str, NetworkFile]") -> dict[str, str]:
        """Key of a column to what would fill it."""
        options = {key: f"--{key} FILE" for key in NETWORKS if key not in networks}
        return options if self.effort.joint else options | dict.fromkeys(JOINT, "--joint")

    def _write(self, table: "Table", cases: list[Case]) -> None:
        from dwgs.evaluation.plot import plot

        document: dict[str, Any] = {
            "command": "dwgs " + " ".join(sys.argv[1:]),
            "settings": asdict(self),
            "cases": [asdict(case) for case in cases],
            "versions": versions(),
            **table.document(),
        }
        text = table.markdown()
        with new_file(self.out / "table.md") as draft:
            draft.write_text(text, encoding="utf-8")
        with new_file(self.out / "table.json") as draft:
            draft.write_text(json.dumps(document, indent=2, default=str))
        plot(table, self.out / "table.png")
        print(text, end="")
