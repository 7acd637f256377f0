import numpy as np
import pytest

from dwgs.scene import InputError
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


def test_the_sky_is_the_backgrounds_or_else_the_backdrop(street):
    assert street.sky is street.background.sky
    assert (SceneGraph(None).sky == 0).all()


def test_a_backdrop_that_is_no_sky_is_refused():
    with pytest.raises(InputError, match="backdrop"):
        SceneGraph(None, backdrop=np.zeros(3, np.float32))
