"""The sheet of stills."""

import numpy as np
from PIL import Image

from dwgs.evaluation.sheet import LABEL, WIDTH, draw_sheet


def test_every_still_stands_in_the_row_of_its_system(tmp_path):
    colors = {"a": [(200, 0, 0), (0, 200, 0)], "b": [(0, 0, 200), (90, 90, 90)]}
    stills = {name: [np.full((20, 40, 3), c, np.uint8) for c in row] for name, row in colors.items()}
    draw_sheet(stills | {"absent": []}, tmp_path / "sheet.png")
    page = np.asarray(Image.open(tmp_path / "sheet.png"))
    height = LABEL + WIDTH // 2
    assert page.shape == (2 * height, 2 * WIDTH, 3)
    for i, row in enumerate(colors.values()):
        for j, color in enumerate(row):
            assert (page[i * height + LABEL + WIDTH // 4, j * WIDTH + WIDTH // 2] == color).all()
