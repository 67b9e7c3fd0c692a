"""Denoising of rendered images by Intel Open Image Denoise, on the CPU; optional, and biased.

A trained network replaces noise by what it holds for likely: much less error from few light paths, but what it removes or
invents is not light that was simulated. It does not converge to the truth as paths are added (measured by
``benchmarks/denoise.py``), so it is off unless asked for, and clips that passed it say so.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.backend import mitsuba
from simulator.render.mitsuba_scene import BLOCK_SIZE

# Rays per pixel of the guides. Centre rays alone leave stair-steps at outlines, which the denoiser keeps; 16 strata
# gain 3 dB more for a tenth of what rendering 16 paths costs with LLVM.
_GUIDE_SAMPLES = 16


def check_denoiser() -> None:
    """Refuse to denoise where the package is not installed; does not import it.

    Raises:
        InputError: when ``pyoidn`` is absent.
    """
    if importlib.util.find_spec("pyoidn") is None:
        raise InputError(
            "render.denoise", "needs the package pyoidn, which is not installed; pip install 'flatlight[denoise]'"
        )


def denoiser_name() -> str:
    """Return what denoises, with its version, for example ``oidn 2.5.1``."""
    number = int(_device(1).get_int("version"))
    return f"oidn {number // 10000}.{number // 100 % 100}.{number % 100}"


def guides(scene: Any, seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return albedo and shading normal ``(H, W, 3)``, averaged over each pixel; zero where nothing is seen.

    They hold no noise of light, only that of 16 stratified positions.

    Args:
        scene: a ``mitsuba.Scene`` of `load_scene`.
        seed: of the positions; with the image's own seed both look through the same ones.
    """
    mi = mitsuba()
    # FIELD_NOTES: no source of depths, since it mixes surfaces at edges; which is what guides must do, like the image.
    integrator = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal", "block_size": BLOCK_SIZE})
    both = np.array(mi.render(scene, integrator=integrator, spp=_GUIDE_SAMPLES, seed=seed), dtype=np.float32)
    return both[..., :3], both[..., 3:6]


def denoise(
    rgb: NDArray[np.float32], albedo: NDArray[np.float32], normal: NDArray[np.float32], threads: int = 1
) -> NDArray[np.float32]:
    """Return an image with its noise removed; the same input gives the same bytes, whatever the number of threads.

    Open Image Denoise's ray tracing filter (Áfra, https://www.openimagedenoise.org) in its HDR mode, with ``cleanAux``: the
    guides are taken for noise-free, which those of `guides` are.

    Args:
        rgb: ``(H, W, 3)`` linear radiance, finite and not negative; no highest value.
        albedo: ``(H, W, 3)`` in 0..1.
        normal: ``(H, W, 3)``, components in -1..1.
        threads: CPU threads; one by default, since there is one worker per core.

    Raises:
        RuntimeError: when the library reports an error.
    """
    oidn = _library()
    device = _device(threads)
    result = np.zeros(rgb.shape, np.float32)
    images = {"color": rgb, "albedo": albedo, "normal": normal}
    # The library reads and writes these very arrays: they must stay until it is done.
    shared = {name: np.ascontiguousarray(image, dtype=np.float32) for name, image in images.items()} | {
        "output": result
    }
    with oidn.Filter(device, "RT") as network:
        for name, image in shared.items():
            network.set_image(name, image, oidn.OIDN_FORMAT_FLOAT3)
        network.set_bool("hdr", True)
        network.set_bool("cleanAux", True)
        network.commit()
        network.execute()
    problem = device.get_error()
    if problem:
        msg = f"Open Image Denoise failed on an image of {rgb.shape}: {problem}"
        raise RuntimeError(msg)
    return np.maximum(result, 0)


@functools.cache
def _device(threads: int) -> Any:
    """Return the denoiser of this process; it pins no threads to cores, which would put all workers on the same one."""
    device = _library().Device()
    device.set_int("numThreads", threads)
    device.set_bool("setAffinity", False)
    device.commit()
    return device


@functools.cache
def _library() -> Any:
    """Import ``pyoidn`` without its torch half, which would cost every worker 3 CPU-s and 500 MB where torch is installed."""
    modules: dict[str, Any] = sys.modules
    torch_is_here = "torch" in modules
    if not torch_is_here:
        modules["torch"] = None  # Python's own way to say: not importable
    try:
        return importlib.import_module("pyoidn")
    finally:
        if not torch_is_here:
            del modules["torch"]
