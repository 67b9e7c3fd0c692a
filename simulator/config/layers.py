"""Layers that light crosses between the mask and the sensor, and the mask's own substrate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from simulator.config.base import Range, Section, refusal
from simulator.errors import InputError
from simulator.text import KeyPath
from simulator.validation import Problem

if TYPE_CHECKING:
    from simulator.config.schema import Config

_THICK = Range(0.0001, 100, "mm", below="a layer has a thickness")
MaterialName = Annotated[str, Field(min_length=1)]


class GapLayer(Section):
    """A plane-parallel layer of the gap, such as air or a cover glass."""

    mm: Annotated[float, _THICK] = Field(description="thickness, millimetres")
    n: Literal["air"] | Annotated[float, Range(1, 4, below="air has 1, and nothing here has less")] | None = Field(
        default=None, description="refractive index, the same for all wavelengths; or air"
    )
    material: MaterialName | None = Field(
        default=None, description="name of a material (see flatlight materials), or its file (.csv, .yml)"
    )

    @model_validator(mode="after")
    def _one_medium(self) -> Self:
        if (self.n is None) == (self.material is None):
            came = "neither" if self.n is None else "both"
            text = f"needs exactly one of n (air or a number) and material, got {came}"
            raise refusal(text, *([] if self.n is None else ["n"]))
        return self


class Substrate(Section):
    """The plate that carries the mask's modulating surface."""

    mm: Annotated[float, _THICK] = Field(description="thickness, millimetres")
    material: MaterialName = Field(description="name of a material (see flatlight materials), or its file (.csv, .yml)")
    side: Literal["scene", "sensor"] = Field(
        description="where the plate lies, seen from the modulating surface; on the sensor's side it comes before the gap"
    )


def material_problems(config: Config) -> list[Problem]:
    """Return what is wrong with the materials that the camera names: unknown names, unreadable files.

    The mask's ``material`` is looked at where the design has a bare name; a user's own may mean something else by it.
    """
    camera = config.camera
    named: dict[KeyPath, str | None] = {
        ("camera", "gap", index, "material"): layer.material for index, layer in enumerate(camera.gap or ())
    }
    if camera.substrate is not None:
        named["camera", "substrate", "material"] = camera.substrate.material
    mask = camera.mask
    if mask is not None and ":" not in mask.design and isinstance(mask.params.get("material"), str):
        named["camera", "mask", "material"] = mask.params["material"]
    return [problem for path, name in named.items() if name and (problem := _problem(path, name, config))]


def _problem(path: KeyPath, name: str, config: Config) -> Problem | None:
    from simulator.optics.materials import load_material  # imports NumPy, which reading a plain camera does not need

    try:
        load_material(name, config.base_dir)
    except InputError as error:
        return Problem(path, str(error).removeprefix("material: "))
    return None
