"""README.md of a data set: a card of facts, from its own files, for whoever finds it on a disk or a hub.

Names, labels and settings may come from anybody: their text is escaped, so that none of it becomes markup.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import yaml

from simulator.dataset.checksums import CARD, OUR_CARD, is_our_card
from simulator.dataset.dataset_info import DatasetInfo, read_info
from simulator.dataset.manifest import Survey, survey
from simulator.errors import InputError
from simulator.io.files import write_atomic
from simulator.io.json import canonical_json
from simulator.io.store import Place
from simulator.optics.error_budget.budget import read_budget
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import DESCRIPTION, PSF_FOLDER, read_psf_stack
from simulator.text import length, share

_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))
_LABELS_SHOWN = 50
_PART_NAMES = ("design", "model", "type")
_LONGEST = 300  # characters of a value; the configuration below holds all
_ESCAPES = {ord(mark): f"\\{mark}" for mark in "\\`*[]|~"} | {ord(mark): f"&#{ord(mark)};" for mark in "<>&@"}
_AT_A_WORDS_END = re.compile(r"(?<![^\W_])_|_(?![^\W_])")  # where an underscore is emphasis

Rows = Iterable[Sequence[object]]

_LAYOUT = """\
```
dataset.json       configuration, fingerprint, versions, exposure, sizes
manifest.jsonl     a line per sample: id, split, digest, seed, label, seconds
checksums.json     SHA-256 of every file that the samples' digests do not cover
report.html        the page to look at             contact_sheet.png, croissant.json: for galleries and indexes
psf/               the PSFs that were used: an EXR file per depth, and psf.json
psf_captured/      where there is one, the same as a calibration of the camera measures them
train/0000/s00000012/   sample.json (metadata, SHA-256 of the files), measurement.exr (channels, noiseless.*),
                        ground_truth.exr (R, G, B, Z, valid), surroundings.exr where light comes from beside the image;
                        of clips frames/ground_truth.0000.exr and so on
```"""
_READING = """\
Read samples as NumPy arrays, with the package `flatlight`:

```python
from simulator.dataset import open_dataset

train = open_dataset("FOLDER", "train")
sample = train[0]  # measurement (C, H, W), noiseless, rgb (T, h, w, 3), depth_m (T, h, w), valid, label
```

Check every byte: `flatlight verify FOLDER`. Other formats: `flatlight export FOLDER --to webdataset --output OUT`."""


def write_card(root: Place) -> None:
    """Write the card of a data set, unless its README.md is the user's; errors as `card`.

    Raises:
        StorageError: the folder is protected, or the disk is full.
    """
    path = root / CARD
    if not path.exists() or is_our_card(path):
        write_atomic(path, card(root))


def card(root: Place) -> bytes:
    """Return the card of a data set: the content of ``README.md``, with Hugging Face's front matter.

    It names no licence: a data set records none.

    Raises:
        InputError: not a data set, or a damaged one.
    """
    info, known, stack = read_info(root), survey(root), read_psf_stack(root / PSF_FOLDER)
    parts = [
        _front_matter(info, known),
        f"# {_plain(info.name)}",
        f"{known.samples} simulated captures of a lensless camera, each with its ground truth: linear radiance, "
        "depth from the mask plane and validity of every pixel.",
        "## Samples",
        _table(("split", "samples"), _counts(info, known)),
        *_labels(known.labels),
        _table(("array", "size"), _sizes(info)),
        "## Camera",
        _table(("what", "value"), _camera(info, stack)),
        "## PSFs",
        _table(("what", "value"), _psfs(stack)),
        *_budget(root, stack),
        "## Scenes",
        _table(("setting", "value"), _settings(info.config, "scene")),
        *_imported(info.config),
        "## Files",
        _LAYOUT,
        _READING,
        "## How it was made",
        _table(("what", "value"), _origin(info)),
        _configuration(info),
        OUR_CARD,
    ]
    return ("\n\n".join(parts) + "\n").encode()


def _plain(value: object) -> str:
    r"""Return a value as one line of text without any markup, neither Markdown's nor HTML's.

    Example:
        >>> print(_plain("a|b\n<script>"), _plain(0.5), _plain({"type": "global"}))
        a\|b &#60;script&#62; 0.5 {"type":"global"}
    """
    text = _AT_A_WORDS_END.sub(r"\\_", _line(_text(value)).translate(_ESCAPES))
    return text.replace("://", "&#58;//").replace("www.", "www&#46;")  # which would become links


def _line(text: str) -> str:
    """Return text as one line, not too long, of what can be seen."""
    text = "".join(mark if mark.isprintable() else " " for mark in text)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


def _table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [heads, ["---"] * len(heads), *([_plain(value) for value in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _front_matter(info: DatasetInfo, known: Survey) -> str:
    count, labelled = known.samples, bool(known.labels)
    content = {
        "pretty_name": _line(info.name),  # hubs look for the line that ends the front matter before they read YAML
        "size_categories": [next((name for most, name in _SIZES if count < most), "n>10M")],
        "task_categories": ["image-to-image", "depth-estimation", *(["image-classification"] if labelled else [])],
        "tags": ["lensless-imaging", "simulated"],
    }
    return f"---\n{yaml.safe_dump(content, sort_keys=False, width=2 * _LONGEST)}---"


def _counts(info: DatasetInfo, known: Survey) -> Rows:
    for split, wanted in info.counts.items():
        found = len(known.finished[split])
        yield split, found if found == wanted else f"{found} of {wanted}"


def _labels(labels: Mapping[str, int]) -> list[str]:
    if not labels:
        return []
    shown = sorted(labels.items(), key=lambda item: (-item[1], item[0]))[:_LABELS_SHOWN]
    more = [("(further labels)", len(labels) - len(shown))] if len(labels) > len(shown) else []
    return [_table(("label", "samples"), [*shown, *more])]


def _sizes(info: DatasetInfo) -> Rows:
    pixels = "{} x {} pixels"
    yield "measurement", f"{pixels.format(*info.sensor_shape)}, channels {', '.join(info.channels)}, {info.unit}"
    yield "ground truth", f"{pixels.format(*info.scene_shape)}, R, G, B in linear radiance, depth in metres"


def _camera(info: DatasetInfo, stack: PsfStack) -> Rows:
    yield from _settings(info.config, "camera", ("mask", "sensor", "shutter", "noise"))
    distance_m = stack.provenance.get("mask_to_sensor_m")
    if isinstance(distance_m, float):
        yield "mask to sensor", length(distance_m)
    yield "pixel pitch", length(stack.pixel_pitch_m)
    yield "full scale", info.exposure.get("full_scale")
    yield "full scale from", info.exposure.get("from")
    beside = info.field_of_view.get("light_from_outside")
    if isinstance(beside, float):
        yield "light from beyond the simulated field", share(beside)


def _psfs(stack: PsfStack) -> Rows:
    ends = [length(depth_m) for depth_m in (stack.depths_m[0], stack.depths_m[-1])]
    yield "depths", f"{len(stack.depths_m)}, {ends[0]} to {ends[1]}" if len(stack.depths_m) > 1 else ends[0]
    yield "size", f"{stack.values.shape[2]} x {stack.values.shape[3]} pixels, channels {', '.join(stack.channels)}"
    for name in ("model", "response", "kind"):
        if name in stack.provenance:
            yield name, stack.provenance[name]
    yield "fingerprint", stack.fingerprint


def _budget(root: Place, stack: PsfStack) -> list[str]:
    try:
        rows = [(row.name, row.kind, share(row.value), row.change) for row in read_budget(stack)]
    except (TypeError, ValueError) as error:
        raise InputError(
            root / PSF_FOLDER / DESCRIPTION, "damaged provenance.budget; restore it from a copy"
        ) from error
    heads = ("error", "of what", "relative L2, or share of light", "what makes it smaller")
    return ["The error budget, worst first:", _table(heads, rows)] if rows else []


def _settings(config: Mapping[str, Any], section: str, names: Sequence[str] = ()) -> Rows:
    """Yield what a section of the configuration says; of sections in it what is not null."""
    values = config.get(section)
    for name, value in values.items() if isinstance(values, dict) else ():
        if name in (names or values) and value is not None:
            yield name, _joined(value) if isinstance(value, dict) else value


def _joined(values: Mapping[str, Any]) -> str:
    """Return what is set in one line, the name of a part before its parameters."""
    names = sorted((name for name in values if values[name] is not None), key=lambda name: name not in _PART_NAMES)
    return ", ".join(f"{name} {_text(values[name])}" for name in names)


def _imported(config: Mapping[str, Any]) -> list[str]:
    scene = config.get("scene")
    if not isinstance(scene, dict) or scene.get("source") is None:
        return []
    return [
        "The scenes come from imported data. Its licence and citation apply; they are not recorded in this data set."
    ]


def _text(value: object) -> str:
    return value if isinstance(value, str) else canonical_json(value).decode()


def _origin(info: DatasetInfo) -> Rows:
    yield "fingerprint", info.fingerprint
    yield "renderer", info.backend
    yield from info.versions.items()


def _configuration(info: DatasetInfo) -> str:
    """Return the command and the file that it was given, in a block that nothing in the file ends."""
    text = yaml.safe_dump(info.config, sort_keys=False, width=120)
    fence = "`" * max(3, *(len(run) + 1 for run in re.findall("`+", text)), 3)
    return (
        "`flatlight generate sim_config.yaml`, with this file:\n\n<details><summary>sim_config.yaml</summary>\n\n"
        f"{fence}yaml\n{text}{fence}\n\n</details>"
    )
