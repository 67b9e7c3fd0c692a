"""The exposure of a data set: what pilot samples and finished samples say of it, and what to change."""

from __future__ import annotations

import io
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.camera.exposure import ExposureShares
from simulator.camera.noise import GaussianNoise, PhysicalNoise
from simulator.camera.sensor import PERCENTILE, PILOTS, TARGET, Sensor, full_scale_from_pilots
from simulator.dataset.engines import GivenUpError
from simulator.dataset.plan import Plan, Report, Say
from simulator.dataset.recipe import make_pilot, perform
from simulator.errors import InputError
from simulator.io.files import TEMPORARY_PREFIX, StorageError, remove_folder, storage_errors
from simulator.io.store import Place

_LOOKED_AT = 4
"""Pilot samples of a data set whose exposure is given."""

# Shares that are worth a word: 'auto' saturates hardly any value, and half of a sensor may lie in the dark.
_SATURATED, _DIM = 0.01, 0.75
_DARK = 0.5  # of the well
_LOST = 0.01  # values with signal for each saturated one, below which the image is burnt out


def find_exposure(plan: Plan, accept: bool, progress: Report, say: Say) -> dict[str, Any]:
    """Return the one number that maps exposure to full scale, where it comes from, and what pilot samples say of it.

    Raises:
        InputError: the exposure is of no use, or is to be found and the pilot samples cannot be made.
        StorageError: the place cannot be written to.
    """
    sensor, fixed = plan.assembly.sensor, plan.assembly.fixed_exposure
    wanted = PILOTS if fixed is None else min(_LOOKED_AT, sum(plan.counts.values()))
    pilots, bad = _pilots(plan, wanted, fixed is not None, progress)
    if fixed is not None and not pilots:
        return fixed  # what cannot be had at all is reported as its sample's failure
    if not pilots:
        raise bad[0]
    if bad:
        say(f"note: {len(bad)} of {wanted} exposure pilots cannot be made and are left out: {bad[min(bad)]}")
    record = _record(pilots, fixed, sensor)
    shares = ExposureShares(**record["pilot_shares"])
    if not accept:
        _refuse_useless(shares, record, sensor)
    say_exposure(f"{len(pilots)} pilot samples", shares, record, plan, say)
    return record


def _pilots(
    plan: Plan, wanted: int, may_fail: bool, progress: Report
) -> tuple[list[NDArray[np.float32]], dict[int, Exception]]:
    """Return the exposures of the first so many pilot samples, and why others could not be made, by number."""
    made: dict[int, Place] = {}
    bad: dict[int, Exception] = {}
    with _shared_folder(plan.root) as folder:
        tasks = ((folder, index) for index in range(wanted))
        for outcome in perform(plan.config.dataset, make_pilot, tasks, wanted, plan.recipe):
            (_, index), error = outcome.task, outcome.error
            if error is None:
                assert outcome.value is not None
                made[index] = outcome.value
            elif isinstance(error, InputError) and error.path == "scene.surroundings":
                raise error  # which fails every sample alike
            elif plan.skips(error) or (may_fail and not isinstance(error, StorageError)):
                bad[index] = error
            elif isinstance(error, GivenUpError):
                raise InputError(f"exposure pilot {index}", outcome.reason) from error
            else:
                raise error
            progress("exposure pilots", len(made) + len(bad), wanted)
        return [np.load(io.BytesIO(made[index].read_bytes())) for index in sorted(made)], bad


@contextmanager
def _shared_folder(root: Place) -> Iterator[Place]:
    """Give a folder that workers on all nodes see, for the time of the block."""
    folder = root / f"{TEMPORARY_PREFIX}pilots-{secrets.token_hex(4)}"
    if isinstance(folder, Path):
        with storage_errors(folder):
            folder.mkdir()
    try:
        yield folder
    finally:
        remove_folder(folder)


def say_exposure(of: str, shares: ExposureShares, record: dict[str, Any], plan: Plan, say: Say) -> None:
    """Say what an exposure is worth, and what to change."""
    say(f"exposure, {of}: {shares}")
    for key, reason in _complaints(shares, record, plan.assembly.sensor):
        say(f"note: {key}: {reason}")


def _record(
    exposures: Sequence[NDArray[np.float32]], fixed: Mapping[str, Any] | None, sensor: Sensor
) -> dict[str, Any]:
    """Return the exposure as a data set records it: its one number, where it comes from, what the pilots are worth with it.

    Args:
        exposures: noiseless exposures ``(C, H, W)`` of the pilot samples.
        fixed: the record of a given exposure; None to find it. What ``auto`` would have chosen is recorded beside it, None
            where the pilots are dark.
        sensor: the camera's, at any ``full_scale``.

    Raises:
        InputError: the exposure is to be found, and the pilots are dark.
    """
    if fixed is None:
        auto = full_scale_from_pilots(exposures)
        record = {"full_scale": auto, "from": "pilots", "percentile": PERCENTILE, "target": TARGET}
    else:
        auto = None
        with suppress(InputError):
            auto = full_scale_from_pilots(exposures)
        record = {**fixed, "auto_full_scale": auto}
    lit = replace(sensor, full_scale=record["full_scale"])
    shares = ExposureShares.mean([lit.shares(exposure) for exposure in exposures])
    return record | {"pilots": len(exposures), "pilot_shares": asdict(shares)}


def _refuse_useless(shares: ExposureShares, record: Mapping[str, Any], sensor: Sensor) -> None:
    """Refuse an exposure with which the pilots hold no value with signal, or hardly one beside those that are saturated.

    Raises:
        InputError: naming the key to change.
    """
    if shares.signal <= _LOST * shares.saturated:
        key, reason = next(_complaints(shares, record, sensor))
        raise InputError(key, f"{reason}. Such data carry no signal; to make them all the same: --accept-exposure")


def _complaints(shares: ExposureShares, record: Mapping[str, Any], sensor: Sensor) -> Iterator[tuple[str, str]]:
    """Yield for every share that is large the key to change, and why and how.

    Args:
        shares: of the pilots, or of all samples.
        record: the exposure as ``dataset.json`` holds it.
        sensor: the camera's, at any ``full_scale``.
    """
    now, auto = record["full_scale"], record.get("auto_full_scale")
    if shares.saturated > _SATURATED:
        seen = f"{shares.saturated:.2%} of the values are saturated"
        dark = float(np.mean(sensor.exposure_s)) * sensor.dark_current_e_per_s / sensor.full_well_e
        if isinstance(sensor.noise, PhysicalNoise) and dark > _DARK:
            cure = f"dark current alone fills {dark:.0%} of the well; lower it, or camera.shutter.exposure_ms"
            yield "camera.sensor.dark_current_e_per_s", f"{seen}: {cure}"
        elif auto is None or auto <= now:
            cure = f"they are brighter than the pilot samples; give a number above {now:.3g}"
            yield "camera.exposure.full_scale", f"{seen}: {cure}"
        else:
            yield _scaled(seen, record)
    if max(shares.black, shares.below_noise) > _DIM:
        seen = f"{shares.black:.2%} of the values are black, {shares.below_noise:.2%} below the noise"
        if auto is not None and auto < now / 2:
            yield _scaled(seen, record)
        elif "auto_full_scale" in record and auto is None:
            yield "scene", f"{seen}: the pilot samples hold no light; check its lights and the mask"
        elif shares.black >= shares.below_noise:
            yield "camera.sensor.shape", f"{seen}: no light reaches much of the sensor; a smaller one sees as much"
        elif isinstance(sensor.noise, GaussianNoise):
            yield (
                "camera.noise",
                f"{seen}: most of the sensor sees too little light for it; less noise, or a smaller sensor",
            )
        else:
            yield "camera.sensor", f"{seen}: less read_noise_e, more binning, or a smaller shape"


def _scaled(seen: str, record: Mapping[str, Any]) -> tuple[str, str]:
    """Return the key that sets a given exposure, and what would suit the pilots."""
    now, auto = record["full_scale"], record["auto_full_scale"]
    if (lux := record.get("illuminance_lux")) is None:
        return "camera.exposure.full_scale", f"got {now:g}, with which {seen}; 'auto' chooses {auto:.3g}"
    cure = f"{lux * now / auto:.3g} lux would fill the sensor's range, as would another camera.shutter.exposure_ms"
    return "camera.exposure.illuminance_lux", f"got {lux:g}, with which {seen}; {cure}"
