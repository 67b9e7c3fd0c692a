"""The light on the scene, and how the scene's colours become the camera's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from simulator.config.base import Range, Section
from simulator.errors import InputError
from simulator.text import KeyPath
from simulator.validation import Problem

if TYPE_CHECKING:
    from simulator.config.schema import Config


class Led(Section):
    """A light-emitting diode: a Gaussian spectrum."""

    led_nm: Annotated[float, Range(200, 2000, "nm")] = Field(description="centre wavelength, nanometres")
    fwhm_nm: Annotated[float, Range(1, 300, "nm", below="narrower lines look the same to a camera")] = Field(
        description="full width at half maximum, nanometres"
    )
    power: Annotated[float, Range(1e-6, 1e6)] = Field(
        default=1.0, description="radiant power relative to the other LEDs"
    )


def _kind(data: Any) -> str:
    if isinstance(data, dict | Led):
        return "one LED"
    return "several LEDs" if isinstance(data, list | tuple) else "a name"


# The tags hold spaces, so that they cannot be mistaken for keys in a message's path.
IlluminantConfig = Annotated[
    Annotated[str, Field(min_length=1), Tag("a name")]
    | Annotated[Led, Tag("one LED")]
    | Annotated[tuple[Led, ...], Field(min_length=1), Tag("several LEDs")],
    Discriminator(_kind),
]

Number = Annotated[float, Range(-100, 100)]
SceneToCamera = Annotated[
    Annotated[Literal["auto", "identity"], Tag("a word")]
    | Annotated[tuple[tuple[Number, Number, Number], ...], Field(min_length=1, max_length=16), Tag("a matrix")],
    Discriminator(lambda data: "a matrix" if isinstance(data, list | tuple) else "a word"),
]


def curve_problems(config: Config) -> list[Problem]:
    """Return what is wrong with the files of spectral curves; names are looked up on use, which takes a second."""
    named: dict[KeyPath, Any] = {
        ("camera", "sensor", "spectral_response"): config.camera.sensor.spectral_response,
        ("camera", "illuminant"): config.camera.illuminant,
    }
    captured = getattr(config.psf, "as_captured", None)
    if captured is not None:
        named["psf", "as_captured", "illuminant"] = captured.illuminant
    return [
        problem for path, name in named.items() if isinstance(name, str) and (problem := _problem(path, name, config))
    ]


def _problem(path: KeyPath, name: str, config: Config) -> Problem | None:
    if not name.lower().endswith((".csv", ".json")):
        return None
    from simulator.optics.spectra import camera_curves, illuminant_curve  # import NumPy, which a name does not need

    try:
        (illuminant_curve if path[-1] == "illuminant" else camera_curves)(name, config.base_dir)
    except InputError as error:
        return Problem(path, str(error))
    return None
