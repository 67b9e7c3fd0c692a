"""`flatlight confidence` on a tiny data set, and reconstructions that say where the depth is unknown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

from learning.commands import confidence, reconstruct
from learning.confidence import job
from learning.confidence.files import read_confidence
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import write_psf_stack
from simulator.plots.drawing import UNSEEN


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job, "_LEAST_SCENES", 2)


def test_the_command_calibrates_checks_and_reconstruct_uses_it(
    few: None, tiny_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    confidence(tiny_dataset, method="cls", output=None)
    out = capsys.readouterr().out
    assert "cls.confidence.json" in out
    assert (tmp_path / "cls.confidence.png").exists()
    file = read_confidence(tmp_path / "cls.confidence.json")
    assert set(file.checked) == {"20 dB", "30 dB", "40 dB", "50 dB"}
    sample = open_dataset(tiny_dataset, "test").folder(0)
    depths, colours = {}, {}
    for least in (0.0, 0.5, 1.0):
        reconstruct(
            sample, method="cls", confidence="cls.confidence.json", least_confidence=least, output=Path(f"o{least}")
        )
        depths[least] = read_exr(tmp_path / f"o{least}" / "depth.exr", finite=False)[0]
        colours[least] = np.asarray(Image.open(tmp_path / f"o{least}" / "depth.png"))
    sure = depths[0.0]["confidence"]
    assert 0 < sure.min() < sure.max() < 1
    assert np.isfinite(depths[0.0]["Z"]).all()
    for least, depth in depths.items():
        unknown = sure < least
        assert np.array_equal(np.isnan(depth["Z"]), unknown)
        assert np.array_equal(depth["Z"][~unknown], depths[0.0]["Z"][~unknown])
        factor = colours[least].shape[0] // len(sure)
        shown = colours[least][: len(sure) * factor : factor, : sure.shape[1] * factor : factor]
        assert np.array_equal((shown == np.array(UNSEEN)).all(axis=-1), unknown)
    assert "unknown everywhere" in capsys.readouterr().out
    record = json.loads((tmp_path / "o0.5" / "reconstruction.json").read_text())
    assert record["confidence_from"].endswith("50 dB (cls.confidence.json)")


def test_too_few_scenes_and_one_depth_are_refused(
    tiny_dataset: Path, few: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job, "_LEAST_SCENES", 999)
    with pytest.raises(InputError, match=r"split 'validation' has"):
        confidence(tiny_dataset, method="cls")
    with pytest.raises(InputError, match=r"^--least-confidence: "):
        reconstruct(open_dataset(tiny_dataset, "test").folder(0), method="cls", least_confidence=1.5)
    with pytest.raises(InputError, match=r"^--least-confidence: the confidence is not asked for"):
        reconstruct(open_dataset(tiny_dataset, "test").folder(0), method="cls", confidence="none", least_confidence=0.7)
    random = np.random.default_rng(0)
    np.save(tmp_path / "capture.npy", random.random((32, 32, 3), np.float32))
    np.save(tmp_path / "psf.npy", random.random((15, 15, 3), np.float32))
    flat = {"method": "cls", "stack": str(tmp_path / "psf.npy"), "frame": "stored", "output": tmp_path / "flat"}
    for option, value in (("least_confidence", 0.7), ("confidence", "cls.confidence.json")):
        with pytest.raises(InputError, match=f"^--{option.replace('_', '-')}: these PSFs have one depth"):
            reconstruct(tmp_path / "capture.npy", **flat, **{option: value})
    reconstruct(tmp_path / "capture.npy", **flat)
    assert json.loads((tmp_path / "flat" / "reconstruction.json").read_text())["confidence_from"] == "no depth"


def test_where_a_capture_of_unknown_exposure_is_dark_the_depth_is_unknown(tmp_path: Path) -> None:
    """A lit square, and nothing around it but what noise leaves in the estimate."""
    rng, size = np.random.default_rng(0), 96
    psfs = (rng.random((3, 1, 31, 31)) < 0.05) * rng.random((3, 1, 31, 31))
    stack = PsfStack(psfs, np.array([0.04, 0.08, 0.2]), 19.2e-6, ("grey",), "random", {"kind": "measured"})
    write_psf_stack(tmp_path / "stack", stack)
    scene = np.zeros((size, size))
    scene[32:64, 32:64] = rng.random((32, 32))
    capture = fftconvolve(scene, psfs[1, 0], mode="same")
    np.save(tmp_path / "capture.npy", 0.8 * capture / capture.max() + rng.normal(0, 0.004, capture.shape))
    options = {"method": "cls", "stack": str(tmp_path / "stack"), "frame": "stored"}
    reconstruct(tmp_path / "capture.npy", output=tmp_path / "whole", confidence="none", **options)
    assert np.isfinite(read_exr(tmp_path / "whole" / "depth.exr")[0]["Z"]).all()
    reconstruct(tmp_path / "capture.npy", output=tmp_path / "sure", least_confidence=0.01, **options)
    known = np.isfinite(read_exr(tmp_path / "sure" / "depth.exr", finite=False)[0]["Z"])
    radiance = np.mean(list(read_exr(tmp_path / "sure" / "image.exr")[0].values()), axis=0)
    light = gaussian_filter(radiance, 1.5) / np.percentile(radiance[radiance > 0], 99.5)
    assert known[light < 0.008].size > 1000
    assert not known[light < 0.008].any()
    assert known[light > 0.1].mean() > 0.5
