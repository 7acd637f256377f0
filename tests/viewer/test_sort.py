import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.sort import CULLED, back_to_front

depths = st.floats(0.0625, 1e6, width=32).map(lambda z: int(np.float32(z).view(np.uint32)))


@settings(deadline=None)
@given(st.lists(depths | st.sampled_from([int(CULLED), int(np.float32(1).view(np.uint32))]), max_size=200))
def test_the_order_is_a_stable_sort_by_depth_turned_round(keys):
    keys = np.array(keys, np.uint32)
    kept = np.flatnonzero(keys != CULLED)
    expected = kept[np.argsort(keys[kept], kind="stable")][::-1]
    order = back_to_front(keys)
    assert order.dtype == np.uint32
    np.testing.assert_array_equal(order, expected)


def test_depths_that_differ_in_the_last_bit_are_told_apart():
    near = np.float32(50)
    far = np.nextafter(near, np.float32(100))
    np.testing.assert_array_equal(back_to_front(np.array([near, far, near]).view(np.uint32)), [1, 2, 0])
