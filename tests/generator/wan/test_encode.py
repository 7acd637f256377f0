import numpy as np
import pytest
import torch
from diffusers import FlowMatchEulerDiscreteScheduler, WanVACEPipeline

from generator.conditions.raster import GREY
from generator.wan.clip import Clip
from generator.wan.encode import Codec, ControlLatents, pack_mask
from generator.wan.tiny import tiny_transformer, tiny_vae

T, H, W = 9, 32, 48


@pytest.fixture(scope="module")
def codec():
    return Codec(tiny_vae())


@pytest.fixture
def clip():
    rng = np.random.default_rng(0)
    video = rng.integers(0, 256, (T, H, W, 3), np.uint8)
    region = np.zeros((T, H, W), bool)
    region[:, 8:20, 10:30] = True
    points = region & (rng.random((T, H, W)) < 0.3)
    image = np.where(points[..., None], rng.integers(130, 256, video.shape, np.uint8), np.uint8(GREY))
    return Clip(video, region, image, points)


def test_latents_and_masks_are_those_of_the_vace_pipeline(codec, clip):
    pipeline = WanVACEPipeline(None, None, codec.vae, FlowMatchEulerDiscreteScheduler(), tiny_transformer())
    video = torch.from_numpy(clip.video / np.float32(127.5) - 1).permute(3, 0, 1, 2)[None]
    mask = torch.from_numpy(clip.reactive_mask)[None, None].expand(1, 3, -1, -1, -1).float()
    with torch.no_grad():
        latents = pipeline.prepare_video_latents(video, mask, [[]])
    control = ControlLatents.of(clip, codec, "vace")
    torch.testing.assert_close(control.inactive, latents[:, :16])
    assert torch.equal(control.reactive_mask, pipeline.prepare_masks(mask, [[]]))


def test_a_mask_keeps_every_pixel_of_the_frames_it_takes():
    mask = np.random.default_rng(0).random((1, 16, 24)) < 0.5
    packed = pack_mask(mask, "group")[0, :, 0]
    for y, x in ((0, 0), (3, 17), (15, 23)):
        assert packed[8 * (y % 8) + x % 8, y // 8, x // 8] == mask[0, y, x]


@pytest.mark.parametrize(
    ("rule", "seen"),
    [
        ("vace", [[f] for f in (1, 5, 9, 13, 16, 20, 24, 28, 32, 35, 39, 43, 47)]),
        ("group", [[0], *(list(range(4 * j - 3, 4 * j + 1)) for j in range(1, 13))]),
    ],
)
def test_each_latent_frame_sees_the_frames_of_its_rule(rule, seen):
    for latent, frames in enumerate(seen):
        heard = []
        for frame in range(49):
            mask = np.zeros((49, 8, 8), bool)
            mask[frame] = True
            if pack_mask(mask, rule)[0, :, latent].all():
                heard.append(frame)
        assert heard == frames


def test_the_channels_are_inactive_point_reactive_mask_point_mask(codec, clip):
    control = ControlLatents.of(clip, codec, "group")
    stacked = control.for_adapter()
    assert stacked.shape == (1, 160, 3, H // 8, W // 8)
    for part, channels in (
        (control.inactive, slice(0, 16)),
        (control.points, slice(16, 32)),
        (control.reactive_mask, slice(32, 96)),
        (control.point_mask, slice(96, 160)),
    ):
        assert torch.equal(stacked[:, channels], part)
    assert torch.equal(control.for_vace(), stacked[:, :96])


def test_the_null_is_an_empty_point_render_encoded(codec, clip):
    empty = Clip(clip.video, clip.reactive_mask, np.full_like(clip.point_image, GREY), np.zeros_like(clip.point_mask))
    null = ControlLatents.of(clip, codec, "group").without_points(codec.encode_grey((T, H, W)))
    assert torch.equal(null.for_adapter(), ControlLatents.of(empty, codec, "group").for_adapter())
    assert null.points.abs().max() > 0.01  # grey pixels are no zero latents


def test_given_pixels_are_dense_in_the_region_and_change_nothing_else(clip):
    image = np.full((H, W, 3), 200, np.uint8)
    given = clip.given({4: image})
    assert np.array_equal(given.point_mask[4], clip.reactive_mask[4])
    assert (given.point_image[4][clip.reactive_mask[4]] == 200).all()
    assert (given.point_image[4][~clip.reactive_mask[4]] == GREY).all()
    others = [0, 1, 2, 3, 5, 6, 7, 8]
    assert np.array_equal(given.point_image[others], clip.point_image[others])
    assert given.reactive_mask is clip.reactive_mask
    assert given.video is clip.video


def test_what_lies_outside_the_region_is_the_recording_bit_by_bit(clip):
    restored = clip.restored(255 - clip.video)
    assert np.array_equal(restored[~clip.reactive_mask], clip.video[~clip.reactive_mask])
    assert np.array_equal(restored[clip.reactive_mask], 255 - clip.video[clip.reactive_mask])


def test_encoding_is_causal_and_takes_the_mode(codec, clip):
    shown = np.ones((T, H, W), bool)
    whole, again = (codec.encode(clip.video, shown) for _ in range(2))
    assert torch.equal(whole, again)
    torch.testing.assert_close(codec.encode(clip.video[:5], shown[:5]), whole[:, :, :2])
    assert codec.decode(whole).shape == clip.video.shape
