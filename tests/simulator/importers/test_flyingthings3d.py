"""FlyingThings3D frames become stills and clips: layouts, gamma, depth maps, crops, sequences, mistakes, a survey."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.importers.flyingthings3d import flyingthings3d, recognises, survey
from simulator.types import SceneSource, View

SHAPE = (24, 32)
VIEW = View(shape=(8, 8), pixel_pitch_m=19.2e-6, distance_m=1.9e-3, near_m=0.04, far_m=0.2)
# One rounding to float32 of a depth below 1 m.
ROUNDING = {"rtol": 2**-24, "atol": 0}


def frame(seed, shape=SHAPE):
    rng = np.random.default_rng(seed)
    return rng.integers(0, 255, (*shape, 3), dtype=np.uint8, endpoint=True), rng.uniform(2, 90, shape).astype(
        np.float32
    )


def write(root, name, seed=0, *, rgb=None, disparity=None, folder="frames_cleanpass", suffix=".png"):
    """Write an image and its disparity; what is not given is drawn."""
    drawn = frame(seed)
    rgb, disparity = drawn[0] if rgb is None else rgb, drawn[1] if disparity is None else disparity
    image, depth = (root / folder / name).with_suffix(suffix), (root / "disparity" / name).with_suffix(".pfm")
    for path in (image, depth):
        path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(rgb).save(image, **({"lossless": True} if suffix == ".webp" else {}))
    header = f"Pf \n{disparity.shape[1]} {disparity.shape[0]} \n-1.0\n".encode()
    depth.write_bytes(header + disparity[::-1].astype("<f4").tobytes())


@pytest.fixture
def rgb():
    return frame(5)[0]


@pytest.fixture
def disparity():
    return frame(5)[1]


@pytest.fixture
def root(tmp_path, rgb, disparity):
    write(tmp_path, "TRAIN/A/0032/left/0006", rgb=rgb, disparity=disparity)
    return tmp_path


def same_clip(first, second):
    return (
        np.array_equal(first.rgb, second.rgb)
        and np.array_equal(first.depth_m, second.depth_m)
        and first.source == second.source
    )


def centre(array, size=8):
    rows, columns = ((n - size) // 2 for n in array.shape[:2])
    return array[rows : rows + size, columns : columns + size]


def clip_of(root, index=0, view=VIEW, seed=0, **choice):
    """A clip of the middle of the image at full resolution, where nothing else is chosen."""
    choice = {"crop": "centre", "downscale": 1} | choice
    return flyingthings3d(view, path=root, **choice).clip(index, np.random.default_rng(seed))


class TestClip:
    def test_colour_is_linear_light_of_the_centre(self, root, rgb):
        clip = clip_of(root)
        encoded = centre(rgb) / 255
        light = np.where(encoded > 0.04045, ((encoded + 0.055) / 1.055) ** 2.4, encoded / 12.92)  # IEC 61966-2-1
        np.testing.assert_allclose(clip.rgb[0], light, rtol=0, atol=2**-24)
        assert clip.valid.all()
        assert clip.frame_edges_s.tolist() == [0.0, 1.0]

    @pytest.mark.parametrize("factor", [2, 3, 4])
    def test_downscaling_averages_light_not_codes_and_takes_the_depth_of_the_middle(self, tmp_path, factor):
        rgb = np.zeros((4 * factor, 4 * factor, 3), np.uint8)
        rgb[::factor] = 255  # one row of a block is white: a mean of codes, then linearised, would be 0.09 for three
        disparity = 10 + np.arange(16 * factor**2, dtype=np.float32).reshape(rgb.shape[:2])
        write(tmp_path, "TRAIN/A/0000/left/0006", rgb=rgb, disparity=disparity)
        choice = {"downscale": "auto", "depth_scaling": "fixed", "metres_per_unit": 1.0}
        clip = clip_of(tmp_path, view=replace(VIEW, shape=(4, 4)), **choice)
        assert clip.source["downscale"] == factor
        np.testing.assert_allclose(clip.rgb, 1 / factor, rtol=1e-7)
        # Nearest to a block's middle, (factor - 1) / 2: another would move depth against colour by up to a block.
        expected = 1050 / disparity[factor // 2 :: factor, factor // 2 :: factor].astype(float)
        np.testing.assert_allclose(clip.depth_m[0], expected, **ROUNDING)

    def test_affine_maps_are_affine_in_one_over_z_or_in_z(self, root, disparity):
        wide = disparity.astype(float)
        ends = [wide.min(), wide.max()]
        slope, offset = np.polyfit(ends, [1 / VIEW.far_m, 1 / VIEW.near_m], 1)
        clip = clip_of(root)
        np.testing.assert_allclose(clip.depth_m[0], 1 / (slope * centre(wide) + offset), rtol=1e-6)
        assert clip.source["inverse_depth_slope_per_m_px"] == pytest.approx(slope)
        assert clip.source["inverse_depth_offset_per_m"] == pytest.approx(offset)
        slope, offset = np.polyfit(1 / np.array(ends), [VIEW.far_m, VIEW.near_m], 1)
        clip = clip_of(root, depth_scaling="affine_depth")
        np.testing.assert_allclose(clip.depth_m[0], slope / centre(wide) + offset, rtol=1e-6)
        assert clip.source["depth_slope_m_px"] == pytest.approx(slope)
        assert clip.source["depth_offset_m"] == pytest.approx(offset)

    def test_fixed_keeps_the_geometry_and_clamps_nothing(self, root, disparity):
        clip = clip_of(root, depth_scaling="fixed", metres_per_unit=0.001)
        np.testing.assert_allclose(clip.depth_m[0], 1050 * 0.001 / centre(disparity.astype(float)), **ROUNDING)
        assert clip.depth_m.max() > VIEW.far_m > VIEW.near_m > clip.depth_m.min()

    def test_both_signs_of_the_releases_mean_the_same(self, root, rgb, disparity):
        first = clip_of(root)
        write(root, "TRAIN/A/0032/left/0006", rgb=rgb, disparity=-disparity)
        assert same_clip(first, clip_of(root))

    def test_zero_disparity_is_invalid_and_far(self, root, rgb, disparity):
        disparity[:, ::2] = 0
        write(root, "TRAIN/A/0032/left/0006", rgb=rgb, disparity=disparity)
        clip = clip_of(root)
        assert np.array_equal(clip.valid[0], centre(disparity) > 0)
        assert np.all(clip.depth_m[~clip.valid] == np.float32(VIEW.far_m))
        assert clip.source["disparity_range_px"][0] >= 2.0

    def test_an_infinite_far_depth_takes_the_lowest_disparity(self, root, disparity):
        view = replace(VIEW, shape=SHAPE, far_m=np.inf)
        clip = clip_of(root, view=view)
        assert np.argwhere(np.isinf(clip.depth_m[0])).tolist() == [list(np.unravel_index(disparity.argmin(), SHAPE))]
        assert clip.valid.all()
        with pytest.raises(InputError, match=r"^depth_scaling: "):
            flyingthings3d(view, path=root, depth_scaling="affine_depth")


class TestDrawing:
    def test_the_generator_decides_the_crop_and_nothing_else(self, root, rgb):
        source = flyingthings3d(VIEW, path=root, downscale=1)
        clips = [source.clip(0, np.random.default_rng(seed)) for seed in range(200)]
        corners = np.array([clip.source["corner_px"] for clip in clips])
        assert corners.min(0).tolist() == [0, 0]
        assert corners.max(0).tolist() == [SHAPE[0] - 8, SHAPE[1] - 8]  # the last position is reached too
        row, column = corners[7]
        full = clip_of(root, view=replace(VIEW, shape=SHAPE))
        window = np.s_[:, row : row + 8, column : column + 8]
        assert np.array_equal(clips[7].rgb, full.rgb[window])
        assert np.array_equal(clips[7].depth_m, full.depth_m[window])  # the map is that of the whole image

    def test_same_index_and_generator_give_the_same_clip_after_pickling(self, root, rgb, disparity):
        write(root, "TRAIN/A/0032/left/0007", rgb=rgb[::-1], disparity=disparity)
        source = flyingthings3d(VIEW, path=root)
        copy = pickle.loads(pickle.dumps(source))
        assert isinstance(copy, SceneSource)
        for index in (1, 0, 3):
            assert same_clip(
                source.clip(index, np.random.default_rng(index)), copy.clip(index, np.random.default_rng(index))
            )
        assert source.clip(0, np.random.default_rng(0)).source["picture"].endswith("0006.png")
        assert source.clip(3, np.random.default_rng(0)).source["picture"].endswith("0007.png")  # 3 modulo 2

    def test_per_set_shares_one_range(self, root, rgb, disparity):
        write(root, "TRAIN/A/0032/left/0007", rgb=rgb, disparity=2 * disparity)
        for index in range(2):
            record = clip_of(root, index, per="set").source
            assert record["per"] == "set"
            assert record["disparity_range_px"] == [float(disparity.min()), float(2 * disparity.max())]
        alone = clip_of(root, 1).source
        assert alone["per"] == "image"
        assert alone["disparity_range_px"] == [float(2 * disparity.min()), float(2 * disparity.max())]


class TestLayouts:
    def test_all_layouts_and_roots_give_the_same_pixels(self, root, rgb, disparity, tmp_path_factory):
        expected, drawn = clip_of(root), {"rgb": rgb, "disparity": disparity}
        found = [path.relative_to(root).as_posix() for path in flyingthings3d(VIEW, path=root).inputs]
        assert found == ["frames_cleanpass/TRAIN/A/0032/left/0006.png", "disparity/TRAIN/A/0032/left/0006.pfm"]
        flat, webp = tmp_path_factory.mktemp("flat") / "SCENE_FLOW", tmp_path_factory.mktemp("webp")
        write(flat, "left/A-0032-0006", folder="RGB_cleanpass", **drawn)
        write(webp, "TRAIN/A/0032/left/0006", folder="frames_cleanpass_webp", suffix=".webp", **drawn)
        for path in (root / "frames_cleanpass", root / "disparity", flat, flat.parent, flat / "RGB_cleanpass", webp):
            clip = clip_of(path)
            assert np.array_equal(clip.rgb, expected.rgb)
            assert np.array_equal(clip.depth_m, expected.depth_m)
            assert recognises(path)
        for path in (tmp_path_factory.mktemp("empty"), root / "nowhere", root / "disparity/TRAIN/A/0032/left/0006.pfm"):
            assert not recognises(path)

    def test_eye_pass_and_subset_choose(self, root, rgb, disparity):
        write(root, "TRAIN/A/0032/right/0006", rgb=255 - rgb, disparity=disparity)
        write(root, "TEST/A/0000/left/0006", rgb=rgb // 2, disparity=disparity, folder="frames_finalpass")
        write(root, "TEST/A/0000/left/0006", rgb=rgb, disparity=disparity)

        def pictures(**choice):
            return [pair.image.as_posix() for pair in flyingthings3d(VIEW, path=root, **choice).pairs]

        assert pictures(eye="right") == ["frames_cleanpass/TRAIN/A/0032/right/0006.png"]
        assert pictures(picture_pass="finalpass") == ["frames_finalpass/TEST/A/0000/left/0006.png"]
        assert pictures(subset="TEST") == ["frames_cleanpass/TEST/A/0000/left/0006.png"]
        assert len(pictures()) == 2

    @pytest.mark.shared
    def test_the_real_sample(self, shared_data):
        view = View((128, 128), VIEW.pixel_pitch_m, VIEW.distance_m, 0.036, 0.2)
        surveyed = survey(shared_data / "flyingthings3d")
        assert (surveyed.usable, surveyed.problems) == (1, ())
        assert surveyed.facts["sizes"] == "540 x 960"
        assert surveyed.facts["disparity"] == "1.206 to 130.4 px"
        found = {}
        for scaling in ("affine_disparity", "affine_depth"):
            source = flyingthings3d(view, path=shared_data / "flyingthings3d", depth_scaling=scaling)
            assert len(source.pairs) == 1
            clip = source.clip(4, np.random.default_rng(4))
            assert clip.source["downscale"] == 4
            assert clip.source["disparity_range_px"] == pytest.approx([1.206, 130.365], abs=5e-4)
            assert 0 < clip.rgb.mean() < 1
            wide = clip_of(source.root, view=replace(view, shape=(540, 960)), depth_scaling=scaling)
            found[scaling] = wide.depth_m
        # An affine map of depth crowds the pixels of this frame just behind the near depth (known: 90 % within 4.2 cm).
        assert np.quantile(found["affine_depth"], 0.9) == pytest.approx(0.042, abs=5e-4)
        assert np.quantile(found["affine_disparity"], 0.9) > 0.1


class TestMistakes:
    def test_folders_and_parameters(self, root, rgb, disparity, tmp_path_factory):
        other = tmp_path_factory.mktemp("other")
        for made in ("nowhere", "", "frames_cleanpass"):
            (other / made).mkdir(exist_ok=True) if made != "nowhere" else None
            with pytest.raises(InputError, match=r"^path: "):
                flyingthings3d(VIEW, path=other / "nowhere" if made == "nowhere" else other)
        two, flat = (tmp_path_factory.mktemp(name) for name in ("two", "flat"))
        for name in "ab":
            write(two / name, "TRAIN/A/0032/left/0006", rgb=rgb, disparity=disparity)
        write(flat, "left/A-0032-0006", rgb=rgb, disparity=disparity, folder="RGB_cleanpass")
        for path, choice, key in [
            (two, {}, "path"),
            (flat, {"subset": "TEST"}, "subset"),  # which only the original layout has
            (root, {"depth_scaling": "fixed"}, "depth_scaling"),
            (root, {"metres_per_unit": 2.0}, "metres_per_unit"),
            (root, {"frames": 2}, "frames_per_second"),
            (root, {"frames_per_second": 24.0}, "frames_per_second"),
        ]:
            with pytest.raises(InputError, match=f"^{key}: "):
                flyingthings3d(VIEW, path=path, **choice)

    def test_a_picture_without_disparity(self, root, rgb, disparity):
        write(root, "TRAIN/A/0032/left/0007", rgb=rgb, disparity=disparity)
        (root / "disparity/TRAIN/A/0032/left/0007.pfm").unlink()
        source = flyingthings3d(VIEW, path=root)
        assert len(source) == 1
        (problem,) = source.problems
        assert problem.startswith(f"{root}/frames_cleanpass/TRAIN/A/0032/left/0007.png: has no .pfm at its place")
        (root / "disparity/TRAIN/A/0032/left/0006.pfm").unlink()
        with pytest.raises(InputError, match=r"left/0006\.pfm"):
            flyingthings3d(VIEW, path=root)

    def test_sizes_that_do_not_fit(self, root, rgb, disparity):
        for choice in ({"downscale": 4}, {"view": replace(VIEW, shape=(40, 8))}):
            with pytest.raises(InputError, match=r"^downscale: .*24 x 32"):
                clip_of(root, **choice)
        write(root, "TRAIN/A/0032/left/0006", rgb=rgb, disparity=disparity[1:])
        with pytest.raises(InputError, match=r"0006\.png: "):
            clip_of(root)

    def test_useless_disparities(self, root, rgb, disparity):
        bad = np.zeros(SHAPE), disparity - 20, np.where(disparity > 80, np.nan, disparity), np.full(SHAPE, 3.0)
        for values in bad:
            write(root, "TRAIN/A/0032/left/0006", rgb=rgb, disparity=np.asarray(values, np.float32))
            with pytest.raises(InputError, match=r"0006\.pfm: "):
                clip_of(root)
            with pytest.raises(InputError, match=rf"path: {root}" if values is bad[3] else r"0006\.pfm: "):
                clip_of(root, per="set")


@pytest.fixture
def sequences(tmp_path):
    """Sequence 0000 has frames 6..9 and 11, 0001 has 6 and 7: three clips of two frames and one left over."""
    for seed, number in enumerate((6, 7, 8, 9, 11)):
        write(tmp_path, f"TRAIN/A/0000/left/{number:04}", seed)
    for number in (6, 7):
        write(tmp_path, f"TRAIN/A/0001/left/{number:04}", number + 4)
    return tmp_path


def clips_of(root, **choice):
    return flyingthings3d(VIEW, path=root, **{"frames": 2, "frames_per_second": 50.0, **choice})


def images(source, index):
    return [name.rpartition("/")[2] for name in source.clip(index, np.random.default_rng(0)).source["pictures"]]


class TestSequences:
    def test_consecutive_frames_of_one_sequence_that_no_other_clip_has(self, sequences):
        source = clips_of(sequences)
        assert len(source) == 3
        assert [images(source, k) for k in range(3)] == [
            ["0006.png", "0007.png"],
            ["0008.png", "0009.png"],
            ["0006.png", "0007.png"],
        ]
        assert list(source.groups) == [0, 0, 1]
        clip = source.clip(2, np.random.default_rng(0))
        assert clip.source["sequence"] == "TRAIN/A/0001"
        assert clip.frame_edges_s.tolist() == [0.0, 0.02, 0.04]

    def test_all_frames_are_cut_at_one_place(self, sequences):
        source = clips_of(sequences, downscale=1)
        clip = pickle.loads(pickle.dumps(source)).clip(0, np.random.default_rng(3))
        row, column = clip.source["corner_px"]
        stills = flyingthings3d(replace(VIEW, shape=SHAPE), path=sequences)
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
        inverse = 1 / VIEW.far_m + (40 * centre(rows).astype(float) - 10) / 70 * (1 / VIEW.near_m - 1 / VIEW.far_m)
        np.testing.assert_allclose(clip.depth_m[1], 1 / inverse, rtol=1e-6)
        assert clip.depth_m[0].min() > clip.depth_m[1].max()

    def test_stills_of_a_sequence_are_one_group(self, sequences):
        source = flyingthings3d(VIEW, path=sequences)
        assert list(source.groups) == [0] * 5 + [1] * 2
        still = source.clip(0, np.random.default_rng(0))
        assert set(still.source) >= {"picture", "disparity"}
        assert "pictures" not in still.source

    def test_a_missing_disparity_is_a_gap_and_a_problem(self, sequences):
        (sequences / "disparity/TRAIN/A/0000/left/0007.pfm").unlink()
        source = clips_of(sequences)
        assert [images(source, k) for k in range(len(source))] == [["0008.png", "0009.png"], ["0006.png", "0007.png"]]
        assert len(source.problems) == 1
        assert "0007.png: has no .pfm" in source.problems[0]

    def test_flattened_names(self, tmp_path):
        for k, name in enumerate(["A-0032-0006", "A-0032-0007", "A-0033-0008", "A-0033-0009"]):
            write(tmp_path, f"left/{name}", k, folder="RGB_cleanpass")
        source = clips_of(tmp_path)
        assert [images(source, k) for k in range(2)] == [
            ["A-0032-0006.png", "A-0032-0007.png"],
            ["A-0033-0008.png", "A-0033-0009.png"],
        ]
        assert list(source.groups) == [0, 1]

    def test_broken_disparities_of_a_set_are_problems(self, sequences):
        write(sequences, "TRAIN/A/0001/left/0007", 11, disparity=np.zeros(SHAPE, np.float32))
        source = clips_of(sequences, per="set")
        assert len(source) == 2
        broken, short = source.problems
        assert broken.startswith(f"{sequences}/disparity/TRAIN/A/0001/left/0007.pfm: ")
        assert short.startswith("TRAIN/A/0001: has 1 consecutive frames, but a clip takes 2")


class TestOtherSets:
    def test_monkaa_has_one_level_and_driving_two_lenses(self, tmp_path):
        """Depth is z = f B / d with f = 450 px for 15 mm and 1050 px for 35 mm on the same 32 mm / 960 px film."""
        disparity = np.linspace(5, 60, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)
        for lens in ("15mm", "35mm"):
            for number in (1, 2):
                write(tmp_path, f"{lens}_focallength/scene_forwards/fast/left/{number:04}", number, disparity=disparity)
        source = clips_of(tmp_path, depth_scaling="fixed", metres_per_unit=0.01, crop="centre", downscale=1)
        for index, millimetres in enumerate((15, 35)):
            clip = source.clip(index, np.random.default_rng(0))
            focal_px = millimetres / 32 * 960
            expected = focal_px * 0.01 / centre(disparity).astype(float)
            np.testing.assert_allclose(clip.depth_m[1], expected, rtol=1e-7)
            assert clip.source["focal_px"] == focal_px
        assert survey(tmp_path).facts["focal lengths"] == "450 and 1050 px (15 and 35 mm)"
        for number in (1, 2):
            write(tmp_path / "monkaa", f"a_rain_of_stones_x2/left/{number:04}", number)
        clip = clips_of(tmp_path / "monkaa").clip(0, np.random.default_rng(0))
        assert clip.source["sequence"] == "a_rain_of_stones_x2"


class TestFolders:
    def test_frames_are_in_the_order_of_their_numbers(self, tmp_path):
        for number in (8, 9, 10, 11):  # names without leading zeros sort as 10, 11, 8, 9
            write(tmp_path, f"TRAIN/A/0000/left/{number}", number)
        source = clips_of(tmp_path, frames=4, downscale=1)
        assert [pair.image.name for pair in source.pairs] == ["8.png", "9.png", "10.png", "11.png"]
        clip = source.clip(0, np.random.default_rng(0))
        assert len(source) == 1
        assert np.array_equal(clip.rgb[3], clip_of(tmp_path, 3, crop="random").rgb[0])

    def test_suffixes_may_be_in_capitals(self, sequences):
        expected = clips_of(sequences).clip(0, np.random.default_rng(1))
        for path in [path for path in sequences.rglob("*") if path.is_file()]:
            path.rename(path.with_suffix(path.suffix.upper()))
        clip = clips_of(sequences).clip(0, np.random.default_rng(1))
        assert np.array_equal(clip.rgb, expected.rgb)
        assert np.array_equal(clip.depth_m, expected.depth_m)
        assert clip.source["disparities"][0].endswith("0006.PFM")


class TestMistakesInSequences:
    @pytest.mark.parametrize("value", [1e-36, 1e38])
    def test_a_depth_that_no_number_holds_names_its_file(self, sequences, value):
        rows = np.full(SHAPE, value, np.float32)
        write(sequences, "TRAIN/A/0000/left/0007", 1, disparity=rows)
        scale = 1e6 if value < 1 else 1e-12
        with pytest.raises(InputError, match=r"0007\.pfm: "):
            clips_of(sequences, depth_scaling="fixed", metres_per_unit=scale).clip(0, np.random.default_rng(0))

    def test_no_sequence_is_long_enough(self, sequences):
        with pytest.raises(InputError, match=r"^frames: "):
            clips_of(sequences, frames=5)
        assert clips_of(sequences, frames=3).problems == (
            "TRAIN/A/0001: has 2 consecutive frames, but a clip takes 3: ask for fewer frames",
        )

    def test_a_sequence_of_two_sizes(self, sequences):
        rgb, disparity = frame(0)
        write(sequences, "TRAIN/A/0001/left/0007", disparity=disparity[:-1])
        Image.fromarray(rgb[:-1]).save(sequences / "frames_cleanpass/TRAIN/A/0001/left/0007.png")
        with pytest.raises(InputError, match=r"0007\.png: "):
            clips_of(sequences).clip(2, np.random.default_rng(0))


class TestSurvey:
    def test_facts_and_problems(self, sequences):
        (sequences / "disparity/TRAIN/A/0001/left/0007.pfm").unlink()
        zero = sequences / "disparity/TRAIN/A/0001/left/0006.pfm"
        write(sequences, "TRAIN/A/0001/left/0006", disparity=np.zeros(SHAPE, np.float32))
        cut = sequences / "frames_cleanpass/TRAIN/A/0000/left/0006.png"
        cut.write_bytes(cut.read_bytes()[:200])
        seen = []
        found = survey(sequences, lambda done, total: seen.append((done, total)))
        assert seen == [(k, 6) for k in range(1, 7)]
        assert found.usable == 4
        assert found.facts["sequences"] == "1"
        assert found.facts["consecutive frames"] == "1 to 3"
        assert found.facts["sizes"] == "24 x 32"
        assert found.notes == ("gaps in the numbering: 1, which no clip crosses",)
        unpaired, damaged, empty = found.problems
        assert "0007.png: has no .pfm" in unpaired
        assert damaged.startswith(f"{cut}: ")
        assert empty.startswith(f"{zero}: ")
