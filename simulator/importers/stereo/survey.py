"""What lies in a folder of FlyingThings3D, Monkaa or Driving: every picture and disparity is read once."""

from __future__ import annotations

from pathlib import Path

from simulator.errors import InputError
from simulator.importers.listing import grouped
from simulator.importers.stereo.pairs import disparity_range, read_disparity
from simulator.importers.stereo.runs import fault_of, run_lengths
from simulator.importers.stereo.sceneflow import PASSES, Eye, PicturePass, Subset, find_root, list_frames
from simulator.importers.survey import Progress, Survey
from simulator.io.images import read_picture


def recognises(path: Path) -> bool:
    """Return whether a folder looks like a SceneFlow data set, by the names in it alone."""
    try:
        root, _ = find_root(path, PASSES)
    except (InputError, OSError):
        return False
    return (root / "disparity").is_dir()


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    picture_pass: PicturePass | None = None,
    eye: Eye = "left",
    subset: Subset = "all",
) -> Survey:
    """Read every pair of one eye once.

    Args:
        path: as for the importer.
        progress: called with how many pairs were read, and of how many.
        picture_pass: which rendering; None is the first that is there.
        eye: which camera.
        subset: ``TRAIN`` or ``TEST``, or both.

    Returns:
        Sequences and their lengths, sizes, disparities; broken and unpaired files are its problems.

    Raises:
        InputError: when there is no such folder or no pair in it.
    """
    path = Path(path)
    root, pictures = find_root(path, (picture_pass,) if picture_pass else PASSES)
    used: PicturePass = "finalpass" if "finalpass" in pictures.name else "cleanpass"
    _, frames, unpaired = list_frames(path, used, eye, subset)
    faults = list(unpaired)
    good, sizes, ranges, holes = [], set(), [], 0
    for done, frame in enumerate(frames, 1):
        name = root / frame.disparity
        try:
            disparity = read_disparity(name)
            ranges.append(disparity_range(disparity, name))
            shape = read_picture(root / frame.picture).shape
            if shape != (*disparity.shape, 3):
                sizes_text = f"{' x '.join(map(str, shape))}, its disparity {' x '.join(map(str, disparity.shape))}"
                faults.append((str(root / frame.picture), f"is {sizes_text}: fetch both again"))
            else:
                good.append(frame)
                sizes.add(disparity.shape)
                holes += int((disparity == 0).sum())
        except InputError as error:
            faults.append(fault_of(error, name, root / frame.picture))
        if progress is not None:
            progress(done, len(frames))
    names = [frame.sequence for frame in good]
    lengths = run_lengths(names, [frame.number for frame in good]) if good else []
    facts = {
        "pictures": f"{pictures.name}, {eye} eye",
        "sequences": str(len(set(names))),
        "frames": str(len(good)),
        "consecutive frames": f"{min(lengths)} to {max(lengths)}" if lengths else "none",
        "sizes": ", ".join(f"{rows} x {columns}" for rows, columns in sorted(sizes)),
    }
    if ranges:
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        facts["disparity"] = f"{lowest:.4g} to {highest:.4g} px"
    if holes:
        facts["without disparity"] = f"{holes} pixels (valid is false there)"
    if len({frame.focal_px for frame in good}) > 1:
        facts["focal lengths"] = "450 and 1050 px (15 and 35 mm)"
    gaps = len(lengths) - len(set(names))
    notes = [f"gaps in the numbering: {gaps}, which no clip crosses"] if gaps else []
    return Survey("flyingthings3d", path, len(good), facts, grouped(faults), tuple(notes))
