"""The shim that lets the same physics run on NumPy and torch: namespaces, FFT, pad, random numbers; memory of grids."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import array_api_compat
import numpy as np

from simulator.errors import InputError

Array = Any  # numpy.ndarray or torch.Tensor: one function body serves both


def namespace(*arrays: Array) -> Any:
    """Return the array-API namespace (NumPy's or torch's) that these arrays share."""
    if all(isinstance(array, np.ndarray | np.generic) for array in arrays):
        return np  # since NumPy 2 the standard's; a wrapper around it would import all of NumPy, f2py too
    return array_api_compat.array_namespace(*arrays)


def module(name: str) -> Any:
    """Return the namespace called ``numpy`` or ``torch``.

    Raises:
        InputError: for any other name, or when torch is not installed.
    """
    if name == "numpy":
        return np
    if name == "torch":
        try:
            import array_api_compat.torch as xp
        except ImportError as error:
            raise InputError(
                "xp", "got 'torch', which is not installed; install the extra: pip install 'flatlight[learn]'"
            ) from error
        return xp
    raise InputError("xp", f"got {name!r}, expected 'numpy' or 'torch'")


def is_torch(array: Array) -> bool:
    """Whether the array is a torch tensor."""
    return array_api_compat.is_torch_array(array)


def like(values: Any, reference: Array, dtype: Any = None) -> Array:
    """Return values as an array of the reference's kind, on its device, in ``dtype`` (default: the reference's)."""
    return namespace(reference).asarray(
        values, dtype=dtype or reference.dtype, device=array_api_compat.device(reference)
    )


def to_numpy(array: Array) -> np.ndarray:
    """Return the array as NumPy, without its gradient."""
    return array.detach().cpu().numpy() if is_torch(array) else np.asarray(array)


def number(scalar: Any) -> float:
    """Return a plain float of a number or a torch scalar, without its gradient."""
    return float(scalar.detach()) if is_torch(scalar) else float(scalar)


def real_dtype(array: Array) -> Any:
    """Return the real dtype of the same precision: float32 for complex64, float64 for complex128."""
    xp = namespace(array)
    return xp.float32 if array.dtype in (xp.complex64, xp.float32) else xp.float64


def complex_dtype(array: Array) -> Any:
    """Return the complex dtype of the same precision: complex64 for float32, complex128 for float64."""
    xp = namespace(array)
    return xp.complex64 if array.dtype in (xp.complex64, xp.float32) else xp.complex128


def bytes_per_sample(array: Array) -> int:
    """Return the bytes of a complex sample of the same precision: 8 or 16."""
    return 8 if real_dtype(array) == namespace(array).float32 else 16


def unit_phasor(phase: Array) -> Array:
    """Return exp(i phase) of a real array, several times faster than a complex exponential on NumPy."""
    if is_torch(phase):
        xp = namespace(phase)
        return xp.complex(xp.cos(phase), xp.sin(phase))
    phasor = np.empty(phase.shape, complex_dtype(phase))
    np.cos(phase, out=phasor.real)
    np.sin(phase, out=phasor.imag)
    return phasor


def _fft_module(array: Array) -> Any:
    if is_torch(array):
        import torch.fft

        return torch.fft
    import scipy.fft

    return scipy.fft


def fft_threads() -> int:
    """Return how many threads NumPy's FFTs use here, as ``scipy.fft.set_workers`` says: one, unless it was asked for more."""
    import scipy.fft

    return scipy.fft.get_workers()


def fft(array: Array, length: int, axis: int, *, overwrite: bool = False) -> Array:
    """Complex FFT along one axis, zero padded to ``length``; ``overwrite`` lets NumPy reuse the input's memory."""
    if overwrite and not is_torch(array):
        import scipy.fft

        return scipy.fft.fft(array, length, axis, overwrite_x=True)
    return _fft_module(array).fft(array, length, axis)


def ifft(array: Array, axis: int, *, overwrite: bool = False) -> Array:
    """Inverse complex FFT along one axis; ``overwrite`` lets NumPy reuse the input's memory."""
    if overwrite and not is_torch(array):
        import scipy.fft

        return scipy.fft.ifft(array, axis=axis, overwrite_x=True)
    return _fft_module(array).ifft(array, None, axis)


def rfft(array: Array, length: int, axis: int) -> Array:
    """Real FFT along one axis, zero padded at the end to ``length``."""
    return _fft_module(array).rfft(array, length, axis)


def irfft(array: Array, length: int, axis: int) -> Array:
    """Inverse of ``rfft`` with ``length`` real samples."""
    return _fft_module(array).irfft(array, length, axis)


def fft2(array: Array, *, overwrite: bool = False) -> Array:
    """Complex FFT of the last two axes; ``overwrite`` lets NumPy reuse the input's memory."""
    if overwrite and not is_torch(array):
        import scipy.fft

        return scipy.fft.fft2(array, overwrite_x=True)
    return _fft_module(array).fft2(array)


def next_fast_len(length: int) -> int:
    """Return the next FFT length that is fast for real and complex transforms; a prime would cost three times.

    The least 2^a 3^b 5^c, which SciPy's function of this name gives for real transforms: without half a second of imports.

    Example:
        >>> next_fast_len(1021)
        1024
    """
    best = 1 << max(length - 1, 0).bit_length()
    fives = 1
    while fives < best:
        odd = fives
        while odd < best:
            # times the least power of two that reaches the length
            best = min(best, odd << (-(-length // odd) - 1).bit_length())
            odd *= 3
        fives *= 5
    return best


def pad2d(array: Array, shape: tuple[int, ...], offset: tuple[int, ...] = (0, 0)) -> Array:
    """Zero-pad the last two axes to ``shape`` with the input's corner at ``offset``."""
    height, width = array.shape[-2:]
    top, left = offset
    bottom, right = shape[0] - height - top, shape[1] - width - left
    if is_torch(array):
        import torch.nn.functional

        return torch.nn.functional.pad(array, (left, right, top, bottom))
    return np.pad(array, [(0, 0)] * (array.ndim - 2) + [(top, bottom), (left, right)])


def normal(rng: Any, reference: Array) -> Array:
    """Draw standard normal values in the reference's shape, kind and precision.

    Args:
        rng: ``numpy.random.Generator``, or ``torch.Generator`` for tensors on its device.
        reference: gives shape, dtype and device.
    """
    if isinstance(rng, np.random.Generator):
        dtype = np.float32 if real_dtype(reference) == namespace(reference).float32 else np.float64
        return like(rng.standard_normal(tuple(reference.shape), dtype=dtype), reference)
    import torch

    return torch.randn(reference.shape, generator=rng, dtype=reference.dtype, device=reference.device)


def poisson(rng: Any, mean: Array) -> Array:
    """Draw Poisson counts with the given mean, in its kind and precision; see ``normal`` for ``rng``."""
    if isinstance(rng, np.random.Generator):
        return like(rng.poisson(to_numpy(mean)), mean)
    import torch

    return torch.poisson(mean, generator=rng)


SHARE = 0.8  # of the machine's memory: the rest is for Python, the stack and the system
# How a container is limited: unified and legacy control groups (Linux kernel, admin-guide/cgroup-v2.rst, memory.max).
_CONTROL_GROUPS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def require_memory(
    name: str, grid: tuple[int, ...], fields: float, bytes_per_sample: int, cure: str, limit_bytes: int | None = None
) -> int:
    """Return the memory that complex fields on one grid take, or refuse it before anything is allocated.

    Args:
        name: the argument that made the grid this large, for the message.
        grid: rows and columns of the padded grid.
        fields: how many of them are held at a time; parts of a field count.
        bytes_per_sample: 8 for complex64, 16 for complex128.
        cure: what to do about it, for the message.
        limit_bytes: the most that may be taken; None allows ``SHARE`` of this machine's (or container's) memory.

    Returns:
        The estimate, bytes.

    Raises:
        InputError: with the estimate, the limit and the cure.

    Example:
        >>> require_memory("oversampling", (1024, 1024), 2, 8, "use less", limit_bytes=10**9)
        16777216
        >>> require_memory("oversampling", (65536, 65536), 2, 8, "use a narrower mask", limit_bytes=10**9)
        Traceback (most recent call last):
        simulator.errors.InputError: oversampling: the grid of 65536 x 65536 samples would take 69 GB of memory, of \
which 1 GB are allowed; use a narrower mask
    """
    estimate = int(grid[0] * grid[1] * fields * bytes_per_sample)
    limit = int(SHARE * machine_bytes()) if limit_bytes is None else limit_bytes
    if estimate > limit:
        raise InputError(
            name,
            f"the grid of {grid[0]} x {grid[1]} samples would take {_gigabytes(estimate)} of memory, of which "
            f"{_gigabytes(limit)} are allowed; {cure}",
        )
    return estimate


def free_bytes(array: Array) -> int | None:
    """Return the free memory of the GPU that holds an array; None where the machine's own memory counts."""
    if not is_torch(array) or array.device.type != "cuda":
        return None
    import torch

    return int(SHARE * torch.cuda.mem_get_info(array.device)[0])


def machine_bytes() -> int:
    """Return the memory of this machine, or of the container where that is less; huge where neither is known."""
    limits = []
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for path in _CONTROL_GROUPS:
        try:
            text = path.read_text(encoding="ascii").strip()
        except OSError:
            continue
        if text.isdigit():  # "max" where there is no limit
            limits.append(int(text))
    return min((limit for limit in limits if limit > 0), default=sys.maxsize)


def _gigabytes(count: int) -> str:
    return f"{float(f'{count / 1e9:.2g}'):g} GB"


# The hungriest design (vortex) holds 40 bytes per sample at its peak, the leanest 10, as tracemalloc counts them.
_BYTES_PER_SAMPLE = 40


def samples_across(width_um: float, pixel_um: float) -> int:
    """Return how many samples make a side of a square mask, whose grid is sure to fit into memory.

    Args:
        width_um: side of the mask, micrometres.
        pixel_um: sample of its grid, micrometres.

    Raises:
        InputError: as :func:`require_mask_memory`.

    Example:
        >>> samples_across(3000, 2)
        1500
    """
    samples = round(width_um / pixel_um)
    require_mask_memory((samples, samples))
    return samples


def require_mask_memory(shape: tuple[int, int]) -> None:
    """Refuse a mask's grid of so many rows and columns that designing on it would exceed the machine's memory.

    Raises:
        InputError: naming ``pixel_um``, with the estimate and the limit.
    """
    require_memory("pixel_um", shape, 1, _BYTES_PER_SAMPLE, "use a coarser pixel or a narrower mask")
