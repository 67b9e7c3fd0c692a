"""The samples of a page: which are shown, what is read of them, and a card for each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.camera.exposure import ExposureShares
from simulator.dataset.reader import Dataset, spread_positions
from simulator.dataset.sample import SceneFrame, StoredSample
from simulator.errors import InputError
from simulator.plots.drawing import (
    centimetres,
    depth_colours,
    depth_range,
    encoded,
    seen_range_m,
    three_channels,
    time_span,
    white_level,
)
from simulator.plots.report.facts import number_of
from simulator.plots.report.markup import Html, joined, paragraph, shown
from simulator.plots.report.pictures import FEW, SOME, depth_legend, picture, shrunk
from simulator.text import share

_FRAMES, _FRAMES_IN_ALL = 12, 288  # of one clip, and of all clips together: they are most of the page's bytes
_MEASUREMENT, _STILL, _FRAME = 512, 256, 128  # greatest number of rows and columns of an image


@dataclass(frozen=True)
class Shown:
    """What a page needs of a sample.

    Attributes:
        name: split and id.
        label: class name, or None.
        measurement: ``(H, W, 3)``, 1 is full scale.
        frames: of the scene, evenly chosen; the only one of a still.
        whole: frames of its clip in all.
        times: which frames these are and when, in words; empty text for a still.
        shares: of the exposure, those that the metadata hold, by the names of `ExposureShares`.
        snr_db: 20 log10 of the rms of the noiseless measurement over that of the noise; None without noise or light.
    """

    name: str
    label: str | None
    measurement: NDArray[np.float32]
    frames: list[SceneFrame]
    whole: int
    times: list[str]
    shares: dict[str, float]
    snr_db: float | None


def chosen_positions(lengths: Mapping[str, int], count: int) -> dict[str, list[int]]:
    """Return which samples of each split are shown: in proportion to its size, at least one where there is one.

    Example:
        >>> chosen_positions({"train": 80, "validation": 10, "test": 0}, 9)
        {'train': [5, 15, 25, 35, 45, 55, 65, 75], 'validation': [5], 'test': []}
    """
    whole = sum(lengths.values())
    return {
        split: spread_positions(length, max(1, round(count * length / whole)) if length else 0)
        for split, length in lengths.items()
    }


def read_samples(datasets: Sequence[Dataset], count: int) -> tuple[list[Shown], list[str]]:
    """Read ``count`` samples, spread over the splits, and return them and a line for each that is damaged."""
    positions = chosen_positions({dataset.split: len(dataset) for dataset in datasets}, count)
    frames = min(_FRAMES, max(2, _FRAMES_IN_ALL // count))
    found, problems = [], []
    for dataset in datasets:
        for position in positions[dataset.split]:
            name = f"{dataset.split}/{dataset.ids[position]}"
            try:
                found.append(_read(dataset.stored(position), name, frames))
            except InputError as error:
                problems.append(f"{name}: {error}")
    return found, problems


def _read(stored: StoredSample, name: str, most: int) -> Shown:
    numbers = np.linspace(0, stored.frames - 1, min(stored.frames, most)).round().astype(int).tolist()
    edges_s, times = stored.frame_edges_s, [""]
    if edges_s is not None:
        times = [f"frame {n + 1} of {stored.frames}, {time_span(edges_s[n : n + 2])}" for n in numbers]
    measurement, noiseless = stored.measurement()
    names = [field.removesuffix("_share") for field in ExposureShares(0, 0, 0, 0).record]
    metadata = stored.description["metadata"]
    return Shown(
        name,
        stored.label,
        three_channels(measurement, stored.channels),
        [stored.frame(number) for number in numbers],
        stored.frames,
        times,
        {key: value for key in names if (value := number_of(metadata, f"{key}_share")) is not None},
        snr_db(measurement, noiseless),
    )


def snr_db(measurement: NDArray[np.float32], noiseless: NDArray[np.float32]) -> float | None:
    """Return 20 log10 of the rms of the noiseless values over the rms of the noise; None where either is zero.

    Example:
        >>> round(snr_db(np.full(4, 1.1), np.full(4, 1.0)), 6)
        20.0
    """
    signal, noise = (float(np.mean(np.square(part, dtype=np.float64))) for part in (noiseless, measurement - noiseless))
    return 10 * float(np.log10(signal / noise)) if signal > 0 and noise > 0 else None


# ---- as HTML


def sample_cards(samples: Sequence[Shown]) -> Html:
    """Return how the samples are shown, and a card for each."""
    frames = [frame for sample in samples for frame in sample.frames]
    white = white_level(frame.rgb for frame in frames)
    near_m, far_m = seen_range_m([(frame.depth_m, frame.valid) for frame in frames])
    choices = joined(
        Html(f'<label><input type="radio" name="large" value="{kind}"{checked}> {words}</label>')
        for kind, words, checked in (
            ("measurement", "measurement", ""),
            ("truth", "ground truth", " checked"),
            ("depth", "depth", ""),
        )
    )
    tools = Html(f'<fieldset class="choice"><legend>Shown large</legend>{choices}</fieldset>')
    if any(len(sample.frames) > 1 for sample in samples):
        tools = Html(f'{tools}<button type="button" class="play" data-every>Play all clips</button>')
    scales = (
        "Measurements: sRGB, white is full scale. Ground truth: sRGB, white is a radiance of "
        f"{white:.3g} for all. Depth from the mask, {depth_range(near_m, far_m)} for all:"
    )
    if most := max((len(sample.frames) for sample in samples if len(sample.frames) < sample.whole), default=0):
        scales = f"Of clips {most} frames each, evenly chosen. {scales}"
    cards = joined(_card(sample, white, (near_m, far_m)) for sample in samples)
    return Html(
        f'<div class="tools">{tools}</div><div class="scales">{paragraph(scales)}{depth_legend(near_m, far_m)}</div>'
        f'<div class="cards">{cards}</div>'
    )


def _card(sample: Shown, white: float, range_m: tuple[float, float]) -> Html:
    name = shown(sample.name)
    label = Html(f'<span class="label">{shown(sample.label)}</span>') if sample.label else ""
    figures = joined(
        Html(f'<figure class="{kind}">{joined(images)}<figcaption>{words}</figcaption></figure>')
        for kind, words, images in (
            ("measurement", "measurement", [_measurement(sample)]),
            ("truth", "ground truth", _truths(sample, white)),
            ("depth", "depth", _depths(sample, range_m)),
        )
    )
    return Html(
        f'<article class="card" aria-label="{name}"><div class="pictures">{figures}'
        f'<button type="button" class="open" aria-label="Show {name} large"></button></div>'
        f"{_frame_control(sample)}<h3>{name}{label}</h3>{paragraph(', '.join(_words(sample)), 'small')}</article>"
    )


def _frame_control(sample: Shown) -> Html:
    if len(sample.frames) == 1:
        return Html()
    name, first = shown(sample.name), shown(sample.times[0])
    return Html(
        f'<div class="frames"><button type="button" class="play">Play<span class="unseen"> {name}</span></button>'
        f'<input type="range" min="0" max="{len(sample.frames) - 1}" value="0" aria-label="Frame of {name}" '
        f'aria-valuetext="{first}"><output aria-live="polite">{first}</output></div>'
    )


def _words(sample: Shown) -> Iterator[str]:
    for key, words in (("saturated", "saturated"), ("black", "black"), ("below_noise", "below the noise")):
        if key in sample.shares:
            yield f"{share(sample.shares[key])} {words}"
    if sample.snr_db is not None:
        yield f"SNR {sample.snr_db:.1f} dB"


def _measurement(sample: Shown) -> Html:
    mean = float(sample.measurement.mean())
    pixels = shrunk(encoded(sample.measurement), _MEASUREMENT)
    return picture(pixels, f"measurement of {sample.name}, mean {mean:.2f} of full scale", SOME)


def _truths(sample: Shown, white: float) -> Iterator[Html]:
    for number, (frame, when) in enumerate(zip(sample.frames, sample.times, strict=True)):
        lit = f"mean radiance {float(frame.rgb.mean()):.3g}, greatest {float(frame.rgb.max()):.3g}"
        described = ", ".join(filter(None, (f"ground truth of {sample.name}", when, lit)))
        yield picture(
            shrunk(encoded(frame.rgb, white), _side(sample)), described, _bytes(sample), **_place(sample, number)
        )


def _depths(sample: Shown, range_m: tuple[float, float]) -> Iterator[Html]:
    for number, (frame, when) in enumerate(zip(sample.frames, sample.times, strict=True)):
        seen = frame.depth_m[frame.valid]
        middle = f"median {centimetres(float(np.median(seen)))}" if seen.size else "nothing seen"
        described = ", ".join(filter(None, (f"depth of {sample.name}", when, middle)))
        pixels = shrunk(depth_colours(frame.depth_m, frame.valid, *range_m), _side(sample), mix=False)
        yield picture(pixels, described, _bytes(sample), **_place(sample, number))


def _side(sample: Shown) -> int:
    return _STILL if len(sample.frames) == 1 else _FRAME


def _bytes(sample: Shown) -> int:
    return SOME if len(sample.frames) == 1 else FEW


def _place(sample: Shown, number: int) -> dict[str, Any]:
    """Return the attributes of a frame's images; without JavaScript the first one is seen."""
    if len(sample.frames) == 1:
        return {}
    return {"data_frame": number, "data_time": sample.times[number], "hidden": number > 0}
