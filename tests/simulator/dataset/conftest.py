"""The light path once more, by its definition: what the data sets' tests hold measurements to; a Ray cluster."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from simulator.dataset.checksums import write_seal
from simulator.dataset.sample import digest_of
from simulator.io.exr import decode_exr
from simulator.io.files import sha256_bytes, sha256_file

PITCH_M, DISTANCE_M, SENSOR = 8 * 2.4e-6, 1.9e-3, (48, 60)  # of the tests' tiny configuration


def _irradiance(root: Path, rgb: NDArray, depth_m: NDArray) -> NDArray[np.float64]:
    described = json.loads((root / "psf/psf.json").read_text())
    nearness = np.array([1 / float(depth) for depth in described["depths_m"]])
    matrix = np.array(json.loads((root / "dataset.json").read_text())["scene_to_camera"]["matrix"])
    assert not np.array_equal(matrix, np.eye(3))
    h, w = depth_m.shape
    y, x = ((np.arange(n) - (n - 1) / 2) * PITCH_M for n in (h, w))
    cosine = DISTANCE_M / np.sqrt(DISTANCE_M**2 + y[:, None] ** 2 + x**2)
    radiance = np.maximum(rgb.astype(np.float64) @ matrix.T, 0)
    light = radiance * ((PITCH_M / DISTANCE_M) ** 2 * cosine**4)[..., None]
    total = np.zeros((3, *SENSOR))
    for k, name in enumerate(described["files"]):
        channels, _ = decode_exr((root / "psf" / name).read_bytes(), Path(name))
        hat = np.eye(len(nearness))[k][::-1]  # 1 at this plane's disparity, 0 at its neighbours', straight between
        share = np.interp(1 / depth_m.astype(np.float64), nearness[::-1], hat)
        for c, letter in enumerate("RGB"):
            psf = channels[letter].astype(np.float64)
            full = fftconvolve(light[..., c] * share, psf)
            rows, columns = (
                np.arange(s) - (s - n) // 2 + m // 2 for s, n, m in zip(SENSOR, (h, w), psf.shape, strict=True)
            )
            inside = [(i >= 0) & (i < n) for i, n in zip((rows, columns), full.shape, strict=True)]
            total[c][np.ix_(*inside)] += full[np.ix_(rows[inside[0]], columns[inside[1]])]
    return total


@pytest.fixture(scope="session")
def irradiance() -> Callable[..., NDArray[np.float64]]:
    """Return ``(root, rgb, depth_m) ->`` what one frame gives on the sensor ``(C, H, W)``.

    By one full convolution per plane and channel, in float64, with the PSFs and the colours of a data set's own files.
    """
    return _irradiance


@pytest.fixture(scope="module")
def ray_cluster() -> Iterator[None]:
    """A cluster that outlives a run; for its workers the tasks' module is importable."""
    import ray

    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {"env_vars": {"PYTHONPATH": path}}
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, runtime_env=environment)
    yield
    ray.shutdown()


@pytest.fixture(scope="session")
def contents(decided: Callable) -> Callable[[Any], dict[str, str]]:
    """Return a function: a data set to all that its seed decides, and its description but for place and workers."""

    def find(root: Any) -> dict[str, str]:
        info = json.loads((root / "dataset.json").read_bytes())
        for free in ("output", "engine", "workers"):
            del info["config"]["dataset"][free]
        return decided(root) | {"info": json.dumps(info)}

    return find


def _forge(root: Path, **changes: object) -> Path:
    """Make all hashes agree with the files of the first training sample, after changes to its ``sample.json``."""
    folder = root / "train/0000/s00000000"
    path = folder / "sample.json"
    description = json.loads(path.read_text()) | changes
    if "files" not in changes:
        description["files"] = {name: sha256_bytes((folder / name).read_bytes()) for name in description["files"]}
    path.write_text(json.dumps(description))
    digest = digest_of(description["files"] | {"sample.json": sha256_file(path)})
    lines = [json.loads(line) for line in (root / "manifest.jsonl").read_text().splitlines()]
    for line in lines:
        if (line["split"], line["id"]) == ("train", "s00000000"):
            line |= {"digest": digest, "label": description["label"]}
    (root / "manifest.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    write_seal(root)
    return folder


@pytest.fixture(scope="session")
def forge() -> Callable[..., Path]:
    """Return ``(root, **changes of sample.json) ->`` the first sample's folder, with whose files all hashes agree."""
    return _forge
