"""The table of an evaluation as a picture."""

import math
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dwgs.evaluation.columns import COLUMNS, Column
from dwgs.evaluation.table import Cell, Table
from dwgs.files import new_file

INK, GREY, FAINT, PLAIN, DISTILLED = "#1c2126", "#8a939c", "#dfe3e7", "#2563eb", "#c2410c"
ACROSS = 4
"""Panels side by side."""


def plot(table: Table, path: Path) -> None:
    """Write a PNG: a panel for each measure with values, a mark and its interval for each system that has one."""
    columns = [c for c in COLUMNS if any(_is_finite(cells[c.key]) for cells in table.rows.values())]
    systems = [s for s, cells in table.rows.items() if any(_is_finite(cells[c.key]) for c in columns)]
    across = min(ACROSS, max(len(columns), 1))
    down = max(math.ceil(len(columns) / across), 1)
    figure = Figure(figsize=(3.4 * across + 1, (0.32 * len(systems) + 1) * down), layout="constrained", dpi=120)
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for number, axes in enumerate(panels):
        if number < len(columns):
            _panel(axes, columns[number], {s: table.rows[s][columns[number].key] for s in systems})
            if number % across:
                axes.set_yticklabels([])
        else:
            axes.set_axis_off()
    with new_file(path) as draft:
        canvas.print_png(draft)


def _panel(axes: Axes, column: Column, cells: dict[str, Cell]) -> None:
    for row, (system, cell) in enumerate(cells.items()):
        if cell.value is None or not math.isfinite(cell.value):
            words = "exact" if cell.value is not None else "unavailable" if cell.reason else ""
            place = axes.get_yaxis_transform()
            axes.text(0.5, row, words, transform=place, ha="center", va="center", color=GREY, size=7)
            continue
        color = DISTILLED if system.endswith("-D") else PLAIN
        if cell.interval is not None and all(map(math.isfinite, cell.interval)):
            axes.plot(cell.interval, (row, row), color=color, linewidth=2, alpha=0.4, solid_capstyle="butt")
        axes.plot([cell.value], [row], "o", color=color, markersize=5)
    axes.set_yticks(range(len(cells)), list(cells))
    axes.set_ylim(len(cells) - 0.5, -0.5)
    axes.set_title(column.heading, size=9, color=INK, loc="left")
    axes.grid(axis="x", color=FAINT)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=7, length=0, colors=INK)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)


def _is_finite(cell: Cell) -> bool:
    return cell.value is not None and math.isfinite(cell.value)
