"""Films and folders of numbered images as flat scenes that move."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.film_files import FILM_SUFFIXES, IMAGE_SUFFIXES, Film, ImageSequence, VideoSurvey, open_films
from simulator.importers.inspection import Likeness, Progress, Survey, sizes_text, told
from simulator.importers.listing import count_of, counting_fault, examples, is_folder, list_folder, natural
from simulator.importers.videos import ClipPlan, Count, Crop, FlatVideos, InterpolateWith, Positive
from simulator.io.images import filled, read_light
from simulator.text import counted
from simulator.types import View

FALLBACK = 2
"""Folders of images are part of many data sets: a source that knows such a layout comes first."""

_LOOKED_AT = 8
_ALIKE = 0.6
"""Correlation of neighbouring frames, shrunk to 16 x 16 pixels, from which they are taken for those of a film."""


def film(
    view: View,
    *,
    path: Path,
    frames: Count,
    frames_per_second: Positive | None = None,
    interpolate_by: Count = 1,
    interpolate_with: InterpolateWith = "optical_flow",
    superslomo_checkpoint: Path | None = None,
    clips_per_video: Count = 1,
    crop: Crop = "centre",
    plane_cm: Positive | None = None,
) -> FlatVideos:
    """Read clips from a film, from a folder of numbered images, or from a folder of several of them.

    Every film and every folder of images is a video. Films are converted to RGB by libav and decoded as sRGB, as are images;
    EXR and floating point TIFF images are linear light already. Only the frames that a clip takes are read.

    Args:
        view: the camera's view: size of the scene, near and far depth.
        path: a film (WebM, MP4, MKV, AVI and others), a folder of images of one size whose names sort by their numbers, or a
            folder of films or of such folders.
        frames: of a clip, after interpolation.
        frames_per_second: rate at which a clip is taken to have been filmed; without it the film's own times interpolate_by.
            Images have none. A shutter of some milliseconds sees motion only if the frames are that short.
        interpolate_by: frames that one of the film's becomes by temporal interpolation.
        interpolate_with: how frames are interpolated.
        superslomo_checkpoint: the published weights, for ``superslomo``.
        clips_per_video: how many clips a video gives, evenly spread; 1 begins anywhere.
        crop: where the view's proportions are cut out of the image, the same for all frames of a clip.
        plane_cm: depth of the plane on which the film is seen; without it the view's far depth.

    Returns:
        A scene source; videos that are damaged or too short, and folders in whose count images are missing, are among its
        ``problems``.

    Raises:
        InputError: nothing at ``path`` can be used, or the parameters contradict one another.
    """
    interpolation = interpolate_by, interpolate_with, superslomo_checkpoint
    plan = ClipPlan.of(view, frames, frames_per_second, clips_per_video, crop, plane_cm, *interpolation)
    root, film_names, sequences = _list(Path(path))
    if sequences and frames_per_second is None:
        raise InputError("frames_per_second", f"missing: {root / next(iter(sequences))} has images, which have none")
    films, problems = open_films(root, [(name, None) for name in film_names])
    videos: list[Film | ImageSequence] = [*films]
    for name, images in sequences.items():
        if fault := counting_fault(images):
            problems.append(f"{name}: {fault}")
        else:
            videos.append(ImageSequence(root, name, images))
    videos.sort(key=lambda video: natural(video.name))
    return FlatVideos.of("film", view, videos, plan, problems)


def recognises(path: Path) -> Likeness | None:
    """Whether there are films or images at a path, and whether images look like those of a film.

    A folder of folders must hold nothing else: files beside them, or folders without images, tell of a data set with another
    layout.

    Raises:
        InputError: a folder cannot be read.
    """
    path = Path(path)
    try:
        root, films, sequences = _list(path)
    except InputError as error:
        if isinstance(error.__cause__, OSError):
            raise
        return None
    if path.is_file():
        known = path.suffix.lower() in FILM_SUFFIXES
        return Likeness("sure", f"ends in {path.suffix}, as films do") if known else None
    if not any(_look(path)):
        folders, files = list_folder(path)
        if files or not all(any(_look(path / folder)) for folder in folders):
            return None
    if films:
        also = f" and {counted(len(sequences), 'folder')} of images" if sequences else ""
        return Likeness("sure", f"holds {counted(len(films), 'film')}{also}")
    images = counted(sum(map(len, sequences.values())), "image")
    for name in [*sequences][:_LOOKED_AT]:
        if doubt := _doubt(root / name, sequences[name]):
            return Likeness("possible", f"{images}, but {name}{doubt}")
    return Likeness("likely", f"{images} whose names count on, of one size, each much like the one before")


def _doubt(folder: Path, names: tuple[str, ...]) -> str | None:
    """Say what speaks against the images of a folder being a film, by the first of them; None where nothing does."""
    if len(names) < 3:
        return f" holds only {counted(len(names), 'image')}"
    if count_of(names) is None:
        return f"'s names do not count on ({examples([*names])})"
    small: list[NDArray[np.float32]] = []
    sizes: set[tuple[int, int]] = set()
    for name in names[:_LOOKED_AT]:
        if _has_palette(folder / name):
            return f"/{name} has a palette, as masks of objects do"
        try:
            light = read_light(folder / name)
        except InputError:
            return f"/{name} cannot be read"
        sizes.add((light.shape[0], light.shape[1]))
        small.append(np.sqrt(filled(light, (16, 16)).mean(axis=-1)))
    if len(sizes) > 1:
        return f"'s images differ in size ({sizes_text([min(sizes), max(sizes)])} and so on)"
    alike = float(np.median([_correlation(*pair) for pair in pairwise(small)]))
    if alike < _ALIKE:
        return f"'s images differ from one to the next as photographs do (correlation {alike:.2f})"
    return None


def _has_palette(path: Path) -> bool:
    from PIL import Image

    try:
        with Image.open(path) as image:
            return image.mode == "P"
    except OSError:  # of a kind that Pillow does not know, or broken
        return False


def _correlation(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Pearson's, 1 where both are the same throughout."""
    spreads = float(one.std()) * float(other.std())
    return float(((one - one.mean()) * (other - other.mean())).mean()) / spreads if spreads > 0 else 1.0


def survey(
    path: Path, progress: Progress | None = None, *, frames: int | None = None, interpolate_by: int = 1
) -> Survey:
    """Decode every film and read every image once; parameters and errors as for :func:`film`."""
    root, films, sequences = _list(Path(path))
    found = VideoSurvey(None if frames is None else ClipPlan(frames, interpolate_by=interpolate_by))
    for name in told([*films, *sequences], len(films) + len(sequences), progress):
        found.add_images(root, name, sequences[name]) if name in sequences else found.add_film(root, name)
    facts = {"films": str(len(films)), "image folders": str(len(sequences))}
    return found.result("film", Path(path), facts, ("frames_per_second",) if sequences else ())


def _list(path: Path) -> tuple[Path, list[str], dict[str, tuple[str, ...]]]:
    """Return the folder that names start from, the films' names, and the images of each folder that holds some."""
    if not is_folder(path):
        if not path.is_file():
            raise InputError("path", f"{path} does not exist; expected a film, or a folder of films or images")
        if path.suffix.lower() in IMAGE_SUFFIXES:
            raise InputError("path", f"{path} is one image; expected a film or a folder of images: give its folder")
        return path.parent, [path.name], {}
    films, images = _look(path)
    if films and images:
        raise InputError("path", f"{path} holds films ({films[0]}) and images ({images[0]}): separate them")
    if images:
        return path.parent, [], {path.name or ".": images}
    sequences: dict[str, tuple[str, ...]] = {}
    for folder in sorted(list_folder(path)[0], key=natural):
        inside, images = _look(path / folder)
        films += tuple(f"{folder}/{name}" for name in inside)
        if images:
            sequences[folder] = images
    if not films and not sequences:
        raise InputError(
            "path",
            f"{path} and its folders hold nothing that ends in {' '.join(sorted(FILM_SUFFIXES | IMAGE_SUFFIXES))}",
        )
    return path, list(films), sequences


def _look(folder: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the films and of the images in a folder, hidden ones left out."""
    names = sorted(list_folder(folder)[1], key=natural)
    films = tuple(name for name in names if Path(name).suffix.lower() in FILM_SUFFIXES)
    return films, tuple(name for name in names if Path(name).suffix.lower() in IMAGE_SUFFIXES)
