"""The confidence of depths: probabilities that were drawn are found again, features are what they say, files are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.camera import CaptureModel
from learning.checkpoint import find_checkpoint
from learning.classical.by_name import ALL_DEFAULTS
from learning.confidence.calibration import FEATURES, TOLERANCE, DepthConfidence, calibrate, features, is_right
from learning.confidence.files import ConfidenceFile, find_confidence, read_confidence
from learning.confidence.job import Reliability, _Pixels, _reliability
from learning.method import Estimate
from simulator.errors import InputError
from simulator.io.files import sha256_file

PLACE = dict(zip(FEATURES, range(5), strict=True))


def drawn(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return features, whether depths are right, and the true probability of it: quadratic in light, falling with noise."""
    rng = np.random.default_rng(seed)
    found = rng.normal([-3, -4, -5, -4, 0.5], [2, 1, 2, 1, 0.3], (count, 5)).astype(np.float32)
    logit = 1 + 0.6 * found[:, 0] - 0.1 * found[:, 0] ** 2 + 0.5 * found[:, 0] * found[:, 4] - 0.8 * (found[:, 3] + 4)
    truth = 1 / (1 + np.exp(-logit.astype(np.float64)))
    return found, rng.random(count) < truth, truth


def probability(confidence: DepthConfidence, found: np.ndarray) -> np.ndarray:
    """Return what a confidence says of features, by the formula of its docstring, written in NumPy."""
    clipped = np.clip(found, confidence.lowest, confidence.highest)
    z = (clipped - confidence.means) / np.array(confidence.deviations)
    products = [z[:, i] * z[:, j] for i in range(5) for j in range(i, 5)]
    return 1 / (1 + np.exp(-np.column_stack([np.ones(len(z)), z, *products]) @ confidence.weights))


def test_probabilities_that_were_drawn_are_found_again() -> None:
    """Standard errors of 20 weights from 40 000 pixels move probabilities by about sqrt(21 / 40 000) of 0.5, 0.011."""
    found, right, _ = drawn(40_000, 1)
    confidence = calibrate([(found[:1000], right[:1000]), (found[1000:], right[1000:])], "drawn")
    fresh, outcome, truth = drawn(20_000, 2)
    said = probability(confidence, fresh)
    assert np.sqrt(np.mean((said - truth) ** 2)) < 0.02
    reliability = _reliability(30.0, _Pixels(fresh, said.astype(np.float32), np.where(outcome, 0.0, 0.3), outcome))
    assert reliability.error < 0.02
    assert reliability.known_rmse is not None
    assert reliability.known_rmse < reliability.disparity_rmse


def test_what_is_said_of_an_estimate_is_the_formula_of_its_features(tiny_capture: CaptureModel) -> None:
    found, right, _ = drawn(2000, 3)
    confidence = calibrate([(found, right)], "drawn")
    rng = torch.Generator().manual_seed(0)
    estimate = Estimate(torch.rand(2, 3, 16, 20, generator=rng), torch.rand(2, 1, 16, 20, generator=rng))
    measurement = torch.rand(2, 3, 48, 48, generator=rng)
    said = confidence.of(estimate, measurement, tiny_capture)
    assert said.shape == estimate.disparity.shape
    seen = features(estimate, measurement, tiny_capture)
    assert np.allclose(said.numpy().ravel(), probability(confidence, seen.reshape(-1, 5).numpy()), atol=1e-4)  # float32
    assert DepthConfidence.read(json.loads(json.dumps(confidence.record()))) == confidence


def test_features_follow_light_texture_roughness_and_noise(tiny_capture: CaptureModel) -> None:
    rng = torch.Generator().manual_seed(0)
    image, disparity = torch.full((1, 3, 24, 24), 0.5), torch.full((1, 1, 24, 24), 0.4)
    image[..., 12:] = 0.02
    image[:, :, :12, :12] += 0.2 * (torch.rand(1, 1, 12, 12, generator=rng) - 0.5)
    disparity[:, :, 12:] += 0.4 * torch.rand(1, 1, 12, 24, generator=rng)
    smooth = torch.linspace(0.1, 0.9, 48).expand(1, 3, 48, 48)
    seen = [
        features(Estimate(image, disparity), smooth + sigma * torch.randn(1, 3, 48, 48, generator=rng), tiny_capture)
        for sigma in (0.001, 0.03)
    ]
    corners = {name: seen[0][0, 0, ..., place] for name, place in PLACE.items()}
    bright, dark = corners["light"][:6, :6].mean(), corners["light"][:6, -6:].mean()
    # sRGB codes 0.5 and 0.02 are 0.214 and 0.00155 of white (IEC 61966-2-1).
    assert 2.0**bright == pytest.approx(0.214, rel=0.05)
    assert 2.0**dark == pytest.approx(0.00155, rel=0.01)
    assert corners["texture"][:6, :6].mean() > corners["texture"][-6:, :6].mean() + 2
    assert corners["roughness"][-6:].mean() > corners["roughness"][:6].mean() + 2
    assert torch.equal(corners["disparity"], disparity[0, 0])
    noise = [float(each[0, 0, 0, 0, PLACE["noise"]]) for each in seen]
    assert noise[1] - noise[0] == pytest.approx(2 * np.log10(30), abs=0.3)  # of powers


def test_right_is_within_the_tolerance_of_the_range() -> None:
    disparity = torch.tensor([0.0, 0.5, 1.0]).reshape(1, 1, 1, 3)
    estimate = Estimate(
        torch.zeros(1, 3, 1, 3), torch.tensor([-0.3, 0.5 + TOLERANCE * 0.99, 1 - TOLERANCE * 1.01])[None, None, None]
    )
    assert is_right(estimate, disparity).flatten().tolist() == [True, True, False]  # clamped first


def test_reliability_counts_bins() -> None:
    sure = np.float32([0.05, 0.05, 0.95, 0.95, 0.95, 1.0])
    right = np.array([False, True, True, True, False, True])
    found = _reliability(20.0, _Pixels(np.zeros((6, 5), np.float32), sure, np.float32([0.4, 0, 0, 0, 0.3, 0]), right))
    assert found == Reliability(
        noise_db=20.0,
        right=pytest.approx(4 / 6),
        unknown=pytest.approx(2 / 6),
        error=pytest.approx((2 * 0.45 + 4 * (0.9625 - 0.75)) / 6, rel=1e-5),
        disparity_rmse=pytest.approx(np.sqrt((0.16 + 0.09) / 6)),
        known_rmse=pytest.approx(np.sqrt(0.09 / 4)),
        confidence=[pytest.approx(0.05), *[None] * 8, pytest.approx(0.9625)],
        share_right=[0.5, *[None] * 8, 0.75],
        pixels=[2, *[0] * 8, 4],
        rmse=[pytest.approx(np.sqrt(0.08)), *[None] * 8, pytest.approx(np.sqrt(0.0225))],
    )


@pytest.fixture
def written(tmp_path: Path) -> tuple[Path, ConfidenceFile]:
    found, right, _ = drawn(500, 4)
    file = ConfidenceFile(calibrate([(found, right)], "drawn"), {"method": "cls", "parameters": {}, "psfs": "a"}, {})
    file.write(tmp_path / "cls.confidence.json")
    return tmp_path / "cls.confidence.json", file


def test_a_file_comes_back_and_belongs_to_its_method(written: tuple[Path, ConfidenceFile]) -> None:
    path, file = written
    assert read_confidence(path) == file
    cls: dict[str, Any] = {"method": "cls", "parameters": {}, "camera": {"psf_fingerprint": "a"}}
    assert find_confidence(cls, str(path)) == (file.confidence, f"drawn ({path})")
    others = cls | {"parameters": {"tikhonov": 2}, "camera": {"psf_fingerprint": "b"}}
    assert find_confidence(others, str(path)) == (file.confidence, f"drawn, with other parameters and PSFs ({path})")
    assert find_confidence(cls, "none")[0] is None
    with pytest.raises(InputError, match=r"^--confidence: "):
        find_confidence(cls | {"method": "admm"}, str(path))
    with pytest.raises(InputError, match=r"^--confidence: "):
        find_confidence({"sha256": "0" * 64, "checkpoint": "a.safetensors"}, str(path))


def test_the_file_beside_a_checkpoint_is_taken_if_it_is_of_it(
    tmp_path: Path, written: tuple[Path, ConfidenceFile]
) -> None:
    own = {"sha256": "1" * 64, "checkpoint": str(tmp_path / "best.safetensors")}
    assert find_confidence(own, None)[0] is None
    replace(written[1], method={"sha256": "1" * 64}).write(tmp_path / "best.confidence.json")
    assert find_confidence(own, None)[0] == written[1].confidence
    assert find_confidence(own | {"sha256": "2" * 64}, None)[0] is None


@pytest.mark.parametrize("network", ["flatnet3d", "videonet3d"])
def test_the_shipped_networks_depths_have_a_confidence(network: str) -> None:
    path = find_checkpoint(network)
    confidence, origin = find_confidence({"sha256": sha256_file(path), "checkpoint": str(path)}, None)
    assert confidence is not None
    assert "validation scenes" in origin


@pytest.mark.parametrize("method", ["cls", "admm", "pnp"])
def test_classical_methods_have_one_that_is_of_their_defaults(method: str) -> None:
    record = {"method": method, "parameters": ALL_DEFAULTS[method], "camera": {"psf_fingerprint": "of my camera"}}
    confidence, origin = find_confidence(record, None)
    assert confidence is not None
    assert origin.endswith(", with other PSFs")


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: {},
        lambda content: content | {"version": 2},
        lambda content: content | {"confidence": content["confidence"] | {"weights": [1.0]}},
        lambda content: content | {"confidence": content["confidence"] | {"means": [None] * 5}},
        lambda content: {key: value for key, value in content.items() if key != "method"},
    ],
)
def test_damaged_files_are_named(written: tuple[Path, ConfidenceFile], damage: Any) -> None:
    path, _ = written
    path.write_text(json.dumps(damage(json.loads(path.read_text()))))
    with pytest.raises(InputError, match=r"cls\.confidence\.json: "):
        read_confidence(path)
