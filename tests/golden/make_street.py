"""Makes street.png, the street as last approved: run this file after looking at what it makes."""

from pathlib import Path

from PIL import Image

from dwgs.street import build_street

GOLDEN = Path(__file__).with_name("street.png")


def golden_frame():
    """One frame of the oracle: everything the street draws, the inserted vehicle too. [120, 180, 3] uint8."""
    street = build_street(seed=0, frames=40, width=180, height=120)
    return street.oracle(street.insertion()).frames["front"][30].pixels


if __name__ == "__main__":
    Image.fromarray(golden_frame()).save(GOLDEN, optimize=True)
