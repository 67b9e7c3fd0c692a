"""``tune`` from a YAML file to tuned.json, with the real CLS."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from learning.commands.tune import tune
from learning.tuning import load_tuned
from simulator.errors import InputError

SEARCH = {
    "cls": {
        "strength": {"values": [0.03, 0.3], "high": 10},
        "cost": {"values": ["spread"]},
        "measure": {"values": ["gradient"]},
        "light": {"values": ["label"]},
        "contrast": {"values": [8.0], "low": 8, "high": 8},
        "steps_between_planes": {"values": [4], "low": 4, "high": 4},
        "window_px": {"values": [1.0], "low": 1, "high": 1},
        "pairwise": {"values": [0.1, 1.0], "high": 100},
    }
}


def test_the_command_tunes_and_goes_on(tiny_dataset: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tune.yaml"
    data = {"validation": str(tiny_dataset), "scenes": 4, "allow_few_scenes": True}
    path.write_text(
        json.dumps({"data": data, "methods": ["cls"], "noise_db": [30, 40], "search": SEARCH}), encoding="utf-8"
    )
    tune(path, ["noise_db=[40]"])
    out, err = capfd.readouterr()
    lines = out.splitlines()
    assert lines[-1] == f"wrote {tmp_path / 'tuned.json'}"
    assert lines[0].split()[:3] == ["method", "noise", "dB"]
    assert lines[1].split()[:2] == ["cls", "40"]
    assert lines[2].startswith("constant guess")
    assert "cls at 40 dB: PSNR" in err
    tuned = load_tuned(tmp_path / "tuned.json")
    parameters, level = tuned.parameters("cls", 33)
    assert level == 40
    first = tuned.content["results"][0]
    trials = {
        (t["parameters"]["strength"], t["parameters"]["pairwise"]): t["score"]
        for t in tuned.content["trials"]
        if all(t["parameters"][name] == parameters[name] for name in parameters if name not in ("strength", "pairwise"))
    }
    best = parameters["strength"], parameters["pairwise"]
    # Within the least gain of the best of all trials, and worse ones above and below it, or a limit.
    assert trials[best] == first["score"] <= min(trials.values()) * (1 + 2e-3)
    for axis, value in enumerate(best):
        others = {pair[axis] for pair in trials if pair[1 - axis] == best[1 - axis]}
        assert (min(others) < value < max(others)) or first["at_limit"]
    tune(path, None)
    again = load_tuned(tmp_path / "tuned.json")
    assert again.levels_db("cls") == [30.0, 40.0]
    assert again.content["trials"][: len(tuned.content["trials"])] == tuned.content["trials"]


def test_an_unknown_parameter_is_refused(tiny_dataset: Path, tmp_path: Path) -> None:
    path = tmp_path / "tune.yaml"
    data = {"validation": str(tiny_dataset), "scenes": 4, "allow_few_scenes": True}
    path.write_text(json.dumps({"data": data, "methods": ["cls"]}), encoding="utf-8")
    with pytest.raises(InputError, match=r"search\.cls: got 'tau', expected one of strength"):
        tune(path, ["search.cls.tau.values=[1.0]"])
    with pytest.raises(InputError, match=r"search\.cls\.strength: values: got \[1\.0, 0\.1\], expected"):
        tune(path, ["search.cls.strength.values=[1.0, 0.1]"])
