import torch

from dwgs.reconstruct.inpaint import fill_smoothly


def test_what_is_known_stays():
    image = torch.rand(13, 22, 3, generator=torch.Generator().manual_seed(0))
    weight = torch.ones(13, 22)
    weight[4:9, 6:15] = 0
    filled = fill_smoothly(image, weight)
    torch.testing.assert_close(filled[weight == 1], image[weight == 1])


def test_a_hole_never_leaves_the_range_of_its_surroundings():
    image = torch.full((40, 40, 1), 0.3)
    image[:, 20:] = 0.6
    weight = torch.ones(40, 40)
    weight[10:30, 10:30] = 0
    image[10:30, 10:30] = 99
    for stride in (1, 4):
        filled = fill_smoothly(image, weight, stride)[10:30, 10:30]
        assert filled.min() > 0.299
        assert filled.max() < 0.601
        assert filled[:, 0].mean() < filled[:, -1].mean() - 0.1


def test_nothing_known_is_black():
    assert (fill_smoothly(torch.rand(5, 7, 3), torch.zeros(5, 7)) == 0).all()
