"""Two renderers that share no line of code guard each other."""

import numpy as np
import pytest
from random_world import camera, psnr

from dwgs.scene import Gaussians, VehicleAsset
from dwgs.scene.sky import sky_image
from dwgs.splat import Splats, View, composite, project, reference
from viewer.scene_graph import SceneGraph


@pytest.mark.parametrize("time", [0.0, 0.37, 1.0])
def test_the_viewer_agrees_with_the_splatter(renderer, street, time):
    view = camera(time=time)
    parts = [
        project(Splats.from_gaussians(cloud), View.from_camera(view, world_from_cloud))
        for cloud, world_from_cloud in street.clouds_at(time)
    ]
    rendering = composite(parts, View.from_camera(view))
    alpha = rendering.alpha.numpy()
    image = renderer.render(street, view)
    rgb = rendering.rgb.numpy() + (1 - alpha)[..., None] * sky_image(street.sky, view)
    assert psnr(image.rgb, rgb) > 90
    assert psnr(image.alpha, alpha) > 90
    assert abs(image.depth - rendering.expected_depth.numpy())[alpha > 0.5].max() < 0.02


def test_the_viewer_agrees_with_the_specification(renderer, street):
    view = camera()
    cloud = street.actors[0][0].body
    world_from_cloud = street.actors[0][1].at(0.5)
    exact = reference.render(Splats.from_gaussians(cloud), View.from_camera(view, world_from_cloud))
    bare = VehicleAsset(cloud, Gaussians.empty(), np.ones(3))
    image = renderer.render(SceneGraph(None, [(bare, street.actors[0][1])]), view)
    assert psnr(image.rgb, exact.rgb.numpy()) > 90
