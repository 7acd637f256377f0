import numpy as np
import pytest
from toy_vehicle import toy_car

from dwgs.scene import InputError
from generator.conditions.axes import convention_of, matrix
from generator.conditions.surface import AXES, UNITS, Convention, Surface


def surface_of(convention: Convention, stated: Convention | None = None) -> Surface:
    points = toy_car().sample(3000, seed=0) @ np.linalg.inv(matrix(convention)).T
    return Surface(points, np.zeros(points.shape, np.uint8), stated=stated)


@pytest.mark.parametrize("unit", ["m", "cm", "mm", "inch"])
@pytest.mark.parametrize(("up", "forward"), [("z", "x"), ("z", "-y"), ("y", "z"), ("y", "-x")])
def test_unit_and_axes_are_found_from_what_a_vehicle_can_be(unit: str, up: str, forward: str):
    convention = Convention(unit, up, forward)
    assert convention_of(surface_of(convention), "car", None, None)[0] == convention


def test_what_the_format_states_is_believed_without_an_assumption():
    stated = Convention("m", "y", "z")
    assert convention_of(surface_of(stated, stated), "car", None, None) == (stated, "")


def test_a_stated_forward_that_makes_no_vehicle_is_replaced_and_said():
    found, assumed = convention_of(surface_of(Convention("m", "y", "-x"), Convention("m", "y", "z")), "car", None, None)
    assert found == Convention("m", "y", "-x")
    assert assumed == "forward assumed from its size and shape"


def test_what_a_person_sets_wins():
    surface = surface_of(Convention("cm", "z", "x"))
    assert convention_of(surface, "car", "cm", "-x") == (Convention("cm", "z", "-x"), "")


def test_a_size_that_no_unit_makes_a_vehicle_is_refused_with_the_extents_and_the_option():
    points = np.array([[0, 0, 0], [1, 1, 1]]) * 3.0
    with pytest.raises(InputError, match=r"car.obj measures 3 x 3 x 3 .* none with any unit; set --unit"):
        convention_of(Surface(points, np.zeros((2, 3), np.uint8)), "car.obj", None, None)


@pytest.mark.parametrize(("unit", "forward"), [("furlong", None), (None, "up")])
def test_unknown_options_list_the_known_ones(unit: str | None, forward: str | None):
    with pytest.raises(InputError, match=", ".join(UNITS if unit else AXES)):
        convention_of(surface_of(Convention("m", "z", "x")), "car", unit, forward)


def test_axes_are_right_handed():
    for forward, up in (("x", "z"), ("-y", "z"), ("z", "y"), ("-x", "y")):
        assert np.linalg.det(matrix(Convention("m", up, forward))) == pytest.approx(1)
