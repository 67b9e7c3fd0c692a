"""Methods that know the test scenes are refused, by the scenes on record, or the earlier files' data set; what seeds are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from learning.camera import CaptureModel
from learning.checkpoint import FOLDER, load_checkpoint, save_checkpoint, save_denoiser
from learning.classical.method import DEFAULTS
from learning.config import EvaluateConfig
from learning.evaluate.methods import (
    ClassicalEntry,
    LearnedEntry,
    check_learned,
    check_seeds,
    check_tuned,
    read_methods,
    says_scenes,
)
from learning.models import SIZES
from learning.models.denoiser import Denoiser
from learning.provenance import scenes_of
from learning.tune.study import Study
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.files import sha256_file


def _record(train: str, validation: str) -> dict[str, Any]:
    return {"data sets": {"train": {"fingerprint": train}, "validation": {"fingerprint": validation}, "white": 1.0}}


def test_seeds_are_of_one_training(tiny_capture: CaptureModel) -> None:
    """All that decides a training but its seed is the same; data are told apart by fingerprint and number of samples."""
    config = {"seed": 4, "steps": 9, "optimiser": {"learning_rate": 1e-3}, "data": {"draws": 2}}
    data_sets = {"train": {"fingerprint": "a", "samples": 16}}

    def entry(name: str, digest: str, architecture: dict[str, Any], **record: Any) -> LearnedEntry:
        network = {"network": "flatnet3d", "size": "tiny"} | architecture
        return LearnedEntry("Net", Path(name), digest, tiny_capture, network, record)

    first = entry("first", "a", {}, config=config, **{"data sets": data_sets})
    second = entry("second", "b", {}, config=config | {"seed": 5, "output": "b"}, **{"data sets": data_sets})
    check_seeds("Net", [first, second])
    check_seeds("Net", [entry("first", "a", {}), entry("second", "b", {})])  # nothing is known
    for twice in (replace(first, path=Path("again"), digest="c"), replace(first, path=Path("again"), record={})):
        with pytest.raises(InputError, match=r"^Net: again and first are of the same training and seed; give"):
            check_seeds("Net", [replace(first, record=twice.record), twice])
    of = dict.fromkeys(("batch", "steps", "loss", "precision", "validate_every"), "other")
    on = dict.fromkeys(("noise_db", "augment", "draws", "shuffle_labels"), "other")
    for key, architecture, changed, sets in (
        ("size", {"size": "compact"}, {}, {}),
        ("filters", {"filters": 4}, {}, {}),
        ("frames", {"frames": "shuffled"}, {}, {}),  # which frames a lens_classifier looks at, not how many
        *((key, {}, {key: other}, {}) for key, other in of.items()),
        *((f"data.{key}", {}, {"data": {"draws": 2, key: other}}, {}) for key, other in on.items()),
        ("optimiser.learning_rate", {}, {"optimiser": {"learning_rate": 2e-3}}, {}),
        ("train data.fingerprint", {}, {}, {"train": {"fingerprint": "b", "samples": 16}}),
        ("train data.samples", {}, {}, {"train": {"fingerprint": "a", "samples": 8}}),
        ("validation data.fingerprint", {}, {}, {"validation": {"fingerprint": "a", "samples": 8}}),
        ("psf stack", {}, {}, {"stack": "c"}),
    ):
        record = {"config": config | {"seed": 5} | changed, "data sets": data_sets | sets}
        other = entry("other", "b", architecture, **record)
        with pytest.raises(InputError, match=f"^Net: got different trainings: other has {key} .*; give checkpoints"):
            check_seeds("Net", [first, second, other])
    begun = replace(first, path=Path("other"), record=first.record | {"init_from": {"architecture": {"size": "tiny"}}})
    with pytest.raises(InputError, match=r"other has init_from\.size 'tiny', first nothing"):
        check_seeds("Net", [first, begun])


@pytest.mark.parametrize(
    ("split", "message"), [("train", "learned from test scenes"), ("validation", "was chosen among its own steps by")]
)
def test_a_network_that_knows_the_scenes_is_refused(tiny_dataset: Path, split: str, message: str) -> None:
    test = open_dataset(tiny_dataset, split)
    of_it = {"train": "0" * 64, "validation": "1" * 64} | {split: test.fingerprint}
    with pytest.raises(InputError, match=r"^Net: "):
        check_learned("Net", Path("net.safetensors"), _record(**of_it), test)
    # What it was warm-started with knew them.
    start = {"init_from": {**_record(**of_it), "scenes": None, "init_from": None}, **_record("2" * 64, "3" * 64)}
    with pytest.raises(InputError, match=message):
        check_learned("Net", Path("net.safetensors"), start, test)
    decides = open_dataset(tiny_dataset, "test")
    check_learned("Net", Path("net.safetensors"), _record(test.fingerprint, test.fingerprint), decides)
    check_learned("Net", Path("net.safetensors"), {}, test)  # nothing is known


def test_only_the_split_that_was_tuned_on_is_refused(tiny_dataset: Path, tmp_path: Path) -> None:
    test = open_dataset(tiny_dataset, "test")
    for split in ("test", "validation"):
        path = tmp_path / f"{split}.json"
        study = Study(path, {"data": test.fingerprint, "split": split}, {})
        study.add_result({"method": "cls", "noise_db": 40.0, "parameters": {}, "score": 1.0})
    check_tuned("CLS", tmp_path / "validation.json", test)
    with pytest.raises(InputError, match=r"^CLS: "):
        check_tuned("CLS", tmp_path / "test.json", test)


@pytest.fixture
def seen_again(tiny_dataset: Path) -> Callable[..., Dataset]:
    """Return a function that gives a split as another camera's data set would have it, with another root seed if asked."""

    def seen(split: str, **changes: Any) -> Dataset:
        known = open_dataset(tiny_dataset, split)
        camera = known.config["camera"] | {"mask_to_sensor_mm": 2.5, "noise": {"type": "none"}}
        info = replace(known.info, config=known.config | {"camera": camera, **changes}, fingerprint="f" * 64)
        return Dataset(known.root, split, known.ids, info)

    return seen


@pytest.mark.parametrize("split", ["train", "validation"])
def test_scenes_are_known_through_another_camera(seen_again: Any, tiny_dataset: Path, split: str) -> None:
    record = {"scenes": {name: scenes_of(open_dataset(tiny_dataset, name)) for name in ("train", "validation")}}
    for knows in (record, {"scenes": {"train": ["other"]}, "init_from": record}):
        with pytest.raises(InputError, match=r"^Net: "):
            check_learned("Net", Path("net.safetensors"), knows, seen_again(split))
        check_learned("Net", Path("net.safetensors"), knows, seen_again("test"))
        check_learned("Net", Path("net.safetensors"), knows, seen_again(split, seed=12345))


def test_scenes_that_were_tuned_on_are_known_through_another_camera(seen_again: Any, tmp_path: Path) -> None:
    study = Study(tmp_path / "tuned.json", {"data": "0" * 64, "scenes": scenes_of(seen_again("validation"))}, {})
    study.add_result({"method": "cls", "noise_db": 40.0, "parameters": {}, "score": 1.0})
    with pytest.raises(InputError, match=r"^CLS: "):
        check_tuned("CLS", study.path, seen_again("validation"))
    check_tuned("CLS", study.path, seen_again("test"))


def test_whether_scenes_are_on_record_is_told(tmp_path: Path) -> None:
    def network(record: dict[str, Any]) -> bool:
        return says_scenes(LearnedEntry("Net", Path(), "0" * 64, cast("Any", None), {}, record))

    told = {"data sets": {}, "scenes": {"train": ["a"]}}
    assert network(told)
    assert network({**told, "init_from": told})
    assert not network({})
    assert not network(_record("1" * 64, "2" * 64))
    assert not network({**told, "init_from": {"data sets": {"train": {}}, "scenes": None}})
    assert says_scenes(ClassicalEntry("CLS", "cls", None, {}))
    for identity, expected in (({"scenes": ["a"]}, True), ({"data": "0" * 64}, False)):
        study = Study(tmp_path / f"{expected}.json", identity, {})
        study.add_result({"method": "cls", "noise_db": 40.0, "parameters": {}, "score": 1.0})
        assert says_scenes(ClassicalEntry("CLS", "cls", study.path, None)) == expected


def pnp(**method: Any) -> EvaluateConfig:
    """Return an evaluation of plug-and-play ADMM, as if its file lay in the current folder."""
    plain = {"name": "PnP", "classical": "pnp", **method}
    data = {"test": "t", "training": "t"}
    return EvaluateConfig.model_validate({"name": "n", "output": "o", "data": data, "methods": [plain]})


def write_denoiser(path: Path, record: dict[str, Any], filters: int = 4) -> Path:
    numbers = {"filters": filters, "blocks": 1, "levels": 1}
    save_denoiser(path, Denoiser(**numbers), architecture={"network": "denoiser", **numbers}, record=record)
    return path


def test_a_denoiser_that_has_seen_the_scenes_is_refused(seen_again: Any, tiny_dataset: Path, tmp_path: Path) -> None:
    train = scenes_of(open_dataset(tiny_dataset, "train"))

    def methods(record: dict[str, Any], split: str, filters: int = 4) -> list[Any]:
        path = write_denoiser(tmp_path / "denoiser.safetensors", record, filters)
        return read_methods(pnp(parameters={"denoiser": str(path)}), seen_again(split))[0]

    with pytest.raises(InputError, match=r"^PnP: "):
        methods({"scenes": {"train": train}}, "train")
    (entry,) = methods({"scenes": {"train": train}}, "test")
    assert says_scenes(entry)
    before = entry.identity(40.0)
    (entry,) = methods({"data sets": {"train": {}}}, "test", filters=8)
    assert not says_scenes(entry)
    assert entry.identity(40.0) != before  # another file under the same name


def test_a_denoiser_lies_where_the_file_says(seen_again: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not in the current folder; and no file there stands in for the shipped one."""
    here, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    for folder in (here, elsewhere):
        folder.mkdir()
    own = write_denoiser(here / "own.safetensors", {})
    (elsewhere / "denoiser").write_bytes(b"not the shipped one")
    monkeypatch.chdir(here)
    relative, shipped = (pnp(parameters=given) for given in ({"denoiser": "own.safetensors"}, {}))
    monkeypatch.chdir(elsewhere)
    for config, expected in ((relative, own), (shipped, FOLDER / "denoiser.safetensors")):
        ((entry,),) = read_methods(config, seen_again("test"))
        assert [*entry.learned] == [expected]  # type: ignore[union-attr]
        assert entry.identity(40.0)["parameters"]["denoiser"] == sha256_file(expected)
    assert "denoiser own.safetensors" in read_methods(relative, seen_again("test"))[0][0].note(40.0)
    with pytest.raises(InputError, match=r"^PnP: "):
        read_methods(pnp(parameters={"denoiser": "none"}), seen_again("test"))


def test_a_network_that_a_method_begins_with_is_held_to_the_same(
    seen_again: Any, clip_checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = load_checkpoint(clip_checkpoint)
    scenes = {"train": scenes_of(seen_again("train"))}
    path = tmp_path / "video.safetensors"
    save_checkpoint(
        path, known.network, architecture=known.architecture, capture=known.capture, record={"scenes": scenes}
    )
    monkeypatch.chdir(tmp_path)
    config = pnp(classical="pnp_clips", parameters={"initial_estimate": path.name})
    monkeypatch.chdir(tmp_path.parent)  # the file's folder counts, not the current one
    with pytest.raises(InputError, match=r"^PnP: .*video.safetensors learned from"):
        read_methods(config, seen_again("train"))
    ((entry,),) = read_methods(config, seen_again("test"))
    assert says_scenes(entry)
    assert entry.identity(40.0)["parameters"]["initial_estimate"] == sha256_file(path)
    assert "initial_estimate video.safetensors" in entry.note(40.0)
    with pytest.raises(InputError, match=r"^PnP: .*'none'.*; or take joint as initial_estimate"):
        read_methods(pnp(classical="pnp_clips", parameters={"initial_estimate": "none"}), seen_again("test"))


def test_every_level_of_a_tuned_file_may_have_its_own_denoiser(
    seen_again: Any, tiny_dataset: Path, tmp_path: Path
) -> None:
    """As files of earlier versions may, where the denoiser was searched; they lie from the tuned file's folder."""
    train = scenes_of(open_dataset(tiny_dataset, "train"))
    for name, scenes in (("first", ["others"]), ("second", train)):
        write_denoiser(tmp_path / f"{name}.safetensors", {"scenes": {"train": scenes}})
    study = Study(tmp_path / "tuned.json", {"scenes": ["others"]}, {})
    for level, name in ((20.0, "first"), (40.0, "second")):
        parameters = DEFAULTS["pnp"] | {"denoiser": f"./{name}.safetensors"}
        study.add_result({"method": "pnp", "noise_db": level, "parameters": parameters, "score": 1.0})
    config = pnp(tuned=str(study.path))
    with pytest.raises(InputError, match=r"^PnP: .*second"):
        read_methods(config, seen_again("train"))
    ((entry,),) = read_methods(config, seen_again("test"))
    digests = [entry.identity(level)["parameters"]["denoiser"] for level in (20.0, 40.0)]
    assert digests == [sha256_file(tmp_path / f"{name}.safetensors") for name in ("first", "second")]


def test_given_parameters_come_before_tuned_ones(seen_again: Any, tmp_path: Path) -> None:
    study = Study(tmp_path / "tuned.json", {"scenes": ["others"]}, {})
    study.add_result({"method": "pnp", "noise_db": 40.0, "parameters": {"prior": 0.3, "iterations": 9}, "score": 1.0})
    ((entry,),) = read_methods(pnp(tuned=str(study.path), parameters={"iterations": 5}), seen_again("test"))
    chosen = entry.identity(40.0)["parameters"]
    assert (chosen["prior"], chosen["iterations"]) == (0.3, 5)
    assert chosen["noise_first"] == DEFAULTS["pnp"]["noise_first"]


def test_a_shipped_network_is_named_like_its_file(seen_again: Any) -> None:
    net = {"name": "Net", "checkpoints": ["flatnet2d"]}
    config = EvaluateConfig.model_validate({"name": "n", "output": "o", "data": {"test": "t"}, "methods": [net]})
    ((entry,),) = read_methods(config, seen_again("test"))
    assert entry.plain()["file"] == "flatnet2d.safetensors"  # type: ignore[union-attr]


def test_a_network_is_told_apart_by_what_differs_from_its_size() -> None:
    size = {"network": "flatnet3d", "size": "compact", **SIZES["compact"]}
    for changes, note in (({}, ""), ({"refinements": 1, "stem": 2}, ", stem 2, refinements 1")):
        entry = LearnedEntry("Net", Path(), "0" * 64, cast("Any", None), size | changes, {})
        assert entry.note(40.0) == f"flatnet3d, compact{note}"
