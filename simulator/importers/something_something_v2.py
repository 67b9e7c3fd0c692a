"""Something-Something V2 as flat scenes that move: short films of hands and things, each labelled by what is done.

Source: Goyal et al., The "something something" video database for learning and evaluating visual common sense, ICCV 2017
(arXiv:1706.04261); V2 has 220847 WebM clips of about 4 s and 12 frames per second in 174 classes.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from simulator.errors import InputError
from simulator.importers.film_files import VideoSurvey, open_films
from simulator.importers.inspection import Likeness, Progress, Survey, told
from simulator.importers.listing import first_lines, is_folder, list_folder, read_json, refuse_unreadable
from simulator.importers.videos import ClipPlan, Count, Crop, FlatVideos, InterpolateWith, Positive
from simulator.text import nearest
from simulator.types import View

Subset = Literal["train", "validation"]
Classes = Literal["all", "coarse"] | Path
COARSE_TABLE = Path(__file__).with_name("something_something_v2_coarse.csv")
"""The 41 templates in 10 classes of the paper's tables 5 and 7, reconstructed; its first lines say from what."""
_CLIP_FOLDERS = ("20bn-something-something-v2", "clips", ".")
_LABEL_FOLDERS = ("", "labels")
_PREFIXES = ("something-something-v2-", "")


def something_something_v2(
    view: View,
    *,
    path: Path,
    frames: Count,
    subset: Subset | None = None,
    classes: Classes = "all",
    frames_per_second: Positive | None = None,
    interpolate_by: Count = 1,
    interpolate_with: InterpolateWith = "optical_flow",
    superslomo_checkpoint: Path | None = None,
    clips_per_video: Count = 1,
    crop: Crop = "centre",
    plane_cm: Positive | None = None,
) -> FlatVideos:
    """Read labelled clips from a Something-Something V2 folder.

    Clips that the label file lists but the folder does not hold are passed over: a part of the data set will do.

    Args:
        view: the camera's view: size of the scene, near and far depth.
        path: the folder that holds ``20bn-something-something-v2`` (or ``clips``) with ``74225.webm`` and so on, and the
            label files ``something-something-v2-labels.json``, ``-train.json``, ``-validation.json`` (or ``labels.json``,
            ``train.json``, ``validation.json``), there or in ``labels``.
        frames: of a clip, after interpolation.
        subset: the data set's own part; without it ``train`` where that is there, else ``validation``.
        classes: ``all`` labels a clip by its template, one of 174; ``coarse`` by one of 10 classes of 41 templates, a table
            that was reconstructed from the paper; or a table of your own, a CSV file with the columns template and class.
            Clips of templates that a table does not list are left out.
        frames_per_second: rate at which a clip is taken to have been filmed; without it the film's own times interpolate_by.
        interpolate_by: frames that one of the film's becomes by temporal interpolation.
        interpolate_with: how frames are interpolated.
        superslomo_checkpoint: the published weights, for ``superslomo``.
        clips_per_video: how many clips a film gives, evenly spread; 1 begins anywhere.
        crop: where the view's proportions are cut out of the image, the same for all frames of a clip.
        plane_cm: depth of the plane on which the film is seen; without it the view's far depth.

    Returns:
        A scene source; films that are damaged or too short, or whose template is unknown, are among its ``problems``.

    Raises:
        InputError: missing folders or files, no clip that can be used, contradicting parameters.
    """
    interpolation = interpolate_by, interpolate_with, superslomo_checkpoint
    plan = ClipPlan.of(view, frames, frames_per_second, clips_per_video, crop, plane_cm, *interpolation)
    found = _list(Path(path), subset, classes)
    films, problems = open_films(found.root, found.films)
    problems = [*found.problems, *problems]
    return FlatVideos.of("something_something_v2", view, films, plan, problems, found.label_files)


def recognises(path: Path) -> Likeness | None:
    """Whether a folder holds the data set's files of labels and of a subset, judged by names alone."""
    files = [find_labels(Path(path), name) for name in ("labels", "train", "validation")]
    if files[0] is None or not any(files[1:]):
        return None
    return Likeness("sure", f"holds {' and '.join(file.name for file in files if file)}")


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    subset: Subset | None = None,
    classes: Classes = "all",
    frames: int | None = None,
    interpolate_by: int = 1,
) -> Survey:
    """Decode every clip once and count classes; parameters and errors as for :func:`something_something_v2`."""
    found = _list(Path(path), subset, classes)
    plan = None if frames is None else ClipPlan(frames, interpolate_by=interpolate_by)
    read = VideoSurvey(plan, problems=[*found.problems])
    films = told(found.films, len(found.films), progress)
    counts = Counter(label for name, label in films if read.add_film(found.root, name))
    if found.absent:
        read.notes.append(
            f"{found.absent} of the {found.listed} clips in {found.label_files[1].name} are not in the folder"
        )
    if found.unlabelled:
        read.notes.append(f"{found.unlabelled} clips are of templates that {found.label_files[-1].name} leaves out")
    if classes == "coarse":
        read.notes.append("the coarse classes are reconstructed from the paper, not the authors' own file")
    most = ", ".join(f"{name} ({count})" for name, count in counts.most_common(5)) or "none"
    facts = {
        "subset": f"{found.subset}, {found.listed} clips listed, {found.listed - found.absent} in the folder",
        "classes": f"{len(counts)} of {found.classes}: {most}{', ...' if len(counts) > 5 else ''}",
    }
    return read.result("something_something_v2", Path(path), facts)


@dataclass(frozen=True)
class _Found:
    """What the folder's names and its label files say.

    Attributes:
        root: the folder.
        subset: which part was chosen.
        films: names relative to ``root`` and labels, in the label file's order.
        label_files: of labels, of the subset, and the table of classes if there is one.
        problems: lines about clips in the folder whose template is unknown.
        listed: clips in the subset's file.
        absent: how many of them the folder does not hold.
        unlabelled: how many of those there the table of classes leaves out.
        classes: how many classes there could be.
    """

    root: Path
    subset: str
    films: list[tuple[str, str]]
    label_files: tuple[Path, ...]
    problems: tuple[str, ...]
    listed: int
    absent: int
    unlabelled: int
    classes: int


def _list(root: Path, subset: Subset | None, classes: Classes) -> _Found:
    if not is_folder(root):
        raise InputError("path", f"{root} is not a folder; expected that of the clips' folder and the label files")
    chosen: Subset = subset or ("train" if find_labels(root, "train") else "validation")
    places = {name: find_labels(root, name) for name in ("labels", chosen)}
    for name, place in places.items():
        if place is None:
            raise InputError("path", f"{root} holds no something-something-v2-{name}.json, there or in labels")
    labels, entries_file = filter(None, places.values())
    templates = read_templates(labels)
    entries, unknown = read_entries(entries_file, templates, labels)
    listed = len(entries) + len(unknown)
    if classes == "all":
        table, files = {template: template for template in templates}, (labels, entries_file)
    else:
        place = COARSE_TABLE if classes == "coarse" else Path(classes)
        table, files = read_table(place, templates, labels), (labels, entries_file, place)

    listings = ((name, [f for f in list_folder(root / name)[1] if f.endswith(".webm")]) for name in _CLIP_FOLDERS)
    folder, clips = next((found for found in listings if found[1]), (None, []))
    if folder is None:
        raise InputError("path", f"{root} holds no clips: expected 74225.webm and so on in {_CLIP_FOLDERS[0]}")
    there = {name.removesuffix(".webm") for name in clips}
    present = {identity: template for identity, template in entries.items() if identity in there}
    problems = tuple(line for identity, line in unknown.items() if identity in there)
    if problems and not present:
        listed_problems = "\n  ".join(first_lines(problems))
        raise InputError("path", f"{root} holds no clip whose template is known:\n  {listed_problems}")
    if not present:
        first = next(iter((*entries, *unknown)))
        raise InputError(
            "path",
            f"{entries_file.name} lists no clip in {root / folder} (of {listed}, the first {first})",
        )
    films = [
        ((Path(folder) / f"{identity}.webm").as_posix(), table[template])
        for identity, template in present.items()
        if template in table
    ]
    if not films:
        raise InputError("classes", f"{files[-1]} lists the template of no clip in {root / folder}")
    return _Found(
        root=root,
        subset=chosen,
        films=films,
        label_files=files,
        problems=problems,
        listed=listed,
        absent=listed - len(present) - len(problems),
        unlabelled=len(present) - len(films),
        classes=len(set(table.values())),
    )


def find_labels(root: Path, name: str) -> Path | None:
    """Return a label file's path under one of its original names (``name`` is ``labels``, ``train`` or ``validation``).

    Raises:
        InputError: the folder cannot be looked into.
    """
    places = (root / folder / f"{prefix}{name}.json" for folder in _LABEL_FOLDERS for prefix in _PREFIXES)
    try:
        return next((place for place in places if place.is_file()), None)
    except OSError as error:
        refuse_unreadable(root, error)


def read_templates(path: Path) -> dict[str, Any]:
    """Read the file of all templates, ``{"Closing something": "5", ...}``.

    Raises:
        InputError: naming the file, when it is something else.
    """
    content = read_json(path)
    if not isinstance(content, dict) or not content or not all(str(value).isdecimal() for value in content.values()):
        raise InputError(path, 'not a file of labels: expected {"Approaching something with your camera": "0", ...}')
    return content


def read_entries(path: Path, templates: Collection[str], labels: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Read a subset's file, ``[{"id": "74225", "template": "Spinning [something] ...", ...}, ...]``.

    Returns:
        By a clip's number, which names its file: the template, without brackets, where that is known; and, for the other
        clips, the line that says what they have instead.

    Raises:
        InputError: naming the file and the clip, when an entry is broken.
    """
    content = read_json(path)
    if not isinstance(content, list) or not content:
        raise InputError(path, 'not a list of clips: expected [{"id": "74225", "template": "Closing [something]"}]')
    entries: dict[str, str] = {}
    unknown: dict[str, str] = {}
    for place, item in enumerate(content):
        if not isinstance(item, Mapping) or not str(item.get("id", "")).isdecimal():
            raise InputError(path, f"entry {place} has no id of digits, got {str(item)[:80]}")
        identity, written = str(item["id"]), item.get("template")
        if not isinstance(written, str):
            raise InputError(path, f"clip {identity} has no template, as in the test subset; use train or validation")
        template = _bare(written)
        if template not in templates:
            text = f"clip {identity} has the unknown template {written!r}, not in {labels.name}"
            unknown[identity] = f"{path.name}: {text}{_nearest(template, templates)}"
        elif identity in entries:
            raise InputError(path, f"lists clip {identity} twice: keep one of them")
        else:
            entries[identity] = template
    return entries, unknown


def read_table(path: Path, templates: Collection[str], labels: Path) -> dict[str, str]:
    """Read a table of classes: a CSV file with the columns ``template`` and ``class``; lines that begin with # are comments.

    Returns:
        Each listed template's class.

    Raises:
        InputError: naming the file and line, for a missing column, an empty class, an unknown or repeated template.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("classes", f"{path} cannot be read ({error}); expected all, coarse or a CSV file") from error
    # Comments become empty lines, so that lines keep their numbers.
    reader = csv.reader(("" if line.startswith("#") else line for line in lines), strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num}", f"not a line of a CSV file ({error})") from error
    columns = [name.strip() for name in rows[0][1]] if rows else []
    if columns != ["template", "class"] or len(rows) == 1:
        raise InputError(path, f"got {','.join(columns)!r}, expected the line template,class and a line per template")
    table: dict[str, str] = {}
    for number, row in rows[1:]:
        if len(row) != 2 or not row[1].strip():
            raise InputError(
                f"{path}:{number}", f"got {','.join(row)}, expected template,class; quote what holds commas"
            )
        template = _bare(row[0]).strip()
        if template not in templates:
            hint = _nearest(template, templates)
            raise InputError(f"{path}:{number}", f"unknown template {template!r}, not in {labels.name}{hint}")
        if template in table:
            raise InputError(f"{path}:{number}", f"lists {template!r} a second time: keep one of them")
        table[template] = row[1].strip()
    return table


def _bare(template: str) -> str:
    return template.replace("[", "").replace("]", "")


def _nearest(template: str, templates: Collection[str]) -> str:
    by_lower = {known.lower(): known for known in templates}
    hint = nearest(template, by_lower)
    for lower, known in by_lower.items():
        hint = hint.replace(repr(lower), repr(known))
    return hint
