"""Something-Something V2 in its original files: labels, tables of classes, and each mistake by name."""

import json
import shutil

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.importers import film
from simulator.importers.something_something_v2 import (
    COARSE_TABLE,
    read_table,
    read_templates,
    recognises,
    something_something_v2,
    survey,
)
from simulator.types import View

VIEW = View(shape=(16, 16), pixel_pitch_m=19.2e-6, distance_m=1.9e-3, near_m=0.04, far_m=0.2)
LABELS = {
    "Closing something": "0",
    "Holding something": "1",
    "Pushing something from left to right": "2",
    "Putting something, something and something on the table": "3",
}
ENTRIES = [
    ("30", "Closing [something]"),
    ("4", "Pushing [something] from left to right"),
    ("100", "Putting [something], [something] and [something] on the table"),
    ("7", "Closing [something]"),  # its clip is not there
    ("55", "Holding [something]"),
]


def entry(identity, template):
    words = [f"thing {i}" for i in range(template.count("["))]
    return {"id": identity, "label": template.lower(), "template": template, "placeholders": words}


def write_json(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


@pytest.fixture
def root(films, tmp_path):
    """The original layout with four tiny clips, in the order 30, 4, 100, 55 of 8, 9, 10 and 11 frames."""
    for number, identity in enumerate(("30", "4", "100", "55")):
        films.write(tmp_path / "20bn-something-something-v2" / f"{identity}.webm", films.numbered(8 + number, (24, 32)))
    write_json(tmp_path / "something-something-v2-labels.json", LABELS)
    write_json(tmp_path / "something-something-v2-validation.json", [entry(*item) for item in ENTRIES])
    return tmp_path


def clips(root, **options):
    return something_something_v2(VIEW, path=root, **({"frames": 4} | options))


def labels_of(source):
    return [video.label for video in source.videos]


def test_clips_carry_their_templates_in_the_files_order(root, films):
    source = clips(root, frames=8)
    names = [f"20bn-something-something-v2/{identity}.webm" for identity in (30, 4, 100, 55)]
    assert [video.name for video in source.videos] == names
    assert labels_of(source) == [list(LABELS)[number] for number in (0, 2, 3, 1)]
    clip = source.clip(0, np.random.default_rng(0))
    assert clip.label == "Closing something"
    assert [films.number_of(frame) for frame in clip.rgb] == list(range(8))
    assert source.problems == ()
    names = {path.name for path in source.inputs}
    assert {"something-something-v2-labels.json", "something-something-v2-validation.json", "30.webm"} <= names


def table(root, text="template,class\nClosing something,shut\nHolding [something],hold\n"):
    path = root / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_train_is_taken_before_validation_unless_it_is_said(root):
    write_json(root / "something-something-v2-train.json", [entry("55", "Holding [something]")])
    assert labels_of(clips(root)) == ["Holding something"]
    assert len(clips(root, subset="validation")) == 4


def test_short_names_and_a_folder_of_labels_do_as_well(root):
    for name in ("labels", "validation"):
        (root / "labels").mkdir(exist_ok=True)
        (root / f"something-something-v2-{name}.json").rename(root / "labels" / f"{name}.json")
    (root / "20bn-something-something-v2").rename(root / "clips")
    assert recognises(root)
    assert not film.recognises(root)
    assert clips(root).videos[0].name == "clips/30.webm"


def test_a_table_groups_templates_and_leaves_out_the_others(root):
    text = "# mine\ntemplate,class\n\nClosing [something],shut\nHolding something,hold\n"
    source = clips(root, classes=table(root, text))
    assert labels_of(source) == ["shut", "hold"]
    assert root / "table.csv" in source.inputs
    quoted = '"Putting something, something and something on the table","put, all"'
    assert labels_of(clips(root, classes=table(root, f"template,class\n{quoted}\n"))) == ["put, all"]
    unmarked = "template,class\nPushing something from left to right,x\n"
    assert labels_of(clips(root, classes=table(root, unmarked))) == ["x"]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("template,class\nClosing somethin,shut\n", ":2"),
        ("# a\n\ntemplate,class\nClosing something,\n", ":4"),
        ("template,class\nClosing something,a\nClosing [something],b\n", ":3"),
        ("template,class\nPutting something, something and something on the table,put\n", ":2"),
        ("label,class\nClosing something,a\n", ""),
        ("", ""),
        ("template,class\n", ""),
        ('template,class\n"Closing something,a\n', ":2"),
    ],
)
def test_a_wrong_table_is_told_with_its_line(root, text, place):
    with pytest.raises(InputError, match=rf"table\.csv{place}: "):
        clips(root, classes=table(root, text))


def test_a_table_that_is_not_there_or_fits_no_clip_is_told(root):
    with pytest.raises(InputError, match=r"^classes: "):
        clips(root, classes=root / "coarze")
    for identity in ("30", "4", "100"):
        (root / "20bn-something-something-v2" / f"{identity}.webm").unlink()
    with pytest.raises(InputError, match=r"^classes: "):
        clips(root, classes=table(root, "template,class\nClosing something,shut\n"))


def test_an_unknown_label_is_a_problem_with_the_nearest_one(root):
    name = "something-something-v2-validation.json"
    entries = [entry("30", "Closing [somethings]"), entry("55", "Holding [something]"), entry("7", "Juggling [things]")]
    write_json(root / name, entries)
    source = clips(root)
    assert labels_of(source) == ["Holding something"]
    (problem,) = source.problems  # clip 7 is not there
    assert problem.startswith(f"{name}: clip 30 has the unknown template 'Closing [somethings]'")
    assert problem.endswith("did you mean 'Closing something'?")
    found = survey(root)
    assert found.problems == source.problems
    assert found.facts["subset"] == "validation, 3 clips listed, 2 in the folder"
    assert found.notes == (f"1 of the 3 clips in {name} are not in the folder",)
    write_json(root / name, entries[:1])
    with pytest.raises(InputError, match=r"^path: "):
        clips(root)


@pytest.mark.parametrize(
    "content",
    [
        [{"id": "30"}],
        [{"template": "Closing [something]"}],
        [{"id": "../x", "template": "Closing [something]"}],
        [entry("30", "Closing [something]")] * 2,
        *({}, [], "["),
    ],
)
def test_a_broken_subset_file_is_named(root, content):
    write_json(root / "something-something-v2-validation.json", content)
    with pytest.raises(InputError, match=r"something-something-v2-validation\.json: "):
        clips(root)
    labels = root / "something-something-v2-labels.json"
    for text in ('{"Closing something": ', '["Closing something"]'):
        labels.write_text(text)
        with pytest.raises(InputError, match=r"something-something-v2-labels\.json: "):
            clips(root)


def test_missing_parts_are_named(root, tmp_path):
    with pytest.raises(InputError, match=r"^path: "):
        clips(root, subset="train")
    shutil.rmtree(root / "20bn-something-something-v2")
    with pytest.raises(InputError, match=r"^path: "):
        clips(root)
    (root / "clips").mkdir()
    (root / "clips" / "12345.webm").write_bytes(b"")
    with pytest.raises(InputError, match=r"^path: "):
        clips(root)
    (root / "something-something-v2-labels.json").unlink()
    with pytest.raises(InputError, match=r"^path: "):
        clips(root)
    assert not recognises(root)
    with pytest.raises(InputError, match=r"^path: "):
        clips(tmp_path / "nowhere")


def test_survey_counts_classes_and_notes_what_is_absent(root):
    path = root / "20bn-something-something-v2" / "4.webm"
    path.write_bytes(path.read_bytes()[:-1200])
    found = survey(root)
    assert (found.importer, found.usable) == ("something_something_v2", 3)
    assert found.facts["subset"] == "validation, 5 clips listed, 4 in the folder"
    assert found.facts["classes"].startswith("3 of 4: ")
    assert found.facts["frames"] == "29 (8 to 11 per video)"
    assert [problem.partition(":")[0] for problem in found.problems] == ["20bn-something-something-v2/4.webm"]
    assert found.notes == ("1 of the 5 clips in something-something-v2-validation.json are not in the folder",)
    assert clips(root).problems == found.problems
    found = survey(root, classes=table(root), frames=9)
    assert found.usable == 1
    assert "2 clips are of templates that table.csv leaves out" in found.notes
    assert any("has 8 frames, but a clip of 9 takes 9" in problem for problem in found.problems)


def test_the_coarse_table_says_that_it_is_reconstructed_and_has_41_templates():
    head, _, rows = COARSE_TABLE.read_text(encoding="utf-8").partition("template,class\n")
    assert "RECONSTRUCTED" in head
    assert len(rows.splitlines()) == 41


@pytest.mark.shared
def test_the_coarse_table_fits_the_real_labels(shared_data):
    labels = shared_data / "ssv2" / "something-something-v2-labels.json"
    templates = read_templates(labels)
    assert len(templates) == 174
    coarse = read_table(COARSE_TABLE, templates, labels)
    assert len(coarse) == 41
    assert len(set(coarse.values())) == 10


@pytest.mark.shared
def test_real_clips_and_label_files(shared_data, tmp_path):
    samples = shared_data / "ssv2"
    shutil.copy(samples / "something-something-v2-labels.json", tmp_path)
    listed = json.loads((samples / "something-something-v2-validation.first400.json").read_bytes())
    write_json(tmp_path / "something-something-v2-validation.json", listed)
    (tmp_path / "clips").mkdir()
    # The samples are not of this subset: they stand in for clips that are.
    known = {"closing_0": ("Closing [something]", 52), "166766": ("Picking [something] up", 49)}
    for name, (template, _) in known.items():
        identity = next(item["id"] for item in listed if item["template"] == template)
        shutil.copy(samples / "clips" / f"{name}.webm", tmp_path / "clips" / f"{identity}.webm")
    source = something_something_v2(VIEW, path=tmp_path, frames=49)
    assert {video.label: len(video) for video in source.videos} == {"Closing something": 52, "Picking something up": 49}
    coarse = something_something_v2(VIEW, path=tmp_path, frames=49, classes="coarse")
    assert labels_of(coarse) == ["Picking something up"]
    assert source.clip(0, np.random.default_rng(0)).rgb.shape == (49, 16, 16, 3)
