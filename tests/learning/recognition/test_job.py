"""Evaluating classifiers from the file to the report: what is in it, what is kept, and what is refused."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from learning.camera import CaptureModel, capture_model, measure_reference_white
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.commands import evaluate as command
from learning.config import RecognitionConfig, evaluation_kind, load_file
from learning.data import ExampleSet
from learning.models import ActivityNet, RawClassifier, build_network, named
from learning.models.activitynet import ClassifierOutput
from learning.provenance import scenes_of
from learning.recognition import job
from learning.recognition.job import recognise
from learning.timing import with_slivers
from simulator.dataset import generate, open_dataset
from simulator.errors import InputError

CLASSES = ["leftwards", "rightwards"]
NETWORKS: dict[str, dict[str, Any]] = {
    "net": {"network": "activitynet", "size": "tiny", "filters": 4, "joint_iterations": 3},
    "lens": {"network": "lens_classifier", "size": "compact"},
    "raw": {"network": "raw_classifier", "size": "compact"},
}


def save(path: Path, capture: CaptureModel, architecture: dict[str, Any], seed: int, **record: Any) -> Path:
    whole = {"classes": CLASSES} | architecture
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = build_network(capture, **named(whole)).eval()
    save_checkpoint(path, network, architecture=whole, capture=capture, record=record)
    return path


@pytest.fixture(scope="module")
def capture(labelled_dataset: Path) -> CaptureModel:
    train = open_dataset(labelled_dataset)
    return capture_model(train, white=measure_reference_white(train))


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory, capture: CaptureModel) -> dict[str, list[Path]]:
    """Two seeds of an untrained network of each kind."""
    folder = tmp_path_factory.mktemp("networks")
    return {
        name: [save(folder / f"{name}{seed}.safetensors", capture, architecture, seed) for seed in (1, 2)]
        for name, architecture in NETWORKS.items()
    }


@pytest.fixture
def settings(labelled_dataset: Path, networks: dict[str, list[Path]], tmp_path: Path) -> Any:
    """Return a function that makes a small evaluation; keys are replaced."""

    def make(**changes: Any) -> RecognitionConfig:
        rows = [{"name": name, "checkpoints": list(map(str, files))} for name, files in networks.items()]
        plain = {"name": "trial", "output": str(tmp_path / "out"), "data": {"test": str(labelled_dataset)}}
        plain |= {"classifiers": rows, "ceiling": "lens", "noise_db": [20, 40], "batch": 3, "timed": 2, "shown": 2}
        return RecognitionConfig.model_validate(plain | {"device": "cpu"} | changes)

    return make


@pytest.mark.slow
def test_probabilities_are_the_networks(settings: Any, labelled_dataset: Path, capture: CaptureModel) -> None:
    """Each capture's own, whatever the batch; a lens sees no noise."""
    found, _ = recognise(settings())
    test = ExampleSet(open_dataset(labelled_dataset, "test"))
    assert [(one.name, one.noise_db, one.slivers) for one in found.predictions] == [
        *(("net", None, 4), ("lens", None, None), ("raw", None, None)),
        *((name, level, slivers) for level in (20.0, 40.0) for name, slivers in (("net", 4), ("raw", None))),
    ]
    for one in found.main:
        assert one.truth.tolist() == [1, 0] * 4
        for seed in (1, 2):
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(seed)
                network: Any = build_network(capture, **named({"classes": CLASSES} | NETWORKS[one.name])).eval()
            for at in (0, 7):
                example = test[at]
                with torch.no_grad():
                    logits = network(*network.inputs(example.measurement[None], None, example.radiance[None])).logits
                expected = logits.softmax(dim=1)[0].numpy()
                np.testing.assert_allclose(one.probabilities[seed - 1, at], expected, atol=2e-4)
            if one.name == "net" and seed == 2:
                levels = {
                    other.noise_db: other.probabilities[1, 7] for other in found.predictions if other.name == "net"
                }
                for level in (20.0, 40.0):
                    noisy = ExampleSet(test.dataset, noise_db=(level, level), seed=0)[7].measurement
                    with torch.no_grad():
                        logits = network(noisy[None]).logits
                    np.testing.assert_allclose(levels[level], logits.softmax(dim=1)[0].numpy(), atol=2e-4)
                assert np.abs(levels[20.0] - levels[40.0]).max() > 5e-4, "more than the tolerance"


@pytest.mark.slow
def test_networks_that_begin_alike_share_it(
    settings: Any,
    networks: dict[str, list[Path]],
    labelled_dataset: Path,
    capture: CaptureModel,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of 8 captures in batches of 3: not once more for the second seed, but for a network of other iterations."""
    other = save(tmp_path / "other.safetensors", capture, NETWORKS["net"] | {"joint_iterations": 30}, 1)
    rows = [
        {"name": "net", "checkpoints": list(map(str, networks["net"]))},
        {"name": "more", "checkpoints": [str(other)]},
    ]
    begun: list[int] = []
    begin = ActivityNet.initial_estimate
    monkeypatch.setattr(ActivityNet, "initial_estimate", lambda *given: begun.append(len(given[1])) or begin(*given))
    found, _ = recognise(settings(classifiers=rows, ceiling=None, noise_db=None, timed=0, shown=0))
    assert begun == [3, 3, 2] * 2
    measurement = ExampleSet(open_dataset(labelled_dataset, "test"))[0].measurement[None]
    net: Any = load_checkpoint(other).network
    with torch.no_grad():
        expected = net(measurement).logits.softmax(dim=1)[0].numpy()
    np.testing.assert_allclose(found.main[1].probabilities[0, 0], expected, atol=2e-4)
    assert np.abs(found.main[0].probabilities[0] - found.main[1].probabilities[0]).max() > 5e-4, (
        "more than the tolerance"
    )


def test_probabilities_that_are_not_finite_are_refused(
    settings: Any, networks: dict[str, list[Path]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Before they are kept: a repaired checkpoint must not meet them again."""

    def forward(self: RawClassifier, measurement: torch.Tensor) -> ClassifierOutput:
        logits = torch.zeros(len(measurement), 2)
        logits[-1] = torch.nan
        return ClassifierOutput(logits, logits[:0])

    monkeypatch.setattr(RawClassifier, "forward", forward)
    rows = [{"name": "raw", "checkpoints": [str(networks["raw"][0])]}]
    with pytest.raises(
        InputError, match=r"raw: its probabilities of sample s00000002 are NaN or infinite; check .*raw1"
    ):
        recognise(settings(classifiers=rows, ceiling=None))
    assert not list((tmp_path / "out" / "cache").glob("*.npz"))


@pytest.mark.slow
def test_the_report_and_its_files(settings: Any, tmp_path: Path) -> None:
    found, files = recognise(settings())
    assert {path.name for path in files} == {
        *("report.md", "results.json", "table.csv", "confusion.png", "reliability.png", "noise.png", "sheet.png")
    }
    report = files[0].read_text(encoding="utf-8")
    for words in (
        "| net |",
        "| chance | 50.0 |",
        "most frequent class",
        "of the ceiling",
        "## Noise",
    ):
        assert words in report
    results = json.loads((tmp_path / "out" / "results.json").read_bytes())
    assert results["classes"] == CLASSES
    right = [one.guesses == one.truth for one in found.main]
    assert [one["top_1"]["mean"] for one in results["predictions"][:3]] == [pytest.approx(one.mean()) for one in right]
    assert 0 < right[0].mean() < 1
    told = results["predictions"][1]
    assert told["note"].startswith("lens_classifier, all frames, dronet, 0.3")
    assert [Path(one["file"]).name for one in told["checkpoints"]] == ["lens1.safetensors", "lens2.safetensors"]
    assert told["test_fingerprint"] == results["data"]["fingerprint"]
    assert {one["other"]: one["paired"] for one in results["differences"]} == {"lens": True, "raw": True}
    assert [one["method"] for one in results["times"]] == ["net"]
    assert list(results["times"][0]["stages_s"]) == ["joint", "network"]
    assert results["top_5"] == {"chance": 1, "most_frequent_class": 1}
    rows = list(csv.DictReader((tmp_path / "out" / "table.csv").open(encoding="utf-8")))
    assert len(rows) == 7
    assert float(rows[0]["top_1"]) == results["predictions"][0]["top_1"]["mean"]
    for path in files[3:]:
        with Image.open(path) as image:
            assert min(image.size) > 100


@pytest.mark.slow
def test_what_is_finished_is_kept(settings: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    recognise(settings(noise_db=[20], timed=0, shown=1))
    asked: list[str] = []
    known = job.probabilities
    monkeypatch.setattr(job, "probabilities", lambda *given, **how: asked.append(given[0].name) or known(*given, **how))
    recognise(settings(noise_db=[20, 30], timed=0, shown=0))
    assert asked == ["net", "net", "raw", "raw"]  # the new level, both seeds
    assert not (tmp_path / "out" / "sheet.png").exists()
    with pytest.raises(InputError, match="trial"):
        recognise(settings(name="another"))


def again(path: Path, output: Path, **how: bool) -> Path:
    """Return a new data set of the same clips through the same camera, changed in time as ``how`` says."""
    config = json.loads((path / "dataset.json").read_text())["config"]
    scene = {"source": "samples", "path": str(path), "size": [16, 16], **how}
    file = output.with_suffix(".yaml")
    file.write_text(json.dumps(config | {"scene": scene, "dataset": config["dataset"] | {"output": str(output)}}))
    for name in ("plugins.py", "response.csv"):  # which the configuration names
        if not (file.parent / name).exists():
            shutil.copyfile(path.parent / name, file.parent / name)
    return generate(file).path


@pytest.mark.slow
def test_backwards_and_other_captures(
    settings: Any, networks: dict[str, list[Path]], labelled_dataset: Path, tmp_path: Path, capture: CaptureModel
) -> None:
    """The same clips backwards through the same camera; and another number of slivers as a row of its own."""
    root = again(labelled_dataset, tmp_path / "back", backwards=True)
    dataset = with_slivers(open_dataset(labelled_dataset), 2)
    two = capture_model(dataset, white=capture.white)
    other = save(tmp_path / "two.safetensors", two, NETWORKS["net"], 1)
    rows = [
        {"name": "net", "checkpoints": [str(networks["net"][0])]},
        {"name": "net, 2 slivers", "checkpoints": [str(other)]},
    ]
    data = {"test": str(labelled_dataset), "backwards": str(root)}
    found, files = recognise(settings(classifiers=rows, data=data, ceiling=None, noise_db=None, timed=0))
    assert [one.slivers for one in found.main] == [4, 2]
    assert found.backwards is not None
    examples, net = ExampleSet(open_dataset(root, "test")), load_checkpoint(networks["net"][0]).network
    for at in (0, 7):
        with torch.no_grad():
            expected = net(examples[at].measurement[None]).logits.softmax(dim=1)[0].numpy()
        np.testing.assert_allclose(found.backwards.probabilities[0, at], expected, atol=2e-4)
    assert np.abs(found.backwards.probabilities - found.main[0].probabilities[:1]).max() > 5e-4, (
        "more than the tolerance"
    )
    assert (files[0].parent / "slivers.png").exists()
    report = files[0].read_text(encoding="utf-8")
    assert "## Time-reversed clips" in report
    assert "| 2 |" in report
    twice = again(root, tmp_path / "twice", backwards=True)  # forwards again, with other noise
    rows[1] = {"name": "net, other noise", "checkpoints": rows[0]["checkpoints"], "test": str(twice)}
    found, files = recognise(settings(classifiers=rows, data=data, ceiling=None, noise_db=None, timed=0, shown=0))
    one, other = found.main
    assert other.test_fingerprint == open_dataset(twice).fingerprint != one.test_fingerprint
    assert found.differences[0].paired, "its clips are the same"
    assert other.note.endswith("tested on twice")
    np.testing.assert_allclose(other.probabilities, one.probabilities, atol=0.05)  # back's differ by up to 0.3
    for path, how, runs in ((root, {}, "run backwards"), (labelled_dataset, {"still": True}, "stand still")):
        rows[1]["test"] = str(again(path, tmp_path / f"{runs[:3]}", **how))
        with pytest.raises(InputError, match=f"its clips {runs}, so their labels no longer describe what they show"):
            recognise(settings(classifiers=rows, data=data, ceiling=None))


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"ceiling": "sky"}, "ceiling"),
        ({"reference": "sky"}, "reference"),
        ({"noise_db": [20, 20]}, "noise_db"),
        ({"noise_db": []}, r"noise_db: got \[\]; expected at least 1 entry \(there are 0\)"),
        ({"classifiers": [{"name": "a", "checkpoints": ["x"]}] * 2, "ceiling": None}, "classifiers"),
        ({"classifiers": [{"name": "a", "checkpoints": ["x", "x"]}], "ceiling": None}, "classifiers"),
    ],
)
def test_what_makes_no_sense_is_refused(settings: Any, tmp_path: Path, changes: dict[str, Any], key: str) -> None:
    path = tmp_path / "rows.yaml"
    path.write_text(json.dumps(settings().dump() | changes))
    with pytest.raises(InputError, match=rf"rows\.yaml:\d+:\d+: {key}"):
        load_file(evaluation_kind, path)


def test_networks_and_data_that_do_not_fit(
    settings: Any,
    networks: dict[str, list[Path]],
    clip_dataset: Path,
    clip_checkpoint: Path,
    labelled_stills: Path,
    tmp_path: Path,
    capture: CaptureModel,
    labelled_dataset: Path,
) -> None:
    def refused(match: str, files: list[Path], **data: str) -> None:
        rows = [{"name": "one", "checkpoints": list(map(str, files))}]
        test = {"test": str(labelled_dataset)} | data
        with pytest.raises(InputError, match=match):
            recognise(settings(classifiers=rows, data=test, ceiling=None))
        assert not (tmp_path / "out").exists()

    refused("is a VideoNet, not a classifier", [clip_checkpoint])
    refused("no label", networks["net"], test=str(clip_dataset))
    refused(
        r"one: its network does not fit .*: slivers: got 4, but .* holds stills",
        networks["net"],
        test=str(labelled_stills),
    )
    unknown = save(tmp_path / "up.safetensors", capture, NETWORKS["lens"] | {"classes": ["rightwards", "up"]}, 0)
    refused("samples of 'leftwards', expected", [unknown])
    other = save(tmp_path / "more.safetensors", capture, NETWORKS["lens"] | {"classes": [*CLASSES, "up"]}, 0)
    refused(
        r"more\.safetensors has classes .*, .*lens1\.safetensors .*; give checkpoints", [networks["lens"][0], other]
    )
    refused("has network 'raw_classifier', .* 'lens_classifier'", [networks["lens"][0], networks["raw"][0]])
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(networks["lens"][0].read_bytes())
    refused(r"copy\.safetensors and .* are of the same training and seed", [networks["lens"][0], copy])
    rows = [{"name": "one", "checkpoints": [str(networks["lens"][0])]}, {"name": "two", "checkpoints": [str(other)]}]
    with pytest.raises(
        InputError, match=r"two: it has the classes .*, up, expected those of one: leftwards, rightwards"
    ):
        recognise(settings(classifiers=rows, ceiling=None))
    assert not (tmp_path / "out").exists()
    scenes = {"scenes": {"train": scenes_of(open_dataset(labelled_dataset, "test"))}}
    knows = save(tmp_path / "knows.safetensors", capture, NETWORKS["lens"], 0, **scenes)
    refused("learned from test scenes", [knows])
    refused("no label", networks["net"], backwards=str(clip_dataset))
    refused("does not have the clips of .* backwards", networks["net"], backwards=str(labelled_dataset))


def test_the_command_prints_the_table(
    networks: dict[str, list[Path]], labelled_dataset: Path, tmp_path: Path, capsys: Any
) -> None:
    rows = [{"name": name, "checkpoints": [str(networks[name][0])]} for name in ("net", "lens")]
    content = {
        "name": "trial",
        "output": "out",
        "data": {"test": str(labelled_dataset)},
        "classifiers": rows,
        "shown": 0,
    }
    path = tmp_path / "rows.yaml"
    path.write_text(json.dumps(content))
    assert isinstance(load_file(evaluation_kind, path), RecognitionConfig)
    command(path)
    told = capsys.readouterr().out
    assert "net minus lens:" in told
    assert f"look at {tmp_path / 'out' / 'report.md'}" in told
