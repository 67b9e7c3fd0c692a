"""Cameras compared by their PSFs: what each candidate is, its figures of merit, and how they are said."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.optics.metrics import (
    autocorrelation_peak,
    depth_correlations,
    distinct_depths,
    light_off_sensor,
    mean_mtf,
)
from simulator.optics.stack import UNPROVEN, PsfStack
from simulator.plots.psf import DepthView
from simulator.plots.psf_facts import psf_facts
from simulator.text import length, share

if TYPE_CHECKING:
    from simulator.config import Config

TITLE = "Mask designs compared"
NOTES = "Two values: at the nearest / at the farthest depth. Errors: of sampling / model / wavelengths."
UNKNOWN = "?"
DEPTHS = (
    7  # whose figures of merit are those of 28 within a hundredth, for the shipped PhlatCam, DiffuserCam and FlatCam
)


@dataclass(frozen=True)
class Column:
    """One figure of merit.

    Attributes:
        title: what it is called.
        definition: its formula in words and symbols.
        cell: a candidate's figure as text.
    """

    title: str
    definition: str
    cell: Callable[[Candidate], str]


def cameras_in_words(candidates: Sequence[Candidate]) -> str:
    """Return the camera that all share, or what cannot be compared when they do not share one."""
    if len({candidate.camera for candidate in candidates}) == 1:
        return f"One camera for all: {candidates[0].camera}."
    return (
        "These cameras differ. Lengths, areas and cycles per mm can be compared as they are; what depends on pixels, depths "
        "and field of view (mean MTF, distinct depths, light off the sensor) cannot."
    )


def _pair(texts: list[str]) -> str:
    return " / ".join(dict.fromkeys(texts))


def _area(value_m2: float | None) -> str:
    return UNKNOWN if value_m2 is None else f"{value_m2 * 1e6:.3g} mm²"


COLUMNS = (
    Column(
        "Autocorrelation width",
        "Full width at half maximum of A(s) = Σ I(x) I(x+s) / Σ I(x)², the diameter of the disc with the area inside which A "
        "stays above one half: the detail that the PSF can place, at least about a pixel. A dense PSF (FlatCam, "
        "MURA) has a pedestal above one half and so the width of its whole shadow: its decoding takes the mean away first.",
        lambda c: _pair([length(width) for width in c.width_m]),
    ),
    Column(
        "Highest sidelobe",
        "The greatest A(s) at shifts of at least that width: how far the PSF confuses a point with another one. "
        "A pedestal counts, because light that is everywhere tells nothing. Lower is better.",
        lambda c: _pair([f"{lobe:.2f}" for lobe in c.sidelobe]),
    ),
    Column(
        "Mean MTF",
        "Mean of |F[I](f)| / F[I](0), averaged over directions, from zero to the Nyquist frequency: the contrast that is "
        "left for noise to compete with. Higher is better; one bright pixel has 1.",
        lambda c: _pair([f"{value:.3f}" for value in c.mean_mtf]),
    ),
    Column(
        "Distinct depths",
        "1 / mean of C(u, v)² over all pairs of disparities in the range, where C = <H_u, H_v> / (|H_u| |H_v|) over channels "
        "and pixels is the correlation of their PSFs: 1 when all depths look alike. “About” where neighbouring planes "
        "correlate by less than one half: more --depths tell.",
        lambda c: ("about " if np.any(np.diag(c.correlations, 1) < 0.5) else "") + f"{c.distinct_depths:.3g}",
    ),
    Column(
        "Transmitted area",
        "Transmittance times open area of the mask: the power that passes it per unit irradiance.",
        lambda c: _area(c.transmitted_m2),
    ),
    Column(
        "Light on sensor",
        "The power that reaches the sensor per unit irradiance at the mask, mean over channels and over all scene pixels: "
        "the transmitted area less what falls beside the sensor or is not followed.",
        lambda c: _pair([_area(value) for value in c.received_m2]),
    ),
    Column(
        "Light off sensor",
        "Share of the PSF's light that misses the sensor, mean over channels and over all scene pixels.",
        lambda c: _pair([share(value) for value in c.off_sensor]),
    ),
    Column(
        "Errors",
        "Relative L2 errors of the PSFs on the sensor's pixels, as recorded with every stack: of the sampling (against a "
        "grid twice as fine) / of the model (against exact PSFs) / of the few wavelengths (against many), each the greatest "
        "of those measured.",
        lambda c: " / ".join(UNKNOWN if error is None else share(error) for error in c.errors),
    ),
)


Progress = Callable[[str, int, int], None]
# Nearest and farthest depth: told apart by colour-blind eyes too (Okabe and Ito, 2008).
_COLOURS = ("#d55e00", "#0072b2")


@dataclass(frozen=True)
class Candidate:
    """One design and what was measured of its PSFs; pairs are of the nearest and the farthest depth.

    Attributes:
        name: of the design or configuration; no two candidates of a comparison share one.
        camera: sensor, distance and depths in words: candidates with the same words can be compared without reserve.
        views: the PSFs of the nearest and the farthest depth (of one depth alone, one).
        pixel_pitch_m: metres.
        width_m: full width at half maximum of the autocorrelation, metres.
        sidelobe: the autocorrelation's highest sidelobe.
        mean_mtf: mean of the MTF from zero to Nyquist.
        correlations: ``(K, K)`` of the PSFs of the depths that were measured.
        distinct_depths: effective number of depths told apart.
        transmitted_m2: transmittance times area of the mask, square metres; None where it is not known.
        received_m2: power on the sensor per irradiance at the mask, mean over channels and scene pixels, square metres.
        off_sensor: share of the light on the PSF's grid that misses the sensor, mean over channels and scene pixels.
        errors: relative L2 errors that the stack recorded: of its sampling, of its model against ``exact`` and of its few
            wavelengths, the worst channel's; None where nothing was recorded.
        facts: everything else that the stack knows of itself.
    """

    name: str
    camera: str
    views: list[DepthView]
    pixel_pitch_m: float
    width_m: tuple[float, ...]
    sidelobe: tuple[float, ...]
    mean_mtf: tuple[float, ...]
    correlations: NDArray[np.float64]
    distinct_depths: float
    transmitted_m2: float | None
    received_m2: tuple[float, ...]
    off_sensor: tuple[float, ...]
    errors: tuple[float | None, float | None, float | None]
    facts: list[tuple[str, str]]


def load_configs(words: Sequence[str], base: Path, overrides: Sequence[str] = ()) -> dict[str, Config]:
    """Return what is to be compared: a configuration for every word, by a name of its own.

    Args:
        words: each a ``sim_config.yaml``, taken as it is; or a mask that is put into the base configuration: a design's
            name, ``./file.py:name`` (from the current folder) or a mapping as in ``camera.mask``, such as
            ``{design: pinhole, diameter_um: 80}``.
        base: the configuration whose camera and depths all bare masks share; read only where there are any.
        overrides: ``key=value`` each, applied to all of them.
    """
    from simulator.config import load_config

    configs: dict[str, Config] = {}
    for word in words:
        if word.lower().endswith((".yaml", ".yml")):
            label, config = Path(word).stem, load_config(word, overrides)
        else:
            mask = word if word.lstrip().startswith("{") else json.dumps({"design": _from_here(word)})
            # The mask first: an override such as camera.mask.width_mm=3 then reaches every design.
            config = load_config(base, [f"camera.mask={mask}", *overrides])
            label = _label(mask)
        configs[_unused(label, configs)] = config
    return configs


def measure(
    name: str, config: Config, *, depths: int | None = DEPTHS, threads: int = 1, progress: Progress | None = None
) -> Candidate:
    """Compute PSFs of at most so many of a configuration's depths (or take them from the cache) and measure them.

    ``depths`` None takes all; ``progress`` as in `Assembly`.
    """
    from simulator.assembly import Assembly

    def tell(stage: str, done: int, total: int) -> None:
        if progress is not None:
            progress(f"{stage} of {name}", done, total)

    assembly = Assembly(config, threads=threads, progress=tell)
    stack = assembly.some_depths(len(assembly.depths_m) if depths is None else depths)
    sensor, scene = config.camera.sensor, config.scene.size
    camera = (
        f"{sensor.shape[0]} x {sensor.shape[1]} pixels of {length(stack.pixel_pitch_m)}, "
        f"{length(assembly.mask_to_sensor_m)} from the mask; scene of {scene[0]} x {scene[1]}; "
        f"depths of {length(stack.depths_m[0])} to {length(stack.depths_m[-1])}, {len(stack.depths_m)} of "
        f"{len(assembly.depths_m)} compared"
    )
    facts = psf_facts(stack, assembly.mask, scene, sensor.shape)
    return judge(name, stack, camera, facts, light_off_sensor(stack, sensor.shape, scene))


def judge(
    name: str, stack: PsfStack, camera: str, facts: list[tuple[str, str]], off_sensor: NDArray[np.float64]
) -> Candidate:
    """Return the figures of merit of a stack; ``off_sensor`` is the share ``(K, C)`` of light that misses the sensor."""
    values, pitch_m = to_numpy(stack.values), stack.pixel_pitch_m
    ends = sorted({0, len(stack.depths_m) - 1})
    planes = [values[k].astype(np.float64) for k in ends]
    peaks = [autocorrelation_peak(plane.mean(0), pitch_m) for plane in planes]
    energy_m2, correlations = stack.energy_m2(), depth_correlations(stack)
    record = stack.provenance.get("mask")
    return Candidate(
        name=name,
        camera=camera,
        views=[
            DepthView(length(stack.depths_m[k]), colour, plane, plane.mean(0), stack.channels)
            for k, colour, plane in zip(ends, _COLOURS, planes, strict=False)
        ],
        pixel_pitch_m=pitch_m,
        width_m=tuple(peak.width_m for peak in peaks),
        sidelobe=tuple(peak.sidelobe for peak in peaks),
        mean_mtf=tuple(mean_mtf(plane.mean(0), pitch_m) for plane in planes),
        correlations=correlations,
        distinct_depths=distinct_depths(correlations, stack.depths_m),
        transmitted_m2=record["transmitted_area_m2"] if record else stack.provenance.get("throughput_m2"),
        received_m2=tuple(float(np.mean((energy_m2 * (1 - off_sensor))[k])) for k in ends),
        off_sensor=tuple(float(np.mean(off_sensor[k])) for k in ends),
        errors=_errors(stack.provenance),
        facts=facts,
    )


def _errors(provenance: dict[str, Any]) -> tuple[float | None, float | None, float | None]:
    """Return the errors that a stack recorded: sampling, model, spectrum."""
    sampling, others = provenance.get("sampling", UNPROVEN), provenance.get("errors", {})
    channels = others.get("spectrum", {}).get("channels", {}).values()
    return (
        None if sampling == UNPROVEN else sampling["error"],
        others.get("model", {}).get("error"),
        max(channels, default=None),
    )


def _from_here(word: str) -> str:
    """Return a design's name; a file's path as seen from the current folder, not from the base configuration's."""
    place, separator, name = word.rpartition(":")
    return f"{Path(place).absolute()}:{name}" if separator and place.endswith(".py") else word


def _label(mask: str) -> str:
    """Return a mask's bare name and the parameters that were given with it."""
    import yaml

    parameters = yaml.safe_load(mask)  # the configuration has read it already, by stricter rules
    name = str(parameters.pop("design")).rpartition(":")[2]
    return ", ".join([name, *(f"{key} {value}" for key, value in parameters.items())])


def _unused(label: str, taken: dict[str, Config]) -> str:
    number, name = 1, label
    while name in taken:
        number += 1
        name = f"{label} ({number})"
    return name
