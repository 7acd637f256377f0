import numpy as np
import pytest

from dwgs.distill.appearance import Appearance
from dwgs.distill.lacquer import FACED, mirrored
from dwgs.distill.light import find_light
from dwgs.scene.color import linear_from_srgb, srgb_from_linear

SUN = np.array([-0.55, 0.41, 0.73])
RIGHT = np.array([-0.8, -0.6, 0])
AROUND = np.array([0.1, 0.2, 0.5, 0.7])
"""What is mirrored of the ground, across and along the way, and of the sky."""
FLAT = [-1, 0, 0.1], [0, -1, 0.1]
"""Toward a camera behind and one beside."""


def sphere(count=3000, seed=0):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def shaded(paints, normals, shares, sun=1.2):
    """Colours as the model has them, under a grey sky and `SUN`."""
    irradiance = 0.25 + 0.1 * normals[:, 2] + sun * np.maximum(normals @ SUN / np.linalg.norm(SUN), 0)
    kept = 1 - shares.sum(1, keepdims=True)
    return srgb_from_linear(kept * linear_from_srgb(paints) * irradiance[:, None] + (shares @ AROUND)[:, None])


def seen_from_the_right(sun=1.2):
    """A sphere, its paints, and what a camera behind it on the right shows of it."""
    normals = sphere()
    paints = np.random.default_rng(1).uniform(0.1, 0.6, (len(normals), 3))
    shares = mirrored(normals, np.tile(RIGHT, (len(normals), 1)))
    seen = normals @ RIGHT > 0.1
    colors = np.where(seen[:, None], shaded(paints, normals, shares, sun), 0)
    return paints, Appearance(normals, colors, seen.astype(float), np.where(seen[:, None], shares, 0))


def test_linear_light_and_srgb_are_inverse():
    values = np.linspace(0, 1, 50)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(values)), values, atol=1e-6)


def straight_on(normals):
    return mirrored(normals, normals)


@pytest.mark.parametrize("is_known", [False, True])
@pytest.mark.parametrize("sun", [0.0, 1.2])
def test_the_light_on_the_sides_that_are_not_seen_is_found(sun, is_known):
    paints, appearance = seen_from_the_right(sun)
    hidden, shares = ~appearance.is_seen, straight_on(appearance.normals)
    light = find_light(paints, appearance, SUN / np.linalg.norm(SUN) if is_known else None)
    found = srgb_from_linear(light.shown(paints, appearance.normals, shares))[hidden]
    truth = shaded(paints, appearance.normals, shares, sun)[hidden]
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.04


def test_the_sun_is_where_it_shines_from():
    light = find_light(*seen_from_the_right())
    direction = light.shares @ light.suns
    assert direction @ SUN / np.linalg.norm(direction) / np.linalg.norm(SUN) > 0.97


def test_black_lacquer_seen_flat_from_behind_mirrors_sky_and_from_beside_what_stands_there():
    paints, appearance = seen_from_the_right()
    light = find_light(paints, appearance, SUN / np.linalg.norm(SUN))
    roof, black = np.array([[0, 0, 1.0]]), np.zeros((1, 3))
    behind, beside = (light.shown(black, roof, mirrored(roof, np.array([toward]))) for toward in FLAT)
    assert (behind > 1.5 * beside).all()


def test_a_surface_mirrors_a_little_from_ahead_and_all_where_it_is_grazed():
    normals = sphere(50)
    tangents = np.cross(normals, [0.3, 0.5, 0.8])
    np.testing.assert_allclose(mirrored(normals, 3 * normals).sum(1), FACED)
    np.testing.assert_allclose(mirrored(normals, 3 * tangents).sum(1), 1)


def test_a_red_car_does_not_stand_in_blue_light():
    _, appearance = seen_from_the_right()
    red = np.tile([0.8, 0.05, 0.02], (len(appearance.normals), 1))
    shown = shaded(red, appearance.normals, appearance.mirrored)
    red_appearance = Appearance(appearance.normals, shown, appearance.pixels, appearance.mirrored)
    nothing = np.zeros_like(appearance.mirrored)
    white = find_light(red, red_appearance).shown(np.full_like(red, 0.8), appearance.normals, nothing)
    np.testing.assert_allclose(white[:, 2], white[:, 0], rtol=0.35, atol=0.05)


def test_one_disc_is_enough_to_say_how_bright_it_is():
    up, paint = np.array([[0, 0, 1.0]]), np.full((1, 3), 0.4)
    one = Appearance(up, np.array([[0.5, 0.5, 0.5]]), np.ones(1), straight_on(up))
    found = srgb_from_linear(find_light(paint, one).shown(paint, up, one.mirrored))
    np.testing.assert_allclose(found, 0.5, atol=0.03)
