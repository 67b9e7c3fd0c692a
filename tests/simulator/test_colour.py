"""The sRGB curve against colour-science, its own inverse and the standard's fixed points."""

from functools import partial

import colour
import numpy as np
import pytest

from simulator.colour import decode_srgb_image, linear_to_srgb, srgb_to_linear
from simulator.errors import InputError

# Rounding to float32 once: half a unit in the last place at 1.0.
ONE_ROUNDING = 2**-24


def test_both_ways_agree_with_colour_science():
    encoded, linear = np.linspace(0, 1, 10_001), np.geomspace(1e-6, 1, 10_001)
    agree = partial(np.testing.assert_allclose, rtol=0, atol=ONE_ROUNDING)
    agree(srgb_to_linear(encoded), colour.models.eotf_sRGB(encoded))
    agree(linear_to_srgb(linear), colour.models.eotf_inverse_sRGB(linear))


def test_one_undoes_the_other_for_every_8_bit_code():
    codes = np.arange(256)
    there = srgb_to_linear(codes / 255.0)
    assert there.dtype == np.float32
    assert np.array_equal(np.round(linear_to_srgb(there) * 255), codes)


def test_values_outside_continue_the_curve():
    assert srgb_to_linear(np.array([-0.1]))[0] == pytest.approx(-0.1 / 12.92)
    assert linear_to_srgb(np.array([4.0]))[0] == pytest.approx(1.055 * 4 ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("size", [5, 100_000])
def test_pictures_are_decoded_alike_by_table_and_by_formula(dtype, size):
    rng = np.random.default_rng(0)
    full_scale = np.iinfo(dtype).max
    picture = rng.integers(0, full_scale, size, dtype=dtype, endpoint=True)
    expected = colour.models.eotf_sRGB(picture / full_scale)
    np.testing.assert_allclose(decode_srgb_image(picture), expected, rtol=0, atol=ONE_ROUNDING)


def test_integers_are_refused_where_their_full_scale_is_unknown():
    with pytest.raises(InputError, match=r"^encoded: "):
        srgb_to_linear(np.zeros(3, np.uint8))
    with pytest.raises(InputError, match=r"^image: "):
        decode_srgb_image(np.zeros(3, np.int32))
