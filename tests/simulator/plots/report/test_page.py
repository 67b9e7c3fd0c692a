"""The page is whole, readable by machines, safe with foreign data, and goes on where something is damaged."""

import base64
import hashlib
import io
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from simulator.dataset import open_dataset, verify
from simulator.dataset.dataset_info import read_info, write_info
from simulator.dataset.manifest import FailedWriter, ManifestWriter, SkippedWriter, load_manifest
from simulator.dataset.sample import SampleRecord, write_sample
from simulator.errors import InputError
from simulator.optics.stack_files import read_psf_stack, write_psf_stack
from simulator.plots.drawing import encoded, white_level
from simulator.plots.report.facts import label_table, read_records, time_parts
from simulator.plots.report.page import report_html, write_report
from simulator.plots.report.samples import chosen_positions, snr_db

RECORD = SampleRecord("s00000000", "train", "0" * 64, 7, None)
EMPTY = {"meta", "img", "input", "link", "br"}


class Reader(HTMLParser):
    """Collects elements and the text of each, and refuses tags that do not nest."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[tuple[str, dict[str, str]]] = []
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = (tag, {name: value or "" for name, value in attrs})
        element[1]["inside"] = " ".join(name for name, _ in self.open)
        self.elements.append(element)
        if tag not in EMPTY:
            self.open.append(element)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        self.texts.append((self.open[-1][0] if self.open else "", data))

    def all(self, tag: str, **attributes: str) -> list[dict[str, str]]:
        wanted = attributes.items()
        return [found for name, found in self.elements if name == tag and all(found.get(k) == v for k, v in wanted)]

    def text(self, *tags: str) -> list[str]:
        return [text for tag, text in self.texts if tag in tags]


@pytest.fixture(scope="module")
def trial_set(make_trial: Callable, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of stills with measured errors, an exposure and times."""
    return make_trial(tmp_path_factory.mktemp("trial")).generate()


@pytest.fixture(scope="module")
def page(trial_set: Path) -> Reader:
    return Reader(report_html(trial_set))


def cards(page: Reader) -> list[str]:
    return [found["aria-label"] for found in page.all("article", **{"class": "card"})]


def pixels(image: dict[str, str]) -> np.ndarray:
    kind, data = image["src"].split(",")
    assert kind == "data:image/webp;base64"
    with Image.open(io.BytesIO(base64.b64decode(data))) as found:
        return np.asarray(found.convert("RGB"))


# ---- what it shows


def test_every_sample_has_its_images(page: Reader, trial_set: Path) -> None:
    names = [f"{split}/{name}" for split, name in load_manifest(trial_set).entries]
    assert cards(page) == names
    frames = {name: open_dataset(trial_set, name.split("/")[0]).stored(int(name[-3:])).frame(0) for name in names}
    white = white_level(frame.rgb for frame in frames.values())
    for name, frame in frames.items():
        (image,) = [found for found in page.all("img") if found["alt"].startswith(f"ground truth of {name},")]
        np.testing.assert_array_equal(pixels(image), encoded(frame.rgb, white))  # exact: it is small
        assert f"mean radiance {frame.rgb.mean():.3g}" in image["alt"]
    assert len([found for found in page.all("img") if found["alt"].startswith("measurement of ")]) == 5


def test_key_figures_and_records_are_there(page: Reader, trial_set: Path) -> None:
    info = read_info(trial_set)
    text = " ".join(page.text("dd", "td", "code", "pre", "h1", "b"))
    for words in ("trial", "5 of 5", info.fingerprint, "full_scale: 3.0e-06", "mask_to_sensor_mm: 1.9", "psf.depths"):
        assert words in text
    assert "hours of one worker" in text
    assert page.text("p").count("No sample failed, none was skipped.") == 1


def test_time_is_shared_out_among_stages(dataset: Path) -> None:
    records = read_records(dataset)
    assert "Time per stage" not in time_parts(records)
    entries = {key: replace(entry, stages=(2.0, 1.0, 1.0)) for key, entry in records.entries.items()}
    page = Reader(time_parts(replace(records, entries=entries)))
    widths = [float(found["width"]) for found in page.all("rect") if found.get("class", "").startswith("part")]
    assert widths == [50, 25, 25]
    assert page.text("td")[:6] == ["8 s", "50 %", "4 s", "25 %", "4 s", "25 %"]
    assert {"scene", "exposure", "files"} <= set(page.text("th"))


def test_one_plane_leaves_no_depth_outside(samples: ModuleType, tmp_path: Path) -> None:
    """One PSF that serves all depths says nothing of how far from it they lie."""
    make = lambda index: samples.make_sample(index, metadata={"saturated_share": 0.25, "clamped_depth_share": 0.0})  # noqa: E731
    root = samples.make_dataset(tmp_path / "set", make)
    assert "Depth outside the PSFs' planes, of a sample's seen pixels" in Reader(report_html(root)).text("dt")
    stack = read_psf_stack(root / "psf")
    shutil.rmtree(root / "psf")
    write_psf_stack(root / "psf", replace(stack, values=stack.values[:1], depths_m=stack.depths_m[:1]))
    told = Reader(report_html(root)).text("dt")
    assert "Saturated, of a sample's values" in told
    assert not [line for line in told if "outside" in line]


def test_samples_left_out_for_good_are_seen_first(dataset: Path) -> None:
    with SkippedWriter(dataset) as skipped:
        skipped.append("train", 7, "clip.webm is truncated")
    page = Reader(report_html(dataset))
    assert "Samples: 1 skipped. " in page.text("p")
    assert "1 sample left out for good (skipped.jsonl)." in page.text("p")


def test_labels_are_counted_per_split(samples: ModuleType, tmp_path: Path) -> None:
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_sample(index, label=f"class {index % 2}"))
    page = Reader(label_table(read_records(root)))
    assert page.text("td") == ["2", "1", "0", "3", "1", "0", "0", "1"]  # train, validation, test, all
    widths = [float(found["width"]) for found in page.all("rect")]
    np.testing.assert_allclose(widths, [100, 100 / 3], atol=0.01)


def test_samples_are_spread_over_the_splits() -> None:
    assert chosen_positions({"train": 1000, "validation": 0, "test": 3}, 24)["train"][0] == 20
    chosen = chosen_positions({"train": 48, "validation": 8, "test": 8}, 24)
    assert {split: len(found) for split, found in chosen.items()} == {"train": 18, "validation": 3, "test": 3}
    assert [len(found) for found in chosen_positions({"train": 9000, "test": 2}, 4).values()] == [4, 1]
    assert [len(found) for found in chosen_positions({"train": 2, "test": 2}, 50).values()] == [2, 2]


def test_signal_to_noise_ratio() -> None:
    rng = np.random.default_rng(1)
    clean = rng.random((3, 200, 200)).astype(np.float32)
    noisy = clean + rng.normal(0, 0.01, clean.shape).astype(np.float32)
    found = snr_db(noisy, clean)
    assert found == pytest.approx(20 * np.log10(np.sqrt(1 / 3) / 0.01), abs=0.05)
    assert snr_db(clean, clean) is None


def test_frames_of_clips_stand_one_after_the_other(samples: ModuleType, tmp_path: Path) -> None:
    """Of 20 frames 12 are shown, each with its time; without JavaScript the first."""
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_clip_sample(index, frames=20))
    page = Reader(report_html(root))
    truths = [found for found in page.all("img") if found["alt"].startswith("ground truth of train/s00000001, frame ")]
    assert [found["data-frame"] for found in truths] == [str(number) for number in range(12)]
    assert ["hidden" in found for found in truths] == [False, *[True] * 11]
    assert truths[0]["data-time"] == "frame 1 of 20, 0 to 0.5 ms"
    assert truths[-1]["data-time"] == "frame 20 of 20, 9.5 to 10 ms"
    sliders = [found["aria-label"] for found in page.all("input", type="range") if "aria-label" in found]
    assert sliders == [f"Frame of {name}" for name in cards(page)]
    many = Reader(report_html(root, samples=100))
    assert len([found for found in many.all("img") if "data-frame" in found]) == 4 * 2 * 2  # fewer frames of each


def test_the_same_data_set_gives_the_same_bytes(trial_set: Path) -> None:
    assert report_html(trial_set) == report_html(str(trial_set))


# ---- one file, for everybody


def test_the_page_needs_nothing_else_and_runs_nothing_else(page: Reader) -> None:
    """All addresses are data or places in the page; script and style are the two that the policy names by their hash."""
    for _, found in page.elements:
        assert not {name for name in found if name.startswith("on")} | ({"style"} & set(found))
        for name in ("src", "href"):
            assert found.get(name, "#").startswith(("#", "data:image/webp;base64,"))
    (policy,) = [found["content"] for found in page.all("meta") if "http-equiv" in found]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert (rules["default-src"], rules["img-src"]) == ("'none'", "data:")
    (style,), (_, script) = page.text("style"), page.text("script")
    for rule, text in (("style-src", style), ("script-src", script)):
        assert rules[rule] == f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        assert not re.search(r"https?:|@import|url\(", text)


def test_the_page_is_accessible(page: Reader) -> None:
    assert page.all("html", lang="en")
    for landmark in ("header", "nav", "main", "footer"):
        assert len(page.all(landmark)) == 1
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    assert all(len(found["alt"]) > 20 for found in page.all("img"))
    assert all("aria-label" in found or "aria-hidden" in found for found in page.all("svg"))
    assert all("aria-label" in found or found["inside"].endswith("label") for found in page.all("input"))
    assert all("scope" in found for found in page.all("th"))
    names = [found["id"] for _, found in page.elements if "id" in found]
    assert len(names) == len(set(names))
    linked = [found["href"][1:] for found in page.all("a")]
    linked += [found["aria-labelledby"] for _, found in page.elements if "aria-labelledby" in found]
    assert set(linked) <= set(names)


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_text_is_told_from_its_ground(scheme: int) -> None:
    """WCAG 2.2, 1.4.3: a contrast of at least 4.5."""
    style = (files("simulator.plots.report") / "page.css").read_text(encoding="utf-8")
    colours = dict(re.findall(r"--(\w+): (#\w+);", style.split(":root {")[1]))
    if scheme:
        colours |= dict(re.findall(r"--(\w+): (#\w+);", style.split(":root {")[2]))

    def luminance(colour: str) -> float:
        digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
        linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4
                  for value in np.frombuffer(bytes.fromhex(digits), np.uint8) / 255]  # fmt: skip
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    for ground in ("ground", "raised"):
        for ink in ("ink", "faint", "accent", "warm"):
            dark, light = sorted((luminance(colours[ground]), luminance(colours[ink])))
            assert (light + 0.05) / (dark + 0.05) >= 4.5, (ground, ink)


# ---- foreign and damaged data

EVIL = '"><script>alert(1)</script><img src=x onerror=alert(2)>$title'


def test_nothing_of_a_data_set_becomes_markup(samples: ModuleType, tmp_path: Path) -> None:
    def make(index: int):
        return samples.make_sample(index, label=EVIL, metadata={"saturated_share": EVIL, "black_share": 0.5})

    root = samples.make_dataset(tmp_path / "set", make)
    info = replace(read_info(root), name=EVIL, versions={EVIL: EVIL}, backend=EVIL, exposure={EVIL: EVIL})
    write_info(root, replace(info, config={EVIL: [EVIL]}))
    with SkippedWriter(root) as skipped:
        skipped.append("train", 7, EVIL)
    with FailedWriter(root) as failed:
        failed.append("train", 8, EVIL, 3, EVIL)
    description = json.loads((root / "psf/psf.json").read_text())
    description["provenance"] = {
        "model": EVIL,
        "budget": [dict.fromkeys(("name", "kind", "change"), EVIL) | {"value": 1}],
    }
    (root / "psf/psf.json").write_text(json.dumps(description))
    page = Reader(report_html(root))
    assert len(page.all("script")) == 2
    assert not [found for _, found in page.elements if "onerror" in found or found.get("src") == "x"]
    text = " ".join(text for _, text in page.texts)
    assert page.text("h1") == [EVIL]
    assert text.count(EVIL) >= 15
    assert "None" not in text


def test_damaged_samples_are_left_out_and_named(dataset: Path) -> None:
    measurement = dataset / "train/0000/s00000001/measurement.exr"
    measurement.write_bytes(measurement.read_bytes()[:-100])
    (dataset / "train/0000/s00000002/sample.json").write_text("{}")
    page = Reader(report_html(dataset))
    assert cards(page) == ["train/s00000000", "validation/s00000000"]
    lines = page.text("li")
    assert [line.split(":")[0] for line in lines] == ["train/s00000001", "train/s00000002"]
    assert "train/0000/s00000001/measurement.exr" in lines[0]
    moved = dataset.rename(dataset.with_name("elsewhere"))
    assert Reader(report_html(moved)).text("li") == lines


def test_a_damaged_manifest_is_named(dataset: Path) -> None:
    (dataset / "manifest.jsonl").write_text("{}\n")
    page = Reader(report_html(dataset))
    assert cards(page) == []
    assert [line.split(":")[0] for line in page.text("li")] == ["manifest.jsonl"]


def test_a_page_without_samples_or_psfs(samples: ModuleType, tmp_path: Path) -> None:
    write_info(tmp_path, samples.make_info())
    with FailedWriter(tmp_path) as failed:
        for index in range(60):
            failed.append("train", index, "ZeroDivisionError: no clip", 1, "Traceback: here")
    page = Reader(report_html(tmp_path))
    text = " ".join(text for _, text in page.texts)
    for words in ("0 of 4", "No sample is finished.", "60 samples could not be made", "And 10 more.", "psf"):
        assert words in text
    assert text.count("Traceback: here") == 50
    (tmp_path / "failed.jsonl").write_text('{"id": 3}\n')
    assert any("failed.jsonl:1" in line for line in Reader(report_html(tmp_path)).text("li"))


@pytest.mark.parametrize("budget", [[{"name": "x"}], [{"name": "a", "value": "b", "kind": "c", "change": "d"}], 7])
def test_damaged_budgets_are_named(dataset: Path, budget: object) -> None:
    description = json.loads((dataset / "psf/psf.json").read_text())
    description["provenance"] = {"budget": budget, "mask": 3}
    (dataset / "psf/psf.json").write_text(json.dumps(description))
    assert [line.split(":")[1].strip() for line in Reader(report_html(dataset)).text("li")] == [
        "provenance.budget",
        "provenance",
    ]


def test_what_is_refused(tmp_path: Path, dataset: Path) -> None:
    with pytest.raises(InputError, match=re.escape(str(tmp_path / "no"))):
        report_html(tmp_path / "no")
    with pytest.raises(InputError, match=r"^samples: "):
        report_html(dataset, samples=0)


# ---- on disk


def test_a_sealed_data_set_stays_whole(dataset: Path) -> None:
    before = verify(dataset).problems
    path = write_report(dataset)
    assert path == dataset / "report.html"
    assert path.read_text() == report_html(dataset)
    assert verify(dataset).problems == before
    path.write_text("changed")
    assert any("report.html" in line for line in verify(dataset).problems)
    write_report(dataset)
    assert verify(dataset).problems == before


@pytest.mark.slow
def test_the_page_of_a_large_and_noisy_data_set_stays_small(samples: ModuleType, tmp_path: Path) -> None:
    """A thousand clips of pure noise, which no encoding makes small, and 40 PSFs of noise."""
    rng = np.random.default_rng(3)
    root, frames, sensor, scene = tmp_path / "set", 12, (480, 640), (160, 160)
    root.mkdir()
    write_info(root, samples.make_info(sensor_shape=sensor, scene_shape=scene, counts={"train": 1000}))
    noise = rng.random((3, *sensor), dtype=np.float32)
    sample = samples.make_clip_sample(
        0,
        measurement=noise,
        noiseless=noise,
        rgb=rng.random((frames, *scene, 3), dtype=np.float32),
        depth_m=rng.uniform(0.03, 0.2, (frames, *scene)).astype(np.float32),
        valid=np.ones((frames, *scene), bool),
        extras={},
        frame_edges_s=np.linspace(0, 0.01, frames + 1),
        global_measurements=None,
    )
    shown = chosen_positions({"train": 1000}, 24)["train"]
    with ManifestWriter(root) as manifest:
        for index in range(1000):  # only those that are shown have files
            record = (
                write_sample(root, "train", index, sample) if index in shown else replace(RECORD, id=f"s{index:08d}")
            )
            manifest.append(record, 0.1)
    stack = samples.PsfStack(
        rng.random((40, 3, 500, 500), dtype=np.float32), np.linspace(0.03, 0.2, 40), 2e-5, ("R", "G", "B"), "a" * 64
    )
    samples.write_psf_stack(root / "psf", stack)
    page = report_html(root)
    assert page.count('class="card"') == 24
    assert len(page) < 10e6
