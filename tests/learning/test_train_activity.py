"""Training classifiers of clips: the loss, what they see, resuming, refusals; and that they learn what differs in time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from torchvision.models import resnet18
from torchvision.transforms.functional import normalize

from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.clip_examples import ClipExample
from learning.commands import train as command
from learning.config import ActivityLossConfig, ActivityTrainConfig, load_file, training_kind
from learning.evaluate.films import film_sheet
from learning.layers.classifiers import FrameClassifier
from learning.method import srgb_to_linear
from learning.models import build_network
from learning.models.activitynet import ActivityNet, ClassifierOutput
from learning.resume import BEST, LAST
from learning.simulate import Augmentation
from learning.train_activity import ActivityLoss, ActivityTraining, train_activity
from learning.validation import PREVIEW, read_metrics
from simulator.errors import InputError

pytestmark = pytest.mark.usefixtures("ctrl_c")
Settings = Callable[..., ActivityTrainConfig]
LENS = {"name": "lens_classifier"}


@pytest.fixture
def activity_settings(labelled_dataset: Path, tmp_path: Path) -> Settings:
    """Return a function that makes a small training; sections are changed key by key, a network as a whole."""

    def make(output: str = "out", **changes: Any) -> ActivityTrainConfig:
        data = {"train": str(labelled_dataset), "cache": str(tmp_path / "cache"), "workers": 0, "draws": 2}
        network = {"name": "activitynet", "size": "tiny", "filters": 4, "joint_iterations": 3}
        plain: dict[str, Any] = {"name": "tiny", "output": str(tmp_path / output), "seed": 3, "data": data}
        plain |= {"network": network, "device": "cpu"}
        plain |= {"steps": 6, "batch": 4, "validate_every": 3, "log_every": 2}
        for key, value in changes.items():
            merged = isinstance(value, dict) and key in plain and key != "network"
            plain[key] = plain[key] | value if merged else value
        return ActivityTrainConfig.model_validate(plain)

    return make


def test_the_loss_is_the_thesis_by_its_definition() -> None:
    """Weights 3 and 1; of two captures the cross entropies are -ln(0.7) and -ln(0.2)."""
    logits = torch.log(torch.tensor([[0.7, 0.2, 0.1], [0.5, 0.3, 0.2]]))
    measured = torch.full((2, 4, 3, 5, 5), 0.3)
    terms = ActivityLoss(ActivityLossConfig())(ClassifierOutput(logits, measured), torch.tensor([0, 2]), measured + 0.5)
    entropy = -(np.log(0.7) + np.log(0.2)) / 2
    assert float(terms["classes"]) == pytest.approx(entropy, rel=1e-6)
    assert float(terms["measurement"]) == pytest.approx(0.25, rel=1e-6)
    assert float(terms["total"]) == pytest.approx(3 * entropy + 0.25, rel=1e-6)
    without = ActivityLoss(ActivityLossConfig(class_weight=2))(
        ClassifierOutput(logits, torch.empty(0)), torch.tensor([0, 2]), measured
    )
    assert float(without["total"]) == pytest.approx(2 * entropy, rel=1e-6)
    assert "measurement" not in without


@pytest.mark.parametrize("network", [None, LENS, {"name": "raw_classifier"}], ids=["activitynet", "lens", "raw"])
def test_a_training_leaves_checkpoints_metrics_and_a_sheet(activity_settings: Settings, network: Any) -> None:
    config = activity_settings(**({} if network is None else {"network": network}))
    result = train_activity(config)
    known = load_checkpoint(result.folder / BEST)
    assert known.architecture["classes"] == ["leftwards", "rightwards"]
    assert known.network.classes == ("leftwards", "rightwards")
    assert known.architecture["classifier"] == "dronet"
    assert (result.folder / PREVIEW).stat().st_size > 1000
    validated = [line for line in read_metrics(result.folder) if line["kind"] == "validation"]
    assert [line["step"] for line in validated] == [3, 6]
    for line in validated:
        assert line["top_2"] == 1.0  # of two classes
        assert 0 <= line["top_1"] <= 1
        assert line["classes"] >= -line["score"] > 0  # cross entropies: at the best temperature, and at 1
    assert result.best["score"] == max(line["score"] for line in validated)
    assert float(known.network.classifier.temperature) == pytest.approx(result.best["temperature"], rel=1e-6) != 1
    assert known.record["loss"] == {"class_weight": 3.0, "measurement_weight": 1.0}


def test_the_preview_shows_clips_of_different_classes(
    activity_settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of four that take turns, the second and the fourth, evenly apart, would be of one class."""
    shown = []
    monkeypatch.setattr("learning.training_loop.SHOWN", 2)
    sheet = "learning.train_activity.film_sheet"
    monkeypatch.setattr(sheet, lambda clips, *words: shown.append(clips) or film_sheet(clips, *words))
    train_activity(activity_settings(network=LENS, steps=1))
    assert [[film.name for film in clip] for clip in shown[0]] == [["leftwards"], ["rightwards"]]


def test_the_temperature_is_that_of_the_validation_clips(
    activity_settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three of four right, each by a margin of 3 nats: 3 / T = ln 3, and the cross entropy is the entropy of (3/4, 1/4)."""
    forward = FrameClassifier.forward

    def answered(classifier: FrameClassifier, own: torch.Tensor, shared: torch.Tensor) -> torch.Tensor:
        if classifier.training:
            return forward(classifier, own, shared)
        guesses = torch.tensor([1, 0, 1, 1])  # of classes 1, 0, 1, 0
        return 3 * torch.nn.functional.one_hot(guesses, 2)[: len(own)].float() / classifier.temperature

    monkeypatch.setattr(FrameClassifier, "forward", answered)
    result = train_activity(activity_settings(network=LENS))
    surprise = -0.75 * np.log(0.75) - 0.25 * np.log(0.25)
    validated = [line for line in read_metrics(result.folder) if line["kind"] == "validation"]
    assert len(validated) == 2  # the second one does not begin with the temperature of the first
    for line in validated:
        assert line["top_1"] == 0.75
        assert line["temperature"] == pytest.approx(3 / np.log(3), rel=1e-4)
        assert line["score"] == pytest.approx(-surprise, rel=1e-6)
        assert line["classes"] == pytest.approx(np.log1p(np.exp(-3)) + 3 / 4, rel=1e-5)  # at a temperature of 1
    saved: Any = load_checkpoint(result.folder / BEST).network
    assert float(saved.classifier.temperature) == pytest.approx(3 / np.log(3), rel=1e-4)


def test_each_step_draws_anew_from_the_seed(activity_settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: dict[int, list[int]] = {}
    schedule = ActivityTraining._schedule

    def recorded(training: ActivityTraining) -> None:
        schedule(training)
        drawn.setdefault(training._config.seed, []).append(torch.initial_seed())

    monkeypatch.setattr(ActivityTraining, "_schedule", recorded)
    for seed in (3, 4):
        train_activity(activity_settings(str(seed), network=LENS, steps=3, seed=seed))
    assert len({*drawn[3], *drawn[4]}) == 6


@pytest.mark.slow
def test_a_resumed_training_is_the_same(activity_settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dropout and moved windows, too, follow from the seed and the step."""
    whole = train_activity(activity_settings("whole"))
    first = activity_settings("parts")
    step = ActivityTraining._step

    def stopped(training: ActivityTraining, wrapped: Any, batch: Any, stop: Any) -> bool:
        stop.wanted = training.progress.step == 1  # of 6, before statistics are frozen
        return step(training, wrapped, batch, stop)

    monkeypatch.setattr(ActivityTraining, "_step", stopped)
    with pytest.raises(KeyboardInterrupt):
        train_activity(first)
    monkeypatch.setattr(ActivityTraining, "_step", step)
    torch.manual_seed(99)
    again = train_activity(first)
    assert again.steps == 4
    one, other = (load_checkpoint(each.folder / LAST).network.state_dict() for each in (whole, again))
    for name, values in one.items():
        assert torch.equal(values, other[name]), name


def test_labels_go_with_their_clips_and_are_shuffled_for_learning_only(
    activity_settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    dealt: dict[tuple[str, bool], list[int]] = {}
    opened = ActivityTraining._open

    def spy(training: ActivityTraining, dataset: Any) -> Any:
        examples = opened(training, dataset)
        shuffled = training._config.data.shuffle_labels
        dealt[dataset.split, shuffled] = [int(examples[at].label) for at in range(len(examples))]
        return examples

    monkeypatch.setattr(ActivityTraining, "_open", spy)
    for shuffle in (False, True):
        train_activity(activity_settings(str(shuffle), network=LENS, steps=1, data={"shuffle_labels": shuffle}))
    assert dealt["train", False] == [1, 0] * 8
    assert dealt["validation", False] == dealt["validation", True] == [1, 0] * 2
    assert dealt["train", True] != dealt["train", False]
    assert sorted(dealt["train", True]) == [0] * 8 + [1] * 8


@pytest.mark.slow
def test_what_is_kept_is_shared_by_classifiers(activity_settings: Settings, tmp_path: Path) -> None:
    """All that look at frames or raw captures learn from the same draws; of another estimate there are others."""
    counts = []
    for number, network in enumerate(
        (
            LENS,
            LENS | {"classifier": "cnn3d"},
            {"name": "raw_classifier"},
            {"name": "activitynet", "size": "tiny", "filters": 4},
        )
    ):
        train_activity(activity_settings(str(number), network=network, steps=1, data={"noise_db": (30.0, 40.0)}))
        counts.append(len(list((tmp_path / "cache").glob("*.clips"))))
    assert counts == [2, 2, 2, 4]


def test_other_slivers_of_the_same_captures(activity_settings: Settings) -> None:
    result = train_activity(activity_settings(steps=1, data={"slivers": 2}))
    known = load_checkpoint(result.folder / LAST)
    assert known.capture.frames == 2
    assert isinstance(known.network, ActivityNet)
    with pytest.raises(InputError, match="slivers"):
        train_activity(activity_settings("odd", steps=1, data={"slivers": 3}))


def test_measnet_learns_what_a_global_shutter_would_measure(activity_settings: Settings) -> None:
    """By its definition: light less the offset."""
    config = activity_settings(steps=1)
    result = train_activity(config)
    network = load_checkpoint(result.folder / LAST).network
    assert isinstance(network, ActivityNet)
    training = ActivityTraining.__new__(ActivityTraining)
    training._network, training._loss = network, ActivityLoss(ActivityLossConfig())
    offset = network.inversion.offset.fill_(0.02)  # of this camera it is 0
    truth = torch.rand(1, 4, 3, 48, 48)
    example = ClipExample(torch.zeros(0), torch.zeros(0), torch.zeros(0), truth + offset, torch.tensor([1]))
    terms = training._losses(ClassifierOutput(torch.zeros(1, 2), truth), example)
    assert float(terms["measurement"]) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"data": {"augment": Augmentation()}}, "data.augment.reverse"),
        ({"data": {"augment": Augmentation(reverse=False, still=0.1)}}, "data.augment.still"),
        ({"network": LENS, "init_from": "videonet"}, "init_from"),
        ({"loss": {"class_weight": 0}}, "loss.class_weight"),
        ({"network": {"name": "raw_classifier", "classifier": "x3d"}}, "network.raw_classifier.classifier"),
        ({"network": LENS, "batch": 1}, "batch"),
    ],
)
def test_what_makes_no_sense_is_refused(activity_settings: Settings, changes: dict[str, Any], key: str) -> None:
    with pytest.raises(ValidationError) as caught:
        activity_settings(**changes)
    (found,) = caught.value.errors()
    assert ".".join(map(str, (*found["loc"], *found.get("ctx", {}).get("at", ())))) == key


def test_mirrors_are_refused_where_a_class_has_a_side(
    activity_settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    mirrored = activity_settings(data={"augment": Augmentation(reverse=False)}, steps=1)
    with pytest.raises(InputError, match=r"data\.augment\.flip.*leftwards"):
        train_activity(mirrored)
    monkeypatch.setattr(
        "learning.train_activity.class_numbers", lambda dataset, _: [at % 2 for at in range(len(dataset))]
    )
    known = "learning.train_activity.class_names"
    for sided in ("moving_left", "Turning it upside down", "picking_up", "anticlockwise", "Turning counter-clockwise"):
        monkeypatch.setattr(known, lambda _, sided=sided: ("towards", sided))
        with pytest.raises(InputError, match=rf"data\.augment\.flip.*{sided}"):
            train_activity(mirrored)
    monkeypatch.setattr(known, lambda _: ("showing a clock", "showing a bright upright cup and leftovers"))
    train_activity(mirrored)


@pytest.mark.parametrize(
    ("network", "key"),
    [
        ({"size": "compact", "filters": 64}, "filters: got 64, but a network without MeasNet"),
        ({"initial_estimate": "slivers", "joint_noise": 2}, "joint_noise: got 2.0, but a network without joint least"),
    ],
)
def test_numbers_of_what_a_network_lacks_are_refused(
    activity_settings: Settings, network: dict[str, Any], key: str
) -> None:
    with pytest.raises(InputError, match=rf"network\.{key}"):
        train_activity(activity_settings(steps=1, network={"name": "activitynet"} | network))


def test_data_in_which_nothing_is_done_are_refused(
    activity_settings: Settings, clip_dataset: Path, labelled_stills: Path
) -> None:
    with pytest.raises(InputError, match="no label"):
        train_activity(activity_settings(data={"train": str(clip_dataset)}))
    with pytest.raises(InputError, match="no label"):
        train_activity(activity_settings(data={"validation": str(clip_dataset)}))
    with pytest.raises(InputError, match="holds stills, in which nothing is done; take clips"):
        train_activity(activity_settings(data={"train": str(labelled_stills)}))


def test_it_begins_with_a_videonet(activity_settings: Settings, tmp_path: Path, labelled_dataset: Path) -> None:
    first = train_activity(activity_settings("camera", steps=1))
    capture = load_checkpoint(first.folder / LAST).capture
    torch.manual_seed(8)
    network = build_network(capture, "videonet", "tiny", filters=4, joint_iterations=3)
    path = tmp_path / "video.safetensors"
    architecture = {"network": "videonet", "size": "tiny", "filters": 4, "joint_iterations": 3}
    save_checkpoint(path, network, architecture=architecture, capture=capture, record={})
    slow = {"learning_rate": 1e-9, "warm_up": 0.0}
    result = train_activity(activity_settings(steps=1, init_from=str(path), optimiser=slow))
    found = load_checkpoint(result.folder / LAST).network.state_dict()
    for name, value in network.state_dict().items():
        if name.startswith("measnet."):
            torch.testing.assert_close(found[name], value, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_it_begins_with_one_for_other_classes(activity_settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """All but the last layer is taken; of one for the same classes, that too."""
    path = train_activity(activity_settings("known", steps=1)).folder / LAST
    known: Any = load_checkpoint(path).network
    last = {f"classifier.{name}" for name in known.classifier.last_layer}
    assert len(last) == 2
    slow = {"learning_rate": 1e-9, "warm_up": 0.0, "freeze_statistics": 0.0}
    for name, classes in (("same", None), ("other", ("a", "b", "c"))):
        if classes:
            monkeypatch.setattr("learning.train_activity.class_names", lambda _, classes=classes: classes)
            monkeypatch.setattr("learning.train_activity.class_numbers", lambda dataset, _: [0] * len(dataset))
        settings = activity_settings(name, steps=1, init_from=str(path), optimiser=slow)
        found = load_checkpoint(train_activity(settings).folder / LAST).network.state_dict()
        for key, value in known.state_dict().items():
            if key != "classifier.temperature" and (key not in last or not classes):
                torch.testing.assert_close(found[key], value, rtol=0, atol=1e-6)
        assert len(found[max(last)]) == len(classes or known.classes)


@pytest.mark.slow
def test_a_lens_classifier_begins_with_weights_of_torchvision(
    activity_settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It sees what torchvision's network sees in the mean of the frames, normalised as its documentation says."""
    torch.manual_seed(3)
    known = resnet18()
    path = tmp_path / "resnet18.pth"
    torch.save(known.state_dict(), path)
    slow = {"learning_rate": 1e-9, "warm_up": 0.0, "freeze_statistics": 0.0}
    network = LENS | {"classifier": "resnet18"}
    result = train_activity(activity_settings(steps=1, network=network, init_from=str(path), optimiser=slow))
    found = load_checkpoint(result.folder / LAST)
    assert found.record["init_from"]["file"] == "resnet18.pth"
    lens: Any = found.network.eval()
    lens.classifier.body.fc = known.fc = torch.nn.Identity()
    lens.classifier.temperature.fill_(1)
    frames = torch.rand(2, 4, 3, 32, 32)
    with torch.no_grad():
        mean = normalize(frames.mean(dim=1), [0.485, 0.456, 0.406], [0.229, 0.224, 0.225])
        features = lens(srgb_to_linear(frames, lens.white)).logits, known.eval()(mean)
    torch.testing.assert_close(*features, rtol=1e-3, atol=1e-3)  # the scaling adds 1e-5 to variances of 0.05
    assert features[1].std() > 0.1

    (tmp_path / "other.pth").write_bytes(b"no weights")
    torch.save({"conv1.weight": torch.zeros(64, 3, 5, 5)}, tmp_path / "small.pth")
    for name in ("other.pth", "small.pth", "missing.pth"):
        with pytest.raises(InputError, match=rf"{name}[:;] .*resnet18-f37072fd.pth"):
            train_activity(activity_settings("bad", steps=1, network=network, init_from=str(tmp_path / name)))


def test_the_command_names_the_kind_of_training(labelled_dataset: Path, tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "lens.yaml"
    content = {
        "name": "lens",
        "output": "lens",
        "data": {"train": str(labelled_dataset), "cache": False, "workers": 0, "draws": 0},
        "network": LENS,
        "steps": 2,
        "batch": 4,
    }
    path.write_text(json.dumps(content))
    assert isinstance(load_file(training_kind, path), ActivityTrainConfig)
    assert load_file(training_kind, path).optimiser.learning_rate == 3e-4
    command(path)
    told = capsys.readouterr().out
    assert "top-1 " in told
    assert "validation.png" in told


@pytest.mark.slow
def test_what_differs_in_time_alone_is_learned_from_a_capture(
    make_learning_trial: Any, clip_settings: dict[str, dict[str, Any]], tmp_path: Path
) -> None:
    """Whether things move to the left or right: a rolling capture tells, one frame or dealt labels do not."""
    counts = {"train": 400, "validation": 80, "test": 0}
    scene = clip_settings["scene"] | {"labelled": True, "speed": 2}
    dataset = clip_settings["dataset"] | counts
    root = make_learning_trial(tmp_path).generate(**clip_settings | {"dataset": dataset, "scene": scene})
    right = {}
    sees = {"name": "activitynet", "joint_iterations": 10, "classifier": "cnn3d"}
    for name, network, more in (
        ("capture", sees, {}),
        ("frame", {"name": "lens_classifier", "frames": "middle"}, {}),
        ("dealt", sees, {"shuffle_labels": True}),
    ):
        data = {"train": str(root), "cache": str(tmp_path / "cache"), "workers": 0, "draws": 1} | more
        plain = {"name": name, "output": str(tmp_path / name), "data": data, "network": network, "device": "cpu"}
        plain |= {"steps": 240, "batch": 16, "validate_every": 240, "optimiser": {"learning_rate": 1e-3}}
        right[name] = train_activity(ActivityTrainConfig.model_validate(plain)).best["top_1"]
    # Of 80 clips, chance is 0.5 +- 0.056.
    assert right["capture"] > 0.75
    assert abs(right["frame"] - 0.5) < 0.2
    assert abs(right["dealt"] - 0.5) < 0.2
