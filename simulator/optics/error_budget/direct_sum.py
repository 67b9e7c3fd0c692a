"""The reference of PSFs: the Rayleigh-Sommerfeld integral behind a mask, summed directly with its own error bar.

The sum runs on NumPy, or as a Dr.Jit kernel (LLVM) in a process of its own: an unsuitable libLLVM does not raise but aborts
its process, and Dr.Jit's threads and log level are shared by everything in it, so beside a chosen Mitsuba variant it has no
place. The price is about half a second per call.
"""

from __future__ import annotations

import functools
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.optics.mask import Mask
from simulator.optics.resample import cubic_interpolation

FINEST_CELL_M = 2e-6 / 3  # the finer of the two sums has cells no larger than this
_STEP = 3  # ratio of the two refinements
_MORE_ROUNDS = 2
_CHUNK = 2**18  # cells at a time on NumPy: the work arrays stay in the cache


class Cells(NamedTuple):
    """A mask as square cells: what lies in each, and how many cells share a sample.

    Attributes:
        height_m: ``(H, W)`` height of the material, metres.
        amplitude: ``(H, W)``, 0..1.
        slope_y: ``(H, W)`` slope of the height along y, or ``(1, 1)`` zero where cells are flat.
        slope_x: the same along x.
        repeat: cells per sample and axis.
    """

    height_m: NDArray[np.floating]
    amplitude: NDArray[np.floating]
    slope_y: NDArray[np.floating]
    slope_x: NDArray[np.floating]
    repeat: int


class Light(NamedTuple):
    """Wavelength, geometry and source of one sum; numbers of NumPy or Dr.Jit.

    Attributes:
        k: wavenumber, radians per metre.
        distance_m: mask to sensor, metres.
        index: refractive index of the mask's material.
        source_x, source_y, source_z: place of the source, metres; for a plane wave the unit vector towards it.
        cell_m: side of a cell, metres.
    """

    k: Any
    distance_m: Any
    index: Any
    source_x: Any
    source_y: Any
    source_z: Any
    cell_m: Any


def reference_intensity(
    mask: Mask,
    wavelength_m: float,
    distance_m: float,
    depth_m: float,
    points_m: NDArray[np.floating],
    direction: tuple[float, float] = (0.0, 0.0),
    *,
    tolerance: float = 1e-3,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the intensity of a point source behind a mask, in air, and how far it may be off.

    The wave is normalised to unit intensity at the mask's centre. Cost: per point one evaluation for each cell of
    ``FINEST_CELL_M``, 80 million of them per CPU-second with LLVM, 6 million without.

    Args:
        mask: the mask; smooth ones are interpolated as ``Mask.transmission`` does it.
        wavelength_m: wavelength in air, metres.
        distance_m: mask to sensor, metres.
        depth_m: z of the source from the mask plane, metres, or ``inf``.
        points_m: ``(N, 2)`` sensor points as x, y in metres, in the physical frame, measured from the geometric shadow of
            the mask's centre at ``-distance_m * direction``.
        direction: tangents of the source's direction: it stands at (tan_x z, tan_y z, z).
        tolerance: relative L2 uncertainty above which the cells are divided again.

    Returns:
        ``(N,)`` intensities and ``(N,)`` uncertainties, both float64.
    """
    points = np.asarray(points_m, np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError("points_m", f"expected (N, 2) as x, y in metres, got shape {points.shape}")
    for name, value in (("wavelength_m", wavelength_m), ("distance_m", distance_m), ("depth_m", depth_m)):
        if not value > 0:
            raise InputError(name, f"got {value!r}, expected positive metres")
    points = points - np.asarray(direction) * distance_m
    factor = math.ceil(mask.pitch_m / (_STEP * FINEST_CELL_M) - 1e-9)

    def intensity(cells_per_sample: int) -> NDArray[np.float64]:
        field = mask_field(mask, cells_per_sample, wavelength_m, distance_m, depth_m, points, direction)
        return np.abs(field) ** 2

    coarse, fine = intensity(factor), intensity(_STEP * factor)
    for _ in range(_MORE_ROUNDS):
        if np.linalg.norm(fine - coarse) <= tolerance * (_STEP**2 - 1) * np.linalg.norm(fine):
            break
        factor *= _STEP
        coarse, fine = fine, intensity(_STEP * factor)
    return fine, np.abs(fine - coarse) / (_STEP**2 - 1)


def mask_field(
    mask: Mask,
    factor: int,
    wavelength_m: float,
    distance_m: float,
    depth_m: float,
    points_m: NDArray[np.float64],
    direction: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.complex128]:
    """Sum the wave behind a mask of ``factor`` cells per sample and axis, ``(N,)``, without the constant phase exp(ikd).

    Arguments as for ``reference_intensity``, but ``points_m`` are measured from the mask's axis.
    """
    cells = mask_cells(mask, factor)
    tan_x, tan_y = direction
    scale = depth_m if math.isfinite(depth_m) else 1 / math.sqrt(1 + tan_x**2 + tan_y**2)
    index = mask.material.index(wavelength_m)
    light = Light(
        2 * math.pi / wavelength_m, distance_m, index, tan_x * scale, tan_y * scale, scale, mask.pitch_m / factor
    )
    plane = not math.isfinite(depth_m)
    found = run_kernel(points_m=points_m, plane=plane, **cells._asdict(), **light._asdict())
    return sum_numpy(cells, light, plane, points_m) if found is None else found


def mask_cells(mask: Mask, factor: int) -> Cells:
    """Divide a mask into ``factor`` cells per sample and axis."""
    height, amplitude = to_numpy(mask.height_m), to_numpy(mask.amplitude)
    flat = np.zeros((1, 1), height.dtype)
    if mask.profile == "staircase":
        return Cells(height, amplitude, flat, flat, factor)
    cell_m = mask.pitch_m / factor
    if factor > 1:
        rows, columns = (cubic_interpolation(length, factor) for length in mask.shape)
        height, amplitude = (columns.apply(rows.apply(part, -2), -1) for part in (height, amplitude))
    slope_y, slope_x = (
        np.gradient(height, cell_m, axis=axis) if height.shape[axis] > 1 else np.zeros_like(height) for axis in (0, 1)
    )
    return Cells(height, np.clip(amplitude, 0, 1), slope_y, slope_x, 1)


def cell_wave(
    m: Any, light: Light, plane: bool, x: Any, y: Any, sample: tuple[Any, Any, Any, Any], px: Any, py: Any
) -> tuple[Any, Any]:
    """Return real and imaginary part of what cells send to points, on NumPy or Dr.Jit.

    Args:
        m: the module that brings sqrt, sin and cos: ``numpy`` or ``drjit``.
        light: wavelength, geometry and source.
        plane: whether the source lies at infinity.
        x: centres of the cells, metres.
        y: the same along y.
        sample: height (metres), amplitude, slope along y and along x.
        px: the points, metres.
        py: the same along y.
    """
    height, amplitude, slope_y, slope_x = sample
    d, k = light.distance_m, light.k
    dx, dy = px - x, py - y
    lateral = dx * dx + dy * dy
    r = m.sqrt(lateral + d * d)
    path = lateral / (r + d)  # r - d without cancellation
    if plane:
        tilt_x, tilt_y, cosine = -light.source_x, -light.source_y, light.source_z
        path = path + x * tilt_x + y * tilt_y
    else:
        from_x, from_y, z = x - light.source_x, y - light.source_y, light.source_z
        r0 = m.sqrt(light.source_x * light.source_x + light.source_y * light.source_y + z * z)
        to_source = m.sqrt(from_x * from_x + from_y * from_y + z * z)
        path = path + (x * (x - 2 * light.source_x) + y * (y - 2 * light.source_y)) / (to_source + r0)
        tilt_x, tilt_y, cosine = from_x / to_source, from_y / to_source, z / to_source
        amplitude = amplitude * r0 / to_source
    thickness = m.sqrt(light.index * light.index - 1 + cosine * cosine) - cosine
    phase = k * (path + height * thickness)
    half = k * light.cell_m / 2
    square = _sinc(m, half * (tilt_x + slope_x * thickness - dx / r))
    square = square * _sinc(m, half * (tilt_y + slope_y * thickness - dy / r))
    size = amplitude * square * light.cell_m * light.cell_m * d / (2 * math.pi * r * r)
    sine, cosine_phase = m.sincos(phase) if hasattr(m, "sincos") else (m.sin(phase), m.cos(phase))
    # (1 / r - ik) exp(i phase)
    return size * (cosine_phase / r + k * sine), size * (sine / r - k * cosine_phase)


def sum_numpy(cells: Cells, light: Light, plane: bool, points_m: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Sum over all cells for each point in float64 NumPy."""
    n = cells.repeat
    height, width = (length * n for length in cells.height_m.shape)
    x, y = ((np.arange(length) - (length - 1) / 2) * light.cell_m for length in (width, height))
    columns = np.arange(width) // n
    values = np.zeros(len(points_m), np.complex128)
    band = max(1, _CHUNK // width)
    for start in range(0, height, band):
        rows = np.arange(start, min(start + band, height))
        at = np.ix_(rows // n, columns)
        height_m, amplitude, slope_y, slope_x = (
            (part if part.size == 1 else part[at]).astype(np.float64)
            for part in (cells.height_m, cells.amplitude, cells.slope_y, cells.slope_x)
        )
        sample = height_m, amplitude, slope_y, slope_x
        for i, (px, py) in enumerate(points_m):
            real, imaginary = cell_wave(np, light, plane, x[None, :], y[rows, None], sample, px, py)
            values[i] += real.sum() + 1j * imaginary.sum()
    return values


def _sinc(m: Any, angle: Any) -> Any:
    """Return sin(x) / x; the tiny term keeps zero out of the denominator and changes nothing else."""
    guarded = m.abs(angle) + 1e-30
    return m.sin(guarded) / guarded


# ---- on Dr.Jit

_LANES = 2**20  # at a time: their state is a few tens of MB
_JOB, _RESULT = "job.npz", "result.npy"


def run_kernel(**inputs: Any) -> np.ndarray | None:
    """Run ``kernel(dr, **inputs)`` in a fresh process.

    Args:
        inputs: NumPy arrays and numbers.

    Returns:
        What the kernel returned; None where Dr.Jit has no working LLVM, and then NumPy must do.
    """
    if not llvm_works():
        return None
    result, said = _run(inputs)
    if result is None:
        msg = f"the kernel failed in a process of its own, though LLVM works here: {said}"
        raise RuntimeError(msg)
    return result


@functools.cache
def llvm_works() -> bool:
    """Whether Dr.Jit can compile and run the sum here, for two open cells and a point; tried once per process, in another."""
    flat = np.zeros((1, 1))
    cells = Cells(np.zeros((1, 2)), np.ones((1, 2)), flat, flat, 1)
    light, point = Light(1e7, 1e-3, 1.5, 1e-5, 2e-5, 0.02, 2e-6), np.array([[3e-6, 1e-6]])
    answer, _ = _run({"points_m": point, "plane": False, **cells._asdict(), **light._asdict()})
    return answer is not None and np.allclose(answer, sum_numpy(cells, light, False, point), rtol=1e-9, atol=0)


def kernel(
    dr: Any,
    *,
    points_m: NDArray[np.float64],
    plane: bool,
    height_m: NDArray[np.floating],
    amplitude: NDArray[np.floating],
    slope_y: NDArray[np.floating],
    slope_x: NDArray[np.floating],
    repeat: int,
    **light: float,
) -> NDArray[np.complex128]:
    """Return the wave at the points, ``(N,)``; arguments as in ``Cells`` and ``Light``."""
    from drjit.llvm import Float32, Float64, UInt32

    numbers = Light(**{name: dr.opaque(Float64, value) for name, value in light.items()})
    samples_high, samples_wide = height_m.shape
    rows, columns = samples_high * repeat, samples_wide * repeat
    # Transposed, so that neighbouring lanes, which are rows, read neighbouring memory.
    stored = [
        (Float32 if part.dtype == np.float32 else Float64)(np.ascontiguousarray(part.T).ravel())
        for part in (height_m, amplitude, slope_y, slope_x)
    ]
    several, high = dr.opaque(UInt32, repeat), dr.opaque(UInt32, samples_high)
    count = dr.opaque(UInt32, columns)
    middle_x, middle_y = (dr.opaque(Float64, (n - 1) / 2) for n in (columns, rows))
    values = np.empty(len(points_m), np.complex128)
    batch = max(1, _LANES // rows)
    for start in range(0, len(points_m), batch):
        some = points_m[start : start + batch]
        lane = dr.arange(UInt32, len(some) * rows)
        row = lane % rows
        px, py = (dr.gather(Float64, Float64(np.ascontiguousarray(some[:, axis])), lane // rows) for axis in (0, 1))
        y = (Float64(row) - middle_y) * numbers.cell_m
        first = row // several

        def step(column: Any, real: Any, imaginary: Any, px=px, py=py, y=y, first=first) -> tuple[Any, Any, Any]:
            at = (column // several) * high + first
            sample = tuple(
                Float64(dr.gather(type(part), part, at if dr.width(part) > 1 else UInt32(0))) for part in stored
            )
            x = (Float64(column) - middle_x) * numbers.cell_m
            more_real, more_imaginary = cell_wave(dr, numbers, plane, x, y, sample, px, py)  # pyright: ignore[reportArgumentType]
            return column + 1, real + more_real, imaginary + more_imaginary

        state = (UInt32(0), dr.zeros(Float64, dr.width(lane)), dr.zeros(Float64, dr.width(lane)))
        _, real, imaginary = dr.while_loop(state, lambda column, *_: column < count, step)
        dr.eval(real, imaginary)
        parts = [np.array(part).reshape(len(some), rows).sum(1) for part in (real, imaginary)]
        values[start : start + batch] = parts[0] + 1j * parts[1]
    return values


def _run(inputs: dict[str, Any]) -> tuple[np.ndarray | None, str]:
    """Return the kernel's result, None where there is none, and the last line that the process wrote to stderr."""
    with tempfile.TemporaryDirectory(prefix="flatlight-kernel-") as folder:
        np.savez(Path(folder) / _JOB, **inputs)
        home = Path.home()
        # Dr.Jit aborts where it cannot keep its compiled kernels.
        lent = {} if (home / ".drjit").is_dir() or os.access(home, os.W_OK | os.X_OK) else {"HOME": folder}
        try:
            done = subprocess.run(
                [sys.executable, "-P", "-m", __name__, folder],
                env=os.environ | lent,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
            )
        except OSError as error:
            return None, str(error)
        said = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        result = Path(folder) / _RESULT
        return (np.load(result, allow_pickle=False) if done.returncode == 0 and result.is_file() else None), said


def _main(folder: str) -> None:
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.LLVM):
        sys.exit(1)
    dr.set_log_level(dr.LogLevel.Error)
    dr.set_thread_count(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    with np.load(Path(folder) / _JOB, allow_pickle=False) as job:
        inputs = {name: job[name] if job[name].ndim else job[name].item() for name in job.files}
    np.save(Path(folder) / _RESULT, kernel(dr, **inputs))


if __name__ == "__main__":
    _main(*sys.argv[1:])
