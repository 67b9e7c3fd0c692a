"""What a reader must know beside the tables: how scores were taken, and what others published."""

from __future__ import annotations

from collections.abc import Sequence

from learning.evaluation.findings import Findings
from learning.evaluation.outcome import Outcome
from learning.evaluation.report import SCORES
from learning.metrics import SSIM_DEFINITION

PUBLISHED = """## Published, on other data

| thesis, table 5.2 | PSNR dB ↑ | SSIM ↑ | LPIPS ↓ | depth RMSE cm ↓ | s per scene ↓ |
| --- | ---: | ---: | ---: | ---: | ---: |
| CLS + graph cut | 16.24 | 0.56 | 0.51 | 4.87 | 1.21 |
| ADMM + graph cut | 15.94 | 0.63 | 0.32 | 5.26 | 10.26 |
| FlatNet2D | 19.86 | 0.65 | 0.30 | 1.92 | 0.011 |
| FlatNet3D | 21.91 | 0.79 | 0.14 | 1.42 | 0.013 |

These are of the thesis's own scenes, camera and computer, and cannot be compared with the above number by number. The best
constant has 4.73 cm on depths that are uniform in the thesis's range, 3.6 to 20 cm."""


def conditions(findings: Findings) -> str:
    """Return on which scenes the methods were judged, and what they were told of the camera."""
    psf = findings.test.info.config["psf"]
    count = len(psf["depths_cm"]) if psf.get("depths_cm") else psf.get("depths")
    planes = f", PSFs {psf['model']} at {count} depths" if psf.get("model") and count else ""
    stack = findings.config.data.stack
    believed = "their own PSFs" if stack == "own" else f"the PSFs {stack}"
    return (
        f"{len(findings.test)} scenes, split {findings.test.split} of a data set with fingerprint "
        f"`{findings.test.fingerprint[:12]}`{planes}; measurements as stored have {findings.stored_db:.1f} dB. The methods "
        f"believe {believed}: {_planes(findings)}."
    )


def how(findings: Findings) -> str:
    """Return how the table is to be read."""
    seeds = [len(next(iter(one.scores.values())).seeds) for one in findings.main if one.kind == "learned"]
    brackets = f", in brackets over {max(seeds)} seeds" if seeds and max(seeds) > 1 else ""
    depth = "Every method's depths are clamped to its range, and count where there is a surface."
    return (
        f"Mean ± standard deviation over scenes{brackets}; the best of each column is bold; answers in italics look at no "
        f"measurement. {depth} Pooled: over all pixels of all scenes; beside it as a share of the best constant depth's. "
        f"SSIM: {SSIM_DEFINITION}. {findings.perceptual[0].upper()}{findings.perceptual[1:]}."
    )


def left_out(outcomes: Sequence[Outcome]) -> str:
    """Return which scores do not have all scenes, because a scene has none; empty where all have all."""
    found: dict[tuple[str, int, int], list[str]] = {}
    for one in outcomes:
        for name, summary in one.scores.items():
            if summary.left_out:
                found.setdefault((SCORES[name][0], summary.left_out, one.scenes), []).append(one.method)
    return "\n".join(
        f"- {score}: {count} of {scenes} scenes have none and are left out ({', '.join(methods)})"
        for (score, count, scenes), methods in found.items()
    )


def on_part(findings: Findings) -> str:
    """Return how many scenes the noise levels and the comparison of PSFs have."""
    whole = len(findings.test)
    return f"Of {'all' if findings.part == whole else 'the first'} {findings.part} of {whole} scenes."


def _planes(findings: Findings) -> str:
    """Return planes and range, of each method where they differ."""
    words: dict[str, list[str]] = {}
    for method in findings.methods:
        near_cm, far_cm = (100 * depth_m for depth_m in method["depth_range_m"])
        text = f"{method['planes']} planes, depths from {near_cm:.3g} to {far_cm:.3g} cm"
        words.setdefault(text, []).append(method["name"])
    if len(words) == 1:
        return next(iter(words))
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in words.items())
