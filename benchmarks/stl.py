"""The STL of 1 mm of a PhlatCam: its size and CPU seconds, and what a file of 20 MB would do to the PSF.

The plain mesh has eight triangles for each mask pixel. Ours is exact; below it stands the least size of any exact mesh,
two triangles for each corner of a level region. Two approximations are made as small as 20 MB: neighbouring levels merged
in pairs (heights 100 nm off), and single pixels given a neighbour's height, those first that save most corners. For each
the PSF of a point at infinity, 532 nm, 1.869 mm behind the mask: relative L2 of the irradiance on pixels of 2.4 and 19.2
um. To compare: a printer that rounds the edges by 0.5 um.

Run: uv run python benchmarks/stl.py
"""

from __future__ import annotations

import time
import zlib
from dataclasses import replace

import numpy as np
from common import versions
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from psf_library.designs.phlatcam import phlatcam
from simulator.design.export import height_tiff
from simulator.design.solid import stl_bytes
from simulator.design.staircase import corner_count
from simulator.optics.mask import Mask
from simulator.optics.propagation import angular_spectrum

WAVELENGTH_M, DISTANCE_M, BASE_M, STEP_M = 532e-9, 1.869e-3, 5e-4, 0.2e-6
FINER = 4
GOAL_BYTES = 20e6
TRIANGLE_BYTES = 50


def irradiance(mask: Mask, height_m: NDArray[np.floating], pixel_m: float) -> NDArray[np.float64]:
    """Of a plane wave behind heights on a grid ``FINER`` times finer than the mask, averaged over sensor pixels."""
    turns = (mask.material.index(WAVELENGTH_M) - 1) / WAVELENGTH_M * height_m
    field = angular_spectrum(np.exp(2j * np.pi * turns), mask.pitch_m / FINER, WAVELENGTH_M, DISTANCE_M)
    pixel = round(pixel_m / mask.pitch_m * FINER * 10)  # in tenths of a sample
    fine = np.abs(field) ** 2
    whole = fine.shape[0] * 10 // pixel
    edges = np.arange(whole + 1) * pixel / 10 + (fine.shape[0] - whole * pixel / 10) / 2
    for _ in range(2):
        summed = np.concatenate([np.zeros((1, fine.shape[1])), np.cumsum(fine, 0)])
        at = np.minimum(edges.astype(int), len(summed) - 2)
        share = (edges - at)[:, None]
        fine = np.diff(summed[at] * (1 - share) + summed[at + 1] * share, axis=0).T
    return fine


def corners_around(level: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many corners level regions have at each inner grid point."""
    ring = [level[..., :-1, :-1], level[..., :-1, 1:], level[..., 1:, 1:], level[..., 1:, :-1]]
    equal = np.stack([ring[k] == ring[k - 1] for k in range(4)])
    straight = (equal[0] & equal[2]) | (equal[1] & equal[3])
    return np.select([equal.sum(0) == 0, equal.sum(0) == 1, (equal.sum(0) == 2) & ~straight], [4, 2, 2])


def fewer_corners(level: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Give pixels the height of a neighbour one step away, where that saves most corners, until few enough are left."""
    level = np.pad(level, 1, mode="edge")
    original = level.copy()
    rows, columns = (np.arange(n) for n in level.shape)
    for least_gain in range(8, 0, -1):
        for _ in range(6):
            for first_row, first_column in np.ndindex(3, 3):
                i, j = (
                    part.ravel()
                    for part in np.meshgrid(
                        rows[1 + first_row : -1 : 3], columns[1 + first_column : -1 : 3], indexing="ij"
                    )
                )
                window = np.stack([[level[i + a, j + b] for b in (-1, 0, 1)] for a in (-1, 0, 1)]).transpose(2, 0, 1)
                before = corners_around(window).sum((1, 2))
                best, best_gain = level[i, j].copy(), np.zeros_like(before)
                for a, b in ((0, 1), (1, 0), (1, 2), (2, 1)):
                    trial = window.copy()
                    trial[:, 1, 1] = window[:, a, b]
                    gain = before - corners_around(trial).sum((1, 2))
                    steps = np.abs(window[:, a, b] - original[i, j])
                    better = (gain > best_gain) & ((steps <= 1) | (steps == 5))  # five steps are nearly a wave
                    best[better], best_gain[better] = window[better, a, b], gain[better]
                taken = best_gain >= least_gain
                level[i[taken], j[taken]] = best[taken]
            if corner_count(level[1:-1, 1:-1].astype(float)) <= most:
                return level[1:-1, 1:-1]
    return level[1:-1, 1:-1]


def main() -> None:
    print(versions("numpy", "scipy", "trimesh"))
    mask = phlatcam(width_mm=1.0, step_um=STEP_M * 1e6)
    height = np.asarray(mask.height_m, np.float64)
    level = np.rint(height / STEP_M).astype(np.int64)
    begin = time.process_time()
    body = stl_bytes(mask, BASE_M)
    seconds = time.process_time() - begin
    corners = corner_count(height)
    print(f"  plain mesh           {8 * height.size * TRIANGLE_BYTES / 1e6:6.1f} MB")
    print(f"  ours, exact          {len(body) / 1e6:6.1f} MB   CPU {seconds:.1f} s")
    print(f"  least of all exact   {2 * corners * TRIANGLE_BYTES / 1e6:6.1f} MB   {corners} corners of level regions")
    print(f"  ours, zipped         {len(zlib.compress(body)) / 1e6:6.1f} MB")
    print(f"  height map (TIFF)    {len(height_tiff(mask)) / 1e6:6.1f} MB")

    finer = np.ones((FINER, FINER))
    truth = {pixel_m: irradiance(mask, np.kron(height, finer), pixel_m) for pixel_m in (2.4e-6, 19.2e-6)}

    def show(name: str, size: float | None, fine_m: NDArray[np.float64]) -> None:
        errors = [
            np.linalg.norm(irradiance(mask, fine_m, pixel_m) - of) / np.linalg.norm(of) for pixel_m, of in truth.items()
        ]
        megabytes = "         " if size is None else f"{size / 1e6:6.1f} MB"
        print(f"  {name:50} {megabytes}   PSF off by {errors[0]:.1%} (2.4 um), {errors[1]:.1%} (19.2 um)", flush=True)

    pairs = (level // 2 * 2 + 0.5) * STEP_M
    # Two triangles a corner, and a seventh more for cuts and sides.
    flipped = fewer_corners(level, round(GOAL_BYTES / TRIANGLE_BYTES / 2 / 1.14))
    for name, approximate in (
        ("levels merged in pairs, 100 nm", pairs),
        (f"{np.mean(flipped != level):.1%} of the pixels one step off", flipped * STEP_M),
    ):
        size = len(stl_bytes(replace(mask, height_m=approximate), BASE_M))
        show(name, size, np.kron(approximate, finer))
    rounded = gaussian_filter(np.kron(height, finer), 0.5e-6 / mask.pitch_m * FINER, mode="nearest")
    show("to compare: edges rounded by 0.5 um", None, rounded)


if __name__ == "__main__":
    main()
