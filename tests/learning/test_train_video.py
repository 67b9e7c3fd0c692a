"""Training a VideoNet: it learns, goes on as if it had never stopped, and says what is wrong."""

from __future__ import annotations

import itertools
import json
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.camera import CaptureModel, capture_model
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.clip_examples import ClipExample, _InitialEstimate
from learning.commands import train as command
from learning.config import TrainConfig, VideoTrainConfig, load_file, training_kind
from learning.data import ExampleSet
from learning.distributed import Processes, processes
from learning.method import linear_to_srgb
from learning.models import build_network
from learning.models.videonet import Film, VideoNet
from learning.resume import BEST, DESCRIPTION, LAST, STATE
from learning.simulate import Augmentation
from learning.timing import Timing
from learning.train import train
from learning.train_video import VideoTraining, train_video
from learning.validation import METRICS, PREVIEW
from simulator.camera.shutter import RowShutter
from simulator.dataset import open_dataset
from simulator.dataset.reader import Dataset
from simulator.errors import InputError

pytestmark = pytest.mark.usefixtures("ctrl_c")
Settings = Callable[..., VideoTrainConfig]

SMALL: dict[str, Any] = {"filters": 4, "joint_iterations": 3}


@pytest.fixture
def video_settings(clip_dataset: Path, tmp_path: Path) -> Settings:
    """Return a function that makes a small training; sections are changed key by key."""

    def make(output: str = "out", **changes: Any) -> VideoTrainConfig:
        data = {"train": str(clip_dataset), "cache": str(tmp_path / "cache"), "workers": 0, "draws": 2}
        plain: dict[str, Any] = {"name": "tiny", "output": str(tmp_path / output), "seed": 3, "data": data}
        plain |= {"network": {"name": "videonet", "size": "tiny", **SMALL}, "device": "cpu"}
        plain |= {"steps": 8, "batch": 3, "validate_every": 3, "log_every": 2}
        for key, value in changes.items():
            plain[key] = plain[key] | value if isinstance(value, dict) and key in plain else value
        return VideoTrainConfig.model_validate(plain)

    return make


def test_clips_are_changed_to_learn_from_and_not_to_validate_on(
    video_settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: dict[str, Augmentation | None] = {}

    def spy(dataset: Dataset, **options: Any) -> ExampleSet:
        opened[dataset.split] = options["augment"]
        return ExampleSet(dataset, **options)

    monkeypatch.setattr("learning.clip_examples.ExampleSet", spy)
    train_video(video_settings(steps=1, data={"augment": Augmentation(colour=0.1)}))
    assert opened == {"train": Augmentation(colour=0.1), "validation": None}


def lines(folder: Path, kind: str) -> list[dict[str, Any]]:
    """Return the log's numbers that do not measure time."""
    found = [json.loads(line) for line in (folder / METRICS).read_text().splitlines()]
    return [line | {"samples_per_second": None} for line in found if line["kind"] == kind]


@pytest.mark.slow
@pytest.mark.parametrize(("start", "share", "better_db"), [("joint", 0.97, 0.3), ("slivers", 0.9, 1.0)])
def test_learns_and_leaves_what_belongs_to_it(
    video_settings: Settings, clip_dataset: Path, start: str, share: float, better_db: float
) -> None:
    network = {"initial_estimate": start}
    idle = train_video(video_settings("idle", steps=1, network=network, optimiser={"learning_rate": 1e-9}))
    changes: dict[str, Any] = {"optimiser": {"learning_rate": 5e-3}, "loss": {"change_weight": 0.5}, "network": network}
    result = train_video(video_settings(steps=40, log_every=10, validate_every=20, **changes))
    trained, validated = (lines(result.folder, kind) for kind in ("train", "validation"))
    # Eight clips of random textures: little of them can be known from the other ones.
    assert trained[-1]["intensity"] < 0.95 * trained[0]["intensity"]
    assert validated[-1]["intensity"] < share * idle.best["intensity"]
    assert validated[-1]["psnr_db"] > idle.best["psnr_db"] + better_db
    terms = ("measurement", "intensity", "change")
    assert trained[-1]["total"] == pytest.approx(sum(trained[-1][f"{name}_weighted"] for name in terms), rel=1e-5)
    for line in validated:
        assert line["score"] == pytest.approx((line["psnr_db"] + line["moving_psnr_db"]) / 2, rel=1e-9)
    files = {BEST, LAST, DESCRIPTION, METRICS, PREVIEW, STATE, "tensorboard"}
    assert {path.name for path in result.folder.iterdir()} == files

    best = load_checkpoint(result.folder / BEST, network="videonet")
    assert best.record["step"] == result.best["step"]
    assert best.record["data sets"]["train"]["samples"] == 8
    assert best.record["loss"]["change_weight"] == 0.5
    validation = open_dataset(clip_dataset, "validation")
    capture = capture_model(validation, white=best.capture.white)
    assert best.capture.timing is not None
    assert capture.timing is not None
    best.capture.timing.check_same(capture.timing, 48)
    # What was logged, from the file, clip by clip in NumPy
    psnrs, moving = [], []
    for measurement, radiance, *_ in ExampleSet(validation):
        with torch.no_grad():
            found = best.network(measurement[None]).image[0].double().numpy().clip(0, 1)
        truth = linear_to_srgb(radiance.double(), capture.white).numpy()
        moves = np.abs(truth - truth.mean(axis=0)).max(axis=(0, 1)) > 0.1
        assert moves.any()
        psnrs.append(-10 * np.log10(np.mean((found - truth) ** 2)))
        moving.append(-10 * np.log10(np.mean((found - truth)[..., moves] ** 2)))
    # What validation begins with is kept in half precision
    assert result.best["psnr_db"] == pytest.approx(np.mean(psnrs), abs=0.02)
    assert result.best["moving_psnr_db"] == pytest.approx(np.mean(moving), abs=0.02)


def test_a_checkpoint_for_other_times_is_refused_by_its_name(video_settings: Settings) -> None:
    folder = train_video(video_settings(steps=1)).folder
    capture = load_checkpoint(folder / LAST).capture
    assert capture.timing is not None
    later = replace(capture, timing=Timing(capture.timing.shutter, capture.timing.frame_edges_s * 1.1))
    with pytest.raises(InputError, match=r"last\.safetensors: frame_edges_s"):
        load_checkpoint(folder / LAST, capture=later)


@pytest.mark.slow
@pytest.mark.parametrize(("body", "augment"), [("naf", Augmentation()), ("unet", None)])
@pytest.mark.slow
def test_goes_on_as_if_it_had_never_stopped(
    video_settings: Settings, augment: Augmentation | None, body: str, tmp_path: Path
) -> None:
    """Bit by bit, on one thread; with another cache, and a process that reads."""

    def stop(stage: str, done: int, total: int) -> None:
        if done == 4:
            signal.raise_signal(signal.SIGINT)

    data: dict[str, Any] = {"augment": augment, "noise_db": (25.0, 35.0)}
    network = {"body": body}
    whole = video_settings("whole", data=data, network=network)
    other = data | {"cache": str(tmp_path / "other"), "workers": 1}
    parts = video_settings("parts", data=other, network=network)
    train_video(whole)
    with pytest.raises(KeyboardInterrupt):
        train_video(parts, progress=stop)
    assert train_video(parts).steps == 4
    one, two = Path(whole.output), Path(parts.output)
    for kind in ("train", "validation"):
        assert lines(one, kind) == lines(two, kind)
    for name in (BEST, LAST):
        expected, found = (load_checkpoint(folder / name).network.state_dict() for folder in (one, two))
        assert all(torch.equal(expected[key], found[key]) for key in expected)
    expected, found = (torch.load(folder / STATE, weights_only=True)["optimiser"]["state"] for folder in (one, two))
    assert len(expected) > 10
    for key, values in expected.items():
        assert all(torch.equal(values[name], found[key][name]) for name in values)


def test_another_configuration_is_refused(video_settings: Settings) -> None:
    train_video(video_settings(steps=1))
    for changes in ({"loss": {"change_weight": 0.1}}, {"network": {"joint_iterations": 4}}, {"data": {"draws": 3}}):
        with pytest.raises(InputError, match=r"^output: "):
            train_video(video_settings(steps=2, **changes))
    assert train_video(video_settings(steps=2, data={"workers": 1, "cache": False})).steps == 1


@pytest.mark.slow
@pytest.mark.parametrize("data", [{"augment": Augmentation()}, {"noise_db": (20.0, 50.0)}], ids=["changed", "noise"])
@pytest.mark.slow
def test_seeds_share_what_is_kept(
    video_settings: Settings, data: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of clips that are drawn a fixed number of times; the joint estimate is worked out by the first training only."""
    calls = []
    begin = _InitialEstimate.__call__
    monkeypatch.setattr(_InitialEstimate, "__call__", lambda self, given: calls.append(1) or begin(self, given))
    counts = []
    for seed in (1, 2):
        train_video(video_settings(str(seed), seed=seed, steps=9, data=data))
        counts.append(len(calls))
        calls.clear()
    # 9 batches of 3 are both draws of 8 clips, and more; 2 clips of validation; and one of each to see its shape.
    assert counts == [8 * 2 + 2 + 2, 2]
    assert len(list((tmp_path / "cache").glob("*.clips"))) == 2


@pytest.mark.parametrize(
    ("changes", "files"),
    [
        ({}, 0),
        ({"network": {"joint_iterations": 4}}, 2),
        pytest.param({"data": {"noise_db": (20.0, 40.0)}}, 2, marks=pytest.mark.slow),
        ({"data": {"augment": Augmentation(colour=0.3)}}, 1),  # clips to validate on are never changed
        pytest.param({"data": {"draws": 3}}, 2, marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_what_is_kept_is_of_the_same_estimate_noise_and_changes(
    video_settings: Settings, tmp_path: Path, changes: dict[str, Any], files: int
) -> None:
    data = {"augment": Augmentation(), "noise_db": (30.0, 40.0)}
    train_video(video_settings("first", steps=1, data=data))
    before = set((tmp_path / "cache").glob("*.clips"))
    train_video(video_settings("second", steps=1, **changes | {"data": data | changes.get("data", {})}))
    assert len(before) == 2
    assert len(set((tmp_path / "cache").glob("*.clips")) - before) == files


@pytest.mark.filterwarnings("ignore:'pin_memory' argument is set")
def test_a_gpu_works_out_all_that_is_left_before_the_first_step(
    video_settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The workers then have nothing left to compute, and read what they would have found: on a CPU the same bits."""
    config = video_settings(steps=6, data={"augment": Augmentation(), "draws": 3})
    with processes("cpu") as group:
        plan = VideoTraining.plan(config, group)

        def built(say: Any) -> VideoTraining:
            training = VideoTraining(plan, say, lambda _: None)
            training.progress.step = 2
            return training

        def read(training: VideoTraining) -> list[ClipExample]:
            train, validation = training._loaders()
            return [*itertools.islice(train, 4), *validation]

        wanted = read(built(lambda *_: None))
        shutil.rmtree(config.resolve_path(str(config.data.cache)))
        shown = []
        training = built(lambda *call: shown.append(call))
        monkeypatch.setattr(Processes, "on_cuda", True)
        training.estimate_ahead()
        monkeypatch.setattr(_InitialEstimate, "__call__", None)
        found = read(training)
    for one, other in zip(found, wanted, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))
    # Four batches of 3 are left, other versions each, and validation has 2 clips
    assert shown == [("first estimates", done, 14) for done in (3, 6, 9, 12, 14)]


def test_what_a_network_begins_with_is_given_without_the_network(clip_capture: CaptureModel) -> None:
    """A copy: the network's own may be moved to a GPU, where other processes cannot follow."""
    network = build_network(clip_capture, "videonet", "tiny", **SMALL)
    measurement = torch.rand(1, 3, 48, 48)
    wanted = network.initial_estimate(measurement)
    begin = _InitialEstimate(network.joint)
    network.to("meta")
    found = begin(measurement)
    assert wanted is not None
    assert found is not None
    assert torch.equal(found, wanted)
    assert _InitialEstimate(None)(measurement) is None


def test_fine_tuning_begins_with_a_checkpoint(video_settings: Settings) -> None:
    first = train_video(video_settings("first", steps=3)).folder / LAST
    slow = {"learning_rate": 1e-9, "warm_up": 0.0}
    said: list[str] = []
    config = video_settings("tuned", init_from=str(first), steps=1, optimiser=slow, seed=9)
    tuned = train_video(config, say=said.append).folder / LAST
    before, after = (load_checkpoint(path).network for path in (first, tuned))
    for (name, one), other in zip(before.named_parameters(), after.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=2e-8, msg=name)  # the inversion's is ten times the rate
    count = len(before.state_dict())
    assert f"last.safetensors: copied {count} of {count} tensors" in said
    with pytest.raises(InputError, match=r"last\.safetensors: "):
        train_video(video_settings("other", init_from=str(first), steps=1, network={"filters": 6}))


@pytest.mark.parametrize("uneven", [False, True])
def test_measnet_learns_what_a_global_shutter_would_measure(clip_capture: CaptureModel, uneven: bool) -> None:
    """Nothing is left to learn for what it completes from the true frames, also where rows differ in exposure."""
    capture = clip_capture
    if uneven:
        opens_s = np.linspace(0, 1e-3, 48)
        shutter = RowShutter(np.stack([opens_s, opens_s + np.linspace(3e-3, 14e-3, 48)], axis=-1))
        exposures = shutter.exposures_s(48)[::-1]
        capture = replace(
            capture, timing=Timing(shutter, np.arange(5) * 4e-3), row_exposure=exposures / exposures.mean()
        )
    radiance = np.random.default_rng(0).random((4, 3, 16, 16))
    light = np.einsum("ca,nahw->nchw", capture.scene_to_camera, radiance)
    exposed = (
        capture.gain * np.ones((48, 1))
        if capture.row_exposure is None
        else capture.gain * capture.row_exposure[:, None]
    )
    model = capture.forward_model(np.zeros(1))
    seen = np.stack([exposed * model.forward((frame * capture.irradiance)[None, None]) for frame in light])
    measured = torch.from_numpy(seen + capture.offset[:, None, None]).float()[None]
    training: Any = object.__new__(VideoTraining)
    training._network, training._capture = build_network(capture, "videonet", "tiny", **SMALL), capture
    given: list[torch.Tensor] = []
    training._loss = lambda film, image, measured: given.append(measured) or {}
    with torch.no_grad():
        start = torch.from_numpy(light / capture.white).float()[None]
        film = training._network(torch.rand(1, 3, 48, 48), start)
    light, nothing = torch.from_numpy(radiance).float()[None], torch.empty(0)
    training._losses(film, ClipExample(torch.zeros(1), light, start, measured, nothing))
    # float32
    torch.testing.assert_close(film.measured, given[0], rtol=0, atol=1e-5 * float(given[0].max()))


def test_validation_counts_clips_that_move(video_settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clip in which nothing moves has no PSNR of moving pixels, and spoils none."""
    errors: list[dict[str, torch.Tensor]] = []
    known = VideoTraining._errors

    def first_stands_still(*given: Any) -> dict[str, torch.Tensor]:
        found = known(*given)
        found["moving_psnr_db"][0] = float("nan")
        errors.append(found)
        return found

    monkeypatch.setattr(VideoTraining, "_errors", first_stands_still)
    result = train_video(video_settings(steps=1))
    (found,) = errors
    assert result.best["moving_psnr_db"] == pytest.approx(found["moving_psnr_db"][1].item(), rel=1e-6)
    assert result.best["psnr_db"] == pytest.approx(found["psnr_db"].mean().item(), rel=1e-6)

    def all_stand_still(*given: Any) -> dict[str, torch.Tensor]:
        found = known(*given)
        return found | {"moving_psnr_db": torch.full_like(found["moving_psnr_db"], float("nan"))}

    monkeypatch.setattr(VideoTraining, "_errors", all_stand_still)
    still = train_video(video_settings("still", steps=1)).best
    assert "moving_psnr_db" not in still
    assert still["score"] == still["psnr_db"]


def test_what_is_equal_has_100_db(clip_dataset: Path) -> None:
    dataset = open_dataset(clip_dataset, "validation")
    capture = capture_model(dataset, white=1.5)
    measurement, radiance, *_ = (each[None] for each in ExampleSet(dataset)[0])
    example = ClipExample(measurement, radiance, *[torch.empty(0)] * 3)
    training: Any = object.__new__(VideoTraining)
    training._capture = capture
    found = training._errors(Film(linear_to_srgb(radiance, capture.white), torch.empty(0)), example)
    assert {name: values.tolist() for name, values in found.items()} == {"psnr_db": [100], "moving_psnr_db": [100]}


@pytest.mark.parametrize(("measnet", "first"), [(True, "wiener"), (False, "inversion")])
def test_p_and_lambda_learn_faster_and_nothing_else(video_settings: Settings, measnet: bool, first: str) -> None:
    """Adam's first step changes every number that has a gradient, the first inversion's at least, by the learning rate."""
    network = {"initial_estimate": "slivers", "measnet": measnet}

    def trained(rate: float) -> dict[str, torch.Tensor]:
        optimiser = {"schedule": "constant", "warm_up": 0.0, "inversion_rate": 10.0, "learning_rate": rate}
        folder = train_video(video_settings(f"{rate}", steps=1, network=network, optimiser=optimiser)).folder
        return dict(load_checkpoint(folder / LAST).network.named_parameters())

    begun, ended = trained(1e-9), trained(1e-3)
    steps = {name: (value - begun[name]).abs().max().item() for name, value in ended.items()}
    for name, step in steps.items():
        assert step == 0 or step == pytest.approx(1e-2 if name.startswith("inversion.") else 1e-3, rel=0.01), name
    assert any(step for name, step in steps.items() if name.startswith(f"{first}."))


@pytest.mark.parametrize(("share", "moved"), [(0.5, 2), (0.0, 0)])
def test_batch_statistics_stay_after_their_share_of_the_steps(
    video_settings: Settings, share: float, moved: int
) -> None:
    given: dict[str, Any] = {"network": {"body": "unet"}, "optimiser": {"freeze_statistics": share}}
    found = load_checkpoint(train_video(video_settings(steps=4, **given)).folder / LAST).network.state_dict()
    assert {int(value) for name, value in found.items() if name.endswith("num_batches_tracked")} == {moved}


@pytest.mark.parametrize(
    "network",
    [
        {"initial_estimate": "slivers", "measnet": True, "body": "unet", "refinements": 0, "noise_aware": False},
        {"initial_estimate": "static", "measnet": False, "dimensions": 3},
    ],
)
def test_other_architectures_train_too(video_settings: Settings, network: dict[str, Any]) -> None:
    result = train_video(video_settings(steps=2, network=network, loss={"intensity": "mse", "multiscale_weight": 1.0}))
    architecture = load_checkpoint(result.folder / LAST).architecture
    assert architecture.items() >= network.items()
    assert ("measurement" in result.best) == network["measnet"]
    assert result.best["multiscale"] > 0


def test_stills_for_a_videonet_and_clips_for_a_flatnet_are_refused(
    video_settings: Settings, learning_trial: Any, clip_dataset: Path
) -> None:
    counts = {"train": 1, "validation": 1, "test": 0}
    stills = learning_trial.generate(dataset=counts, psf={"as_captured": None})
    config = video_settings("stills", data={"train": str(stills)})
    with pytest.raises(InputError, match=r"^capture: "):
        train_video(config)
    plain = config.dump() | {"network": {"name": "flatnet3d", "size": "tiny"}, "loss": {}}
    plain["data"] = {"train": str(clip_dataset), "cache": False, "workers": 0}
    with pytest.raises(InputError, match=r"^capture: "):
        train(TrainConfig.model_validate(plain))
    assert not Path(config.output).exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"slivers": 2}, r"^data\.validation: .*slivers: got 2, .*4"),
        ({"order": "centre_out"}, r"^data\.validation: .*shutter: "),
    ],
)
def test_validation_through_another_shutter_is_refused(
    clip_dataset: Path, tmp_path: Path, video_settings: Settings, changes: dict[str, Any], message: str
) -> None:
    other = tmp_path / "other"
    shutil.copytree(clip_dataset, other)
    description = json.loads((other / "dataset.json").read_bytes())
    description["time"] |= {key: value for key, value in changes.items() if key == "slivers"}
    description["time"]["shutter"] |= {key: value for key, value in changes.items() if key == "order"}
    (other / "dataset.json").write_text(json.dumps(description), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        train_video(video_settings(data={"validation": str(other)}))


def test_clips_of_slivers_alone_cannot_be_changed(clip_dataset: Path, tmp_path: Path) -> None:
    """Within a sliver, nothing that was stored moves."""
    other = tmp_path / "other"
    shutil.copytree(clip_dataset, other)
    description = json.loads((other / "dataset.json").read_bytes())
    assert description["time"]["ground_truth"] == "frames"
    description["time"]["ground_truth"] = "slivers"
    (other / "dataset.json").write_text(json.dumps(description), encoding="utf-8")
    with pytest.raises(InputError, match=r"^data\.augment: .*dataset\.ground_truth: frames"):
        ExampleSet(open_dataset(other, "train"), augment=Augmentation())


def test_the_file_says_which_training_it_is(
    clip_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "video.yaml"
    data = f"{{train: {clip_dataset}, cache: false, workers: 0}}"
    network = "{name: videonet, size: tiny, filters: 4, joint_iterations: 2}"
    file.write_text(
        f"name: tiny\noutput: out\ndata: {data}\nnetwork: {network}\nsteps: 2\nbatch: 2\n", encoding="utf-8"
    )
    assert isinstance(load_file(training_kind, file), VideoTrainConfig)
    assert training_kind({"network": {"name": "flatnet2d"}}) is TrainConfig
    assert training_kind({}) is training_kind({"network": "videonet"}) is TrainConfig
    with pytest.raises(
        InputError, match=r"^network\.name: got 'VideoNet', expected one of flatnet3d, flatnet2d, videonet"
    ):
        training_kind({"network": {"name": "VideoNet"}})
    command(file, ["network.filters=5"])
    out = capsys.readouterr().out
    assert "of moving pixels" in out
    made = tmp_path / "out" / BEST
    assert str(made) in out
    checkpoint = load_checkpoint(made)
    assert isinstance(checkpoint.network, VideoNet)
    assert checkpoint.architecture["filters"] == 5
    assert checkpoint.record["command"].startswith("flatlight train video.yaml --set network.filters=5")
    with pytest.raises(InputError, match="attention"):  # which a FlatNet has
        load_file(training_kind, file, ["network.attention=true"])


def test_a_flatnet_gives_its_inside(video_settings: Settings, tiny_capture: CaptureModel, tmp_path: Path) -> None:
    sizes = {"filters": 8, "levels": 2}
    known, architecture = tmp_path / "flat.safetensors", {"network": "flatnet2d", "size": "tiny", **sizes}
    network = build_network(tiny_capture, "flatnet2d", "tiny", **sizes)
    save_checkpoint(
        known, network, architecture=architecture, capture=tiny_capture, record={"scenes": {"train": ["x"]}}
    )
    said: list[str] = []
    slow = {"learning_rate": 1e-9, "warm_up": 0.0}
    config = video_settings("video", steps=1, init_from=str(known), network=sizes, optimiser=slow)
    checkpoint = load_checkpoint(train_video(config, say=said.append).folder / LAST)
    (line,) = [line for line in said if "copied" in line]
    assert line.startswith("flat.safetensors: copied ")
    assert checkpoint.record["init_from"]["architecture"]["network"] == "flatnet2d"
    assert checkpoint.record["init_from"]["scenes"] == {"train": ["x"]}
    name = "shrink.0.weight"
    taken, given = (
        checkpoint.network.state_dict()[f"enhancement.body.{name}"],
        network.state_dict()[f"enhancement.{name}"],
    )
    torch.testing.assert_close(taken, given, rtol=0, atol=2e-9)
