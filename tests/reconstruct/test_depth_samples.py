import numpy as np

from dwgs.reconstruct.depth_samples import depth_samples


def test_a_depth_hidden_by_something_nearer_is_no_sample(drive):
    camera = drive.frames["front"][0].camera
    wall = np.array([[20, y, z] for y in np.linspace(-2, 2, 60) for z in np.linspace(0.5, 2.5, 40)], np.float32)
    pixels, depths = depth_samples(
        np.concatenate([wall, wall * [0.4, 0.4, 0.4] + [0, 0, 0.9]]).astype(np.float32), camera
    )
    assert len(np.unique(pixels, axis=0)) == len(pixels)
    np.testing.assert_allclose(depths, 8, atol=1e-4)
