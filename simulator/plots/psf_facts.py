"""What one wants to know of a PSF stack before trusting it: facts and error budget, in words and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from simulator.arrays import to_numpy
from simulator.optics.error_budget.budget import read_budget
from simulator.optics.mask import Mask
from simulator.optics.metrics import depth_limit_m, light_off_sensor
from simulator.optics.stack import UNPROVEN, PsfStack
from simulator.text import length, share


def psf_facts(
    stack: PsfStack,
    mask: Mask | None = None,
    scene_shape: tuple[int, int] | None = None,
    sensor_shape: tuple[int, int] | None = None,
) -> list[tuple[str, str]]:
    """Return (what, value) lines about a stack; lines that cannot be known are left out.

    Args:
        stack: the PSFs.
        mask: the mask that made them; without it the stack's provenance is asked.
        scene_shape: h, w of the scene; with ``sensor_shape`` the light that misses the sensor is told.
        sensor_shape: H, W of the (binned) sensor.
    """
    provenance = stack.provenance
    facts = _mask_facts(stack, mask)
    facts.append(("pixel pitch", length(stack.pixel_pitch_m)))
    facts += _light_facts(stack, mask, scene_shape, sensor_shape)
    depths_m = stack.depths_m
    ends = (
        length(depths_m[0])
        if len(depths_m) == 1
        else f"{len(depths_m)}, {length(depths_m[0])} to {length(depths_m[-1])}"
    )
    facts.append(("depths" if len(depths_m) > 1 else "depth", ends))
    limit_m = psf_depth_limit_m(stack, mask)
    if limit_m is not None:
        facts.append(("z_max", f"{length(limit_m)}: beyond it the PSF no longer changes"))
    if "model" in provenance:
        facts.append(("model", str(provenance["model"])))
    facts += _spectrum_facts(provenance)
    sampling = provenance.get("sampling")
    if sampling == UNPROVEN:
        facts.append(("sampling", UNPROVEN))
    elif sampling:
        facts.append(("sampling error", f"at most {share(sampling['error_bar'])}"))
    if provenance.get("kind") == "measured":
        files = sorted({image["file"] for image in provenance["images"]})
        facts.append(("measured", files[0] if len(files) == 1 else f"{len(files)} images"))
        facts.append(("background", str(provenance["background"])))
        if provenance.get("same_psf_for_all_channels"):
            facts.append(("channels", "one grey PSF for all"))
    if "interpolation" in provenance:
        facts.append(("interpolated", _interpolation(provenance["interpolation"])))
    if "registration" in provenance:
        facts.append(("registered", _registration(provenance["registration"])))
    return facts


def psf_depth_limit_m(stack: PsfStack, mask: Mask | None = None) -> float | None:
    """Return the depth beyond which the PSF no longer changes by a pixel, metres; None when the mask is not known."""
    record, distance_m = stack.provenance.get("mask"), stack.provenance.get("mask_to_sensor_m")
    if mask is not None:
        open_pixels = to_numpy(mask.amplitude) > 0
        aperture_m = float(max(np.ptp(np.flatnonzero(open_pixels.any(axis))) + 1 for axis in (0, 1)) * mask.pitch_m)
    elif record is not None:
        aperture_m = max(record["shape"]) * record["pitch_m"]
    else:
        return None
    return None if distance_m is None else depth_limit_m(aperture_m, distance_m, stack.pixel_pitch_m)


def _mask_facts(stack: PsfStack, mask: Mask | None) -> list[tuple[str, str]]:
    record: dict[str, Any] | None = mask.provenance() if mask is not None else stack.provenance.get("mask")
    facts = []
    if record is not None:
        rows, columns = (length(n * record["pitch_m"]) for n in record["shape"])
        facts.append(("mask", f"{record['name']}, {columns} × {rows}"))
        nominal = " (nominal)" if "nominal" in record["material_source"] else ""
        facts.append(("material", f"{record['material']}{nominal}, {record['profile']}"))
        facts.append(("transmitted area", f"{record['transmitted_area_m2'] * 1e6:.3g} mm²"))
    elif "throughput_m2" in stack.provenance:
        facts.append(("throughput", f"{stack.provenance['throughput_m2'] * 1e6:.3g} mm²"))
    if "mask_to_sensor_m" in stack.provenance:
        facts.append(("mask to sensor", length(stack.provenance["mask_to_sensor_m"])))
    return facts


def _interpolation(record: dict[str, Any]) -> str:
    """Say from how many planes a stack was interpolated, and the greatest error that they state."""
    errors = [plane["error"] for plane in record["planes"]]
    text = f"from {len(record['measured_depths_m'])} measured planes"
    beyond = sum(plane["extrapolated"] for plane in record["planes"])
    text += f", {beyond} beyond them" if beyond else ""
    return text + (", error unknown" if None in errors else f", error up to {share(max(errors))}")


def _registration(record: dict[str, Any]) -> str:
    """Say how far the planes of a measured stack were moved, and how differently they were exposed."""
    text = f"planes moved by up to {np.linalg.norm(record['shifts_px'], axis=1).max():.2g} px"
    low, high = min(record["exposures"]), max(record["exposures"])
    text += f", exposures of {share(low)} to {share(high)} made equal" if low < high else ""
    unlike = [f"{k + 1} and {j + 1}" for k, j in record["unlike_neighbours"]]
    return text + (f", but planes {', '.join(unlike)} are unlike and were not" if unlike else "")


def _light_facts(
    stack: PsfStack, mask: Mask | None, scene_shape: tuple[int, int] | None, sensor_shape: tuple[int, int] | None
) -> list[tuple[str, str]]:
    facts = []
    record = stack.provenance.get("mask")
    area_m2 = mask.transmitted_area_m2 if mask is not None else record and record["transmitted_area_m2"]
    if area_m2:
        shares = stack.energy_m2() / area_m2
        facts.append(("light on PSF grid", _range(shares)))
    if scene_shape is not None and sensor_shape is not None:
        facts.append(("light off sensor", _range(light_off_sensor(stack, sensor_shape, scene_shape))))
    return facts


def _range(shares: np.ndarray) -> str:
    low, high = share(float(shares.min())), share(float(shares.max()))
    return low if low == high else f"{low} to {high}"


def _spectrum_facts(provenance: dict[str, Any]) -> list[tuple[str, str]]:
    facts = []
    lines: dict[str, list[float]] = {}
    for channel, wavelength_m, _ in provenance.get("lines", []):
        lines.setdefault(channel, []).append(wavelength_m * 1e9)
    channels: dict[tuple[float, ...], list[str]] = {}
    for channel, wavelengths in lines.items():
        channels.setdefault(tuple(wavelengths), []).append(channel)
    for wavelengths, alike in channels.items():
        shown = [f"{w:.0f}" for w in wavelengths]
        if len(shown) > 5:
            shown = [*shown[:2], "…", *shown[-2:]]
        facts.append((" ".join(["wavelengths", *(alike if len(channels) > 1 else ())]), f"{' '.join(shown)} nm"))
    if "response" in provenance:
        facts.append(("response", str(provenance["response"])))
    return facts


# ---- the error budget


def budget_facts(stack: PsfStack) -> list[tuple[str, str]]:
    """Return a stack's budget as one (what, value) line, worst first; none where nobody judged it."""
    worst: dict[str, str] = {}  # of the rows that share a cause
    for row in read_budget(stack):
        worst.setdefault(row.name, f"{row.name} {share(row.value)}")
    return [("errors", ", ".join(worst.values()))] if worst else []


_NM = 1e9


def budget_tables(errors: dict[str, Any], sampling: dict[str, Any] | str) -> str:
    """Return the full error budget as tables: per depth and wavelength, per channel, per gap between planes, per angle.

    Args:
        errors: from ``full_errors``.
        sampling: from ``sampling_error``, or ``UNPROVEN``.
    """
    parts = [_by_depth(errors, sampling), _by_channel(errors["spectrum"])]
    if "planes" in errors:
        parts.append(_by_gap(errors["planes"]))
    if "field" in errors:
        parts.append(_by_angle(errors["field"]))
    return "\n\n".join(parts)


def _by_depth(errors: dict[str, Any], sampling: dict[str, Any] | str) -> str:
    """Return a row per depth and wavelength; what was not measured there stays empty."""
    columns: dict[str, dict[tuple[float, float], str]] = {}
    model, direct = errors.get("model"), errors.get("direct_sum")
    if model:
        columns["model vs exact"] = {_key(row): share(row["error"]) for row in model["table"]}
    if direct:
        columns["points vs direct sum"] = {
            _key(row): f"{share(row['error'])} (its own {share(row['uncertainty'])})" for row in direct["table"]
        }
    if not isinstance(sampling, str):
        coarse, fine = sampling["oversampling"]
        columns[f"sampling s = {coarse} vs {fine}"] = {_key(row): share(row["error"]) for row in sampling["table"]}
    keys = sorted({key for column in columns.values() for key in column})
    rows = [
        [
            length(depth_m),
            f"{wavelength_m * _NM:.0f} nm",
            *(column.get((depth_m, wavelength_m), "") for column in columns.values()),
        ]
        for depth_m, wavelength_m in keys
    ]
    judged = {"model": model, "points": direct, "sampling": None if isinstance(sampling, str) else sampling}
    widths = [f"{name}: {length(part['crop_m'])} of the mask" for name, part in judged.items() if part]
    remark = "\npoints are no pixels: faint orders beyond the grid and shifts of a micrometre count there in full"
    table = f"relative L2 errors ({', '.join(widths)})\n{_table(['depth', 'wavelength', *columns], rows)}"
    return table + (remark if direct else "")


def _by_channel(spectrum: dict[str, Any]) -> str:
    rows = [[channel, share(error)] for channel, error in spectrum["channels"].items()]
    title = f"wavelengths per channel against {spectrum['lines']} ({length(spectrum['crop_m'])} of the mask)"
    return f"{title}\n{_table(['channel', 'error'], rows)}"


def _by_gap(planes: dict[str, Any]) -> str:
    rows = [
        [length(row["near_m"]), length(row["far_m"]), length(row["depth_m"]), share(row["error"])]
        for row in planes["table"]
    ]
    title = "light between planes, taken from both, against its own PSF"
    return f"{title}\n{_table(['plane', 'plane', 'light from', 'error'], rows)}"


def _by_angle(field: dict[str, Any]) -> str:
    rows = sorted(field["table"], key=lambda row: row["degrees"])
    by_angle: dict[str, list[float]] = {}
    for row in rows:
        by_angle.setdefault(f"{row['degrees']:.1f}°", []).append(row["error"])
    rows = [[angle, share(float(np.sqrt(np.mean(np.square(errors)))))] for angle, errors in by_angle.items()]
    title = (
        f"one PSF for all directions, against exact oblique ones ({length(field['crop_m'])} of the mask, "
        f"{field['wavelength_m'] * _NM:.0f} nm, source at {length(field['depth_m'])})"
    )
    return f"{title}\n{_table(['field angle', 'error'], rows)}"


def _key(row: dict[str, Any]) -> tuple[float, float]:
    return float(row["depth_m"]), float(row["wavelength_m"])


def _table(heads: list[str], rows: list[list[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    return "\n".join(
        "  " + "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in [heads, *rows]
    )
