"""Evaluations of several data sets: one table each, one for all, and paths that name the set."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from learning.classical.method import DEFAULTS
from learning.config import EvaluateConfig
from learning.evaluate.job import evaluate
from learning.tune.study import Study
from simulator.errors import InputError

Load = Callable[..., EvaluateConfig]


@pytest.fixture
def other_camera(learning_trial: Any) -> Path:
    """A small data set of another camera, at another distance from its mask."""
    return learning_trial.generate(
        "camera.mask_to_sensor_mm=2.3", "seed=8", dataset={"train": 2, "test": 2, "validation": 0}
    )


@pytest.mark.slow
def test_several_data_sets_have_a_table_each_and_a_joint_one(
    load: Load, tmp_path: Path, tiny_dataset: Path, other_camera: Path
) -> None:
    for name, folder in (("wide", tiny_dataset), ("narrow", other_camera)):
        (tmp_path / name).symlink_to(folder)
        study = Study(tmp_path / f"tuned_{name}.json", {"data": name}, {})
        parameters = DEFAULTS["cls"] | {"regularisation_lambda": 0.1 if name == "wide" else 0.2}
        study.add_result({"method": "cls", "noise_db": 40.0, "parameters": parameters, "score": 1.0})
    methods = [
        {"name": "tuned", "classical": "cls", "tuned": "tuned_<set>.json"},
        {"name": "given", "classical": "cls", "parameters": {}},
    ]
    sets = {"test": {"wide": str(tiny_dataset), "narrow": "<set>"}, "training": "<set>"}
    stages: set[str] = set()
    evaluation, files = evaluate(
        load(methods=methods, data=sets, output="sets"), progress=lambda stage, *_: stages.add(stage)
    )
    assert list(evaluation.findings) == ["wide", "narrow"]
    assert stages == {"wide: tuned", "wide: given", "narrow: tuned", "narrow: given"}
    for name, folder, value in (("wide", tiny_dataset, 0.1), ("narrow", other_camera, 0.2)):
        given = [*methods[1:], {"name": "by hand", "classical": "cls", "parameters": {"regularisation_lambda": value}}]
        data = {"test": str(folder), "training": str(folder)}
        alone = evaluate(load(methods=given, data=data, output=f"alone_{name}"))[0].findings[""]
        assert [one.scores for one in evaluation.findings[name].main] == [one.scores for one in reversed(alone.main)]
        assert tmp_path / "sets" / name / "depth.png" in files
    report = files[0].read_text(encoding="utf-8")
    assert report.index("## All data sets") < report.index("## wide") < report.index("## narrow")
    assert "| PSNR dB ↑ | wide | narrow |" in report
    assert "](narrow/depth.png)" in report
    rows = list(csv.DictReader((tmp_path / "sets" / "table.csv").read_text(encoding="utf-8").splitlines()))
    assert {(row["set"], row["method"]) for row in rows if row["kind"] == "classical"} == {
        (name, method) for name in ("wide", "narrow") for method in ("tuned", "given")
    }
    assert set(json.loads((tmp_path / "sets" / "results.json").read_bytes())["sets"]) == {"wide", "narrow"}
    # Without one of them its figures go.
    evaluate(load(methods=methods, data=sets | {"test": {"wide": str(tiny_dataset)}}, output="sets"))
    assert not (tmp_path / "sets" / "narrow").exists()
    assert (tmp_path / "sets" / "wide" / "depth.png").exists()


def test_every_path_may_have_the_name_of_the_data_set(load: Load) -> None:
    data = {"test": {"a": "<set>_test", "b": "other"}, "training": "<set>", "stack": "psf_<set>"}
    methods = [
        {"name": "Net", "checkpoints": ["<set>/0", "<set>/1"]},
        {"name": "CLS", "classical": "cls", "tuned": "<set>.json"},
        {"name": "PnP", "classical": "pnp", "parameters": {"denoiser": "<set>/d", "prior": 0.2}},
    ]
    config = load(data=data | {"compare_stacks": ["nominal", "<set>/psf"]}, methods=methods)
    one, other = (alone.dump() for alone in config.sets.values())
    assert one["data"]["test"] == "a_test"
    assert other["data"]["test"] == "other"
    for name, dumped in (("a", one), ("b", other)):
        assert dumped["data"] | {"test": ""} == config.dump()["data"] | {
            "test": "",
            "training": name,
            "stack": f"psf_{name}",
            "compare_stacks": ["nominal", f"{name}/psf"],
        }
        assert [method["checkpoints"] for method in dumped["methods"]] == [[f"{name}/0", f"{name}/1"], None, None]
        assert [method["tuned"] for method in dumped["methods"]] == [None, f"{name}.json", None]
        assert dumped["methods"][2]["parameters"] == {"denoiser": f"{name}/d", "prior": 0.2}
    assert config.sets["a"].resolve_path("x") == config.resolve_path("x")


@pytest.mark.parametrize(("test", "key"), [({}, "data.test: "), ({"../up": "x"}, "data.test")])
def test_names_of_data_sets_are_those_of_folders(load: Load, test: Any, key: str) -> None:
    with pytest.raises(InputError, match=re.escape(key)):
        load(data={"test": test})
