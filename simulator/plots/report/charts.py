"""What samples are worth, as histograms: exposure and clamped shares of all of them, SNR and depth of those shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from simulator.dataset.reader import all_metadata
from simulator.io.store import Place
from simulator.plots.drawing import centimetres
from simulator.plots.report.facts import number_of
from simulator.plots.report.histograms import Histogram, histogram, histogram_figure
from simulator.plots.report.markup import Html, facts, joined
from simulator.plots.report.samples import Shown
from simulator.text import share

_MOST = 2000  # samples whose metadata are read
_SHARES = {
    "saturated_share": ("Saturated", "% of a sample's values"),
    "black_share": ("Black", "% of a sample's values"),
    "below_noise_share": ("Below the noise", "% of a sample's values"),
}
_OUTSIDE = {
    "clamped_depth_share": ("Depth outside the PSFs' planes", "% of a sample's seen pixels"),
    "clamped_light_share": ("Light from outside the PSFs' planes", "% of a sample's light"),
}


def charts(root: Place, finished: int, samples: Sequence[Shown], planes: int) -> Html:
    """Return the histograms of a data set; a value that all samples share is told in words.

    Args:
        root: the data set's folder.
        finished: how many samples it has.
        samples: those that the page shows.
        planes: depths of the PSFs; of a single one, which serves all depths, nothing is outside.
    """
    of = (
        f"all {finished:,} finished samples"
        if finished <= _MOST
        else f"{_MOST:,} of {finished:,} samples, evenly chosen"
    )
    drawn, told = list(_of_shown(samples)), []
    metadata = list(all_metadata(root, _MOST)) if finished else []
    for key, (title, unit) in (_SHARES | (_OUTSIDE if planes > 1 else {})).items():
        values = [value for one in metadata if (value := number_of(one, key)) is not None]
        if values and min(values) == max(values):
            told.append((f"{title}, {unit[2:]}", share(values[0])))
        elif values:
            drawn.append(histogram(title, unit, np.multiply(values, 100), of))
    alike = joined((Html(f"<h3>The same in {of}</h3>"), facts(told))) if told else Html()
    return joined((Html(f'<div class="charts">{joined(map(histogram_figure, drawn))}</div>'), alike))


def _of_shown(samples: Sequence[Shown]) -> Iterator[Histogram]:
    """Yield what takes the samples' images: SNR and depth."""
    shown = "the sample" if len(samples) == 1 else f"the {len(samples)} samples"
    snr = [sample.snr_db for sample in samples if sample.snr_db is not None]
    if snr:
        unit = "dB, 20 log₁₀ of rms without noise / rms of the noise"
        yield histogram("Signal-to-noise ratio of measurements", unit, snr, f"{shown} shown above")
    frames = [frame for sample in samples for frame in sample.frames]
    depth_m = np.concatenate([frame.depth_m[frame.valid] for frame in frames]) if frames else np.empty(0)
    if depth_m.size:
        of = f"{depth_m.size:,} seen pixels of {shown} shown above"
        yield histogram("Depth", "depth from the mask, even in 1/z", 1 / depth_m, of, _depth)


def _depth(disparity: float) -> str:
    return centimetres(1 / disparity if disparity > 1e-9 else np.inf)
