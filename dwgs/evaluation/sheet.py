"""One still of every system on every drive, side by side: numbers are to be looked at."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dwgs.files import new_file

WIDTH = 320
"""Of a still [px]."""
LABEL = 22
"""Height of the line above it [px]."""


def draw_sheet(stills: Mapping[str, Sequence[NDArray[np.uint8]]], path: Path) -> None:
    """Write a PNG with a row of stills [H, W, 3] for each system that has some; heights follow the images."""
    rows = {name: [_scaled(still) for still in row] for name, row in stills.items() if row}
    heights = [LABEL + max(image.height for image in row) for row in rows.values()]
    width = WIDTH * max((len(row) for row in rows.values()), default=1)
    page = Image.new("RGB", (width, max(sum(heights), 1)), "white")
    draw, font, top = ImageDraw.Draw(page), ImageFont.load_default(14), 0
    for (name, row), height in zip(rows.items(), heights, strict=True):
        draw.text((4, top + 2), name, "#1c2126", font)
        for column, image in enumerate(row):
            page.paste(image, (column * WIDTH, top + LABEL))
        top += height
    with new_file(path) as draft:
        page.save(draft)


def _scaled(still: NDArray[np.uint8]) -> Image.Image:
    height, width = still.shape[:2]
    return Image.fromarray(still).resize((WIDTH, max(round(WIDTH * height / width), 1)), Image.Resampling.LANCZOS)
