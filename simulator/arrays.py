"""The one shim that lets the same physics run on NumPy and torch: namespaces, FFT, pad, random numbers; no more.

Elementwise work goes through array-api-compat. FFTs go to scipy.fft on NumPy (it keeps float32 and is the fastest
there; its threads follow ``scipy.fft.set_workers``) and to torch.fft where gradients or CUDA are wanted.
"""

from __future__ import annotations

from typing import Any

import array_api_compat
import numpy as np

from simulator.errors import InputError

Array = Any  # numpy.ndarray or torch.Tensor: one function body serves both


def namespace(*arrays: Array) -> Any:
    """Return the array-API namespace (NumPy's or torch's) that these arrays share."""
    return array_api_compat.array_namespace(*arrays)


def module(name: str) -> Any:
    """Return the namespace called ``numpy`` or ``torch``.

    Raises:
        InputError: for any other name, or when torch is not installed.
    """
    if name == "numpy":
        import array_api_compat.numpy as xp

        return xp
    if name == "torch":
        try:
            import array_api_compat.torch as xp
        except ImportError as error:
            msg = "xp: got 'torch', which is not installed; install the extra: pip install 'flatlight[learn]'"
            raise InputError(msg) from error
        return xp
    msg = f"xp: got {name!r}, expected 'numpy' or 'torch'"
    raise InputError(msg)


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
    """Return the next FFT length that is fast for real and complex transforms; a prime would cost three times."""
    import scipy.fft

    return int(scipy.fft.next_fast_len(length, real=True))  # pyright: ignore[reportArgumentType]


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
