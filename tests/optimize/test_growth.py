import torch

from dwgs.optimize.growth import sample_errors


def generator():
    return torch.Generator().manual_seed(3)


def test_each_pixel_is_drawn_once_and_never_where_there_is_no_error():
    error = torch.zeros(20, 30)
    error[5:10, 3:9] = 1
    pixels = sample_errors(error, 25, generator())
    assert len(torch.unique(pixels, dim=0)) == 25
    assert (error[pixels[:, 0], pixels[:, 1]] > 0).all()
    assert len(sample_errors(error, 1000, generator())) == 30
    assert len(sample_errors(torch.zeros(4, 4), 3, generator())) == 0


def test_draws_follow_the_error_to_the_power_and_the_seed():
    error = torch.ones(200, 200)
    error[:100] = 4
    pixels = sample_errors(error, 2000, generator())
    share = (pixels[:, 0] < 100).float().mean()
    assert abs(share - 8 / 9) < 0.03
    assert torch.equal(pixels, sample_errors(error, 2000, generator()))
