"""Masks of one's own files: the right way up, of the asked size, material and steps."""

import numpy as np
import pytest
from PIL import Image

from psf_library import load_mask
from simulator.design.solid import stl_bytes
from simulator.errors import InputError
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA, PHLATCAM_RESIST

HEIGHT_M = np.float32([[0.0, 0.25e-6, 1.0e-6], [0.1e-6, 0.5e-6, 0.7e-6]])


def test_one_height_map_from_three_kinds_of_files(tmp_path):
    """16 bits of 1 um: half a code is 8e-12 m; single precision of 1 um is 1e-13 m."""
    np.save(tmp_path / "h.npy", HEIGHT_M + np.float32(3e-6))
    Image.fromarray(np.rint(HEIGHT_M / 1e-6 * 65535).astype(np.uint16)).save(tmp_path / "h.png")
    (tmp_path / "h.stl").write_bytes(stl_bytes(Mask(HEIGHT_M, np.ones_like(HEIGHT_M), 4e-6), 1e-4))
    for file, scale, tolerance_m in (
        ("h.npy", {}, 1e-12),
        ("h.png", {"max_height_um": 1.0}, 8e-12),
        ("h.stl", {}, 1e-12),
    ):
        mask = load_mask("height_map", tmp_path, file=file, pixel_um=4.0, **scale)
        np.testing.assert_allclose(mask.height_m, HEIGHT_M, rtol=0, atol=tolerance_m)
        assert (mask.pitch_m, mask.profile, mask.material, mask.name) == (4e-6, "staircase", FUSED_SILICA, "height_map")
        assert np.all(mask.amplitude == 1)


def test_a_height_map_has_units_steps_and_a_material(tmp_path):
    np.save(tmp_path / "h.npy", HEIGHT_M * 1e6)
    mask = load_mask(
        "height_map",
        tmp_path,
        **{"file": "h.npy", "pixel_um": 2.0, "unit_um": 1.0, "step_um": 0.2, "profile": "smooth"},
        material="phlatcam-resist",
    )
    np.testing.assert_allclose(mask.height_m, [[0, 0.2e-6, 1e-6], [0, 0.4e-6, 0.6e-6]], rtol=1e-6)
    assert (mask.profile, mask.material) == ("smooth", PHLATCAM_RESIST)


def test_a_changed_file_is_another_mask(tmp_path):
    np.save(tmp_path / "h.npy", HEIGHT_M)
    before = load_mask("height_map", tmp_path, file="h.npy", pixel_um=4.0)
    np.save(tmp_path / "h.npy", HEIGHT_M[::-1])
    after = load_mask("height_map", tmp_path, file="h.npy", pixel_um=4.0)
    np.testing.assert_array_equal(after.height_m, before.height_m[::-1])


def test_height_maps_that_cannot_be_are_refused(tmp_path):
    np.save(tmp_path / "h.npy", HEIGHT_M)
    (tmp_path / "h.stl").write_bytes(stl_bytes(Mask(HEIGHT_M, np.ones_like(HEIGHT_M), 4e-6), 1e-4))
    for named, params in (
        ("file", {"pixel_um": 2.0}),
        ("pixel_um", {"file": "h.npy"}),
        ("material", {"file": "h.npy", "pixel_um": 2.0, "material": "glas"}),
        (r"absent\.npy", {"file": "absent.npy", "pixel_um": 2.0}),
        ("max_height_um", {"file": "h.stl", "pixel_um": 2.0, "max_height_um": 1.0}),
    ):
        with pytest.raises(InputError, match=f"{named}: "):
            load_mask("height_map", tmp_path, **params)


def test_an_amplitude_image_is_transmittance_unless_it_says_otherwise(tmp_path):
    """White, black and a grey of 64 / 256: a quarter of the light, half of the amplitude."""
    np.save(tmp_path / "a.npy", np.float32([[1, 0, 0.25]]))

    def features(**params):
        mask = load_mask("amplitude_image", tmp_path, file="a.npy", feature_um=6.0, **params)
        assert np.all(mask.height_m == 0)
        assert np.asarray(mask.shape) * mask.pitch_m == pytest.approx([6e-6, 18e-6])
        middle = mask.shape[0] // 2
        return list(mask.amplitude[middle, middle :: mask.shape[0]])

    assert features() == [1, 0, 0.5]
    assert features(values="amplitude") == [1, 0, 0.25]
    assert features(threshold=0.25) == [1, 0, 1]
    assert features(threshold=0.3, pixel_um=3.0) == [1, 0, 0]


@pytest.mark.parametrize(("feature_um", "samples"), [(30.0, 15), (5.0, 3), (1.5, 1), (0.3, 1)])
def test_an_amplitude_image_has_samples_of_at_most_two_micrometres(tmp_path, feature_um, samples):
    np.save(tmp_path / "a.npy", np.eye(2))
    mask = load_mask("amplitude_image", tmp_path, file="a.npy", feature_um=feature_um)
    assert mask.shape == (2 * samples, 2 * samples)
    assert mask.pitch_m == pytest.approx(feature_um * 1e-6 / samples)
    np.testing.assert_array_equal(mask.amplitude, np.kron(np.eye(2), np.ones((samples, samples))))
