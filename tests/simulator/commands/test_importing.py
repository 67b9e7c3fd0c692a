"""``import --check``: which importer, what it found, and what a user is told to do next."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from simulator.importers import film
from simulator.importers.inspection import choose, find_candidates


@pytest.fixture
def davis_root(tmp_path) -> Path:
    root = tmp_path / "set of: videos"  # a path that YAML would misread without quotes
    for name in ("bear", "dog"):
        for number in range(3):
            for folder in ("JPEGImages", "Annotations"):
                (root / folder / "480p" / name).mkdir(parents=True, exist_ok=True)
            picture = np.full((8, 12, 3), 90, np.uint8)
            Image.fromarray(picture).save(root / "JPEGImages" / "480p" / name / f"{number:05d}.jpg")
            mask = Image.fromarray(np.eye(8, 12, dtype=np.uint8), "P")
            mask.putpalette([0, 0, 0, 128, 0, 0])
            mask.save(root / "Annotations" / "480p" / name / f"{number:05d}.png")
    return root


def test_a_good_folder(flatlight, davis_root) -> None:
    code, out, err = flatlight("import", "--check", davis_root)
    assert code == 0
    assert f"{davis_root}: davis, 2 usable" in out
    assert "6 (3 to 3 per video, median 3)" in out
    assert "problem" not in out
    assert "read: 6 of 6" in err
    for words in (("--check",), ()):
        assert flatlight("import", davis_root, *words)[1] == out


def test_the_line_to_use_is_yaml_that_loads(flatlight, davis_root, tmp_path, make_trial) -> None:
    _, out, _ = flatlight("import", "--check", davis_root, "--set", "keep_background=true")
    (line,) = [line for line in out.splitlines() if line.startswith("  scene: ")]
    scene: dict[str, Any] = yaml.safe_load(line)["scene"]
    assert scene == {
        "source": "davis",
        "path": str(davis_root),
        "size": [128, 128],
        "keep_background": True,
        "frames": "...",
    }
    assert "where frames is: whole number from 1; " in out
    assert out.rstrip().endswith("the published videos have 25 to 104; those here have 3"), "hints that agree"
    from simulator.config import load_config

    trial = make_trial(tmp_path / "trial")
    assert load_config(trial.write(scene=scene | {"frames": 3, "size": [16, 20]})).scene.source == "davis"


def test_problems_fail_unless_they_are_skipped(flatlight, davis_root, one_error) -> None:
    (davis_root / "JPEGImages" / "480p" / "dog" / "00001.jpg").write_bytes(b"no picture")
    result = flatlight("import", "--check", davis_root)
    one_error(result, "--skip-bad")
    assert "problem: JPEGImages/480p/dog/00001.jpg: " in result[1]
    assert "scene:" not in result[1]
    code, out, _ = flatlight("import", "--check", davis_root, "--skip-bad")
    assert code == 0
    assert "davis, 1 usable" in out
    assert "problem: JPEGImages/480p/dog/00001.jpg" in out
    assert "scene: {source: davis" in out
    for mask in davis_root.rglob("*.png"):
        mask.write_bytes(b"no picture")
    one_error(flatlight("import", "--check", davis_root, "--skip-bad"), f"{davis_root}: ")


def test_options_are_those_of_the_survey(flatlight, davis_root, one_error) -> None:
    run = "import", "--check", davis_root, "--set"
    one_error(flatlight(*run, "subset=train"), "subset: ")
    one_error(flatlight(*run, "subse=train"), "subse: ", "'subset'")
    one_error(flatlight(*run, "crop=centre"), "crop: ")  # decides how clips are cut, not what is there
    one_error(flatlight(*run, "size=55"), "--set: size")
    assert "did you mean" not in flatlight(*run, "size=55")[2]
    one_error(flatlight(*run, "frames=0"), "frames: ")
    one_error(flatlight(*run, "keep_background=3"), "keep_background")


def test_what_no_importer_knows(flatlight, tmp_path, one_error) -> None:
    (tmp_path / "empty").mkdir()
    result = flatlight("import", "--check", tmp_path / "empty")
    one_error(result, "--source", "davis: DAVIS 2016 and 2017", "path: the folder that holds")
    one_error(flatlight("import", "--check", tmp_path / "no"), str(tmp_path / "no"))
    one_error(flatlight("import", "--check", tmp_path, "--source", "davs"), "'davs'", "'davis'")
    one_error(flatlight("import", "--check", tmp_path / "empty", "--source", "davis"), "JPEGImages/480p")


def test_nothing_in_the_folder_is_imported(flatlight, davis_root, monkeypatch, tmp_path) -> None:
    for place in (davis_root, davis_root / "JPEGImages", davis_root / "JPEGImages" / "480p" / "dog"):
        for name in ("__init__.py", "sitecustomize.py", "numpy.py", "davis.py"):
            (place / name).write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n", encoding="utf-8")
    monkeypatch.chdir(davis_root)
    assert flatlight("import", "--check", ".")[0] == 0
    assert not (tmp_path / "ran").exists()


SOURCE = '''
"""Boxes of rocks."""

from pathlib import Path

{imports}

def {name}(view, *, path: Path, weight: float, kind: str = "flint"):
    """Rocks.

    Args:
        path: a folder that holds rocks.txt.
        weight: of each, grams.
    """
'''
SURVEY = """
def recognises(path):
    {recognises}

def survey(path, progress=None, *, kind="flint"):
    progress(1, 1)
    return Survey("{name}", path, 3, {{"rocks": "3", "kind": kind}})
"""


@pytest.fixture
def install_sources(install) -> Callable[..., None]:
    """Install a package of sources, each with what its ``recognises`` does, or None for neither that nor a survey."""

    def install_package(package: str, **sources: str | None) -> None:
        code = {name: source(name, recognises) for name, recognises in sources.items()}
        install(package, f"[flatlight.sources]\n{package} = {package}\n", **code)

    return install_package


def source(name: str, recognises: str | None) -> str:
    if recognises is None:
        return SOURCE.format(name=name, imports="")
    imports = "from simulator.importers import Survey\n"
    return SOURCE.format(name=name, imports=imports) + SURVEY.format(name=name, recognises=recognises)


IS_ROCKS = "return (path / 'rocks.txt').is_file()"


@pytest.fixture
def rocks(tmp_path) -> Path:
    (tmp_path / "rocks").mkdir()
    (tmp_path / "rocks" / "rocks.txt").touch()
    return tmp_path / "rocks"


def test_a_source_of_another_package(flatlight, install_sources, rocks) -> None:
    install_sources("geology_one", pebbles=IS_ROCKS)
    code, out, _ = flatlight("import", "--check", rocks, "--set", "kind=chalk")
    assert code == 0
    assert f"{rocks}: pebbles, 3 usable" in out
    assert "kind   chalk" in out
    assert 'kind: "chalk", weight: ...}' in out
    assert "where weight is: number; of each, grams" in out


def test_two_that_recognise_the_same(flatlight, install_sources, rocks, one_error) -> None:
    install_sources("geology_two", boulders=IS_ROCKS, gravel=IS_ROCKS)
    result = flatlight("import", "--check", rocks)
    one_error(result, "--source", "boulders: Boxes of rocks.", "gravel: Boxes of rocks.")
    assert "davis" not in result[2]
    assert "gravel, 3 usable" in flatlight("import", "--check", rocks, "--source", "gravel")[1]


def test_sources_that_cannot_tell_or_fail_do_not_stand_in_the_way(
    flatlight, install_sources, davis_root, rocks, one_error
) -> None:
    install_sources("geology_three", mute=None, faulty="return 1 / 0")
    code, out, err = flatlight("import", "--check", davis_root)
    assert code == 0
    assert "davis, 2 usable" in out
    assert "warning: this source cannot be asked: faulty: ZeroDivisionError" in err
    one_error(flatlight("import", "--check", rocks), "mute: Boxes of rocks")
    one_error(flatlight("import", "--check", rocks, "--source", "mute"), "'mute'", "survey(path, progress)")


@pytest.mark.parametrize(
    ("names", "folder", "source"),
    [
        (("Frames/image_0000.png", "Pixelwise Depths/aov_image_0000.png"), ".", "endoslam"),
        (("FrameBuffer_0001/FrameBuffer_0000.png", "Depth_0001/Depth_0000.png"), ".", "endoslam"),
        (("RGB_cleanpass/left/A-1-6.png", "disparity/left/A-1-6.pfm"), "RGB_cleanpass", "flyingthings3d"),
    ],
)
def test_folders_of_pictures_of_a_known_data_set(tmp_path, names, folder, source) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    candidates = find_candidates(tmp_path / folder)
    assert choose(tmp_path / folder, candidates).name == source
    assert film.recognises(tmp_path / folder)  # it alone would take them for films


def moving(count: int, seed: int = 0) -> list[np.ndarray]:
    """Frames of a scene that moves down by a row each."""
    blocks = np.random.default_rng(seed).integers(0, 255, (12, 8, 3), dtype=np.uint8)
    whole = blocks.repeat(8, 0).repeat(8, 1)
    return [whole[number : number + 48] for number in range(count)]


@pytest.mark.parametrize(
    ("pictures", "doubt"),
    [
        ({f"IMG_{2000 + n}.png": moving(1, n)[0] for n in range(6)}, "as photographs do"),
        ({f"{n}.png": moving(1)[0][n:] for n in range(6)}, "differ in size"),
        ({f"{name}.png": moving(1)[0] for name in ("beach", "food", "hotel")}, "do not count on"),
        ({f"{n}.png": moving(1)[0] for n in range(2)}, "only 2 images"),
    ],
)
def test_not_every_folder_of_pictures_is_a_film(flatlight, tmp_path, one_error, pictures, doubt) -> None:
    (tmp_path / "holiday").mkdir()
    for name, picture in pictures.items():
        Image.fromarray(picture).save(tmp_path / "holiday" / name)
    result = flatlight("import", "--check", tmp_path / "holiday")
    one_error(result, "--source", "film  possible", doubt, "family: files")
    assert "film, 1 usable" in flatlight("import", "--check", tmp_path / "holiday", "--source", "film", "--skip-bad")[
        1
    ] or ("size" in doubt)


def test_masks_of_objects_are_no_film(tmp_path) -> None:
    for number in range(4):
        mask = Image.fromarray(np.eye(8, 12, dtype=np.uint8), "P")
        mask.putpalette([0, 0, 0, 128, 0, 0])
        mask.save(tmp_path / f"{number}.png")
    likeness = film.recognises(tmp_path)
    assert likeness is not None
    assert (likeness.sure, "palette" in likeness.why) == ("possible", True)


def test_images_with_depth_beside_them_are_told_from_two_films(flatlight, tmp_path) -> None:
    """Two folders with the same numbers: only what is stored in 16 bits of grey tells a chart."""
    for number, frame in enumerate(moving(4)):
        for folder in ("depth", "films"):
            for part in "ab":
                (tmp_path / folder / part).mkdir(parents=True, exist_ok=True)
                Image.fromarray(frame).save(tmp_path / folder / part / f"{number:03}.png")
        chart = np.full(frame.shape[:2], 1500 + number, np.uint16)
        chart[:4] = 0
        Image.fromarray(chart).save(tmp_path / "depth" / "b" / f"{number:03}.png")
    assert "/films looks like\n  film  likely" in flatlight("import", "--check", tmp_path / "films")[1]
    code, out, _ = flatlight("import", "--check", tmp_path / "depth")
    assert code == 0
    assert "rgb_depth  likely    4 of 4 charts pair with an image by name; charts are 16 bit codes 0 to 1500" in out
    assert "film       likely" in out
    (line,) = [line for line in out.splitlines() if line.startswith("  scene: ")]
    scene = yaml.safe_load(line)["scene"]
    assert (scene["images"], scene["depths"], scene["depth"]) == (
        "a/*.png",
        "b/*.png",
        {"type": "metric", "unit": "mm"},
    )
    assert "mm is a guess, by which the first chart reaches 1.5 m" in out


def test_films_step_aside_where_another_source_knows_the_folder(flatlight, install_sources, tmp_path) -> None:
    install_sources("layouts", boxes_of_frames="return (path / 'known').is_file()")
    pictures = tmp_path / "pictures"
    (pictures / "a").mkdir(parents=True)
    for number in range(3):
        Image.fromarray(np.full((8, 12, 3), 90 + number, np.uint8)).save(pictures / "a" / f"{number}.png")
    assert choose(pictures, find_candidates(pictures)).name == "film"
    _, out, _ = flatlight("import", "--check", pictures)
    assert "frames: ..., frames_per_second: ...}" in out
    assert "where frames_per_second is: " in out
    (pictures / "a" / "known").touch()
    inside = find_candidates(pictures / "a")
    assert choose(pictures / "a", inside).name == "boxes_of_frames"
    assert [plugin.name for plugin, _ in inside.recognised] == ["boxes_of_frames", "film"]


def test_a_folder_that_may_not_be_read_is_named(flatlight, davis_root, monkeypatch, one_error) -> None:
    def forbidden(path):
        raise PermissionError(13, "Permission denied", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(os, "scandir", forbidden)
        one_error(flatlight("import", "--check", davis_root), f"path: {davis_root} ")
        run = "import", "--check", davis_root, "--source"
        one_error(flatlight(*run, "davis"), f"path: {davis_root}/")


def test_a_users_own_file(flatlight, rocks, tmp_path, monkeypatch) -> None:
    (tmp_path / "mine.py").write_text(source("mine", "return False"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code, out, _ = flatlight("import", "--check", rocks, "--source", "./mine.py:mine")
    assert code == 0
    assert "mine, 3 usable" in out
    assert "source: ./mine.py:mine" in out


def test_a_survey_that_meets_a_closed_door_says_where(
    flatlight, install_sources, rocks, monkeypatch, one_error
) -> None:
    fault = "raise PermissionError(13, 'Permission denied', str(path / 'cave'))"
    monkeypatch.setitem(globals(), "SURVEY", SURVEY.replace("progress(1, 1)", fault))
    install_sources("geology_four", closed=IS_ROCKS)
    one_error(flatlight("import", "--check", rocks), f"path: {rocks / 'cave'} ")
