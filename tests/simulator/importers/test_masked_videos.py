"""YouTube-VOS and DAVIS folders become clips: masks, gamma, edges, frame rates, labels, lists, and each mistake by name."""

import json
import pickle
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.importers import davis as davis_module
from simulator.importers import youtube_vos as youtube_vos_module
from simulator.importers.davis import davis
from simulator.importers.youtube_vos import youtube_vos
from simulator.types import SceneSource, View

SHAPE = (8, 12)
VIEW = View(shape=SHAPE, pixel_pitch_m=19.2e-6, distance_m=1.9e-3, near_m=0.04, far_m=0.2)
# The first colours of the palette that both data sets use; 255 is a light grey.
PALETTE = [0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0] + [0] * (3 * 252 - 3) + [224, 224, 192]
ROUNDING = {"rtol": 2**-23, "atol": 0}  # float32


def linear(value):
    """IEC 61966-2-1, above its threshold."""
    return ((np.asarray(value) / 255 + 0.055) / 1.055) ** 2.4


def write_picture(path, value, shape=SHAPE):
    """Save one grey; at this quality a JPEG of one grey is exact."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((*shape, 3), value, np.uint8)).save(path, quality=100, subsampling=0)


def write_mask(path, numbers):
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(np.asarray(numbers, np.uint8), "P")
    image.putpalette(PALETTE)
    image.save(path)


def box(rows, columns, number=1, shape=SHAPE):
    numbers = np.zeros(shape, np.uint8)
    numbers[rows, columns] = number
    return numbers


LEFT = box(slice(None), slice(0, 6))


class Tube:
    """A YouTube-VOS folder under construction."""

    def __init__(self, root: Path, subset: str = "train") -> None:
        self.root, self.folder = root, root / subset
        self.videos: dict[str, dict] = {}

    def video(self, name, frames, masks, objects=(("1", "zebra"),), value=188):
        for number in frames:
            write_picture(self.folder / "JPEGImages" / name / f"{number:05d}.jpg", value)
        for number, mask in masks.items():
            write_mask(self.folder / "Annotations" / name / f"{number:05d}.png", mask)
        found = {"frames": [f"{frame:05d}" for frame in masks]}
        listed = {number: found | ({"category": category} if category else {}) for number, category in objects}
        self.videos[name] = {"objects": listed}
        self.folder.mkdir(parents=True, exist_ok=True)
        self.meta()

    def meta(self):
        (self.folder / "meta.json").write_text(json.dumps({"videos": self.videos}), encoding="utf-8")

    def source(self, **parameters: Any):
        return youtube_vos(VIEW, path=self.root, **{"frames": 2, **parameters})


@pytest.fixture
def tube(tmp_path):
    found = Tube(tmp_path)
    found.video("a1b2", (0, 5, 10, 15), dict.fromkeys((0, 5, 10, 15), LEFT))
    return found


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def error_of(call, *arguments, **parameters) -> str:
    with pytest.raises(InputError) as caught:
        call(*arguments, **parameters)
    return str(caught.value)


def test_gamma_is_removed_and_so_is_the_background(tube, rng) -> None:
    source = tube.source()
    assert isinstance(source, SceneSource)
    clip = source.clip(0, rng)
    assert clip.rgb.shape == (2, *SHAPE, 3)
    # Half of the picture is lit; any gamma left would give 188/255 or its square root instead.
    np.testing.assert_allclose(clip.rgb[:, :, :6], linear(188), **ROUNDING)
    assert not clip.rgb[:, :, 6:].any()
    assert clip.rgb.mean() == pytest.approx(linear(188) / 2, rel=1e-6)
    assert clip.valid.all()
    assert set(clip.depth_m.ravel().tolist()) == {np.float32(0.2)}


def test_the_union_of_all_objects_stays_and_void_is_background(tmp_path, rng) -> None:
    tube = Tube(tmp_path)
    draw = np.random.default_rng(8)
    masks = {number: draw.integers(0, 4, SHAPE, dtype=np.uint8) for number in (0, 5)}
    tube.video("many", masks, masks, objects=(("1", "ape"), ("2", "owl"), ("3", "ape")))
    clip = tube.source().clip(0, rng)
    for frame, mask in zip(clip.rgb, masks.values(), strict=True):
        expected = np.where(np.isin(mask, (1, 2, 3)), linear(188), 0)[..., None]
        np.testing.assert_allclose(frame, np.broadcast_to(expected, frame.shape), **ROUNDING)
    assert clip.source["objects"] == [1, 2, 3]
    mask = LEFT + box(slice(None), slice(6, 9), 255)
    tube.video("a_void", (0, 5), {0: mask, 5: LEFT})
    clip = tube.source().clip(0, rng)
    assert (clip.rgb[0] > 0).any(axis=-1).sum() == 8 * 6
    assert clip.source["masks_with_void"] == ["00000"]
    assert "masks with void" in str(youtube_vos_module.survey(tmp_path))


def test_edges_mix_light_in_the_shares_of_their_areas(tmp_path, rng) -> None:
    tube = Tube(tmp_path)
    # Five of twelve columns: at half the size the third column is half object, half darkness, in linear light. A mask that is
    # shrunk by itself would leave 0 or 1 of it, and shrinking before gamma is removed something else than a half.
    tube.video("edge", (0, 5), dict.fromkeys((0, 5), box(slice(None), slice(0, 5))))
    clip = youtube_vos(replace(VIEW, shape=(4, 6)), path=tmp_path, frames=2).clip(0, rng)
    expected = linear(188) * np.array([1, 1, 0.5, 0, 0, 0])
    np.testing.assert_allclose(clip.rgb[0, :, :, 0], np.tile(expected, (4, 1)), rtol=1e-6, atol=1e-7)


def test_only_annotated_frames_are_used_in_the_order_of_their_numbers(tmp_path, rng) -> None:
    root = tmp_path / "davis"
    numbers = (1, 2, 3, 9, 10, 11)
    for number in numbers:  # names without leading zeros sort otherwise than their numbers
        write_picture(root / "images" / "x" / f"{number}.jpg", 100 + number)
    for number in (2, 9, 10):
        write_mask(root / "masks" / "x" / f"{number}.png", LEFT)
    clip = davis(VIEW, path=root, frames=3).clip(0, rng)
    np.testing.assert_allclose(clip.rgb[:, 0, 0, 0], linear([102, 109, 110]), **ROUNDING)
    assert clip.source["frames"] == ["2", "9", "10"]
    survey = str(davis_module.survey(root))
    assert "images without a mask, left out: 3" in survey
    assert "videos annotated at uneven steps, which are taken as even: 1 (x)" in survey


def test_frame_rates_follow_from_the_numbers(tube, davis_root, rng) -> None:
    clip = tube.source(frames=4).clip(0, rng)  # every fifth of 30 per second
    np.testing.assert_allclose(clip.frame_edges_s, np.arange(5) / 6, rtol=1e-12)
    for choice, rate in (({}, 24), ({"frames_per_second": 500}, 500)):
        clip = davis(VIEW, path=davis_root, frames=2, **choice).clip(0, rng)
        np.testing.assert_allclose(clip.frame_edges_s, np.arange(3) / rate, rtol=1e-12)
    clip = tube.source(frames=3, interpolate_by=2).clip(0, rng)
    np.testing.assert_allclose(clip.frame_edges_s, np.arange(4) / 12, rtol=1e-12)
    # The background went first, so nothing comes back between the frames.
    assert not clip.rgb[:, :, 8:].any()


def test_kept_background_uses_every_frame_and_reads_no_mask(tube, rng) -> None:
    write_picture(tube.folder / "JPEGImages" / "a1b2" / "00020.jpg", 188)
    (tube.folder / "Annotations" / "a1b2" / "00000.png").write_text("broken")
    source = tube.source(frames=5, keep_background=True)
    clip = source.clip(0, rng)
    np.testing.assert_allclose(clip.rgb, linear(188), **ROUNDING)
    assert all(file.suffix != ".png" for file in source.inputs)
    assert clip.source["background"] == "kept"


def test_labels_are_categories_that_all_objects_share(tmp_path, rng) -> None:
    tube = Tube(tmp_path)
    both = LEFT + box(slice(None), slice(8, 10), 2)
    tube.video("same", (0, 5), dict.fromkeys((0, 5), both), objects=(("1", "ape"), ("2", "ape")))
    tube.video("several", (0, 5), dict.fromkeys((0, 5), both), objects=(("1", "ape"), ("2", "owl")))
    tube.video("unnamed", (0, 5), dict.fromkeys((0, 5), both), objects=(("1", None), ("2", None)))
    source = tube.source()
    clips = [source.clip(index, rng) for index in range(3)]
    assert [clip.label for clip in clips] == ["ape", None, None]
    assert clips[1].source["categories"] == {"1": "ape", "2": "owl"}
    survey = youtube_vos_module.survey(tmp_path)
    assert survey.facts["categories"] == "2: ape 3, owl 1"
    assert survey.facts["labelled"].startswith("1 videos")


@pytest.mark.parametrize("spare", [-1, 1])
def test_a_mask_that_differs_by_a_pixel_is_resized_warned_of_and_recorded(tube, rng, spare) -> None:
    wide = box(slice(None), slice(0, 6), shape=(8, 12 + spare))
    write_mask(tube.folder / "Annotations" / "a1b2" / "00005.png", wide)
    source = tube.source(frames=4)
    with pytest.warns(UserWarning, match=r"a1b2/00005\.png"):
        clip = source.clip(0, rng)
    expected = np.asarray(Image.fromarray(wide).resize((12, 8), Image.Resampling.NEAREST)) > 0
    np.testing.assert_array_equal((clip.rgb[1] > 0).all(axis=-1), expected)
    assert clip.source["masks_resized_by_a_pixel"] == ["00005"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        source.clip(0, rng)  # told once, not for each clip
    assert "resized: 1 (Annotations/a1b2/00005.png)" in str(youtube_vos_module.survey(tube.root))


def test_a_mask_without_object_gives_a_black_frame_that_is_counted(tube, rng) -> None:
    write_mask(tube.folder / "Annotations" / "a1b2" / "00005.png", np.zeros(SHAPE))
    clip = tube.source(frames=4).clip(0, rng)
    assert clip.rgb.any(axis=(1, 2, 3)).tolist() == [True, False, True, True]
    assert clip.source["masks_without_object"] == ["00005"]
    assert "make black frames: 1 (Annotations/a1b2/00005.png)" in str(youtube_vos_module.survey(tube.root))


@pytest.mark.parametrize("number", [0, 255])
def test_masks_that_leave_nothing_are_refused_by_name(tmp_path, rng, number) -> None:
    """Masks of 0 and 255 in a palette are void everywhere, so a clip would be black from end to end."""
    tube = Tube(tmp_path)
    tube.video("empty", (0, 5, 10), dict.fromkeys((0, 5, 10), LEFT * number))
    assert re.match(r".*/Annotations/empty/000\d\d\.png: ", error_of(tube.source().clip, 0, rng))
    survey = youtube_vos_module.survey(tube.root)
    assert survey.usable == 0
    assert survey.problems[0].startswith("Annotations/empty/00000.png: ")
    assert tube.source(keep_background=True).clip(0, rng).rgb.all()
    write_mask(tube.folder / "Annotations" / "empty" / "00005.png", LEFT)
    assert tube.source().clip(0, rng).rgb.any(), "one of any two frames has an object"


def test_suffixes_may_be_in_capitals(tube, rng) -> None:
    expected = tube.source(frames=4).clip(0, rng)
    for file in [*tube.folder.glob("Annotations/*/*"), *tube.folder.glob("JPEGImages/*/*")]:
        file.rename(file.with_suffix(file.suffix.upper()))
    source = tube.source(frames=4)
    np.testing.assert_array_equal(source.clip(0, rng).rgb, expected.rgb)
    assert tube.folder / "Annotations" / "a1b2" / "00005.PNG" in source.inputs
    write_mask(tube.folder / "Annotations" / "a1b2" / "00005.png", LEFT)
    assert "a1b2: 00005.PNG and 00005.png" in error_of(tube.source)


@pytest.mark.parametrize(("numbers", "step"), [((0, 5, 15), 5), ((0, 10, 15), 5), ((0, 10, 15, 25), 10)])
def test_of_several_commonest_steps_the_smallest_gives_the_rate(tmp_path, rng, numbers, step) -> None:
    tube = Tube(tmp_path)
    tube.video("uneven", numbers, dict.fromkeys(numbers, LEFT))
    clip = tube.source(frames=2).clip(0, rng)
    np.testing.assert_allclose(clip.frame_edges_s, np.arange(3) * step / 30, rtol=1e-12)


def test_an_object_that_meta_json_does_not_list_is_refused(tube, rng) -> None:
    write_mask(tube.folder / "Annotations" / "a1b2" / "00005.png", LEFT * 3)
    message = error_of(tube.source(frames=4).clip, 0, rng)
    assert "00005.png: has objects [3]" in message
    assert youtube_vos_module.survey(tube.root).usable == 0


def test_videos_that_cannot_be_used_are_problems(tube) -> None:
    tube.video("bare", (0, 5), {})
    tube.video("gone", (), {}, objects=(("1", "owl"),))
    tube.video("unlisted", (0, 5), dict.fromkeys((0, 5), LEFT))
    tube.video("short", (0, 5), {0: LEFT})
    tube.video("twice", (0, 5), dict.fromkeys((0, 5), LEFT))
    write_picture(tube.folder / "JPEGImages" / "twice" / "0005.jpg", 3)
    tube.video("nameless", (0, 5), dict.fromkeys((0, 5), LEFT))
    write_picture(tube.folder / "JPEGImages" / "nameless" / "cover.jpg", 3)
    del tube.videos["unlisted"]
    tube.meta()
    source = tube.source()
    assert [video.name for video in source.videos] == ["a1b2"]
    lines = dict(line.split(": ", 1) for line in source.problems)
    assert len(lines) == len(source.problems) == 6
    words = {"bare": "Annotations", "gone": "JPEGImages", "unlisted": "meta.json", "nameless": "cover.jpg"}
    for name, word in (words | {"short": "than the 2", "twice": "00005.jpg and 0005.jpg"}).items():
        assert word in lines[name]
    assert error_of(tube.source, frames=5).startswith("source: ")
    assert youtube_vos_module.survey(tube.root, frames=5).usable == 0


def test_damaged_files_are_named(tube, rng) -> None:
    picture = tube.folder / "JPEGImages" / "a1b2" / "00005.jpg"
    mask = tube.folder / "Annotations" / "a1b2" / "00010.png"
    whole = picture.read_bytes()
    picture.write_bytes(whole[: len(whole) // 2])
    assert str(picture) in error_of(tube.source(frames=4).clip, 0, rng)
    picture.write_bytes(whole)
    mask.write_bytes(mask.read_bytes()[:-30])
    assert str(mask) in error_of(tube.source(frames=4).clip, 0, rng)
    picture.write_bytes(b"GIF, perhaps")
    survey = youtube_vos_module.survey(tube.root)
    assert survey.usable == 0
    places = [line.partition(": ")[0] for line in survey.problems]
    assert places == ["JPEGImages/a1b2/00005.jpg", "Annotations/a1b2/00010.png"]


def test_frames_of_another_size_are_named(tube, rng) -> None:
    write_picture(tube.folder / "JPEGImages" / "a1b2" / "00010.jpg", 7, (9, 12))
    write_mask(tube.folder / "Annotations" / "a1b2" / "00010.png", np.ones((9, 12)))
    assert "00010.jpg: " in error_of(tube.source(frames=4).clip, 0, rng)
    (line,) = youtube_vos_module.survey(tube.root).problems
    assert line.startswith("a1b2: frames of several sizes (3 of 8 x 12, 1 of 9 x 12)")


def test_the_folder_may_be_the_set_or_its_subset(tube) -> None:
    valid = Tube(tube.root, "valid")
    valid.video("v9", (0, 5), dict.fromkeys((0, 5), LEFT))
    cases: list[tuple[Path, Any]] = [(tube.root, subset) for subset in (None, "train", "valid")]
    cases += [(tube.folder, None), (tube.folder, "train"), (valid.folder, None)]
    names = [youtube_vos(VIEW, path=path, frames=1, subset=subset).videos[0].name for path, subset in cases]
    assert names == ["a1b2", "a1b2", "v9", "a1b2", "a1b2", "v9"]
    for path, subset in ((tube.folder, "valid"), (tube.root / "no", None)):
        assert error_of(youtube_vos, VIEW, path=path, frames=1, subset=subset).startswith("path: ")


@pytest.mark.parametrize("text", [None, "{", '{"videos": []}', '{"videos": {"a1b2": {"objects": {"one": {}}}}}'])
def test_a_damaged_meta_json_is_refused(tube, text) -> None:
    meta = tube.folder / "meta.json"
    meta.unlink() if text is None else meta.write_text(text, encoding="utf-8")
    assert "meta.json: " in error_of(tube.source)


def test_a_source_names_its_files_and_survives_pickling(tube, rng) -> None:
    source = tube.source()
    assert {file.name for file in source.inputs} == {
        "meta.json",
        *(f"{number:05d}{suffix}" for number in (0, 5, 10, 15) for suffix in (".jpg", ".png")),
    }
    assert pickle.loads(pickle.dumps(source)) == source
    assert json.loads(json.dumps(source.clip(0, rng).source))["video"] == "a1b2"


@pytest.fixture
def davis_root(tmp_path):
    root = tmp_path / "DAVIS"
    for name, value in (("bear", 60), ("camel", 90), ("dog", 120)):
        for number in range(3):
            write_picture(root / "JPEGImages" / "480p" / name / f"{number:05d}.jpg", value)
            write_mask(root / "Annotations" / "480p" / name / f"{number:05d}.png", LEFT * 2)
    sets = root / "ImageSets"
    for folder in ("2016", "2017", "480p"):
        (sets / folder).mkdir(parents=True)
    (sets / "2017" / "train.txt").write_text("camel\ndog\n", encoding="utf-8")
    (sets / "2016" / "train.txt").write_text("dog\nbear\n", encoding="utf-8")
    lines = [f"/JPEGImages/480p/bear/{n:05d}.jpg /Annotations/480p/bear/{n:05d}.png\n" for n in range(3)]
    (sets / "480p" / "db_info.txt").write_text("".join(lines), encoding="utf-8")  # as the release of 2016 lists frames
    (sets / "2017" / "val.txt").write_text("camel\nelephant\n", encoding="utf-8")
    return root


def test_lists_of_davis(davis_root) -> None:
    def names(subset):
        return [video.name for video in davis(VIEW, path=davis_root, frames=3, subset=subset).videos]

    assert names(None) == ["bear", "camel", "dog"]
    assert names("train") == ["camel", "dog"]
    assert names("2016/train") == ["bear", "dog"]
    assert names("db_info") == ["bear"]
    (line,) = davis(VIEW, path=davis_root, frames=3, subset="val").problems
    assert line.startswith("elephant: no images in JPEGImages/480p")
    message = error_of(names, "test-dev")
    assert message.startswith("subset: ")
    assert "2016/train, 2017/train" in message
    (davis_root / "ImageSets" / "2017" / "train.txt").write_bytes(b"camel\xff\n")
    assert "2017/train.txt: " in error_of(names, "train")


def test_resolutions_of_davis(davis_root) -> None:
    message = error_of(davis, VIEW, path=davis_root, frames=1, resolution="Full-Resolution")
    assert "(resolutions there: 480p)" in message
    (davis_root / "JPEGImages" / "480p").rename(davis_root / "JPEGImages" / "Full-Resolution")
    (davis_root / "Annotations" / "480p").rename(davis_root / "Annotations" / "Full-Resolution")
    assert len(davis(VIEW, path=davis_root, frames=1, resolution="Full-Resolution")) == 3


def test_images_without_masks_are_told_so(tmp_path, rng) -> None:
    for number in range(2):
        write_picture(tmp_path / "images" / "x" / f"{number:05d}.jpg", 188)
    for call in (lambda: davis(VIEW, path=tmp_path, frames=2), lambda: davis_module.survey(tmp_path)):
        assert error_of(call).startswith("path: ")
    assert error_of(davis, VIEW, path=tmp_path, frames=2, subset="train").startswith("subset: ")
    clip = davis(VIEW, path=tmp_path, frames=2, keep_background=True).clip(0, rng)
    np.testing.assert_allclose(clip.rgb, linear(188), **ROUNDING)


def test_layouts_are_told_apart(tube, davis_root, tmp_path) -> None:
    flat = tmp_path / "flat"
    write_picture(flat / "images" / "x" / "00000.jpg", 1)
    write_mask(flat / "masks" / "x" / "00000.png", LEFT)
    paths = (tube.root, tube.folder, davis_root, flat, tmp_path / "none", davis_root / "ImageSets")
    assert [bool(youtube_vos_module.recognises(path)) for path in paths] == [True, True, False, False, False, False]
    assert [bool(davis_module.recognises(path)) for path in paths] == [False, False, True, True, False, False]


@pytest.mark.shared
def test_the_real_judo_and_bike(shared_data, monkeypatch) -> None:
    monkeypatch.setattr("simulator.importers.masked_videos._WARNED", set())
    root = shared_data / "davis"
    view = replace(VIEW, shape=(240, 427))
    source = davis(view, path=root, frames=4)
    (problem,) = source.problems
    assert problem.startswith("bike: fewer frames with a mask than the 4")
    with pytest.warns(UserWarning, match=r"judo/00005\.png"):
        clip = source.clip(0, np.random.default_rng(0))
    assert clip.source["frames"] == ["00000", "00005", "00008", "00013"]
    assert clip.source["objects"] == [1, 2, 3, 4]  # the sample's NOTE: each mask holds only the object that is new
    assert clip.source["masks_resized_by_a_pixel"] == ["00005"]
    survey = davis_module.survey(root)
    assert survey.usable == 2
    assert survey.problems == ()
    assert survey.facts["frames"].startswith("5 (1 to 4 per video")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        still = davis(view, path=root, frames=1).clip(0, np.random.default_rng(0))
    assert still.source["video"] == "bike"
    assert still.source["objects"] == [1, 2]
