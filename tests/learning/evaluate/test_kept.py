"""What an evaluation keeps: only what is new is done again, from where it was interrupted, and what was fitted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from learning.classical.clips import ClipMethod
from learning.classical.fitting import FilmNetwork
from learning.classical.method import ClassicalMethod
from learning.config import EvaluateConfig
from learning.evaluate import runs
from learning.evaluate.job import CACHE, evaluate
from simulator.errors import InputError

Load = Callable[..., EvaluateConfig]


@pytest.mark.usefixtures("no_figures")
def test_only_what_changed_is_done_anew(
    load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: Callable[[], dict[str, Any]]
) -> None:
    scored: list[str] = []
    real = runs.score

    def counting(method: Any, *arguments: Any, **options: Any) -> dict[str, Any]:
        scored.append(method.name)
        return real(method, *arguments, **options)

    monkeypatch.setattr(runs, "score", counting)
    evaluate(load())
    first = written()
    assert scored == ["FlatNet3D", "FlatNet3D", "CLS"]
    evaluate(load())
    assert len(scored) == 3
    assert written() == first
    (tmp_path / "out" / "noise.png").write_bytes(b"of a run with other settings")
    evaluate(load())
    assert not (tmp_path / "out" / "noise.png").exists()
    with pytest.raises(InputError, match=r"^output: "):
        evaluate(load(name="another"))
    evaluate(load(noise_db=[30]))  # an extended evaluation does only what is new
    assert scored[3:] == ["FlatNet3D", "FlatNet3D", "CLS"]
    methods = [{"name": "CLS", "classical": "cls", "parameters": {"regularisation_lambda": 0.2}}]
    for changes in ({}, {"dark_share": 0.1}, {"data": {"scenes": 2}}):
        before = len(scored)
        evaluate(load(methods=methods, **changes))
        assert scored[before:] == ["CLS"], changes


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("clips", [True, False])
def test_an_interrupted_run_goes_on_where_it_was(
    load: Load, tmp_path: Path, clip_dataset: Path, monkeypatch: pytest.MonkeyPatch, clips: bool
) -> None:
    name, kind = ("static", ClipMethod) if clips else ("cls", ClassicalMethod)
    told = {"methods": [{"name": "it", "classical": name, "parameters": {}}], "batch": 1}
    if clips:
        told["data"] = {"test": str(clip_dataset), "training": str(clip_dataset), "scenes": 2}
    whole = evaluate(load(**told, output="whole"))[0].findings[""].main[0].scores
    monkeypatch.setattr(runs, "_KEEP_EVERY_S", 0.0)
    seen, real = [], kind.reconstruct

    def stopping(self: Any, measurement: Any) -> Any:
        seen.append(measurement)
        if len(seen) == 2:
            raise KeyboardInterrupt
        return real(self, measurement)

    monkeypatch.setattr(kind, "reconstruct", stopping)
    with pytest.raises(KeyboardInterrupt):
        evaluate(load(**told))
    rest = evaluate(load(**told))[0].findings[""].main[0].scores
    assert len(seen) == 1 + (2 if clips else 3)  # what failed is done again, what was done is not
    assert rest == whole
    assert len(list((tmp_path / "out" / CACHE).glob("*.json"))) == 1


@pytest.mark.usefixtures("no_figures")
def test_what_is_fitted_to_each_capture_is_kept_and_not_timed(
    load: Load,
    clip_dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    written: Callable[[], dict[str, Any]],
) -> None:
    methods = [
        {"name": "fit", "classical": "nstm", "parameters": {"iterations": 2, "width": 8}},
        {"name": "static", "classical": "static", "parameters": {}},
    ]
    data = {"test": str(clip_dataset), "training": str(clip_dataset), "scenes": 2}
    evaluate(load(data=data, methods=methods, time={"repeats": 1}))
    cache = tmp_path / "out" / "cache"
    fits = sorted(cache.glob("fits/*/*.pt"))
    assert len(fits) == 2
    assert [one["method"] for one in written()["times"]] == ["static"]
    # Of an evaluation that died before its end, the fits are taken up again.
    for path in cache.glob("*.json"):
        path.unlink()
    first = written()["outcomes"]
    with monkeypatch.context() as patched:
        patched.setattr(FilmNetwork, "penalty", lambda *_: pytest.fail("an iteration of a fit that was done"))
        evaluate(load(data=data, methods=methods))
    assert written()["outcomes"] == first
    assert sorted(cache.glob("fits/*/*.pt")) == fits
    # Other code may find other films.
    monkeypatch.setattr("learning.evaluate.runs.code_digest", lambda *_: "another")
    evaluate(load(data=data, methods=methods))
    assert len(list(cache.glob("fits/*/*.pt"))) == 4
