"""The error budget in words: a few lines for the facts of a stack, tables for the full check."""

from __future__ import annotations

from typing import Any

from simulator.text import length, share

_NM = 1e9


def budget_tables(errors: dict[str, Any], sampling: dict[str, Any]) -> str:
    """Return the full check as tables: per depth and wavelength, per channel, per field angle.

    Args:
        errors: from ``check.full_errors``.
        sampling: from ``sampling.sampling_error``.
    """
    parts = [_by_depth(errors, sampling), _by_channel(errors["spectrum"])]
    if "field_angle" in errors:
        parts.append(_by_angle(errors["field_angle"]))
    return "\n\n".join(parts)


def _by_depth(errors: dict[str, Any], sampling: dict[str, Any]) -> str:
    """Return a row per depth and wavelength; what was not measured there stays empty."""
    columns: dict[str, dict[tuple[float, float], str]] = {}
    model, direct = errors.get("model"), errors.get("direct_sum")
    if model:
        columns["model vs exact"] = {_key(row): share(row["error"]) for row in model["table"]}
    if direct:
        columns["points vs direct sum"] = {
            _key(row): f"{share(row['error'])} (its own {share(row['uncertainty'])})" for row in direct["table"]
        }
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
    judged = {"model": model, "points": direct, "sampling": sampling}
    widths = [f"{name}: {length(part['crop_m'])} of the mask" for name, part in judged.items() if part]
    return f"relative L2 errors ({', '.join(widths)})\n{_table(['depth', 'wavelength', *columns], rows)}"


def _by_channel(spectrum: dict[str, Any]) -> str:
    rows = [[channel, share(error)] for channel, error in spectrum["channels"].items()]
    title = f"wavelengths per channel against {spectrum['lines']} ({length(spectrum['crop_m'])} of the mask)"
    return f"{title}\n{_table(['channel', 'error'], rows)}"


def _by_angle(angles: dict[str, Any]) -> str:
    rows = [[f"{row['degrees']:.1f}°", share(row["error"])] for row in angles["table"]]
    title = (
        f"one PSF for the whole field, against the exact one off axis ({length(angles['crop_m'])} of the mask, "
        f"{angles['wavelength_m'] * _NM:.0f} nm, source at {length(angles['depth_m'])})"
    )
    return f"{title}\n{_table(['field angle', 'error'], rows)}"


def _key(row: dict[str, Any]) -> tuple[float, float]:
    return float(row["depth_m"]), float(row["wavelength_m"])


def _table(heads: list[str], rows: list[list[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    return "\n".join(
        "  " + "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in [heads, *rows]
    )
