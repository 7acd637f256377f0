import numpy as np
import pytest

from dwgs.distill.appearance import Appearance
from dwgs.distill.light import find_light, fresnel
from dwgs.scene.color import linear_from_srgb, srgb_from_linear

SUN = np.array([-0.55, 0.41, 0.73])


def sphere(count=3000, seed=0):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def shaded(paints, normals, cosines, sun=1.2, gloss=0.02, mirror=0.15):
    """Colours as the model has them, under a grey sky and `SUN`."""
    irradiance = 0.25 + 0.1 * normals[:, 2] + sun * np.maximum(normals @ SUN / np.linalg.norm(SUN), 0)
    return srgb_from_linear(linear_from_srgb(paints) * irradiance[:, None] + gloss + mirror * fresnel(cosines)[:, None])


def seen_from_the_right(sun=1.2):
    """A sphere, its paints, and what a camera behind it on the right shows of it."""
    normals = sphere()
    paints = np.random.default_rng(1).uniform(0.1, 0.6, (len(normals), 3))
    cosines = normals @ [-0.8, -0.6, 0]
    seen = cosines > 0.1
    colors = np.where(seen[:, None], shaded(paints, normals, cosines, sun), 0)
    return paints, Appearance(normals, colors, seen.astype(float), np.where(seen, cosines, 0))


def test_linear_light_and_srgb_are_inverse():
    values = np.linspace(0, 1, 50)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(values)), values, atol=1e-6)


@pytest.mark.parametrize("sun", [0.0, 1.2])
def test_the_light_on_the_sides_that_are_not_seen_is_found(sun):
    paints, appearance = seen_from_the_right(sun)
    hidden = ~appearance.is_seen
    found = srgb_from_linear(find_light(paints, appearance).diffuse(paints, appearance.normals))[hidden]
    truth = shaded(paints, appearance.normals, np.ones(len(paints)), sun)[hidden]
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.04


def test_the_sun_is_where_it_shines_from():
    light = find_light(*seen_from_the_right())
    direction = light.shares @ light.suns
    assert direction @ SUN / np.linalg.norm(direction) / np.linalg.norm(SUN) > 0.97


def test_a_red_car_does_not_stand_in_blue_light():
    _, appearance = seen_from_the_right()
    red = np.tile([0.8, 0.05, 0.02], (len(appearance.normals), 1))
    shown = shaded(red, appearance.normals, appearance.cosines)
    red_appearance = Appearance(appearance.normals, shown, appearance.pixels, appearance.cosines)
    white = find_light(red, red_appearance).diffuse(np.full_like(red, 0.8), appearance.normals)
    np.testing.assert_allclose(white[:, 2], white[:, 0], rtol=0.35, atol=0.05)


def test_one_disc_is_enough_to_say_how_bright_it_is():
    one = Appearance(np.array([[0, 0, 1.0]]), np.array([[0.5, 0.5, 0.5]]), np.ones(1), np.ones(1))
    found = srgb_from_linear(find_light(np.full((1, 3), 0.4), one).diffuse(np.full((1, 3), 0.4), one.normals))
    np.testing.assert_allclose(found, 0.5, atol=0.03)
