"""Small synthetic samples and data sets that the tests of this folder share."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from simulator.dataset.checksums import write_seal
from simulator.dataset.dataset_info import DatasetInfo, write_info
from simulator.dataset.fingerprint import build_fingerprint
from simulator.dataset.manifest import ManifestWriter
from simulator.dataset.sample import Sample, write_sample
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import write_psf_stack

SENSOR, SCENE = (24, 36), (10, 12)


def make_sample(index: int = 0, sensor: tuple[int, int] = SENSOR, scene: tuple[int, int] = SCENE, **changes) -> Sample:
    """A sample whose values all depend on the index; the channels differ, so swapped ones are noticed."""
    rng = np.random.default_rng(index)
    noiseless = rng.random((3, *sensor), dtype=np.float32)
    values = {
        "measurement": np.round(noiseless * 4096).astype(np.float32) / np.float32(4096),
        "noiseless": noiseless,
        "rgb": rng.random((1, *scene, 3), dtype=np.float32),
        "depth_m": rng.uniform(0.036, 0.2, (1, *scene)).astype(np.float32),
        "valid": rng.random((1, *scene)) > 0.2,
        "seed": 7,
        "label": f"class {index % 3}",
        "metadata": {"source": {"depths_m": [0.036, 0.2]}, "clipped": 0.001, "psf": "a" * 64, "full_scale": 0.5},
    }
    return Sample(**(values | changes))


def make_clip_sample(index: int = 0, frames: int = 3, **changes) -> Sample:
    """A sample of several frames with a global measurement for each."""
    rng = np.random.default_rng(1000 + index)
    values = {
        "rgb": rng.random((frames, *SCENE, 3), dtype=np.float32),
        "depth_m": rng.uniform(0.036, 0.2, (frames, *SCENE)).astype(np.float32),
        "valid": rng.random((frames, *SCENE)) > 0.2,
        "extras": {"shape_id": rng.integers(-1, 9, (frames, *SCENE), np.int32)},
        "frame_edges_s": np.linspace(0, 0.01, frames + 1),
        "global_measurements": rng.random((frames, 3, *SENSOR), dtype=np.float32),
    }
    return make_sample(index, **(values | changes))


def in_units(seconds: float, unit: float) -> float:
    """The number that gives exactly these seconds when it is multiplied by the unit."""
    near = seconds / unit
    return next(n for n in (near, np.nextafter(near, 0), np.nextafter(near, np.inf)) if n * unit == seconds)


def camera_section(record: dict) -> dict:
    """What a configuration says of the camera with a recorded shutter."""
    chosen = {key: value for key, value in record.items() if key in ("type", "direction", "order")}
    chosen |= (
        {"file": "rows.csv"} if record["type"] == "windows" else {"exposure_ms": in_units(record["exposure_s"], 1e-3)}
    )
    if "line_time_s" in record:
        chosen["line_time_us"] = in_units(record["line_time_s"], 1e-6)
    return {"shutter": chosen, "sensor": {"binning": record["binning"]}}


def make_info(**changes) -> DatasetInfo:
    config = {"seed": 7, "psf": {"far_cm": float("inf")}}
    if "time" in changes:
        config["camera"] = camera_section(changes["time"]["shutter"])
    config = changes.get("config", config)
    fingerprint, parts = build_fingerprint(config, "scalar_rgb")
    values = {
        "name": "small",
        "config": config,
        "fingerprint": fingerprint,
        "fingerprint_parts": parts,
        "versions": {"numpy": "2.0"},
        "backend": "scalar_rgb",
        "exposure": {"full_scale": 0.5},
        "counts": {"train": 3, "validation": 1, "test": 0},
        "scene_shape": SCENE,
        "sensor_shape": SENSOR,
        "channels": ("R", "G", "B"),
    }
    return DatasetInfo(**(values | changes))


def make_dataset(root: Path, make: Callable[[int], Sample] = make_sample, **changes) -> Path:
    """Write a whole data set: three training samples (finished in another order) and one for validation."""
    root.mkdir()
    write_info(root, make_info(**changes))
    values = np.random.default_rng(0).random((2, 3, 5, 5), dtype=np.float32)
    write_psf_stack(root / "psf", PsfStack(values, np.array([0.036, 0.2]), 2e-5, ("R", "G", "B"), "a" * 64))
    with ManifestWriter(root) as manifest:
        for split, index in (("train", 2), ("train", 0), ("validation", 0), ("train", 1)):
            manifest.append(write_sample(root, split, index, make(index)), seconds=0.1)
    write_seal(root)
    return root
