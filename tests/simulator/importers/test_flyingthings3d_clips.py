"""Sequences of the SceneFlow data sets become clips: consecutive numbers, one crop and one depth map, groups, a survey."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.importers.flyingthings3d import flyingthings3d, recognises, survey
from simulator.plugins import ParameterError, resolve
from simulator.types import View

SHAPE = (12, 16)
VIEW = View(shape=(8, 8), pixel_pitch_m=19.2e-6, distance_m=1.9e-3, near_m=0.04, far_m=0.2)


def frame(seed):
    rng = np.random.default_rng(seed)
    rgb = rng.integers(0, 255, (*SHAPE, 3), dtype=np.uint8, endpoint=True)
    return rgb, rng.uniform(2.0, 90.0, SHAPE).astype(np.float32)


def write(root, name, seed=0, disparity=None, folder="frames_cleanpass"):
    rgb, drawn = frame(seed)
    disparity = drawn if disparity is None else disparity
    picture, depth = root / folder / f"{name}.png", root / "disparity" / f"{name}.pfm"
    for path in (picture, depth):
        path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(rgb).save(picture)
    header = f"Pf\n{disparity.shape[1]} {disparity.shape[0]}\n-1.0\n".encode()
    depth.write_bytes(header + disparity[::-1].astype("<f4").tobytes())


@pytest.fixture
def root(tmp_path):
    """Sequence 0000 has frames 6..9 and 11, 0001 has 6 and 7: three clips of two frames and one left over."""
    for k, name in enumerate(
        ["0000/left/0006", "0000/left/0007", "0000/left/0008", "0000/left/0009", "0000/left/0011"]
    ):
        write(tmp_path, f"TRAIN/A/{name}", k)
    for k, name in enumerate(["0001/left/0006", "0001/left/0007"]):
        write(tmp_path, f"TRAIN/A/{name}", 10 + k)
    return tmp_path


def clips_of(root, **choice):
    return flyingthings3d(VIEW, path=root, **{"frames": 2, "frames_per_second": 50.0, **choice})


def pictures(source, index):
    return [name.rpartition("/")[2] for name in source.clip(index, np.random.default_rng(0)).source["pictures"]]


class TestClips:
    def test_consecutive_frames_of_one_sequence_that_no_other_clip_has(self, root):
        source = clips_of(root)
        assert len(source) == 3
        assert [pictures(source, k) for k in range(3)] == [
            ["0006.png", "0007.png"],
            ["0008.png", "0009.png"],
            ["0006.png", "0007.png"],
        ]
        assert list(source.groups) == [0, 0, 1]
        clip = source.clip(2, np.random.default_rng(0))
        assert clip.source["sequence"] == "TRAIN/A/0001"
        assert clip.frame_edges_s.tolist() == [0.0, 0.02, 0.04]

    def test_all_frames_are_cut_at_one_place(self, root):
        source = clips_of(root, downscale=1)
        clip = pickle.loads(pickle.dumps(source)).clip(0, np.random.default_rng(3))
        row, column = clip.source["corner_px"]
        stills = flyingthings3d(View(SHAPE, *[getattr(VIEW, n) for n in ("pixel_pitch_m", "distance_m", "near_m", "far_m")]),
                                path=root)  # fmt: skip
        for t in range(2):
            whole = stills.clip(t, np.random.default_rng(0)).rgb[0]
            assert np.array_equal(clip.rgb[t], whole[row : row + 8, column : column + 8])

    def test_one_depth_map_for_all_frames_of_a_clip(self, tmp_path):
        rows = np.linspace(1.0, 2.0, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)
        write(tmp_path, "TRAIN/A/0000/left/0006", 0, disparity=10 * rows)
        write(tmp_path, "TRAIN/A/0000/left/0007", 1, disparity=40 * rows)
        clip = clips_of(tmp_path, crop="centre", downscale=1).clip(0, np.random.default_rng(0))
        assert clip.source["disparity_range_px"] == [10.0, 80.0]
        # 1/z runs from 1/far at 10 px to 1/near at 80 px in both frames.
        inverse = 1 / VIEW.far_m + (40 * rows[2:10, 4:12].astype(float) - 10) / 70 * (1 / VIEW.near_m - 1 / VIEW.far_m)
        np.testing.assert_allclose(clip.depth_m[1], 1 / inverse, rtol=1e-6)
        assert clip.depth_m[0].min() > clip.depth_m[1].max()

    def test_stills_of_a_sequence_are_one_group(self, root):
        source = flyingthings3d(VIEW, path=root)
        assert list(source.groups) == [0] * 5 + [1] * 2
        still = source.clip(0, np.random.default_rng(0))
        assert set(still.source) >= {"picture", "disparity"}
        assert "pictures" not in still.source

    def test_a_missing_disparity_is_a_gap_and_a_problem(self, root):
        (root / "disparity/TRAIN/A/0000/left/0007.pfm").unlink()
        source = clips_of(root)
        assert [pictures(source, k) for k in range(len(source))] == [["0008.png", "0009.png"], ["0006.png", "0007.png"]]
        assert len(source.problems) == 1
        assert "0007.png: has no .pfm" in source.problems[0]

    def test_flattened_names(self, tmp_path):
        for k, name in enumerate(["A-0032-0006", "A-0032-0007", "A-0033-0008", "A-0033-0009"]):
            write(tmp_path, f"left/{name}", k, folder="RGB_cleanpass")
        source = clips_of(tmp_path)
        assert [pictures(source, k) for k in range(2)] == [
            ["A-0032-0006.png", "A-0032-0007.png"],
            ["A-0033-0008.png", "A-0033-0009.png"],
        ]
        assert list(source.groups) == [0, 1]

    def test_broken_disparities_of_a_set_are_problems(self, root):
        write(root, "TRAIN/A/0001/left/0007", 11, disparity=np.zeros(SHAPE, np.float32))
        source = clips_of(root, per="set")
        assert len(source) == 2
        broken, short = source.problems
        assert broken.startswith(f"{root}/disparity/TRAIN/A/0001/left/0007.pfm: is zero everywhere")
        assert short.startswith("TRAIN/A/0001: has 1 consecutive frames, but a clip takes 2")


class TestRegistration:
    @pytest.mark.parametrize("factor", [2, 3, 4])
    def test_depth_is_that_of_the_middle_of_what_colour_averages(self, tmp_path, factor):
        """A ramp of light and one of disparity that are each other's images stay so, to half a pixel of an even factor.

        The mean of a linear ramp over a block is its value in the block's middle, (factor - 1) / 2; the sample nearest to it
        is factor // 2. Another would move depth against colour by up to a block.
        """
        size = 8 * factor
        rows, columns = np.indices((size, size))
        disparity = (1 + columns + 100 * rows).astype(np.float32)
        write(tmp_path, "TRAIN/A/0000/left/0006", disparity=disparity)
        light = ((columns + rows) / (2 * size))[..., None].repeat(3, -1)
        encoded = np.where(light > 0.0031308, 1.055 * light ** (1 / 2.4) - 0.055, 12.92 * light)
        picture = tmp_path / "frames_cleanpass/TRAIN/A/0000/left/0006.png"
        Image.fromarray((255 * encoded).round().astype(np.uint8)).save(picture)
        view = View((8, 8), VIEW.pixel_pitch_m, VIEW.distance_m, VIEW.near_m, VIEW.far_m)
        source = flyingthings3d(view, path=tmp_path, depth_scaling="fixed", metres_per_unit=1.0)
        clip = source.clip(0, np.random.default_rng(0))
        assert clip.source["downscale"] == factor
        sampled = (1050 / clip.depth_m[0].astype(float)).round().astype(int) - 1
        column, row = sampled % 100, sampled // 100
        assert np.array_equal(column[0], factor * np.arange(8) + factor // 2)
        assert np.array_equal(row[:, 0], factor * np.arange(8) + factor // 2)
        # Colour by colour: the ramp's value at the sample, half a pixel on (of both axes) where the factor is even.
        shift = factor // 2 - (factor - 1) / 2
        expected = (column + row - 2 * shift) / (2 * size)
        np.testing.assert_allclose(clip.rgb[0, ..., 0], expected, atol=0.005)  # 8 bit codes are 0.009 apart at white


class TestOtherSets:
    def test_monkaa(self, tmp_path):
        for number in (1, 2):
            write(tmp_path, f"a_rain_of_stones_x2/left/{number:04}", number)
        clip = clips_of(tmp_path).clip(0, np.random.default_rng(0))
        assert clip.source["sequence"] == "a_rain_of_stones_x2"

    def test_driving_has_two_lenses(self, tmp_path):
        """Depth is z = f B / d with f = 450 px for 15 mm and 1050 px for 35 mm on the same 32 mm / 960 px film."""
        disparity = np.linspace(5, 60, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)
        for lens in ("15mm", "35mm"):
            for number in (1, 2):
                write(tmp_path, f"{lens}_focallength/scene_forwards/fast/left/{number:04}", number, disparity=disparity)
        source = clips_of(tmp_path, depth_scaling="fixed", metres_per_unit=0.01, crop="centre", downscale=1)
        for index, millimetres in enumerate((15, 35)):
            clip = source.clip(index, np.random.default_rng(0))
            focal_px = millimetres / 32 * 960
            expected = focal_px * 0.01 / disparity[2:10, 4:12].astype(float)
            np.testing.assert_allclose(clip.depth_m[1], expected, rtol=1e-7)
            assert clip.source["focal_px"] == focal_px
        assert survey(tmp_path).facts["focal lengths"] == "450 and 1050 px (15 and 35 mm)"


class TestFolders:
    def test_frames_are_in_the_order_of_their_numbers(self, tmp_path):
        for number in (8, 9, 10, 11):  # names without leading zeros sort as 10, 11, 8, 9
            write(tmp_path, f"TRAIN/A/0000/left/{number}", number)
        source = clips_of(tmp_path, frames=4)
        assert [pair.image.name for pair in source.pairs] == ["8.png", "9.png", "10.png", "11.png"]
        clip = source.clip(0, np.random.default_rng(0))
        assert len(source) == 1
        for t, number in enumerate((8, 9, 10, 11)):
            row, column = clip.source["corner_px"]
            encoded = frame(number)[0][row : row + 8, column : column + 8] / 255
            linear = np.where(encoded > 0.04045, ((encoded + 0.055) / 1.055) ** 2.4, encoded / 12.92)
            np.testing.assert_allclose(clip.rgb[t], linear, rtol=0, atol=2**-23)

    @pytest.mark.parametrize("name", ["._0006", ".ipynb_checkpoints/0006", "__MACOSX/left/0006"])
    def test_what_systems_leave_behind_is_no_frame(self, root, name):
        expected = clips_of(root).pairs
        for folder in ("TRAIN/A/0000/left", "TRAIN/A", "."):
            for top, suffix in (("frames_cleanpass", ".png"), ("disparity", ".pfm")):
                path = (root / top / folder / name).with_suffix(suffix)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(b"\x00\x05\x16\x07")
        source = clips_of(root)
        assert (source.pairs, source.problems) == (expected, ())
        assert survey(root).problems == ()

    def test_suffixes_may_be_in_capitals(self, root):
        expected = clips_of(root).clip(0, np.random.default_rng(1))
        for path in [path for path in root.rglob("*") if path.is_file()]:
            path.rename(path.with_suffix(path.suffix.upper()))
        clip = clips_of(root).clip(0, np.random.default_rng(1))
        assert np.array_equal(clip.rgb, expected.rgb)
        assert np.array_equal(clip.depth_m, expected.depth_m)
        assert clip.source["disparities"][0].endswith("0006.PFM")

    @pytest.mark.parametrize("shut", ["frames_cleanpass/TRAIN/A/0001", "disparity/TRAIN/A/0001/left"])
    def test_a_folder_that_may_not_be_read_is_named(self, root, monkeypatch, shut):
        scandir = os.scandir

        def refuse(path):
            if Path(path) == root / shut:
                raise PermissionError(13, "Permission denied", str(path))
            return scandir(path)

        monkeypatch.setattr(os, "scandir", refuse)
        for call in (clips_of, survey):
            with pytest.raises(InputError, match=rf"path: {root / shut} cannot be read: Permission denied"):
                call(root)

    def test_one_reason_for_many_files_makes_one_line(self, root):
        for path in sorted(root.glob("disparity/TRAIN/A/0000/left/*"))[1:]:
            path.unlink()
        lines = survey(root).problems, flyingthings3d(VIEW, path=root).problems
        for (line,) in lines:
            assert line.startswith(f"{root}/frames_cleanpass/TRAIN/A/0000/left/0007.png, ")
            assert "0009.png and 1 more: has no .pfm at its place below disparity" in line


class TestMistakes:
    @pytest.mark.parametrize("name", ["frames_per_second", "metres_per_unit"])
    def test_infinite_parameters(self, root, name):
        plain = {"path": str(root), "frames": 2, "frames_per_second": 50.0, name: float("inf")}
        with pytest.raises(ParameterError, match=f"{name}: "):
            resolve("source", "flyingthings3d").bind(plain)

    @pytest.mark.parametrize("value", [1e-36, 1e38])
    def test_a_depth_that_no_number_holds_names_its_file(self, root, value):
        rows = np.full(SHAPE, value, np.float32)
        write(root, "TRAIN/A/0000/left/0007", 1, disparity=rows)
        scale = 1e6 if value < 1 else 1e-12
        with pytest.raises(InputError, match=r"left/0007\.pfm has a disparity of 1e.*check metres_per_unit"):
            clips_of(root, depth_scaling="fixed", metres_per_unit=scale).clip(0, np.random.default_rng(0))

    def test_clips_need_a_rate_and_stills_take_none(self, root):
        with pytest.raises(InputError, match="frames_per_second is missing: a clip of 2 frames"):
            flyingthings3d(VIEW, path=root, frames=2)
        with pytest.raises(InputError, match="frames_per_second is 24, but frames: 1"):
            flyingthings3d(VIEW, path=root, frames_per_second=24.0)

    def test_no_sequence_is_long_enough(self, root):
        with pytest.raises(InputError, match=r"frames is 5, .* the longest, 'TRAIN/A/0000', has 4; ask for fewer"):
            clips_of(root, frames=5)
        assert clips_of(root, frames=3).problems == (
            "TRAIN/A/0001: has 2 consecutive frames, but a clip takes 3: ask for fewer frames",
        )

    def test_a_sequence_of_two_sizes(self, root):
        rgb, disparity = frame(0)
        write(root, "TRAIN/A/0001/left/0007", disparity=disparity[:-1])
        Image.fromarray(rgb[:-1]).save(root / "frames_cleanpass/TRAIN/A/0001/left/0007.png")
        with pytest.raises(InputError, match=r"0001/left/0007\.png is 11 x 16, but the clip's first frame is 12 x 16"):
            clips_of(root).clip(2, np.random.default_rng(0))

    def test_a_broken_frame_inside_a_clip_is_named(self, root):
        broken = root / "disparity/TRAIN/A/0000/left/0007.pfm"
        broken.write_bytes(b"P6" + broken.read_bytes()[2:])
        with pytest.raises(InputError, match=r"0007\.pfm is not a PFM file"):
            clips_of(root).clip(0, np.random.default_rng(0))
        write(root, "TRAIN/A/0000/left/0007", disparity=np.zeros(SHAPE, np.float32))
        with pytest.raises(InputError, match=r"0007\.pfm is zero everywhere"):
            clips_of(root).clip(0, np.random.default_rng(0))


class TestSurvey:
    def test_facts_and_problems(self, root):
        (root / "disparity/TRAIN/A/0001/left/0007.pfm").unlink()
        zero = root / "disparity/TRAIN/A/0001/left/0006.pfm"
        write(root, "TRAIN/A/0001/left/0006", disparity=np.zeros(SHAPE, np.float32))
        cut = root / "frames_cleanpass/TRAIN/A/0000/left/0006.png"
        cut.write_bytes(cut.read_bytes()[:200])
        seen = []
        found = survey(root, lambda done, total: seen.append((done, total)))
        assert seen == [(k, 6) for k in range(1, 7)]
        assert found.usable == 4
        assert found.facts["sequences"] == "1"
        assert found.facts["consecutive frames"] == "1 to 3"
        assert found.facts["sizes"] == "12 x 16"
        assert found.notes == ("gaps in the numbering: 1, which no clip crosses",)
        unpaired, damaged, empty = found.problems
        assert "0007.png: has no .pfm" in unpaired
        assert damaged.startswith(f"{cut}: is damaged")
        assert empty.startswith(f"{zero}: is zero everywhere")

    def test_recognises_by_names(self, root, tmp_path_factory):
        assert recognises(root)
        assert recognises(root / "frames_cleanpass")
        assert not recognises(tmp_path_factory.mktemp("empty"))
        assert not recognises(root / "nowhere")
        assert not recognises(root / "disparity/TRAIN/A/0000/left/0006.pfm")

    @pytest.mark.shared
    def test_the_real_sample(self, shared_data):
        folder = shared_data / "flyingthings3d"
        assert recognises(folder)
        found = survey(folder)
        assert (found.usable, found.problems) == (1, ())
        assert found.facts["sizes"] == "540 x 960"
        assert found.facts["disparity"] == "1.206 to 130.4 px"
        source = flyingthings3d(VIEW, path=folder)
        assert list(source.groups) == [0]
