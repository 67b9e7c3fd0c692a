"""What a data set's records say in numbers and tables: counts, labels, failures, errors, time, configuration."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from simulator.dataset.dataset_info import DatasetInfo, read_info
from simulator.dataset.manifest import (
    FAILED,
    SKIPPED,
    STAGES,
    Entry,
    FailedSample,
    Key,
    load_failed,
    load_manifest,
    load_skipped,
)
from simulator.errors import InputError
from simulator.io.store import Place
from simulator.optics.error_budget.budget import BudgetRow, read_budget
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import PSF_FOLDER, read_psf_stack
from simulator.plots.psf_facts import psf_facts
from simulator.plots.report.histograms import histogram, histogram_figure
from simulator.plots.report.markup import Html, bar, facts, folded, joined, paragraph, shown, table
from simulator.text import counted, duration, share

Result = TypeVar("Result")
_LISTED = 50  # failures, skipped samples and labels


@dataclass(frozen=True)
class Records:
    """What a data set holds beside its samples' files; a damaged record is left out, with a line in ``problems``.

    Attributes:
        root: the data set's folder.
        info: the content of ``dataset.json``.
        entries: the finished samples.
        failed: those that could not be made.
        skipped: those that were left out for good.
        stack: the PSFs; None where they cannot be read.
        budget: the errors of the stack, worst first.
        optics: (what, value) facts of the stack.
        problems: what could not be read, a line each.
    """

    root: Place
    info: DatasetInfo
    entries: dict[Key, Entry]
    failed: dict[Key, FailedSample]
    skipped: dict[Key, str]
    stack: PsfStack | None
    budget: list[BudgetRow]
    optics: list[tuple[str, str]]
    problems: list[str]


def read_records(root: Place) -> Records:
    """Read a data set's records.

    Raises:
        InputError: no such folder, not a data set, or a damaged ``dataset.json``.
    """
    info, problems = read_info(root), []

    def tried(read: Callable[..., Result], *arguments: object, otherwise: Result) -> Result:
        try:
            return read(*arguments)
        except InputError as error:
            problems.append(str(error))
            return otherwise

    def entries() -> dict[Key, Entry]:
        return load_manifest(root).entries

    def psfs() -> PsfStack | None:
        return read_psf_stack(root / PSF_FOLDER)

    stack = tried(psfs, otherwise=None)
    return Records(
        root,
        info,
        tried(entries, otherwise={}),
        tried(load_failed, root, otherwise={}),
        tried(load_skipped, root, otherwise={}),
        stack,
        tried(_budget, stack, otherwise=[]) if stack else [],
        tried(_optics, stack, otherwise=[]) if stack else [],
        problems,
    )


def _budget(stack: PsfStack) -> list[BudgetRow]:
    try:
        rows = read_budget(stack)
        return sorted(rows, key=lambda row: -float(row.value))  # also refuses what is not a number
    except (TypeError, ValueError) as error:
        raise InputError("psf.json: provenance.budget", f"damaged ({error}); compute the stack again") from error


def _optics(stack: PsfStack) -> list[tuple[str, str]]:
    try:
        return psf_facts(stack)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise InputError("psf.json: provenance", f"damaged ({error!r}); compute the stack again") from error


def number_of(metadata: Mapping[str, Any], key: str) -> float | None:
    """Return a finite number of metadata, which anybody may have written; None where there is none."""
    value: Any = metadata.get(key)
    return float(value) if type(value) in (int, float) and math.isfinite(value) else None


# ---- as HTML


def split_table(records: Records) -> Html:
    """Return how many samples each split wants, has, lacks for good and failed to make."""
    counts = [Counter(split for split, _ in keys) for keys in (records.entries, records.skipped, records.failed)]
    rows = []
    for split, wanted in records.info.counts.items():
        finished, skipped, failed = (count[split] for count in counts)
        done = bar([finished / max(wanted, 1)])
        rows.append((split, f"{wanted:,}", f"{finished:,}", f"{skipped:,}", f"{failed:,}", done))
    return table("Samples per split", ("split", "wanted", "finished", "skipped", "failed", "finished of wanted"), rows)


def label_table(records: Records) -> Html:
    """Return how often each label occurs in each split; nothing where samples have none."""
    found = Counter((entry.label, entry.split) for entry in records.entries.values() if entry.label is not None)
    labels = Counter(entry.label for entry in records.entries.values() if entry.label is not None)
    if not labels:
        return Html()
    splits, most = list(records.info.counts), max(labels.values())
    kept = labels.most_common(_LISTED)
    rows = [
        (label, *(f"{found[label, split]:,}" for split in splits), f"{whole:,}", bar([whole / most]))
        for label, whole in sorted(kept)
    ]
    more = f", the {_LISTED} most frequent of {len(labels):,}" if len(labels) > _LISTED else ""
    return table(f"Labels per split{more}", ("label", *splits, "all", "share of the most frequent"), rows)


def failure_list(records: Records) -> Html:
    """Return which samples failed or were skipped, and why."""
    failed, skipped = list(records.failed.items()), list(records.skipped.items())
    if not failed and not skipped:
        return paragraph("No sample failed, none was skipped.")
    parts = []
    if failed:
        parts.append(
            paragraph(f"{counted(len(failed), 'sample')} could not be made ({FAILED}); the next run tries again.")
        )
    for (split, name), failure in failed[:_LISTED]:
        tries = "tried once" if failure.attempts == 1 else f"tried {failure.attempts} times"
        reason = failure.reason.removesuffix(f" ({tries})")
        head = Html(f"<b>{shown(f'{split}/{name}')}</b>: {shown(reason)} <small>({tries})</small>")
        trace = Html(f'<pre tabindex="0">{shown(failure.traceback or "No traceback was recorded.")}</pre>')
        parts.append(folded(head, trace))
    parts.append(_more(failed))
    if skipped:
        parts.append(paragraph(f"{counted(len(skipped), 'sample')} left out for good ({SKIPPED})."))
        rows = [(f"{split}/{name}", reason) for (split, name), reason in skipped[:_LISTED]]
        parts += [table("Skipped samples", ("sample", "reason"), rows), _more(skipped)]
    return joined(parts)


def _more(items: list[Any]) -> Html:
    return paragraph(f"And {len(items) - _LISTED:,} more.") if len(items) > _LISTED else Html()


def budget_table(rows: list[BudgetRow]) -> Html:
    """Return the error budget as bars, worst first."""
    if not rows:
        return paragraph("Nobody judged these PSFs.")
    cells = [
        (
            Html(f"<b>{shown(row.name)}</b>{' <span class=warn>larger than it should be</span>' if row.warn else ''}"),
            Html(f"{bar([row.value])} {share(row.value)}"),
            row.kind,
            row.change,
        )
        for row in rows
    ]
    caption = "Relative L2 errors, or shares of light, worst first; a full bar is 100 %"
    return table(caption, ("cause", "error", "of what", "what makes it smaller"), cells)


def time_parts(records: Records) -> Html:
    """Return how long samples took: in all, each, and for what."""
    entries = list(records.entries.values())
    if not entries:
        return paragraph("No sample is finished.")
    seconds = np.array([entry.seconds for entry in entries], np.float64)
    slowest = max(entries, key=lambda entry: entry.seconds)
    head = facts(
        [
            ("in all", f"{seconds.sum() / 3600:.3g} hours of one worker"),
            ("median of a sample", duration(float(np.median(seconds)))),
            ("slowest sample", f"{duration(slowest.seconds)}, {slowest.split}/{slowest.id}"),
        ]
    )
    chart = histogram_figure(histogram("Time per sample", "seconds", seconds, f"all {len(entries):,} finished samples"))
    return joined((head, _stages(entries), Html(f'<div class="charts">{chart}</div>')))


def _stages(entries: list[Entry]) -> Html:
    """Return how the time divides among the stages, where the manifest tells them."""
    whole = np.sum([entry.stages for entry in entries if len(entry.stages) == len(STAGES)], axis=0)
    if not np.sum(whole) > 0:
        return Html()
    shares = [(name, float(part), float(part / whole.sum())) for name, part in zip(STAGES, whole, strict=True)]
    rows = [
        (Html(f'<i class="key part{number % 6}"></i>{shown(name)}'), duration(seconds), share(part))
        for number, (name, seconds, part) in enumerate(shares)
    ]
    return joined((bar(part for *_, part in shares), table("Time per stage", ("stage", "in all", "share"), rows)))


def configuration(info: DatasetInfo) -> Html:
    """Return how the data set was made, to be read and copied."""
    import yaml

    text = yaml.safe_dump(info.config, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    made = facts(
        [
            ("fingerprint", Html(f"<code>{shown(info.fingerprint)}</code>")),
            ("rendered by", info.backend),
            *((name, value) for name, value in sorted(info.versions.items())),
        ]
    )
    exposure = yaml.safe_dump(info.exposure, sort_keys=False, allow_unicode=True, default_flow_style=None)
    return joined(
        (
            Html(
                '<div class="code"><button type="button" class="copy" aria-describedby="copied">Copy</button>'
                f'<output id="copied" aria-live="polite"></output><pre tabindex="0">{shown(text)}</pre></div>'
            ),
            Html("<h3>Exposure</h3>"),
            Html(f'<pre tabindex="0">{shown(exposure)}</pre>'),
            Html("<h3>Made with</h3>"),
            made,
        )
    )
