"""What lies in a folder of pictures with depth charts: every file is read once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from simulator.errors import InputError
from simulator.importers.listing import grouped
from simulator.importers.rgbd.border import find_circle
from simulator.importers.rgbd.depth_count import Depths
from simulator.importers.rgbd.depth_decoding import DepthAlong, DepthCode, DepthDecoding, read_codes
from simulator.importers.rgbd.frames import Pair, list_pairs
from simulator.importers.rgbd.frames import recognises as recognises
from simulator.importers.rgbd.intrinsics import nearest_file, read_intrinsics
from simulator.importers.stereo.runs import fault_of, run_lengths
from simulator.importers.survey import Progress, Survey
from simulator.io.images import read_picture

SIMCOL = (
    "SimCol3D's own code reads code / 65280 x 20 cm: depth_scale_cm: 20, depth_code: linear, depth_full_code: 65280"
)
_BORDER_FRAMES = 8
_OFF_CENTRE = 0.05


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    depth_scale_cm: float | None = None,
    depth_code: DepthCode | None = None,
    depth_at_zero_cm: float | None = None,
    depth_full_code: int | None = None,
    depth_along: DepthAlong = "axis",
    max_cm: float = 10.0,
) -> Survey:
    """Read every pair once.

    Args:
        path: the folder.
        progress: called with how many pairs were read, and of how many.
        depth_scale_cm: with ``depth_code``, codes are told in centimetres too, as the importer would read them.
        depth_code: what is affine in the code.
        depth_at_zero_cm: depth at code zero.
        depth_full_code: the full code.
        depth_along: whether charts hold depths or distances along rays.
        max_cm: the deepest that is valid; a chart that lies beyond it everywhere is a problem.

    Returns:
        Sequences and their lengths, sizes, depth codes, the image circle and files with intrinsics; broken and unpaired files
        are its problems.

    Raises:
        InputError: when there is no such folder or no pair in it, or only one of ``depth_scale_cm`` and ``depth_code`` is
            given.
    """
    root = Path(path)
    decoding = _decoding(depth_scale_cm, depth_code, depth_at_zero_cm, depth_full_code)
    pairs, unpaired = list_pairs(root)
    faults = list(unpaired)
    depths = Depths(decoding, max_cm * 1e-2, depth_along)
    good: list[Pair] = []
    sizes: Counter[tuple[int, ...]] = Counter()
    brightest: np.ndarray | None = None
    for done, pair in enumerate(pairs, 1):
        try:
            picture, codes = read_picture(root / pair.picture), read_codes(root / pair.depth)
            if picture.shape != (*codes.shape, 3):
                texts = (" x ".join(map(str, array.shape)) for array in (picture, codes))
                faults.append((str(root / pair.picture), f"is {' and its depth chart '.join(texts)}: fetch both again"))
            elif depths.add(codes):
                good.append(pair)
                sizes[codes.shape] += 1
                if brightest is None:
                    brightest = picture
                elif brightest.shape == picture.shape and len(good) <= _BORDER_FRAMES:
                    brightest = np.maximum(brightest, picture)
            else:
                faults.append((str(root / pair.depth), depths.all_beyond))
        except InputError as error:
            faults.append(fault_of(error, root / pair.picture, root / pair.depth))
        if progress is not None:
            progress(done, len(pairs))
    names = [pair.sequence for pair in good]
    lengths = run_lengths(names, [pair.number for pair in good]) if good else []
    facts = {
        "sequences": str(len(set(names))),
        "frames": str(len(good)),
        "consecutive frames": f"{min(lengths)} to {max(lengths)}" if lengths else "none",
        "sizes": ", ".join(f"{size[0]} x {size[1]}" for size in sorted(sizes)),
        **depths.facts(),
    }
    notes = depths.notes()
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
    return Survey("endoslam", root, len(good), facts, grouped(faults), tuple(notes))


def _decoding(
    scale_cm: float | None, code: DepthCode | None, at_zero_cm: float | None, full_code: int | None
) -> DepthDecoding | None:
    """What codes mean, where that is told."""
    if scale_cm is None and code is None and at_zero_cm is None and full_code is None:
        return None
    if scale_cm is None or code is None:
        missing = "depth_scale_cm" if scale_cm is None else "depth_code"
        msg = f"{missing} is missing: depths follow from depth_scale_cm and depth_code together; give both or neither"
        raise InputError(msg)
    return DepthDecoding(code, scale_cm * 1e-2, None if at_zero_cm is None else at_zero_cm * 1e-2, full_code)


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
