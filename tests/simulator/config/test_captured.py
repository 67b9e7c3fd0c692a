"""The keys of psf.as_captured, of interpolated planes and of stored stacks, and what is said when they are wrong."""

from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from simulator.config.psf import AsCaptured, ComputedPsf, MeasuredPsf, PsfConfig, StoredPsf
from simulator.validation import validate

PSF: TypeAdapter[Any] = TypeAdapter(PsfConfig)


def test_without_the_key_nothing_is_captured_and_an_empty_one_is_a_careful_laboratory() -> None:
    plain = PSF.validate_python({"depths_cm": (5.0,)})
    assert isinstance(plain, ComputedPsf)
    assert plain.as_captured is None
    assert PSF.validate_python({"depths_cm": (5.0,), "as_captured": {}}).as_captured == AsCaptured()


def test_a_list_names_images_a_text_a_folder() -> None:
    assert isinstance(PSF.validate_python({"measured": "out/stack"}), StoredPsf)
    images = {"measured": ("a.tif",), "depths_cm": (5.0,), "frame": "stored", "throughput_mm2": 1.0}
    found = PSF.validate_python(images | {"planes": {"depths_cm": (4.0, 5.0), "extrapolate": True}})
    assert isinstance(found, MeasuredPsf)
    assert found.planes is not None
    assert found.planes.extrapolate


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"depths_cm": (5.0,), "as_captured": {"source_mm": 1.0}}, "source_mm"),
        ({"depths_cm": (5.0,), "as_captured": {"source_um": -1.0}}, "0 to 5000 um"),
        ({"depths_cm": (5.0,), "as_captured": {"peak_percent": 0.0}}, "0.1 to 100 percent"),
        ({"depths_cm": (5.0,), "as_captured": {"frames": 0}}, "1 to 10000"),
        ({"depths_cm": (5.0,), "as_captured": {"tilt_deg": (0.1, 40.0)}}, "-10 to 10 deg"),
        ({"depths_cm": (5.0,), "as_captured": {"background": "median"}}, "'dark', 'border' or 'none'"),
        ({"measured": "out/stack", "as_captured": {}}, "as_captured"),
        ({"measured": "out/stack", "planes": {"near_cm": 3.0}}, "the planes are not given"),
        ({"measured": "out/stack", "planes": {"near_cm": 9.0, "far_cm": 3.0, "depths": 2}}, "swap them"),
        ({"measured": "out/stack", "planes": {"depths_cm": (5.0, 4.0)}}, "depths"),
    ],
)
def test_mistakes_are_named(section: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        PSF.validate_python(section)


def test_the_default_light_is_that_of_the_leds_written_out() -> None:
    leds = [{"led_nm": 630, "fwhm_nm": 18}, {"led_nm": 530, "fwhm_nm": 33}, {"led_nm": 465, "fwhm_nm": 22}]
    assert AsCaptured() == validate(AsCaptured, {"illuminant": leds})
