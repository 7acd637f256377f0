"""The README's picture, from what `make demo` leaves in out/demo: `python docs/make_teaser.py`."""

from pathlib import Path

import av
import numpy as np
from PIL import Image

from dwgs.datasets import folder

FRAME = 60
"""Of the drive: the vehicle is seen from behind and from its side."""
ORBIT_FRAMES = (3, 15, 27, 39)
WIDTH = 640


def main() -> None:
    """Write docs/teaser.jpg."""
    out = Path("out/demo")
    pictures = [
        drive.frames[drive.main_camera][FRAME].pixels for drive in map(folder.read, (out / "recorded", out / "edited"))
    ]
    with av.open(str(out / "orbit.mp4")) as film:
        turns = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    top = np.concatenate([np.asarray(Image.fromarray(p).resize((WIDTH, WIDTH * 2 // 3))) for p in pictures], 1)
    size = (WIDTH // 2, WIDTH // 3)
    bottom = np.concatenate([np.asarray(Image.fromarray(turns[i]).resize(size)) for i in ORBIT_FRAMES], 1)
    Image.fromarray(np.concatenate([top, bottom])).save("docs/teaser.jpg", quality=88)


main()
