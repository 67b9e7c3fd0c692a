"""Tuning by a method whose best parameters are known, on a tiny data set: found, resumed, volumes reused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.data import default_collate

from learning.camera import CaptureModel, capture_model, measure_reference_white
from learning.checkpoint import save_denoiser
from learning.classical.by_name import build_method
from learning.classical.method import DEFAULTS, ClassicalMethod
from learning.config import TuneConfig, load_file
from learning.data import Example, ExampleSet
from learning.method import Estimate, linear_to_srgb
from learning.metrics import depth_scores, psnr
from learning.models.denoiser import Denoiser
from learning.provenance import scenes_of
from learning.tune.job import Errors, Score, Tunable, classical, table, tune, tune_file
from learning.tune.search import Axis, Parameters
from learning.tune.study import Study, load_tuned
from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError
from simulator.io.files import sha256_bytes
from simulator.io.json import canonical_json

SCENES = 5
LEVELS = (20.0, 40.0)


def steps(value: Any, best: float) -> float:
    """Return how far a value is from the best, in decades; it costs nothing to be right."""
    return abs(float(np.log10(float(value) / best)))


class Truth:
    """The truth of some scenes, and what a method makes of it: blurred by wrong parameters, exact with the right ones."""

    def __init__(self, capture: CaptureModel) -> None:
        rng = np.random.default_rng(3)
        radiance = torch.from_numpy(rng.uniform(0, 0.8, (SCENES, 3, 8, 8)).astype(np.float32))
        depth_m = torch.from_numpy(1 / rng.uniform(1 / 0.2, 1 / 0.01, (SCENES, 1, 8, 8)).astype(np.float32))
        valid = torch.ones_like(depth_m, dtype=torch.bool)
        self.example = Example(torch.zeros(SCENES, 3, 8, 8), radiance, depth_m, valid)
        self.image, self.disparity = linear_to_srgb(radiance, capture.white), capture.disparity(depth_m)
        self.volumes = self.estimates = 0

    def tunable(self, optimum: Parameters) -> Tunable:
        """Return a method with the least error at ``optimum``; lambda decides its volume, ``window`` what follows."""
        truth = self

        class Fake:
            def __init__(self, parameters: Parameters) -> None:
                self.parameters = parameters

            def volume(self, measurement: Tensor) -> Tensor:
                truth.volumes += len(measurement)
                found, best = (each["regularisation_lambda"] for each in (self.parameters, optimum))
                error = 0.05 + 0.1 * steps(found, float(best))
                return measurement[:, :1, None] + error  # a scene's own number, then the error

            def estimate(self, volume: Tensor) -> Estimate:
                truth.estimates += len(volume)
                scenes = volume.flatten(1)[:, 0].floor().long()
                error = volume.flatten(1)[:, 0] - scenes
                wrong = 0.1 * steps(self.parameters["window"], float(optimum["window"]))
                blur = (error + wrong)[:, None, None, None]
                grey, middle = truth.image.mean(), truth.disparity.mean()
                image, disparity = truth.image[scenes], truth.disparity[scenes]
                return Estimate(image * (1 - blur) + grey * blur, disparity * (1 - blur) + middle * blur)

        space = {"regularisation_lambda": Axis((1e-3, 1e-2, 1e-1)), "window": Axis((1, 10, 100), low=1)}
        defaults: Parameters = {"regularisation_lambda": 1e-2, "window": 1, "smoothness": 0.5}
        return Tunable("fake", Fake, defaults, space, frozenset({"regularisation_lambda"}))

    def measurements(self) -> dict[float, Tensor]:
        """Return measurements that say which scene they are of."""
        return {level: torch.arange(SCENES).float()[:, None, None, None].expand(-1, 3, 8, 8) for level in LEVELS}


@pytest.fixture
def truth(tiny_capture: CaptureModel) -> Truth:
    return Truth(tiny_capture)


@pytest.fixture
def score(truth: Truth, tiny_capture: CaptureModel) -> Score:
    return Score("both", truth.example, tiny_capture)


@pytest.mark.parametrize(
    "optimum", [{"regularisation_lambda": 1e-1, "window": 10}, {"regularisation_lambda": 1e2, "window": 1000}]
)
def test_a_known_optimum_is_found(truth: Truth, score: Score, tmp_path: Path, optimum: Parameters) -> None:
    study = Study(tmp_path / "tuned.json", {"data": "x"}, {})
    tune([truth.tunable(optimum)], truth.measurements(), score, study)
    tuned = load_tuned(tmp_path / "tuned.json")
    for level in LEVELS:
        parameters, used = tuned.parameters("fake", level + 3)
        assert parameters == {**optimum, "smoothness": 0.5}
        assert used == level
    # One volume for each regularisation_lambda and level: all trials that differ in the window only take them from before.
    strengths = {(t["noise_db"], t["parameters"]["regularisation_lambda"]) for t in study.trials}
    assert truth.volumes == SCENES * len(strengths)
    assert truth.estimates == SCENES * len(study.trials)
    assert sum(t["volume_reused"] for t in study.trials) == len(study.trials) - len(strengths)
    for result in study.results:
        assert result["converged"]
        assert result["at_limit"] == []
        assert result["score"] == min(t["score"] for t in study.trials if t["noise_db"] == result["noise_db"])
    # The second level begins where the first ended.
    counts = [sum(t["noise_db"] == level for t in study.trials) for level in LEVELS]
    assert counts[0] < counts[1]


def test_a_run_that_dies_goes_on_and_tries_nothing_twice(truth: Truth, score: Score, tmp_path: Path) -> None:
    optimum: Parameters = {"regularisation_lambda": 1.0, "window": 100}
    whole = Study(tmp_path / "whole.json", {"data": "x"}, {})
    tune([truth.tunable(optimum)], truth.measurements(), score, whole)

    def dying(_: str, tried: int, __: int) -> None:
        if tried == 7:
            raise MemoryError

    path = tmp_path / "tuned.json"
    with pytest.raises(MemoryError):
        tune([truth.tunable(optimum)], truth.measurements(), score, Study(path, {"data": "x"}, {}), progress=dying)
    done = load_tuned(path).content["trials"]
    assert 0 < len(done) <= 7
    with pytest.raises(InputError, match=r"tuned\.json: "):
        load_tuned(path).parameters("fake", 20)

    estimates = truth.estimates
    study = Study(path, {"data": "x"}, {})
    tune([truth.tunable(optimum)], truth.measurements(), score, study)
    assert truth.estimates - estimates == SCENES * (len(whole.trials) - len(done))
    assert [t["parameters"] for t in study.trials] == [t["parameters"] for t in whole.trials]
    assert [r["parameters"] for r in study.results] == [r["parameters"] for r in whole.results]

    estimates, before = truth.estimates, path.read_bytes()
    tune([truth.tunable(optimum)], truth.measurements(), score, Study(path, {"data": "x"}, {}))
    assert truth.estimates == estimates  # finished: only the study is read
    assert path.read_bytes() == before


def test_a_study_of_other_data_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "tuned.json"
    study = Study(path, {"data": "x", "seed": 0}, {})
    study.add_trial({"method": "cls", "noise_db": 20.0, "parameters": {"a": 1.0}, "score": float("inf")})
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"tuned\.json: "):
        Study(path, {"data": "x", "seed": 1}, {})
    assert path.read_bytes() == before
    assert float(Study(path, {"data": "x", "seed": 0}, {}).trials[0]["score"]) == float("inf")


def test_a_method_joins_a_study_with_what_decides_its_scores(tmp_path: Path) -> None:
    """A denoiser, for plug-and-play ADMM: runs without it need not know it, others must have the same."""

    def run(noise_db: float, **identity: str) -> Study:
        study = Study(tmp_path / "tuned.json", {"data": "x", **identity}, {})
        study.add_trial({"method": "any", "noise_db": noise_db, "parameters": {}, "score": 1.0})
        return study

    run(20)
    run(30, denoiser="one")
    assert len(run(40).trials) == len(run(40, denoiser="one").trials) - 1 == 3
    with pytest.raises(InputError, match=r"tuned\.json: .*denoiser"):
        run(50, denoiser="another")


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[]",
        '{"format": "flatlight tuned", "version": 99}',
        '{"format": "flatlight tuned", "version": 1, "identity": {}, "trials": []}',
        '{"format": "flatlight tuned", "version": 1, "identity": {}, "trials": [], "results": [{"method": "cls"}]}',
    ],
)
def test_files_that_are_not_a_study_are_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "tuned.json"
    with pytest.raises(InputError, match=r"tuned\.json: "):
        load_tuned(path)  # absent
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=r"tuned\.json: "):
        load_tuned(path)


@pytest.mark.parametrize(("objective", "at_constant"), [("both", 2.0), ("image", 1.0), ("depth", 1.0)])
def test_scores_are_in_units_of_the_constant_guess(
    truth: Truth, tiny_capture: Any, objective: Any, at_constant: float
) -> None:
    score = Score(objective, truth.example, tiny_capture)
    assert score(score.constant) == pytest.approx(at_constant, rel=1e-12)
    # By NumPy: the depth error of guessing the mean everywhere is the spread within the scenes about it.
    depth_cm = truth.example.depth_m.numpy().astype(np.float64) * 100
    spread_cm = np.sqrt(((depth_cm - depth_cm.mean()) ** 2).mean(axis=(1, 2, 3))).mean()
    assert score.constant.depth_rmse_cm == pytest.approx(spread_cm, rel=1e-5)  # float32 on the way
    half = Errors(score.constant.psnr_db + 20 * np.log10(2), score.constant.depth_rmse_cm / 2)
    assert score(half) == pytest.approx(at_constant / 2, rel=1e-12)
    perfect = score.errors([Estimate(truth.image * 1.0, truth.disparity + 0.0)])
    assert score.objective == "image" or perfect.depth_rmse_cm < 1e-4
    broken = Estimate(truth.image * float("nan"), truth.disparity * float("nan"))
    assert score(score.errors([broken])) == float("inf")


def test_depth_counts_where_something_was_seen_as_in_evaluations(truth: Truth, tiny_capture: CaptureModel) -> None:
    valid = truth.example.valid.clone()
    valid[:, :, 2:5, 1:4] = False  # a patch that no surface covers
    valid[1] = False  # a scene of which nothing was seen
    example = truth.example._replace(valid=valid)
    score = Score("both", example, tiny_capture)
    wrong = torch.where(valid, truth.disparity, 1.0)
    assert score.errors([Estimate(truth.image, wrong)]).depth_rmse_cm < 1e-4  # float32 disparities
    guess = Estimate(truth.image * 0.5, (truth.disparity + 0.1).clamp(0, 1))
    found = score.errors([Estimate(*(values[:2] for values in guess)), Estimate(*(values[2:] for values in guess))])
    assert found.psnr_db == pytest.approx(float(psnr(guess.image, truth.image).mean()), rel=1e-6)
    by_evaluation = depth_scores(guess, example, tiny_capture, valid).depth_rmse_cm
    assert found.depth_rmse_cm == pytest.approx(float(by_evaluation.nanmean()), rel=1e-6)
    # The constant guess by NumPy: the mean depth of valid pixels, its error over them.
    depth_cm = np.where(valid.numpy(), truth.example.depth_m.numpy().astype(np.float64) * 100, np.nan)
    depth_cm = np.delete(depth_cm, 1, axis=0)
    spread_cm = np.sqrt(np.nanmean((depth_cm - np.nanmean(depth_cm)) ** 2, axis=(1, 2, 3))).mean()
    assert score.constant.depth_rmse_cm == pytest.approx(spread_cm, rel=1e-5)  # float32 on the way


def test_lines_and_table_say_when_nothing_was_learned(truth: Truth, score: Score, tmp_path: Path) -> None:
    lines: list[str] = []
    constant = {"psnr_db": score.constant.psnr_db, "depth_rmse_cm": score.constant.depth_rmse_cm}
    study = Study(tmp_path / "tuned.json", {}, {"constant_guess": constant})
    good = truth.tunable({"regularisation_lambda": 1e-2, "window": 1})

    class Guess:
        def volume(self, measurement: Tensor) -> Tensor:
            return measurement[:, :1, None]

        def estimate(self, volume: Tensor) -> Estimate:
            scenes = volume.flatten(1)[:, 0].long()
            return Estimate(torch.zeros(len(scenes), 3, 8, 8), truth.disparity[scenes])

    space = {"regularisation_lambda": Axis((1.0,), high=1)}
    image_only = Tunable("guess", lambda _: Guess(), {"regularisation_lambda": 1.0}, space, frozenset())
    tune([good, image_only], {40.0: truth.measurements()[40.0]}, score, study, say=lines.append)
    psnr_db, depth_cm = (f"{constant[name]:.2f}" for name in ("psnr_db", "depth_rmse_cm"))
    assert f"(constant guess {psnr_db}), depth RMSE" in lines[0]
    assert f" cm ({depth_cm}), score 0." in lines[0]
    assert "no better" not in lines[0]
    assert lines[1].endswith("; image no better than a constant guess; at its limit: regularisation_lambda")
    rows = table(load_tuned(tmp_path / "tuned.json").content).splitlines()
    assert [row.split()[0] for row in rows] == ["method", "fake", "guess", "constant"]
    assert rows[2].endswith("regularisation_lambda 1; " + lines[1].split("; ", 1)[1])
    assert rows[3].split()[-2:] == [psnr_db, depth_cm]


def test_searches_of_classical_methods_have_limits(tiny_capture: CaptureModel, tmp_path: Path) -> None:
    search = {"cls": {"regularisation_lambda": {"values": [1.0]}, "pairwise": {"high": 5000}}}
    config = load_file(TuneConfig, write_config(tmp_path, tmp_path, search=search))
    for name in ("cls", "admm", "pnp"):
        axes = classical(tiny_capture, name, config, torch.device("cpu")).space
        for parameter, axis in axes.items():
            assert not axis.is_number or np.isfinite(axis.high), parameter
        assert axes["window_px"].high == 8  # half of 16 pixels
    space = classical(tiny_capture, "cls", config, torch.device("cpu")).space
    assert (space["regularisation_lambda"].high, space["pairwise"].high) == (100, 5000)


def test_candidates_that_the_method_refuses_are_named_before_any_trial(
    tiny_capture: CaptureModel, tmp_path: Path
) -> None:
    path = write_config(tmp_path, tmp_path, methods=["pnp"])
    for parameter, values in (("prior", "[0, 0.1]"), ("iterations", "[1.5]"), ("light", "[dark]")):
        config = load_file(TuneConfig, path, [f"search.pnp.{parameter}={{values: {values}, low: 0}}"])
        with pytest.raises(InputError, match=rf"^search\.pnp\.{parameter}: "):
            classical(tiny_capture, "pnp", config, torch.device("cpu"))


def test_a_denoiser_of_ones_own_is_recorded_as_it_lies_from_the_result(
    tiny_capture: CaptureModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = {"filters": 4, "blocks": 1, "levels": 1}
    file = tmp_path / "denoiser"  # not the shipped one, whose name alone means it
    save_denoiser(file, Denoiser(**size), architecture={"network": "denoiser", **size}, record={})
    path = write_config(tmp_path, tmp_path, methods=["pnp"], output="a/tuned.json", denoiser="./denoiser")
    config = load_file(TuneConfig, path)
    monkeypatch.chdir(path.anchor)
    tunable = classical(tiny_capture, "pnp", config, torch.device("cpu"))
    method = tunable.build(tunable.defaults)
    assert isinstance(method, ClassicalMethod)
    prior = method._method.denoiser
    assert isinstance(prior, Denoiser)
    assert prior.state_dict().keys() == Denoiser(**size).state_dict().keys()
    (tmp_path / "a").mkdir()
    study = Study(tmp_path / "a" / "tuned.json", {}, {})
    study.add_result({"method": "pnp", "noise_db": 40.0, "parameters": tunable.defaults, "score": 1.0})
    assert not Path(str(tunable.defaults["denoiser"])).is_absolute()
    assert Path(str(load_tuned(study.path).parameters("pnp", 40)[0]["denoiser"])).samefile(file)
    shipped = classical(tiny_capture, "pnp", load_file(TuneConfig, path, ["denoiser=denoiser"]), torch.device("cpu"))
    assert shipped.defaults == DEFAULTS["pnp"]


def write_config(folder: Path, dataset: Path, **changes: Any) -> Path:
    """Write a file for the tiny data set."""
    data = {"validation": str(dataset), "scenes": 6, "allow_few_scenes": True} | changes.pop("data", {})
    path = folder / "tune.yaml"
    path.write_text(json.dumps({"data": data, "noise_db": [30], **changes}), encoding="utf-8")  # JSON is YAML
    return path


def test_a_file_is_tuned_on_noise_of_its_level_and_says_what_it_used(tiny_dataset: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, ...]] = []
    captures: list[CaptureModel] = []

    class Mean:
        def __init__(self, parameters: Parameters) -> None:
            self.level = float(parameters["level"])

        def volume(self, measurement: Tensor) -> Tensor:
            seen.append(tuple(measurement.shape))
            return measurement[:, None, :, :16, :16]

        def estimate(self, volume: Tensor) -> Estimate:
            image = torch.full((len(volume), 3, 16, 16), self.level)
            return Estimate(image, image[:, :1])

    def tunables(capture: CaptureModel) -> list[Tunable]:
        captures.append(capture)
        return [Tunable("mean", Mean, {"level": 0.5}, {"level": Axis((0.2, 0.5), high=1)}, frozenset())]

    file = write_config(tmp_path, tiny_dataset, output="a/tuned.json", data={"stack": "captured"})
    path = tune_file(load_file(TuneConfig, file), tunables=tunables)
    assert path == tmp_path / "a" / "tuned.json"
    content = load_tuned(path).content
    assert seen == [(1, 3, 48, 48)] * 6  # one volume of each scene, whatever the level of the guess
    assert content["about"]["scenes"] == 6
    assert content["about"]["fewer_scenes_than_advised"] is True
    assert content["identity"]["stack"] == captures[0].stack.fingerprint
    assert content["identity"]["white"] == captures[0].white != 1
    assert [result["noise_db"] for result in content["results"]] == [30]
    kept = load_manifest(tiny_dataset).entries
    digests = [kept["validation", sample].digest for sample in content["identity"]["samples"]]
    assert content["identity"]["digests"] == sha256_bytes(canonical_json(digests))
    assert len(content["identity"]["code"]) == 64
    assert content["identity"]["scenes"] == scenes_of(open_dataset(tiny_dataset, "validation"))
    with pytest.raises(InputError, match=r"tuned\.json: "):
        tune_file(load_file(TuneConfig, tmp_path / "tune.yaml", ["seed=3"]), tunables=tunables)


def test_noise_as_stored_is_a_level_too(tiny_dataset: Path, tmp_path: Path) -> None:
    seen: list[np.ndarray] = []

    class Sees:
        def __init__(self, parameters: Parameters) -> None:
            del parameters

        def volume(self, measurement: Tensor) -> Tensor:
            seen.append(measurement.numpy())
            return measurement[:, None, :, :16, :16]

        def estimate(self, volume: Tensor) -> Estimate:
            image = torch.full((len(volume), 3, 16, 16), 0.5)
            return Estimate(image, image[:, :1])

    def tunables(capture: CaptureModel) -> list[Tunable]:
        del capture
        return [Tunable("sees", Sees, {"level": 0.5}, {"level": Axis((0.5,), 0.5, 0.5)}, frozenset())]

    file = write_config(tmp_path, tiny_dataset, noise_db=["stored", 30], data={"scenes": 2})
    tuned = load_tuned(tune_file(load_file(TuneConfig, file), tunables=tunables))
    stored = open_dataset(tiny_dataset, "validation").spread(2)
    as_stored, other = np.concatenate(seen[:2]), np.concatenate(seen[2:])
    np.testing.assert_array_equal(as_stored, [stored.stored(position).measurement()[0] for position in range(2)])
    assert not np.array_equal(other, as_stored)
    low, high = tuned.levels_db("sees")
    assert low == 30.0
    assert 40.0 < high < 42.0  # noise of 40 dB, less what was clipped


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["data.scenes=4", "data.allow_few_scenes=false"], r"data\.scenes: "),
        (["data.scenes=9"], r"data\.scenes: "),
        (["methods=[wiener]"], r"methods\[0\]: "),
        (["search.admm.tv.values=[1.0]", "methods=[cls]"], r"search\.admm: "),
        (["objective=pretty"], "objective: "),
        (["noise_db=[-3]"], r"noise_db\[0\]: "),
        (["data.stack=nowhere"], "nowhere: "),
        (["data.validation=nowhere"], "nowhere: "),
        (["methods=[pnp]", "search.pnp.denoiser.values=[denoiser]"], r"search\.pnp\.denoiser: "),
        (
            ["methods=[fista]", "search.fista.initial_estimate.values=[joint, dark]"],
            r"search\.fista\.initial_estimate: ",
        ),
        (["methods=[pnp]", "denoiser=nowhere"], "^denoiser: "),
        (["methods=[cls]", "denoiser=nowhere"], "denoiser: only pnp"),
    ],
)
def test_files_that_make_no_sense_are_refused(tiny_dataset: Path, tmp_path: Path, overrides: Any, message: str) -> None:
    path = write_config(tmp_path, tiny_dataset)
    with pytest.raises(InputError, match=message):
        tune_file(load_file(TuneConfig, path, overrides), tunables=lambda _: [])
    assert not (tmp_path / "tuned.json").exists()


def test_clips_are_tuned_on_all_their_frames(clip_dataset: Path, tmp_path: Path) -> None:
    """The static inversion, repeated: by hand its PSNR and that of the one colour that is nearest to all frames."""
    searched = {"regularisation_lambda": {"values": [0.3]}, "tikhonov": {"values": [1.0]}}
    changes: dict[str, Any] = {"data": {"scenes": 2}, "methods": ["static"], "objective": "image"}
    file = write_config(tmp_path, clip_dataset, search={"static": searched}, noise_db=["stored"], **changes)
    path = tune_file(load_file(TuneConfig, file))
    validation = open_dataset(clip_dataset, "validation")
    white = measure_reference_white(open_dataset(clip_dataset, "train"))
    examples = ExampleSet(validation)
    batch = default_collate([examples[position] for position in range(2)])
    truth = linear_to_srgb(batch.radiance, white).double()
    assert truth.shape[1] == 4
    colour = truth.mean(dim=(0, 1, 3, 4), keepdim=True)
    parameters, _ = load_tuned(path).parameters("static", 40.0)
    method = build_method(capture_model(validation, white=white), "static", parameters)
    found = method.reconstruct(batch.measurement).clamped().image.double()
    by_hand = [float(-10 * (each - truth).square().mean(dim=(1, 2, 3, 4)).log10().mean()) for each in (found, colour)]
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["about"]["constant_guess"]["psnr_db"] == pytest.approx(by_hand[1], rel=1e-5)
    [result] = content["results"]
    assert result["psnr_db"] == pytest.approx(by_hand[0], rel=1e-5)


@pytest.mark.parametrize("clips", [True, False])
def test_a_method_for_other_data_is_refused_before_any_is_tuned(
    clip_dataset: Path, tiny_dataset: Path, tmp_path: Path, clips: bool
) -> None:
    methods = ["static", "cls"] if clips else ["cls", "joint"]
    changes: dict[str, Any] = {"data": {"scenes": 2}, "methods": methods, "objective": "image"}
    file = write_config(tmp_path, clip_dataset if clips else tiny_dataset, **changes)
    with pytest.raises(InputError, match=f"{methods[1]}: got"):
        tune_file(load_file(TuneConfig, file), progress=lambda *_: pytest.fail("tuned"))


def test_a_parameter_that_the_method_lacks_is_refused(truth: Truth) -> None:
    tunable = truth.tunable({"regularisation_lambda": 1.0, "window": 10})
    with pytest.raises(InputError, match=r"^search\.fake: "):
        Tunable("fake", tunable.build, tunable.defaults, {"tv": Axis((1.0,))}, frozenset())
