"""What lies in a folder of pictures with depth charts: every file is read once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from simulator.errors import InputError
from simulator.importers.rgbd.border import find_circle
from simulator.importers.rgbd.depth_decoding import read_codes
from simulator.importers.rgbd.frames import Pair, list_pairs
from simulator.importers.rgbd.frames import recognises as recognises
from simulator.importers.rgbd.intrinsics import nearest_file, read_intrinsics
from simulator.importers.stereo.runs import problem_line, run_lengths
from simulator.importers.survey import Progress, Survey
from simulator.pictures import read_picture

SIMCOL = (
    "SimCol3D's own code reads code / 65280 x 20 cm: depth_scale_cm: 20, depth_code: linear, depth_full_code: 65280"
)
_BORDER_FRAMES = 8
_OFF_CENTRE = 0.05


def survey(path: Path, progress: Progress | None = None) -> Survey:
    """Read every pair once.

    Args:
        path: the folder.
        progress: called with how many pairs were read, and of how many.

    Returns:
        Sequences and their lengths, sizes, depth codes, the image circle and files with intrinsics; each broken or unpaired
        file is a problem.

    Raises:
        InputError: when there is no such folder or no pair in it.
    """
    root = Path(path)
    pairs, unpaired = list_pairs(root)
    problems = list(unpaired)
    good: list[Pair] = []
    sizes: Counter[tuple[int, ...]] = Counter()
    codes_seen: dict[str, tuple[int, int]] = {}
    holes = 0
    brightest: np.ndarray | None = None
    for done, pair in enumerate(pairs, 1):
        try:
            picture, codes = read_picture(root / pair.picture), read_codes(root / pair.depth)
            if picture.shape != (*codes.shape, 3):
                texts = (" x ".join(map(str, array.shape)) for array in (picture, codes))
                problems.append(f"{root / pair.picture}: is {' and its depth chart '.join(texts)}: fetch both again")
            else:
                good.append(pair)
                sizes[codes.shape] += 1
                kind = f"{8 * codes.itemsize} bit"
                low, high = codes_seen.get(kind, (65535, 0))
                codes_seen[kind] = min(low, int(codes.min())), max(high, int(codes.max()))
                holes += int((codes == 0).sum())
                if brightest is None:
                    brightest = picture
                elif brightest.shape == picture.shape and len(good) <= _BORDER_FRAMES:
                    brightest = np.maximum(brightest, picture)
        except InputError as error:
            problems.append(problem_line(error, root / pair.picture, root / pair.depth))
        if progress is not None:
            progress(done, len(pairs))
    names = [pair.sequence for pair in good]
    lengths = run_lengths(names, [pair.number for pair in good]) if good else []
    facts = {
        "sequences": str(len(set(names))),
        "frames": str(len(good)),
        "consecutive frames": f"{min(lengths)} to {max(lengths)}" if lengths else "none",
        "sizes": ", ".join(f"{size[0]} x {size[1]}" for size in sorted(sizes)),
        "depth codes": ", ".join(f"{kind}, {low} to {high}" for kind, (low, high) in codes_seen.items()),
    }
    if holes:
        facts["code zero"] = f"{holes} pixels"
    notes = []
    gaps = len(lengths) - len(set(names))
    if gaps:
        notes.append(f"gaps in the numbering: {gaps}, which no clip crosses")
    if brightest is not None:
        facts["image circle"], note = _circle(brightest, root)
        notes += note
        facts["intrinsics"], note = _intrinsics(root, good[0], brightest.shape)
        notes += note
        if good[0].picture.name.startswith("FrameBuffer"):
            notes.append(SIMCOL)
    return Survey("endoslam", root, len(good), facts, tuple(problems), tuple(notes))


def _circle(brightest: np.ndarray, root: Path) -> tuple[str, list[str]]:
    try:
        circle = find_circle([brightest], str(root))
    except InputError as error:
        return "none found", [str(error)]
    if circle is None:
        return "the whole picture", []
    return f"column {circle[0]:.1f}, row {circle[1]:.1f}, radius {circle[2]:.1f} px", []


def _intrinsics(root: Path, pair: Pair, shape: tuple[int, ...]) -> tuple[str, list[str]]:
    file = nearest_file(root, (root / pair.picture).parent)
    if file is None:
        return "no file", []
    try:
        column, row = read_intrinsics(file).centre
    except InputError as error:
        return str(file), [str(error)]
    off = max(abs(column - (shape[1] - 1) / 2) / shape[1], abs(row - (shape[0] - 1) / 2) / shape[0])
    if off <= _OFF_CENTRE:
        return str(file), []
    return str(file), [
        f"{file} puts the optical axis at column {column:g}, row {row:g} of {shape[0]} x {shape[1]} pixels: check that it "
        "belongs to pictures of this size"
    ]
