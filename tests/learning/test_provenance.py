"""Keys of earlier versions: refused with the new name in files, read in results; what scenes are known by."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from learning.checkpoint import load_checkpoint, shipped_checkpoints
from learning.config import TrainConfig, TuneConfig, load_file
from learning.provenance import clips_of, playback, scenes_of
from learning.tune.study import load_tuned
from simulator.errors import InputError


@pytest.mark.parametrize(
    ("model", "content", "place"),
    [
        (TrainConfig, {"start": "x"}, "start.*init_from"),
        (TrainConfig, {"network": {"strength": 0.1}}, "network.strength.*regularisation_lambda"),
        (TuneConfig, {"data": {"validation": "d"}, "objective": "picture"}, "objective.*image"),
    ],
)
def test_old_keys_of_files_are_refused_with_the_new_name(tmp_path: Path, model: Any, content: Any, place: str) -> None:
    path = tmp_path / "old.yaml"
    training = {"name": "a", "output": "o", "data": {"train": "d"}, "steps": 1}
    path.write_text(yaml.safe_dump((training if model is TrainConfig else {}) | content))
    with pytest.raises(InputError, match=place):
        load_file(model, path)


def test_what_earlier_versions_wrote_is_read_with_the_new_names(tmp_path: Path) -> None:
    for path in shipped_checkpoints().values():
        checkpoint = load_checkpoint(path)
        assert not {"strength", "floor"} & checkpoint.architecture.keys()
    result = {"method": "cls", "noise_db": 40.0, "parameters": {"strength": 0.3, "floor": 1.0}, "score": 1.0}
    content = {"format": "flatlight tuned", "version": 1, "identity": {}, "trials": [], "results": [result]}
    (tmp_path / "tuned.json").write_text(json.dumps(content))
    parameters, _ = load_tuned(tmp_path / "tuned.json").parameters("cls", 30.0)
    assert parameters == {"regularisation_lambda": 0.3, "tikhonov": 1.0}


class _Split(SimpleNamespace):
    """A split of a data set, as far as provenance looks at it; ``clips`` are what the source says of each sample."""

    def __len__(self) -> int:
        return len(self.clips)

    def stored(self, position: int) -> Any:
        return SimpleNamespace(description={"metadata": {"scene": self.clips[position]}})


def _drawn(split: str = "test", seed: int = 7, **scene: Any) -> list[str]:
    config = {"seed": seed, "scene": {"family": "flying_things", "size": [64, 64], **scene}}
    return scenes_of(_Split(config=config, split=split, clips=[{}]))  # pyright: ignore[reportArgumentType]


def _imported(*clips: dict[str, Any], source: str = "videos", **config: Any) -> list[str]:
    made = {"seed": 7, "scene": {"source": source}, **config}
    return scenes_of(_Split(config=made, split="test", clips=clips))  # pyright: ignore[reportArgumentType]


def test_drawn_scenes_are_known_by_their_random_numbers() -> None:
    assert _drawn() == _drawn(size=[32, 32], samples_per_pixel=64, near_cm=3)
    apart = [_drawn(), _drawn("train"), _drawn(seed=8), _drawn(family="endoscopy")]
    assert len({tuple(each) for each in apart}) == 4


def test_own_families_are_known_by_their_name_wherever_they_lie() -> None:
    assert _drawn(family="./mine.py:vortex") == _drawn(family="elsewhere/mine.py:vortex") != _drawn(family="vortex")


def test_imported_scenes_are_known_by_their_recordings() -> None:
    one, other = ({"importer": "v", "video": name, "first_frame": 3, "crop": {"corner_px": [0, 0]}} for name in "ab")
    assert _imported(one, other) == _imported(other | {"first_frame": 9}, one | {"crop": {}}, one, seed=8)
    assert not set(_imported(one)) & set(_imported(other))
    assert not set(_imported(one)) & set(_imported(one, source="films"))
    still, next_one, elsewhere = ({"picture": f"left/{name}.png"} for name in ("a/1", "a/2", "b/1"))
    assert _imported(still) == _imported(next_one) != _imported(elsewhere)
    assert _imported({"mine": 1}) == _imported({"mine": 1}) != _imported({"mine": 2})


def test_scenes_that_are_seen_again_are_known_by_what_they_were_known_by() -> None:
    film = {"importer": "v", "video": "a"}
    seen = {"sample": "validation/s00000003", "seed": 9}
    drawn = seen | {"made by": {"family": "flying_things"}, "scene": {"index": 3}}
    assert _imported(drawn, source="samples") == _drawn("validation", seed=9)
    filmed = seen | {"made by": {"source": "videos"}, "scene": film}
    assert _imported(filmed, source="samples") == _imported(film)
    again = {"sample": "test/s00000000", "seed": 1, "made by": {"source": "samples"}, "scene": drawn}
    assert _imported(again, source="samples") == _drawn("validation", seed=9)


def _again(made_by: str, scene: dict[str, Any], sample: str, **how: bool) -> dict[str, Any]:
    """Return what the source `samples` says of a sample of the data set "first" or, of one made from it, "second"."""
    made = {"family": "activity"} if made_by == "first" else {"source": "samples"}
    return {"data set": made_by, "sample": sample, "made by": made, "scene": scene, "seed": 7, **how}


def _split(*clips: dict[str, Any], **scene: Any) -> Any:
    ids = tuple(f"s{place}" for place in range(len(clips)))
    return _Split(config={"seed": 7, "scene": scene}, split="test", fingerprint="own", ids=ids, clips=clips)


def test_clips_are_known_by_the_first_data_set_and_their_names_there() -> None:
    assert clips_of(_split({}, {}, family="activity")) == ("own test/s0", "own test/s1")
    once = [_again("first", {}, f"test/s{place}", backwards=True) for place in (5, 3)]
    assert clips_of(_split(*once, source="samples")) == ("first test/s5", "first test/s3")
    twice = [_again("second", clip, f"test/s{place}") for place, clip in enumerate(once)]
    assert clips_of(_split(*twice, source="samples")) == ("first test/s5", "first test/s3")


def test_how_clips_run_follows_from_all_that_showed_them_again() -> None:
    back, stopped, plain = (_again("first", {}, "test/s0", **how) for how in ({"backwards": True}, {"still": True}, {}))
    for clip, runs in ((back, "backwards"), (stopped, "still"), (plain, "forwards")):
        assert playback(_split(clip, source="samples")) == runs
        assert playback(_split(_again("second", clip, "test/s0"), source="samples")) == runs
    for clip, runs in ((back, "forwards"), (stopped, "still"), (plain, "backwards")):
        assert playback(_split(_again("second", clip, "test/s0", backwards=True), source="samples")) == runs
    assert playback(_split({}, family="activity")) == playback(_split(source="samples")) == "forwards"
