import numpy as np
import pytest
from toy_street import SIZE

from dwgs.distill.config import GENERATED
from dwgs.distill.layers import FrozenBackground
from dwgs.distill.shadow import initialize_shadow
from dwgs.distill.shots import find_sights
from dwgs.scene.pose import transform_points


@pytest.fixture
def sights(toy):
    return find_sights(toy.scene(), FrozenBackground(toy.background, []), toy.insertion, GENERATED, threads=1)


def test_the_shadow_lies_on_the_ground_around_the_box(sights):
    shadow = initialize_shadow(SIZE, 1.0, sights)
    assert len(shadow) > 20
    assert np.abs(shadow.means[:, 2] + SIZE[2] / 2).max() < 0.1
    assert (np.abs(shadow.means[:, :2]) < SIZE[:2] / 2 + 1).all()
    assert (shadow.scales[:, 2] < 0.2 * shadow.scales[:, 0]).all()


def test_no_shadow_begins_where_only_the_box_was_seen(sights):
    shadow = initialize_shadow(SIZE, 1.0, sights)
    left = shadow.means[:, 1] > SIZE[1] / 2  # the side away from the camera
    assert left.mean() < 0.2


def test_no_shadow_begins_where_nothing_may_change(sights):
    sight = sights[5]
    shadow = initialize_shadow(SIZE, 6.0, [sight])
    pixels, _ = sight.camera.project(transform_points(sight.world_from_vehicle, shadow.means))
    inside = (pixels >= 0).all(1) & (pixels < (sight.camera.width, sight.camera.height)).all(1)
    column, row = pixels[inside].astype(int).T
    assert inside.sum() > 20
    assert sight.frame.reactive_mask[row, column].all()


def test_without_frames_there_is_no_shadow():
    assert len(initialize_shadow(SIZE, 1.0, [])) == 0


def test_with_no_margin_there_is_no_shadow(sights):
    assert len(initialize_shadow(SIZE, 0.0, sights)) == 0
