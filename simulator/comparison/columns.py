"""The table's columns: what each figure is called, how it is written and how it is defined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from simulator.comparison.candidates import Candidate
from simulator.text import length, share

TITLE = "Mask designs compared"
NOTES = "Two values: at the nearest / at the farthest depth. Errors: of sampling / model / wavelengths."
UNKNOWN = "?"


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
        "K² / Σ C_ij², where C_ij = <H_i, H_j> / (|H_i| |H_j|) over channels and pixels is the correlation of the PSFs of "
        "two of the K depths: 1 when all depths look alike, K when no two overlap.",
        lambda c: f"{c.distinct_depths:.3g} of {len(c.correlations)}",
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
