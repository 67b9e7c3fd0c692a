"""Classical methods: put together as their parameters say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from learning.checkpoint import load_denoiser, save_denoiser
from learning.classical.admm import Admm
from learning.classical.focus import assemble, unary_cost
from learning.classical.graph_cut import cut_labels
from learning.classical.method import DEFAULTS, SEARCH, VOLUME_PARAMETERS, ConstrainedLeastSquares, build_classical
from learning.classical.plug_and_play import PlugAndPlay
from learning.method import Clock
from learning.models.denoiser import Denoiser
from simulator.errors import InputError
from simulator.optics.stack import PsfStack

THESIS = {"cost": "defocus", "measure": "gradient", "contrast": 0.5, "window_px": 1.0, "light": "label"}


@pytest.fixture
def measurement():
    return torch.from_numpy(np.random.default_rng(0).uniform(size=(2, 3, 48, 48)).astype(np.float32))


@pytest.fixture
def denoiser(tmp_path):
    """The parameter of ``pnp`` that names a denoiser that has learned nothing."""
    size = {"filters": 2, "blocks": 1, "levels": 2}
    torch.manual_seed(0)
    save_denoiser(tmp_path / "d.safetensors", Denoiser(**size), architecture={"network": "denoiser", **size}, record={})
    return {"denoiser": str(tmp_path / "d.safetensors")}


@pytest.mark.parametrize(
    ("name", "given", "volume_method", "stage"),
    [
        ("cls", {"regularisation_lambda": 0.05, "tikhonov": 0.2}, ConstrainedLeastSquares, "inversion"),
        ("admm", {"tv": 0.02, "sparsity": 0.03, "iterations": 3}, Admm, "admm"),
        ("pnp", {"prior": 0.01, "noise_first": 0.1, "noise_last": 0.03, "iterations": 3}, PlugAndPlay, "pnp"),
    ],
)
def test_is_volume_graph_cut_and_assembly(tiny_capture, measurement, denoiser, name, given, volume_method, stage):
    """Each given parameter arrives where it belongs; the labels are those of the energy that the parameters say."""
    given |= denoiser if name == "pnp" else {}
    depth = {"cost": "defocus", "measure": "gradient", "contrast": 0.9, "window_px": 1.5, "steps_between_planes": 1}
    depth |= {"pairwise": 1.2, "light": "sum"}
    method = build_classical(tiny_capture, name, given | depth)
    clock = Clock()
    estimate = method.reconstruct(measurement, clock)
    assert list(clock.seconds) == [stage, "graph cut", "assembly"]

    ready = {"denoiser": load_denoiser(given["denoiser"])[0]} if name == "pnp" else {}
    volume = volume_method(tiny_capture, **given | ready)(measurement)
    torch.testing.assert_close(method.volume(measurement), volume)
    labels = method.places(volume).long()
    torch.testing.assert_close(estimate, assemble(volume, labels, tiny_capture, "sum"))
    unary = {key: value for key, value in depth.items() if key not in ("pairwise", "light")}
    costs = unary_cost(volume, **unary).double().numpy()
    expected = [cut_labels(cost, 1.2 * np.ptp(cost, axis=0).mean() / 2) for cost in costs]
    np.testing.assert_array_equal(labels, expected)
    assert len(np.unique(labels)) > 1


@pytest.mark.parametrize("name", DEFAULTS)
def test_scenes_of_a_batch_do_not_touch(tiny_capture, measurement, denoiser, name):
    few: dict[str, Any] = {"admm": {"iterations": 3}, "pnp": {"iterations": 3, **denoiser}}
    method = build_classical(tiny_capture, name, few.get(name))
    both = method.reconstruct(measurement)
    for scene in range(2):
        one = method.reconstruct(measurement[scene : scene + 1])
        # FFTs of other batch sizes round differently; labels at such a tie would differ by a whole plane.
        torch.testing.assert_close(one.disparity, both.disparity[scene : scene + 1])
        torch.testing.assert_close(one.image, both.image[scene : scene + 1], atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("name", DEFAULTS)
def test_every_candidate_builds(tiny_capture, denoiser, name):
    given = denoiser if name == "pnp" else {}
    assert set(SEARCH[name]) <= set(DEFAULTS[name])
    assert set(VOLUME_PARAMETERS[name]) <= {*SEARCH[name], *given}
    for parameter, values in SEARCH[name].items():
        numbers = [value for value in values if not isinstance(value, str)]
        assert numbers == sorted(set(numbers))
        for value in values:
            build_classical(tiny_capture, name, {parameter: value, **given})


@pytest.mark.parametrize("steps", [1, 4])
def test_labels_between_planes_are_the_best_of_all(tiny_capture, steps):
    """2 pixels, all pairs of 9 labels of three planes: the energy of the method's own definition, by brute force."""
    rng = np.random.default_rng(5)
    settings = {"cost": "spread", "measure": "light", "contrast": 0.5, "window_px": 0.0, "light": "label"}
    method = build_classical(tiny_capture, "cls", settings | {"pairwise": 0.3, "steps_between_planes": steps})
    between = 0
    for _ in range(20):
        volume = torch.from_numpy(rng.uniform(size=(1, 3, 1, 1, 2)))
        weights = volume[0, :, 0, 0].numpy()
        weights = weights / weights.sum(axis=0)
        places = np.arange(2 * steps + 1) / steps
        costs = ((places[:, None] - np.arange(3)) ** 2 / 4) @ weights
        full = costs[:, None, 0] + costs[None, :, 1]
        full = full + 0.3 * np.ptp(costs, axis=0).mean() * np.abs(np.subtract.outer(places, places)) / 2
        best = np.unravel_index(full.argmin(), full.shape)
        found = method.places(volume)[0, 0].numpy()
        np.testing.assert_array_equal(found, places[list(best)])
        between += int((found % 1 > 0).sum())
    assert (between > 0) == (steps > 1)


def test_the_number_of_labels_and_the_unit_do_not_change_what_pairwise_means(tiny_capture):
    """The volume times 1000 gives the same labels; pairwise from none to much gives fewer and fewer steps."""
    volume = torch.from_numpy(np.random.default_rng(3).uniform(size=(1, 3, 3, 16, 16)))
    steps = []
    for pairwise in (0.0, 0.5, 2.0, 100.0):
        method = build_classical(tiny_capture, "cls", THESIS | {"pairwise": pairwise})
        labels = method.places(volume)
        torch.testing.assert_close(method.places(volume * 1000), labels)
        steps.append(float(labels.diff(dim=1).abs().sum() + labels.diff(dim=2).abs().sum()))
    assert steps[0] > steps[1] > steps[2] > steps[3] == 0


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("wiener", {}, "^name: "),
        ("cls", {"tv": 0.1}, "^parameters: "),
        ("cls", {"strength": 0.1}, "^parameters: .*regularisation_lambda"),  # its name in earlier versions
        ("cls", {"regularisation_lambda": "much"}, "^parameters: "),
        ("admm", {"iterations": 10.5}, "^parameters: "),
        ("cls", {"measure": 3}, "^parameters: "),
        ("cls", {"measure": "edges"}, "^measure: "),
        ("cls", {"cost": "best"}, "^cost: "),
        ("cls", {"light": "all"}, "^light: "),
        ("cls", {"contrast": -1.0}, "^contrast: "),
        ("cls", {"window_px": -1.0}, "^window_px: "),
        ("cls", {"steps_between_planes": 0}, "^steps_between_planes: "),
        ("cls", {"pairwise": -1.0}, "^pairwise: "),
        ("cls", {"regularisation_lambda": 0.0}, "^regularisation_lambda: "),
    ],
)
def test_refuses_parameters_that_make_no_sense(tiny_capture, name, parameters, message):
    with pytest.raises(InputError, match=message):
        build_classical(tiny_capture, name, parameters)


def test_refuses_other_measurements_and_nan(tiny_capture, measurement):
    method = build_classical(tiny_capture, "cls")
    with pytest.raises(InputError, match=r"^measurement: "):
        method.reconstruct(measurement[..., :40])
    measurement[1, 0, 0, 0] = torch.nan
    with pytest.raises(InputError, match=r"^unary: "):
        method.reconstruct(measurement)


def test_refuses_a_single_plane(tiny_capture):
    stack = tiny_capture.stack
    single = tiny_capture.with_stack(PsfStack(stack.values[:1], stack.depths_m[:1], 20e-6, stack.channels, "1" * 64))
    with pytest.raises(InputError, match=r"^capture: "):
        build_classical(single, "cls")
