"""FlyingThings3D frames become clips: layouts, gamma, depth maps, crops, and each mistake by name."""

import pickle

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.importers.flyingthings3d import flyingthings3d
from simulator.types import SceneSource, View

SHAPE = (24, 32)
VIEW = View(shape=(8, 8), pixel_pitch_m=19.2e-6, distance_m=1.9e-3, near_m=0.04, far_m=0.2)
# One rounding to float32 of a depth below 1 m.
ROUNDING = {"rtol": 2**-24, "atol": 0}


def write_frame(root, name, rgb, disparity, flattened=False, folder="frames_cleanpass", suffix=".png"):
    top = "RGB_cleanpass" if flattened else folder
    picture, depth = (root / top / name).with_suffix(suffix), (root / "disparity" / name).with_suffix(".pfm")
    for path in (picture, depth):
        path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(rgb).save(picture, **({"lossless": True} if suffix == ".webp" else {}))
    header = f"Pf \n{disparity.shape[1]} {disparity.shape[0]} \n-1.0\n".encode()
    depth.write_bytes(header + disparity[::-1].astype("<f4").tobytes())


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def rgb(rng):
    return rng.integers(0, 255, (*SHAPE, 3), dtype=np.uint8, endpoint=True)


@pytest.fixture
def disparity(rng):
    return rng.uniform(2.0, 90.0, SHAPE).astype(np.float32)


@pytest.fixture
def root(tmp_path, rgb, disparity):
    write_frame(tmp_path, "TRAIN/A/0032/left/0006", rgb, disparity)
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


class TestClip:
    def test_colour_is_linear_light_of_the_centre(self, root, rgb):
        import colour

        clip = flyingthings3d(VIEW, path=root, crop="centre", downscale=1).clip(0, np.random.default_rng(0))
        np.testing.assert_allclose(clip.rgb[0], colour.models.eotf_sRGB(centre(rgb) / 255.0), rtol=0, atol=2**-24)
        assert clip.valid.all()
        assert clip.frame_edges_s.tolist() == [0.0, 1.0]

    def test_downscaling_averages_light_not_codes_and_never_mixes_depths(self, tmp_path):
        rgb = np.zeros((12, 12, 3), np.uint8)
        rgb[::3] = 255  # one row in three is white: a mean of codes, then linearised, would be 0.09
        disparity = np.where(np.indices((12, 12)).sum(0) % 2, 10.0, 80.0).astype(np.float32)
        write_frame(tmp_path, "TRAIN/A/0000/left/0006", rgb, disparity)
        view = View((4, 4), VIEW.pixel_pitch_m, VIEW.distance_m, VIEW.near_m, VIEW.far_m)
        clip = flyingthings3d(view, path=tmp_path).clip(0, np.random.default_rng(0))
        assert clip.source["downscale"] == 3
        np.testing.assert_allclose(clip.rgb, 1 / 3, rtol=1e-7)
        near_and_far = np.float32([VIEW.near_m, VIEW.far_m])
        assert np.array_equal(np.unique(clip.depth_m), near_and_far)
        expected = np.where(disparity[1::3, 1::3] == 80, *near_and_far)
        assert np.array_equal(clip.depth_m[0], expected)

    def test_affine_disparity_is_affine_in_one_over_z(self, root, disparity):
        clip = flyingthings3d(VIEW, path=root, crop="centre", downscale=1).clip(0, np.random.default_rng(0))
        wide = disparity.astype(float)
        slope, offset = np.polyfit([wide.min(), wide.max()], [1 / VIEW.far_m, 1 / VIEW.near_m], 1)
        np.testing.assert_allclose(clip.depth_m[0], 1 / (slope * centre(wide) + offset), rtol=1e-6)
        assert clip.source["inverse_depth_slope_per_m_px"] == pytest.approx(slope)
        assert clip.source["inverse_depth_offset_per_m"] == pytest.approx(offset)

    def test_affine_depth_is_affine_in_z(self, root, disparity):
        source = flyingthings3d(VIEW, path=root, crop="centre", downscale=1, depth_scaling="affine_depth")
        clip = source.clip(0, np.random.default_rng(0))
        wide = 1 / disparity.astype(float)
        slope, offset = np.polyfit([wide.min(), wide.max()], [VIEW.near_m, VIEW.far_m], 1)
        np.testing.assert_allclose(clip.depth_m[0], slope * centre(wide) + offset, rtol=1e-6)
        assert clip.source["depth_slope_m_px"] == pytest.approx(slope)
        assert clip.source["depth_offset_m"] == pytest.approx(offset)

    def test_fixed_keeps_the_geometry_and_clamps_nothing(self, root, disparity):
        source = flyingthings3d(
            VIEW, path=root, crop="centre", downscale=1, depth_scaling="fixed", metres_per_unit=0.001
        )
        clip = source.clip(0, np.random.default_rng(0))
        np.testing.assert_allclose(clip.depth_m[0], 1050 * 0.001 / centre(disparity.astype(float)), **ROUNDING)
        assert clip.depth_m.max() > VIEW.far_m > VIEW.near_m > clip.depth_m.min()

    def test_both_signs_of_the_releases_mean_the_same(self, root, rgb, disparity, tmp_path):
        first = flyingthings3d(VIEW, path=root).clip(0, np.random.default_rng(0))
        write_frame(root, "TRAIN/A/0032/left/0006", rgb, -disparity)
        assert same_clip(first, flyingthings3d(VIEW, path=root).clip(0, np.random.default_rng(0)))

    def test_zero_disparity_is_invalid_and_far(self, root, rgb, disparity):
        disparity[:, ::2] = 0
        write_frame(root, "TRAIN/A/0032/left/0006", rgb, disparity)
        clip = flyingthings3d(VIEW, path=root, crop="centre", downscale=1).clip(0, np.random.default_rng(0))
        assert np.array_equal(clip.valid[0], centre(disparity) > 0)
        assert np.all(clip.depth_m[~clip.valid] == np.float32(VIEW.far_m))
        assert clip.source["disparity_range_px"][0] >= 2.0

    def test_an_infinite_far_depth_takes_the_lowest_disparity(self, root, disparity):
        view = View(SHAPE, VIEW.pixel_pitch_m, VIEW.distance_m, VIEW.near_m, np.inf)
        clip = flyingthings3d(view, path=root).clip(0, np.random.default_rng(0))
        assert np.argwhere(np.isinf(clip.depth_m[0])).tolist() == [list(np.unravel_index(disparity.argmin(), SHAPE))]
        assert clip.valid.all()
        with pytest.raises(InputError, match=r"affine_depth cannot reach far = inf: use affine_disparity"):
            flyingthings3d(view, path=root, depth_scaling="affine_depth")


class TestDrawing:
    def test_the_generator_decides_the_crop_and_nothing_else(self, root, rgb):
        source = flyingthings3d(VIEW, path=root, downscale=1)
        clips = [source.clip(0, np.random.default_rng(seed)) for seed in range(200)]
        corners = np.array([clip.source["corner_px"] for clip in clips])
        assert corners.min(0).tolist() == [0, 0]
        assert corners.max(0).tolist() == [SHAPE[0] - 8, SHAPE[1] - 8]  # the last position is reached too
        row, column = corners[7]
        whole = View(SHAPE, VIEW.pixel_pitch_m, VIEW.distance_m, VIEW.near_m, VIEW.far_m)
        full = flyingthings3d(whole, path=root).clip(0, np.random.default_rng(0))
        window = np.s_[:, row : row + 8, column : column + 8]
        assert np.array_equal(clips[7].rgb, full.rgb[window])
        assert np.array_equal(clips[7].depth_m, full.depth_m[window])  # the map is that of the whole image

    def test_same_index_and_generator_give_the_same_clip_after_pickling(self, root, rgb, disparity):
        write_frame(root, "TRAIN/A/0032/left/0007", rgb[::-1], disparity)
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
        write_frame(root, "TRAIN/A/0032/left/0007", rgb, 2 * disparity)
        source = flyingthings3d(VIEW, path=root, per="set", crop="centre", downscale=1)
        for index in range(2):
            record = source.clip(index, np.random.default_rng(0)).source
            assert record["per"] == "set"
            assert record["disparity_range_px"] == [float(disparity.min()), float(2 * disparity.max())]
        alone = flyingthings3d(VIEW, path=root).clip(1, np.random.default_rng(0)).source
        assert alone["per"] == "image"
        assert alone["disparity_range_px"] == [float(2 * disparity.min()), float(2 * disparity.max())]

    def test_inputs_are_all_files_that_may_be_read(self, root, rgb, disparity):
        write_frame(root, "TRAIN/A/0032/right/0006", rgb, disparity)
        found = [path.relative_to(root).as_posix() for path in flyingthings3d(VIEW, path=root).inputs]
        assert found == ["frames_cleanpass/TRAIN/A/0032/left/0006.png", "disparity/TRAIN/A/0032/left/0006.pfm"]


class TestLayouts:
    def test_all_layouts_and_roots_give_the_same_pixels(self, root, rgb, disparity, tmp_path_factory):
        expected = flyingthings3d(VIEW, path=root).clip(0, np.random.default_rng(0))
        flat, webp = tmp_path_factory.mktemp("flat") / "SCENE_FLOW", tmp_path_factory.mktemp("webp")
        write_frame(flat, "left/A-0032-0006", rgb, disparity, flattened=True)
        write_frame(webp, "TRAIN/A/0032/left/0006", rgb, disparity, folder="frames_cleanpass_webp", suffix=".webp")
        paths = [root / "frames_cleanpass", root / "disparity", flat, flat.parent, flat / "RGB_cleanpass", webp]
        for path in paths:
            clip = flyingthings3d(VIEW, path=path).clip(0, np.random.default_rng(0))
            assert np.array_equal(clip.rgb, expected.rgb)
            assert np.array_equal(clip.depth_m, expected.depth_m)

    def test_eye_pass_and_subset_choose(self, root, rgb, disparity):
        write_frame(root, "TRAIN/A/0032/right/0006", 255 - rgb, disparity)
        write_frame(root, "TEST/A/0000/left/0006", rgb // 2, disparity, folder="frames_finalpass")
        write_frame(root, "TEST/A/0000/left/0006", rgb, disparity)

        def pictures(**choice):
            return [pair.image.as_posix() for pair in flyingthings3d(VIEW, path=root, **choice).pairs]

        assert pictures(eye="right") == ["frames_cleanpass/TRAIN/A/0032/right/0006.png"]
        assert pictures(picture_pass="finalpass") == ["frames_finalpass/TEST/A/0000/left/0006.png"]
        assert pictures(subset="TEST") == ["frames_cleanpass/TEST/A/0000/left/0006.png"]
        assert len(pictures()) == 2

    @pytest.mark.shared
    def test_the_real_sample(self, shared_data):
        view = View((128, 128), VIEW.pixel_pitch_m, VIEW.distance_m, 0.036, 0.2)
        found = {}
        for scaling in ("affine_disparity", "affine_depth"):
            source = flyingthings3d(view, path=shared_data / "flyingthings3d", depth_scaling=scaling)
            assert len(source.pairs) == 1
            clip = source.clip(4, np.random.default_rng(4))
            assert clip.source["downscale"] == 4
            assert clip.source["disparity_range_px"] == pytest.approx([1.206, 130.365], abs=5e-4)
            assert 0 < clip.rgb.mean() < 1
            wide = flyingthings3d(
                View((540, 960), view.pixel_pitch_m, view.distance_m, view.near_m, view.far_m),
                path=shared_data / "flyingthings3d",
                depth_scaling=scaling,
            ).clip(0, np.random.default_rng(0))
            found[scaling] = wide.depth_m
        # An affine map of depth crowds the pixels of this frame just behind the near depth (known: 90 % within 4.2 cm).
        assert np.quantile(found["affine_depth"], 0.9) == pytest.approx(0.042, abs=5e-4)
        assert np.quantile(found["affine_disparity"], 0.9) > 0.1


class TestMistakes:
    def make(self, root, **changes):
        return flyingthings3d(VIEW, **{"path": root, **changes})

    def test_missing_folders(self, tmp_path):
        with pytest.raises(InputError, match=r"there is no folder .*nowhere"):
            self.make(tmp_path / "nowhere")
        (tmp_path / "pictures").mkdir()
        with pytest.raises(InputError, match=r"has none of frames_cleanpass.*it has pictures"):
            self.make(tmp_path)
        (tmp_path / "frames_cleanpass").mkdir()
        with pytest.raises(InputError, match=r"holds no left image"):
            self.make(tmp_path)

    def test_two_data_sets_side_by_side(self, tmp_path, rgb, disparity):
        for name in "ab":
            write_frame(tmp_path / name, "TRAIN/A/0032/left/0006", rgb, disparity)
        with pytest.raises(InputError, match=r"several data sets in it \(a, b\)"):
            self.make(tmp_path)

    def test_a_picture_without_disparity(self, root, rgb, disparity):
        write_frame(root, "TRAIN/A/0032/left/0007", rgb, disparity)
        (root / "disparity/TRAIN/A/0032/left/0007.pfm").unlink()
        source = self.make(root)
        assert len(source) == 1
        (problem,) = source.problems
        assert problem.startswith(f"{root}/frames_cleanpass/TRAIN/A/0032/left/0007.png: has no .pfm at its place")
        (root / "disparity/TRAIN/A/0032/left/0006.pfm").unlink()
        with pytest.raises(InputError, match=r"none of the 2 images .*the first wants .*/disparity/.*left/0006\.pfm"):
            self.make(root)

    def test_subset_needs_the_original_layout(self, tmp_path, rgb, disparity):
        write_frame(tmp_path, "left/A-0032-0006", rgb, disparity, flattened=True)
        with pytest.raises(InputError, match="flattened layout without TRAIN and TEST"):
            self.make(tmp_path, subset="TEST")

    def test_contradicting_parameters(self, root):
        with pytest.raises(InputError, match="fixed needs metres_per_unit"):
            self.make(root, depth_scaling="fixed")
        with pytest.raises(InputError, match=r"metres_per_unit is 2\.0, but depth_scaling: affine_disparity"):
            self.make(root, metres_per_unit=2.0)

    def test_sizes_that_do_not_fit(self, root, rgb, disparity):
        with pytest.raises(InputError, match=r"8 x 8 pixels at downscale 4 .*\(24 x 32\): use downscale at most 3"):
            self.make(root, downscale=4).clip(0, np.random.default_rng(0))
        large = View((40, 8), VIEW.pixel_pitch_m, VIEW.distance_m, VIEW.near_m, VIEW.far_m)
        with pytest.raises(InputError, match=r"use a scene of at most 24 x 32"):
            flyingthings3d(large, path=root).clip(0, np.random.default_rng(0))
        write_frame(root, "TRAIN/A/0032/left/0006", rgb, disparity[1:])
        with pytest.raises(InputError, match=r"24 x 32 x 3 and its disparity .*0006\.pfm is 23 x 32"):
            self.make(root).clip(0, np.random.default_rng(0))

    def test_useless_disparities(self, root, rgb, disparity):
        name = "TRAIN/A/0032/left/0006"
        for values, message in [
            (np.zeros(SHAPE), "zero everywhere"),
            (np.full(SHAPE, 3.0), r"one single disparity \(3 px\)"),
            (disparity - 20, "mixes disparities of both signs"),
            (np.where(disparity > 80, np.nan, disparity), "NaN or infinite"),
        ]:
            write_frame(root, name, rgb, np.asarray(values, np.float32))
            with pytest.raises(InputError, match=message):
                self.make(root).clip(0, np.random.default_rng(0))
            with pytest.raises(InputError, match=message):
                self.make(root, per="set")

    def test_broken_files_are_named(self, root):
        picture = root / "frames_cleanpass/TRAIN/A/0032/left/0006.png"
        picture.write_bytes(picture.read_bytes()[:200])
        with pytest.raises(InputError, match=r"0006\.png is damaged"):
            self.make(root).clip(0, np.random.default_rng(0))
