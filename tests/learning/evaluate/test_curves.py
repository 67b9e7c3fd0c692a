"""Learning curves as a training's log has them."""

from __future__ import annotations

import json
from pathlib import Path

from learning.evaluate.curves import learning_curve
from learning.validation import METRICS


def test_a_curve_is_what_the_training_logged(tmp_path: Path) -> None:
    """Validations alone, in order; the last line of a process that died while it wrote is none."""
    lines = [{"step": 50, "kind": "train", "psnr_db": 3.0}]
    lines += [
        {"step": step, "kind": "validation", "psnr_db": step / 10, "depth_rmse_cm": 300 / step, "score": 0.0}
        for step in (100, 200)
    ]
    others = [{"loss": 1.0}, [1]]  # of another program
    text = "\n".join([*map(json.dumps, [*others, *lines]), '{"step": 300, "kind": "valida'])
    (tmp_path / METRICS).write_text(text, encoding="utf-8")
    curve = learning_curve("net", tmp_path / "best.safetensors")
    assert curve is not None
    assert (curve.method, curve.steps) == ("net", (100, 200))
    assert curve.scores == {"psnr": (10.0, 20.0), "depth_rmse_cm": (3.0, 1.5)}
    (tmp_path / METRICS).write_text(json.dumps(lines[0]), encoding="utf-8")
    assert learning_curve("net", tmp_path / "best.safetensors") is None
    assert learning_curve("net", tmp_path / "elsewhere" / "best.safetensors") is None
