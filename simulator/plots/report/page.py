"""The page `report.html` of a data set: one file, without network, with all that one wants to see of it first."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from importlib.resources import files
from statistics import median
from string import Template

from simulator.dataset.checksums import REPORT, write_beside
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.store import Place, place
from simulator.plots.report import SAMPLES
from simulator.plots.report.charts import charts
from simulator.plots.report.facts import (
    Records,
    budget_table,
    configuration,
    failure_list,
    label_table,
    read_records,
    split_table,
    time_parts,
)
from simulator.plots.report.markup import Html, embedded_json, facts, folded, joined, paragraph, section, shown
from simulator.plots.report.psfs import explorer
from simulator.plots.report.samples import Shown, read_samples, sample_cards
from simulator.text import duration, length, share


def write_report(root: Place | str, *, samples: int = SAMPLES) -> Place:
    """Write the page of a data set, finished or still growing, beside its files; none of its code is run.

    The same data set gives the same bytes. Damaged samples and records are left out, and the page says so. A seal that is
    there lists the page from then on.

    Args:
        root: the data set's folder.
        samples: how many are shown, evenly spread over the splits.

    Returns:
        The path of the page, ``root/report.html``.

    Raises:
        InputError: no such folder, not a data set, or damaged ``dataset.json`` or ``checksums.json``.
        StorageError: the page cannot be written.
    """
    page = report_html(root, samples=samples).encode()
    write_beside(place(root), REPORT, page)
    return place(root) / REPORT


def report_html(root: Place | str, *, samples: int = SAMPLES) -> str:
    """Return the page; arguments and errors as for `write_report`."""
    if samples < 1:
        raise InputError("samples", f"got {samples}, expected at least 1")
    records = read_records(place(root))
    found, damaged = read_samples(_splits(records), samples)
    optics, data = _optics(records)
    # Wherever the folder lies, its page is the same.
    problems = [line.replace(f"{records.root}/", "") for line in records.problems + damaged]
    planes = 0 if records.stack is None else len(records.stack.depths_m)
    parts = {
        "samples": ("Samples", _samples(found)),
        "psf": ("Point spread functions", optics),
        "statistics": ("Exposure, noise and depth", charts(records.root, len(records.entries), found, planes)),
        "splits": ("Splits and labels", joined((split_table(records), label_table(records)))),
        "errors": ("Error budget", budget_table(records.budget)),
        "time": ("Time", time_parts(records)),
        "failures": ("Failures", failure_list(records)),
        "made": ("How it was made", configuration(records.info)),
    }
    style, script = _resource("page.css"), _resource("page.js")
    return Template(_resource("page.html")).substitute(
        title=shown(records.info.name),
        summary=shown(_summary(records)),
        key_figures=facts(_key_figures(records, found)),
        links=joined(Html(f'<li><a href="#{name}">{shown(title)}</a></li>') for name, (title, _) in parts.items()),
        notices=_notices(records, problems),
        sections=joined(section(name, title, content) for name, (title, content) in parts.items()),
        style=style,
        style_hash=_hash(style),
        script=script,
        script_hash=_hash(script),
        data=embedded_json({"psf": data}),
    )


def _splits(records: Records) -> list[Dataset]:
    ids = {split: tuple(name for own, name in records.entries if own == split) for split in records.info.counts}
    return [Dataset(records.root, split, names, records.info) for split, names in ids.items()]


def _samples(found: list[Shown]) -> Html:
    return sample_cards(found) if found else paragraph("No sample is finished.")


def _optics(records: Records) -> tuple[Html, dict | None]:
    """Return the section of the PSFs, and the data of its sliders; None without PSFs."""
    if records.stack is None:
        return paragraph("The PSFs cannot be read."), None
    known = folded("What the PSFs record of themselves", facts(records.optics)) if records.optics else Html()
    try:
        content, data = explorer(records.info, records.stack)
    except InputError as error:
        return joined((paragraph(f"The field cannot be read: {error}."), known)), None
    return joined((content, known)), data


def _summary(records: Records) -> str:
    info, stack = records.info, records.stack
    sensor, scene = (f"{rows} × {columns}" for rows, columns in (info.sensor_shape, info.scene_shape))
    text = f"Measurements of {sensor} pixels, ground truth of {scene}"
    if stack is None:
        return f"{text}."
    ends = dict.fromkeys(length(float(depth_m)) for depth_m in stack.depths_m[[0, -1]])
    count = f"{len(stack.depths_m)} depths" if len(stack.depths_m) > 1 else "one depth"
    return f"{text}, PSFs of {count}, {' to '.join(ends)}."


def _key_figures(records: Records, found: list[Shown]) -> Iterator[tuple[str, str]]:
    """Yield what one wants to know first."""
    yield "samples finished", f"{len(records.entries):,} of {sum(records.info.counts.values()):,}"
    saturated = [sample.shares["saturated"] for sample in found if "saturated" in sample.shares]
    if saturated:
        yield "saturated, mean of those shown", share(sum(saturated) / len(saturated))
    if snr := [sample.snr_db for sample in found if sample.snr_db is not None]:
        yield "median SNR of those shown", f"{median(snr):.1f} dB"
    if records.budget:
        yield f"largest error: {records.budget[0].name}", share(records.budget[0].value)
    if records.entries:
        yield "time of the workers", duration(sum(entry.seconds for entry in records.entries.values()))


def _notices(records: Records, problems: list[str]) -> Html:
    """Return what should be seen before anything else."""
    parts = []
    counts = {"failed": len(records.failed), "skipped": len(records.skipped)}
    if words := ", ".join(f"{count:,} {what}" for what, count in counts.items() if count):
        parts.append(Html(f'<p class="notice">Samples: {words}. <a href="#failures">See why</a></p>'))
    if problems:
        lines = joined(Html(f"<li>{shown(line)}</li>") for line in problems)
        parts.append(Html(f'<div class="notice"><p>Damaged, and left out of this page:</p><ul>{lines}</ul></div>'))
    return joined(parts)


def _resource(name: str) -> str:
    return (files(__package__ or "") / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return a hash by which the page's own policy admits a style or script."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
