"""Which stack is the same stack: everything that decides the values is in the fingerprint, and nothing else is."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from simulator.optics.mask import Mask
from simulator.optics.materials import AIR, FUSED_SILICA, N_BK7, Material
from simulator.optics.psf import PsfConfig, psf_fingerprint
from simulator.optics.spectra import Line
from simulator.types import CameraGeometry, Layer, SpectralResponse

HEIGHT_M = np.arange(6.0).reshape(2, 3) * 1e-7
NM = 1e-9 * np.array([500.0, 532, 600])
PARTS: dict[str, Any] = {
    "mask": Mask(HEIGHT_M, np.full((2, 3), 0.5), 2e-6, FUSED_SILICA),
    "response": SpectralResponse(NM, np.array([[0.0, 1, 0], [0, 1, 2]]), ("R", "G"), "two channels"),
    "camera": CameraGeometry(
        1.9e-3, 1e-5, SpectralResponse(NM, NM[None], ("Y",), ""), (Layer(1e-3, AIR),), (Layer(2e-4, N_BK7),)
    ),
    "config": PsfConfig((0.05, 0.1)),
    "line": Line(0, 532e-9, 1.0),
    "layer": Layer(1e-3, FUSED_SILICA),
    "material": Material("glass", "cauchy", (1.5, 0.01, -2), (4e-7, 8e-7), "a book"),
}
DECIDES: list[tuple[str, str, Any]] = [
    ("mask", "height_m", HEIGHT_M + 1e-9),
    ("mask", "height_m", HEIGHT_M.astype(np.float32)),  # its precision is that of the values
    ("mask", "amplitude", np.full((2, 3), 0.6)),
    ("mask", "pitch_m", 2.1e-6),
    ("mask", "material", N_BK7),
    ("mask", "profile", "smooth"),
    ("camera", "mask_to_sensor_m", 1.91e-3),
    ("camera", "pixel_pitch_m", 1.1e-5),
    ("camera", "gap", ()),
    ("camera", "gap", (Layer(0.5e-3, AIR), Layer(0.5e-3, AIR))),
    ("camera", "window", ()),
    ("camera", "window", (Layer(2e-4, FUSED_SILICA),)),
    ("response", "wavelengths_m", NM + 1e-9),
    ("response", "weights", np.array([[0.0, 1, 0], [0, 1, 3]])),
    ("response", "channels", ("G", "R")),
    ("config", "depths_m", (0.05, 0.11)),
    ("config", "depths_m", (0.05, float("inf"))),
    ("config", "model", "scaled_psf"),
    ("config", "wavelengths_per_channel", 2),
    ("config", "oversampling", 2),
    ("config", "shared_wavelengths", 5),
    ("line", "channel", 1),
    ("line", "wavelength_m", 533e-9),
    ("line", "weight", 0.5),
    ("layer", "thickness_m", 1.1e-3),
    ("layer", "material", N_BK7),
    ("material", "formula", "sellmeier"),
    ("material", "coefficients", (1.5, 0.02, -2)),
    ("material", "scale", 1.1),
]
DECIDES_NOTHING: list[tuple[str, str, Any]] = [
    ("mask", "name", "another name"),
    ("mask", "notes", {"made": "by hand"}),
    ("response", "label", "another label"),
    ("config", "accept_error", 0.5),
]
LEFT_OUT = {("camera", "response"), ("material", "name"), ("material", "range_m"), ("material", "source")}
"""The response has fields of its own; a material's words do no harm where they are counted."""


def fingerprint(part: str = "", name: str = "", value: Any = None) -> str:
    """The fingerprint of all parts together, with one field of one of them changed."""
    parts = PARTS | ({part: replace(PARTS[part], **{name: value})} if part else {})
    gap = (*parts["camera"].gap, replace(parts["layer"], material=parts["material"]), parts["layer"])
    camera = replace(parts["camera"], response=parts["response"], gap=gap)
    return psf_fingerprint(parts["mask"], camera, parts["config"], [parts["line"]])


@pytest.mark.parametrize(("part", "name", "value"), DECIDES)
def test_every_field_that_decides_the_values_changes_the_fingerprint(part: str, name: str, value: Any) -> None:
    assert fingerprint(part, name, value) != fingerprint()


@pytest.mark.parametrize(("part", "name", "value"), DECIDES_NOTHING)
def test_words_and_limits_do_not_change_it(part: str, name: str, value: Any) -> None:
    assert fingerprint(part, name, value) == fingerprint()


@pytest.mark.parametrize("part", PARTS)
def test_no_field_is_forgotten_above(part: str) -> None:
    known = {name for of, name, _ in DECIDES + DECIDES_NOTHING if of == part}
    known |= {name for of, name in LEFT_OUT if of == part}
    assert known == {field.name for field in fields(PARTS[part])}


def test_own_lines_and_no_lines_differ() -> None:
    parts = PARTS["mask"], PARTS["camera"], PARTS["config"]
    assert len({psf_fingerprint(*parts), psf_fingerprint(*parts, [PARTS["line"]]), psf_fingerprint(*parts, [])}) == 3
