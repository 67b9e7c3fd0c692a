"""Films and folders of numbered pictures as flat scenes that move."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from simulator.errors import InputError
from simulator.importers.film_files import FILM_SUFFIXES, PICTURE_SUFFIXES, Film, FilmCheck, PictureSequence, open_films
from simulator.importers.inspection import Progress, Survey
from simulator.importers.listing import counting_fault, is_folder, list_folder, natural
from simulator.importers.videos import ClipPlan, FlatVideos, choose_raiser, flat_videos, plane_depth
from simulator.types import View

FALLBACK = True
"""Folders of pictures are part of many data sets: a source that knows such a layout comes first."""


def film(
    view: View,
    *,
    path: Path,
    frames: Annotated[int, Field(gt=0)],
    frames_per_second: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None,
    raise_by: Annotated[int, Field(gt=0)] = 1,
    raise_with: Literal["optical_flow", "superslomo"] = "optical_flow",
    superslomo_checkpoint: Path | None = None,
    clips_per_video: Annotated[int, Field(gt=0)] = 1,
    crop: Literal["centre", "random"] = "centre",
    plane_cm: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None,
) -> FlatVideos:
    """Read clips from a film, from a folder of numbered pictures, or from a folder of several of them.

    Every film and every folder of pictures is a video. Films are converted to RGB by libav and decoded as sRGB, as are
    pictures; EXR and floating point TIFF pictures are linear light already. Only the frames that a clip takes are read.

    Args:
        view: the camera's view: size of the scene, near and far depth.
        path: a film (WebM, MP4, MKV, AVI and others), a folder of pictures of one size whose names sort by their numbers, or
            a folder of films or of such folders.
        frames: of a clip, after raising.
        frames_per_second: rate at which a clip is taken to have been filmed; without it the film's own, raised. Pictures have
            none of their own. A shutter of some milliseconds sees motion only if the frames are that short.
        raise_by: frames that one of the film's becomes, by interpolation.
        raise_with: how frames are interpolated.
        superslomo_checkpoint: the published weights, for ``superslomo``.
        clips_per_video: how many clips a video gives, evenly spread; 1 begins anywhere.
        crop: where the view's proportions are cut out of the picture, the same for all frames of a clip.
        plane_cm: depth of the plane on which the film is seen; without it the view's far depth.

    Returns:
        A scene source; videos that are damaged or too short, and folders in whose count pictures are missing, are among its
        ``problems``.

    Raises:
        InputError: nothing at ``path`` can be used, or the parameters contradict one another.
    """
    plan = ClipPlan(frames, frames_per_second, raise_by, clips_per_video, crop)
    depth_m = plane_depth(view, plane_cm)
    raiser = choose_raiser(raise_by, raise_with, superslomo_checkpoint)
    root, film_names, sequences = _list(Path(path))
    if sequences and frames_per_second is None:
        msg = (
            f"frames_per_second: pictures such as those in {root / next(iter(sequences))} have no rate of their own; say at "
            "which rate a clip is taken to have been filmed"
        )
        raise InputError(msg)
    films, problems = open_films(root, [(name, None) for name in film_names])
    videos: list[Film | PictureSequence] = [*films]
    for name, pictures in sequences.items():
        if fault := counting_fault(pictures):
            problems.append(f"{name}: {fault}")
        else:
            videos.append(PictureSequence(root, name, pictures))
    videos.sort(key=lambda video: natural(video.name))
    return flat_videos("film", view, videos, plan=plan, plane_m=depth_m, raiser=raiser, problems=problems)


def recognises(path: Path) -> bool:
    """Whether there are films or pictures at a path, judged by names alone.

    A folder of folders must hold nothing else: files beside them, or folders without pictures, tell of a data set with a
    layout of its own.

    Raises:
        InputError: a folder cannot be read.
    """
    path = Path(path)
    try:
        _list(path)
    except InputError as error:
        if isinstance(error.__cause__, OSError):
            raise
        return False
    if path.is_file() or any(_look(path)):
        return True
    folders, files = list_folder(path)
    return not files and all(any(_look(path / folder)) for folder in folders)


def survey(path: Path, progress: Progress | None = None, *, frames: int | None = None, raise_by: int = 1) -> Survey:
    """Decode every film and read every picture once.

    Args:
        path: as for :func:`film`.
        progress: told after each video.
        frames: of a clip; with it, videos that are too short are among the problems.
        raise_by: see :func:`film`.

    Raises:
        InputError: there is nothing to be read at ``path``.
    """
    root, film_names, sequences = _list(Path(path))
    checked = FilmCheck(None if frames is None else ClipPlan(frames, raise_by=raise_by))
    total = len(film_names) + len(sequences)
    for done, name in enumerate(film_names, start=1):
        checked.add_film(root, name)
        if progress is not None:
            progress(done, total)
    for done, (name, pictures) in enumerate(sequences.items(), start=len(film_names) + 1):
        checked.add_pictures(root, name, pictures)
        if progress is not None:
            progress(done, total)
    found = checked.result("film", Path(path), {"films": str(len(film_names)), "picture folders": str(len(sequences))})
    return dataclasses.replace(found, needed=("frames_per_second",)) if sequences else found


def _list(path: Path) -> tuple[Path, list[str], dict[str, tuple[str, ...]]]:
    """Return the folder that names start from, the films' names, and the pictures of each folder that holds some."""
    if not is_folder(path) and path.is_file():
        if path.suffix.lower() in PICTURE_SUFFIXES:
            msg = (
                f"path: {path} is one picture; expected a film or a folder of pictures: give the folder that it lies in"
            )
            raise InputError(msg)
        return path.parent, [path.name], {}
    if not is_folder(path):
        msg = f"path: {path} does not exist; expected a film, or a folder of films or pictures"
        raise InputError(msg)
    films, pictures = _look(path)
    if films and pictures:
        msg = f"path: {path} holds both films ({films[0]}) and pictures ({pictures[0]}): put them into folders of their own"
        raise InputError(msg)
    if pictures:
        return path.parent, [], {path.name: pictures} if path.name else {".": pictures}
    sequences: dict[str, tuple[str, ...]] = {}
    for folder in sorted(list_folder(path)[0], key=natural):
        inside, pictures = _look(path / folder)
        films += tuple(f"{folder}/{name}" for name in inside)
        if pictures:
            sequences[folder] = pictures
    if not films and not sequences:
        msg = (
            f"path: {path} holds no films ({', '.join(sorted(FILM_SUFFIXES))}) and no pictures "
            f"({', '.join(sorted(PICTURE_SUFFIXES))}), nor do the folders in it"
        )
        raise InputError(msg)
    return path, list(films), sequences


def _look(folder: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the films and of the pictures in a folder, hidden ones left out."""
    names = sorted(list_folder(folder)[1], key=natural)
    films = tuple(name for name in names if Path(name).suffix.lower() in FILM_SUFFIXES)
    return films, tuple(name for name in names if Path(name).suffix.lower() in PICTURE_SUFFIXES)
