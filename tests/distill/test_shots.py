import numpy as np

import dwgs.distill.shots as shots_module
from dwgs.distill.config import GENERATED
from dwgs.distill.layers import FrozenBackground
from dwgs.distill.model import body_bounds
from dwgs.distill.shots import find_sights, prepare_shots


def prepared(toy, **options):
    frozen = FrozenBackground(toy.background, [])
    sights = find_sights(toy.scene(), frozen, toy.insertion, GENERATED, threads=1)
    scene, bounds = toy.scene(), body_bounds(toy.insertion.size)
    loop = prepare_shots(sights, scene, frozen, toy.insertion, bounds, threads=2, **options)
    while True:
        try:
            next(loop)
        except StopIteration as end:
            return sights, end.value


def test_every_sight_is_prepared_in_its_order(toy):
    sights, shots = prepared(toy)
    assert [shot.sight.frame.index for shot in shots] == [sight.frame.index for sight in sights]


def test_enough_frames_are_prepared_however_late_it_is(toy, monkeypatch):
    monkeypatch.setattr(shots_module, "ENOUGH", 3)
    sights, shots = prepared(toy, deadline=0.0)
    assert [shot.sight for shot in shots] == sights[:3]


def test_what_may_not_show_the_vehicle_is_compared_with_the_background(toy):
    _, shots = prepared(toy)
    region = shots[3].sight.region
    alone = shots[3].frozen.alone(shots[3].view).numpy()
    np.testing.assert_array_equal(shots[3].target.numpy()[region.bare], alone[region.bare])
