"""Images as sRGB codes on tensors, against the simulator's curve in float64; and the one white of a data set."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning import method
from learning.camera import CaptureModel, measure_reference_white
from learning.classical.admm import Admm
from learning.method import Estimate, linear_to_srgb, srgb_to_linear, threads_for
from simulator import colour
from simulator.dataset import generate
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError

LINEAR = np.concatenate([np.linspace(0, 1, 1001), np.geomspace(1e-6, 1, 400), [0.0031308, 0.0031307, 0.0031309]])


@pytest.mark.parametrize("white", [1.0, 0.37, 12.0])
def test_codes_are_those_of_the_standard(white: float) -> None:
    codes = linear_to_srgb(torch.from_numpy(LINEAR * white).float(), white)
    assert codes.numpy() == pytest.approx(colour.linear_to_srgb(LINEAR), abs=1e-6)
    encoded = np.linspace(0, 1, 1001)
    linear = srgb_to_linear(torch.from_numpy(encoded).float(), white)
    assert linear.numpy() == pytest.approx(white * colour.srgb_to_linear(encoded), abs=1e-6 * white)
    assert srgb_to_linear(codes.double(), white).numpy() == pytest.approx(LINEAR * white, abs=2e-6 * white)


def test_what_is_outside_is_clipped() -> None:
    assert linear_to_srgb(torch.tensor([-1.0, 0.0, 2.0, 5.0]), 2.0).tolist() == pytest.approx([0, 0, 1, 1], abs=1e-6)
    assert srgb_to_linear(torch.tensor([-1.0, 0.0, 1.0, 5.0]), 2.0).tolist() == pytest.approx([0, 0, 2, 2], abs=1e-6)


@pytest.mark.parametrize("curve", [linear_to_srgb, srgb_to_linear])
def test_gradients_are_finite_and_those_of_the_curve(curve: Any) -> None:
    values = torch.tensor([0.0, 1e-5, 0.002, 0.02, 0.3, 0.9, 1.0], dtype=torch.float64, requires_grad=True)
    curve(values, 1.0).sum().backward()
    assert values.grad is not None
    assert torch.isfinite(values.grad).all()
    reference = colour.linear_to_srgb if curve is linear_to_srgb else colour.srgb_to_linear
    inner = values.detach().numpy()[1:-1]
    step = 1e-2 * inner  # wide, as the reference rounds to float32
    slope = (reference(inner + step).astype(float) - reference(inner - step)) / (2 * step)
    assert values.grad.numpy()[1:-1] == pytest.approx(slope, rel=2e-3)


def test_white_is_the_99th_percentile_of_all_scenes(tiny_dataset: Path) -> None:
    dataset = open_dataset(tiny_dataset, "train")
    white = measure_reference_white(dataset)
    values = np.concatenate([sample.rgb.ravel() for sample in dataset])
    assert np.mean(values <= white) == pytest.approx(0.99, abs=1e-3)
    assert measure_reference_white(dataset[:1]) != white


def test_black_scenes_and_empty_splits_have_no_white(learning_trial: Any) -> None:
    counts = {"train": 1, "validation": 0, "test": 0}
    path = learning_trial.write(dataset=counts, psf={"as_captured": None})
    folder = generate(path, ["scene.black=true"], accept_exposure=True).path
    with pytest.raises(InputError, match="out: "):
        measure_reference_white(open_dataset(folder))
    with pytest.raises(InputError, match="out: "):
        measure_reference_white(open_dataset(folder)[:0])


def test_clamping_changes_only_what_is_outside() -> None:
    image = torch.tensor([-0.5, 0.0, 0.25, 1.0, 3.0]).expand(1, 3, 1, 5)
    disparity = torch.tensor([-2.0, 0.1, 0.9, 1.0, 1.5]).reshape(1, 1, 1, 5)
    clamped = Estimate(image, disparity).clamped()
    assert clamped.image[0, 1, 0].tolist() == [0, 0, 0.25, 1, 1]
    assert clamped.disparity.ravel().tolist() == pytest.approx([0, 0.1, 0.9, 1, 1])
    assert image.min() == -0.5


def test_depths_stay_within_the_stacks_range(tiny_capture: CaptureModel) -> None:
    disparity = torch.tensor([-1.0, 0.0, 0.2, 1.0, 2.0]).reshape(1, 1, 1, 5)
    depth_m = Estimate(torch.zeros(1, 3, 1, 5), disparity).depth_m(tiny_capture)
    assert depth_m.shape == (1, 1, 1, 5)
    # 5 per metre, and a fifth of the 95 per metre to the nearest plane on top: 24 per metre.
    assert depth_m.ravel().tolist() == pytest.approx([0.2, 0.2, 1 / 24, 0.01, 0.01])


@pytest.fixture
def two_threads() -> Iterator[None]:
    """Let torch have two threads, whatever the machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("two_threads")
def test_small_arrays_have_one_thread() -> None:
    with threads_for(method.WORTH_THREADS):
        assert torch.get_num_threads() == 2
    with threads_for(method.WORTH_THREADS - 1):
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize(("worth", "threads"), [(10**6, 1), (2, 2)])
def test_admm_iterates_in_as_many_threads_as_pay(
    tiny_capture: CaptureModel, monkeypatch: pytest.MonkeyPatch, worth: int, threads: int
) -> None:
    seen = set()
    step = Admm._step
    monkeypatch.setattr(method, "WORTH_THREADS", worth)
    monkeypatch.setattr(Admm, "_step", lambda *given: (seen.add(torch.get_num_threads()), step(*given))[1])
    Admm(tiny_capture, tv=0.1, sparsity=0.0, iterations=2)(torch.ones(1, 3, 48, 48))
    assert seen == {threads}
