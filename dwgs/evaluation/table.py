"""The table of an evaluation: for people in Markdown, for programs in JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dwgs.evaluation.columns import COLUMNS, FRECHET_SAMPLES, PAPER, Column, Measured
from dwgs.metrics.bootstrap import LEVEL, bootstrap_interval


@dataclass(frozen=True)
class Cell:
    """One system, one measure."""

    value: float | None = None
    """None where there is none; then `reason` says why."""
    interval: tuple[float, float] | None = None
    """Of the bootstrap over sequences; None for one sequence alone."""
    sequences: int = 0
    """So many count."""
    reason: str = ""
    """Why there is no value; empty where the measure means nothing for the system."""


@dataclass(frozen=True)
class Table:
    """Systems in rows, measures in columns."""

    rows: dict[str, dict[str, Cell]]
    """System to column's key to cell."""
    absent: dict[str, str] = field(default_factory=dict)
    """System that did not run to the reason; its row is empty."""

    def markdown(self) -> str:
        """Two tables, the paper's measures and the others, and what they mean."""
        parts = []
        for columns in (COLUMNS[:PAPER], COLUMNS[PAPER:]):
            lines = [["system", *(c.heading for c in columns)], ["---"] * (1 + len(columns))]
            lines += [[system, *(self._text(system, column) for column in columns)] for system in self.rows]
            parts += ["\n".join(f"| {' | '.join(line)} |" for line in lines), ""]
        parts += [f"- {c.title}: {c.meaning}" for c in COLUMNS]
        parts.append(f"- [a, b]: {LEVEL:.0%} bootstrap interval over sequences; - where a measure means nothing")
        parts.append("- better is ↑ higher, ↓ lower, ≈ nearer to the ground truth's")
        parts += [f"- {system} is unavailable: {reason}" for system, reason in self.absent.items()]
        return "\n".join(parts) + "\n"

    def _text(self, system: str, column: Column) -> str:
        """A cell for people."""
        cell = self.rows[system][column.key]
        if cell.value is None:
            words = "unavailable" if system in self.absent else "-"
            return f"unavailable: {cell.reason}" if cell.reason else words
        words = _number(cell.value, column.digits)
        if cell.interval is not None and cell.interval[0] != cell.interval[1]:
            words += f" [{', '.join(_number(end, column.digits) for end in cell.interval)}]"
        return words

    def document(self) -> dict[str, Any]:
        """JSON values; an infinite PSNR is the string "inf"."""
        return {
            "columns": [{"key": c.key, "title": c.title, "meaning": c.meaning, "better": c.better} for c in COLUMNS],
            "systems": {
                system: {key: _entry(cell) for key, cell in cells.items()} for system, cells in self.rows.items()
            },
            "absent": self.absent,
        }


def tabulate(systems: Mapping[str, Sequence[Measured] | str], unavailable: Mapping[str, str], seed: int = 0) -> Table:
    """The table of what was measured.

    Args:
        systems: To each system its sequences, or the reason why it did not run.
        unavailable: Column's key to the reason why nothing is measured there.
        seed: Of the bootstrap.
    """
    absent = {name: reason for name, reason in systems.items() if isinstance(reason, str)}
    ran = {name: () if isinstance(sequences, str) else sequences for name, sequences in systems.items()}
    return Table({name: _row(sequences, unavailable, seed) for name, sequences in ran.items()}, absent)


def _row(sequences: Sequence[Measured], unavailable: Mapping[str, str], seed: int) -> dict[str, Cell]:
    cells = {}
    for column in COLUMNS:
        counted = [m for m in sequences if column.has(m)]
        if column.key in unavailable:
            cells[column.key] = Cell(reason=unavailable[column.key])
        elif counted:
            samples = FRECHET_SAMPLES if column.is_frechet else 1000
            interval = bootstrap_interval(counted, column.pool, samples, seed)
            cells[column.key] = Cell(column.pool(counted), interval, len(counted))
        elif any(column.key in m.features for m in sequences):
            cells[column.key] = Cell(reason="no sequence is long enough")
        else:
            cells[column.key] = Cell()
    return cells


def _number(value: float, digits: int) -> str:
    return "∞" if math.isinf(value) else f"{value:.{digits}f}"


def _entry(cell: Cell) -> dict[str, Any]:
    if cell.value is None:
        return {"value": None, "reason": cell.reason or "means nothing here"}
    numbers = [cell.value, *(cell.interval or ())]
    value, *interval = ["inf" if math.isinf(x) else round(x, 6) for x in numbers]
    return {"value": value, "interval": interval or None, "sequences": cell.sequences}
