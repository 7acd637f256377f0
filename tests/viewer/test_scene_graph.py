from dataclasses import replace

import numpy as np
import pytest

from dwgs.scene import Casting, InputError, Wheel
from viewer.scene_graph import SceneGraph


def test_clouds_are_the_very_objects_of_the_assets_so_that_they_are_uploaded_once(street):
    clouds = [cloud for cloud, _ in street.clouds_at(0.5)]
    (first, _), (second, _) = street.actors
    expected = [street.background.gaussians, first.shadow, first.body, second.shadow, second.body]
    assert all(a is b for a, b in zip(clouds, expected, strict=True))


def test_vehicles_stand_where_their_trajectories_say(street):
    clouds = street.clouds_at(0.25)
    np.testing.assert_array_equal(clouds[0][1], np.eye(4))
    np.testing.assert_array_equal(clouds[2][1], street.actors[0][1].at(0.25))
    assert len(street.clouds_at(1.5)) == 1


def test_the_sun_does_not_turn_with_a_vehicle(street):
    asset, trajectory = street.actors[0]
    heights = np.ones(len(asset.shadow), np.float32)
    here = trajectory.at(0.5)
    sun = np.array([0.6, 0, 0.8])
    at_rest = here[:3, :3].T @ (sun * [-1, 1, 1])  # as if it had shone from the other side
    cast = replace(asset, casting=Casting(sun, at_rest, heights))
    (shadow, world_from_shadow), *_ = SceneGraph(None, [(cast, trajectory)]).clouds_at(0.5)
    moved = (shadow.means - asset.shadow.means) @ world_from_shadow[:3, :3].T
    np.testing.assert_allclose(moved, np.broadcast_to([-1.5, 0, 0], moved.shape), atol=1e-5)


def test_wheels_are_clouds_of_their_own_that_turn_beside_what_stays_the_same(street):
    asset, trajectory = street.actors[0]
    rolling = replace(asset, wheels=(Wheel(np.array([1.2, 0.8, -0.4]), 0.3, 40),))
    graph = SceneGraph(None, [(rolling, trajectory)])
    (_, still, wheel), (_, later, turned) = ([cloud for cloud, _ in graph.clouds_at(t)] for t in (0.0, 0.1))
    assert still is later
    assert len(still) == len(asset.body) - 40
    np.testing.assert_allclose(wheel.means, asset.body.means[-40:], atol=1e-6)
    assert np.abs(turned.means - wheel.means).max() > 0.1


def test_the_sky_is_the_backgrounds_or_else_the_backdrop(street):
    assert street.sky is street.background.sky
    assert (SceneGraph(None).sky == 0).all()


def test_a_backdrop_that_is_no_sky_is_refused():
    with pytest.raises(InputError, match="backdrop"):
        SceneGraph(None, backdrop=np.zeros(3, np.float32))
