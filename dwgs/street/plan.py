"""Where everything stands, drawn by lot."""

from dataclasses import dataclass

import numpy as np

from dwgs.scene.trajectory import Trajectory
from dwgs.street.buildings import build_house
from dwgs.street.car import DESIGNS, SEDAN, CarDesign, build_car, face_forward, paint_car
from dwgs.street.drive import ego_x, key_times, lead_trajectory, oncoming_trajectory
from dwgs.street.material import Palette
from dwgs.street.road import (
    KERB_HEIGHT,
    LEFT_KERB,
    PAVEMENT,
    RIGHT_KERB,
    build_bollard,
    build_floor,
    build_kerbs,
    build_lamp,
    build_sign,
)
from dwgs.street.shape import Shape
from dwgs.street.trees import build_tree

PAINTS = (
    (188, 190, 192), (34, 36, 40), (226, 226, 224), (122, 24, 28), (32, 58, 106), (96, 100, 104),
    (40, 70, 60), (150, 136, 108), (70, 92, 118), (178, 96, 34),
)  # fmt: skip
HERO_PAINT = (196, 62, 34)
"""Of the vehicle to be inserted."""
LEAD_PAINT = (206, 208, 210)
"""Of the car that drives ahead."""
BEHIND = 45.0
"""How far the street reaches behind the first frame [m]."""
AHEAD = 190.0
"""How far it goes on before the last frame [m]."""


@dataclass(frozen=True)
class Vehicle:
    """A car on the road: moving ones are bodies of their own, parked ones belong to the still world."""

    shape: Shape
    """In its own frame."""
    size: tuple[float, float, float]
    """(length, width, height) of its box [m]."""
    trajectory: Trajectory
    """Pose of the box centre."""


@dataclass(frozen=True)
class Plan:
    """A street, not yet on the device."""

    palette: Palette
    """Looks."""
    floor: Shape
    """The ground: level pieces that face up."""
    still: Shape
    """All that stands on it but the cars."""
    parked: tuple[Vehicle, ...]
    """Cars at the kerbs."""
    movers: tuple[Vehicle, ...]
    """Recorded traffic."""
    hero: Vehicle
    """The vehicle to be inserted; it stands at the origin."""


def draw_plan(seed: int, frames: int) -> Plan:
    """A street long enough for a drive of so many frames."""
    rng = np.random.default_rng((seed, 7))
    palette = Palette()
    start, stop = -BEHIND, float(ego_x(key_times(frames))[-1]) + AHEAD
    right_front, left_front = RIGHT_KERB - PAVEMENT, LEFT_KERB + PAVEMENT
    ends = start - 20, stop + 40
    pieces = [build_kerbs(palette, *ends)]
    for front in (right_front, left_front):
        x = start
        while x < stop:
            width = float(rng.uniform(7.5, 15))
            pieces.append(build_house(palette, x, front, width, rng))
            x += width + (0.0 if rng.random() < 0.8 else float(rng.uniform(2.5, 5.0)))
    trees = [build_tree(palette, rng) for _ in range(4)]
    for kerb, inward in ((RIGHT_KERB, -1), (LEFT_KERB, 1)):
        for x in np.arange(start + rng.uniform(4, 9), stop, 17.0):
            shift = rng.uniform(-1.5, 1.5)
            if rng.random() < 0.85:
                turn = face_forward(0, 0, 0, rng.uniform(0, 2 * np.pi))
                tree = trees[rng.integers(len(trees))].moved(turn)
                pieces.append(tree.at(x + shift, kerb + inward * 0.8, KERB_HEIGHT))
        lamp = build_lamp(palette, -inward)
        pieces += [lamp.at(x, kerb + inward * 0.5, KERB_HEIGHT) for x in np.arange(start + 11, stop, 34.0)]
        sign = build_sign(palette, (176, 28, 30) if inward < 0 else (24, 74, 150))
        pieces += [sign.at(x, kerb + inward * 0.45, KERB_HEIGHT) for x in np.arange(start + 21, stop, 55.0)]
        bollard = build_bollard(palette)
        for x in np.arange(52.0, stop - 10, 92.0):
            pieces += [bollard.at(x + d, kerb + inward * 0.4, KERB_HEIGHT) for d in (-1.2, 5.0, 6.6, -2.8)]

    cars = [build_car(design) for design in DESIGNS]
    times = key_times(frames)

    def car(kind: int) -> tuple[Shape, CarDesign]:
        return paint_car(cars[kind], palette, PAINTS[rng.integers(len(PAINTS))]), DESIGNS[kind]

    parked = []
    for y, yaw in ((RIGHT_KERB + 1.12, 0.0), (LEFT_KERB - 1.12, np.pi)):
        for x in np.arange(start + 4.1, stop - 4, 6.2):
            on_crossing = (x - 52.0) % 92.0 < 8 or (x - 52.0) % 92.0 > 86
            if rng.random() < 0.42 or on_crossing:
                continue
            shape, design = car(rng.choice(4, p=(0.35, 0.35, 0.2, 0.1)))
            world_from_car = face_forward(x + rng.uniform(-0.3, 0.3), y, design.size[2], yaw + rng.normal(0, 0.01))
            stands = Trajectory(times[[0, -1]], np.stack([world_from_car, world_from_car]))
            parked.append(Vehicle(shape, design.size, stands))
    movers = []
    shape, design = paint_car(cars[2], palette, LEAD_PAINT), DESIGNS[2]
    movers.append(Vehicle(shape, design.size, lead_trajectory(frames, design.size[2])))
    for begin, speed in ((46.0, 7.5), (118.0, 8.0), (215.0, 7.2)):
        shape, design = car(rng.choice(4, p=(0.4, 0.4, 0.1, 0.1)))
        movers.append(Vehicle(shape, design.size, oncoming_trajectory(frames, design.size[2], begin, speed)))
    hero = paint_car(build_car(SEDAN), palette, HERO_PAINT)
    origin = Trajectory(times[:1], np.eye(4)[None])
    still = Shape.join(pieces)
    return Plan(
        palette,
        build_floor(palette, *ends),
        still,
        tuple(parked),
        tuple(movers),
        Vehicle(hero, SEDAN.size, origin),
    )
