"""The viewer may not import the splatter, so its rules are written twice; this is what keeps them one."""

import re

import pytest

from dwgs.splat import constants
from viewer.shaders import source


@pytest.mark.parametrize("name", ["LOW_PASS", "MAX_ALPHA", "MIN_ALPHA", "NEAR", "MAX_TANGENT"])
def test_shader_and_splatter_obey_the_same_number(name):
    written = re.search(rf"const float {name} = ([^;]+);", source("rules"))
    assert written
    assert eval(written[1]) == getattr(constants, name)


def test_shader_and_splatter_use_the_same_harmonics():
    numbers = {float(n) for n in re.findall(r"\d\.\d{8,}", source("project"))}
    assert numbers == {constants.SH_C0, constants.SH_C1, *constants.SH_C2, *constants.SH_C3}
