"""Masks as height maps and layers: read back by Pillow, tifffile and the design ``height_map``, they are the mask."""

import json

import numpy as np
import pytest
import tifffile
from PIL import Image

from psf_library import load_mask
from simulator.design.export import binary_layers, height_tiff, write_layers
from simulator.errors import InputError
from simulator.optics.mask import Mask
from simulator.optics.materials import PHLATCAM_RESIST


def _mask(height_m, amplitude=None, profile="staircase") -> Mask:
    height_m = np.asarray(height_m, np.float32)
    amplitude = np.ones_like(height_m) if amplitude is None else np.asarray(amplitude, np.float32)
    return Mask(height_m, amplitude, 2e-6, PHLATCAM_RESIST, profile, "example")


@pytest.fixture
def steps() -> Mask:
    return _mask(np.random.default_rng(0).integers(1, 6, (11, 14)) * np.float32(0.2e-6))


@pytest.fixture
def smooth() -> Mask:
    return _mask(np.random.default_rng(0).random((11, 14)) * 3e-6, profile="smooth")


@pytest.mark.parametrize("name", ["steps", "smooth"])
def test_a_tiff_reads_back_within_half_a_code(name, request, tmp_path):
    mask = request.getfixturevalue(name)
    (tmp_path / "mask.tif").write_bytes(height_tiff(mask))
    relief = np.asarray(mask.height_m, np.float64) - mask.height_m.min()
    highest_um = float(relief.max() * 1e6)
    again = load_mask("height_map", tmp_path, file="mask.tif", pixel_um=2.0, max_height_um=highest_um)
    assert np.abs(again.height_m - relief).max() <= 0.501 * highest_um * 1e-6 / 65535  # and float32 rounding


def test_a_tiff_says_what_its_numbers_mean(steps, tmp_path):
    """By tags that other programs read (pixels per centimetre) and by JSON."""
    path = tmp_path / "mask.tif"
    path.write_bytes(height_tiff(steps))
    with tifffile.TiffFile(path) as file:
        (page,) = file.pages
        described = json.loads(page.description)
        assert page.resolutionunit.name == "CENTIMETER"
        assert page.resolution == (5000, 5000)
        codes = page.asarray()
    assert (codes.dtype, codes.min(), codes.max()) == (np.uint16, 0, 65535)
    assert described["metres_per_dn"] * 65535 == pytest.approx(0.8e-6)
    assert (described["pitch_m"], described["material"], described["profile"]) == (2e-6, "phlatcam-resist", "staircase")
    np.testing.assert_allclose(codes * described["metres_per_dn"] + 0.2e-6, steps.height_m, atol=7e-12)
    assert Image.open(path).info["dpi"] == pytest.approx((12700, 12700))


def test_layers_add_up_to_the_heights(steps, tmp_path):
    """Every image times its thickness, from the files alone: the mask above its lowest height."""
    names = write_layers(tmp_path / "layers", binary_layers(steps))
    assert names == [f"layer_00{n}.png" for n in (1, 2, 3, 4)]
    content = json.loads((tmp_path / "layers" / "layers.json").read_text())
    assert content["aperture"] is None
    total = np.zeros(steps.shape)
    for layer in content["layers"]:
        with Image.open(tmp_path / "layers" / layer["file"]) as image:
            assert image.mode == "1"
            assert image.info["dpi"] == pytest.approx((12700, 12700))  # 2 um
            total += np.asarray(image) * layer["thickness_m"]
        assert total.max() == pytest.approx(layer["top_m"])
    np.testing.assert_allclose(total, np.asarray(steps.height_m, float) - 0.2e-6, atol=1e-12)


def test_layers_of_uneven_steps_keep_their_thicknesses():
    layers = binary_layers(_mask([[0, 0.1e-6], [0.4e-6, 0.1e-6]]))
    assert layers.thicknesses_m == pytest.approx((0.1e-6, 0.3e-6), abs=1e-12)
    assert [image.tolist() for image in layers.images()] == [
        [[False, True], [True, True]],
        [[False, False], [True, False]],
    ]


def test_layers_of_a_smooth_mask_are_rounded_down_to_the_step_that_is_given(smooth):
    layers = binary_layers(smooth, 0.1e-6)
    total = sum(image * thickness for image, thickness in zip(layers.images(), layers.thicknesses_m, strict=True))
    loss = np.asarray(smooth.height_m, float) - smooth.height_m.min() - total
    assert loss.min() > -1e-12
    assert loss.max() < 0.1e-6
    assert max(layers.thicknesses_m) < 0.3e-6


def test_too_many_layers_are_refused():
    ramp = _mask([np.arange(300) * 1e-8])
    with pytest.raises(InputError, match=r"^step_um: "):
        binary_layers(ramp)
    with pytest.raises(InputError, match=r"^step_um: "):
        binary_layers(ramp, 1e-8)
    assert len(binary_layers(ramp, 0.012e-6).tops_m) == 249


def test_an_amplitude_mask_is_one_image_of_its_opening(tmp_path):
    """What lithography of chrome on glass takes; greys of a hard edge count from a half on."""
    mask = _mask(np.zeros((2, 3)), [[1, 0, 0.6], [0.4, 1, 0]])
    assert write_layers(tmp_path / "layers", binary_layers(mask)) == ["aperture.png"]
    with Image.open(tmp_path / "layers" / "aperture.png") as image:
        np.testing.assert_array_equal(np.asarray(image), [[1, 0, 1], [0, 1, 0]])
    with pytest.raises(InputError, match=r"^height_m: "):
        height_tiff(mask)


def test_clear_glass_is_refused():
    with pytest.raises(InputError, match="flat and open"):
        binary_layers(_mask(np.full((2, 2), 1e-6)))
