"""RGB + depth in every coding, file kind and layout, against the formulas of those who publish them."""

import json
import pickle
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from PIL import Image

from simulator.errors import InputError
from simulator.importers.depth_files import read_chart
from simulator.importers.flyingthings3d import flyingthings3d
from simulator.importers.rgb_depth import recognises, survey
from simulator.plugins import ParameterError, resolve
from simulator.types import SceneSource, View

SHAPE = (12, 16)
FOCAL_PX = 20.0
VIEW = View(shape=SHAPE, pixel_pitch_m=1e-6, distance_m=FOCAL_PX * 1e-6, near_m=0.01, far_m=0.5)
CAMERA = {"type": "pinhole", "fx": FOCAL_PX, "fy": FOCAL_PX, "cx": 7.5, "cy": 5.5}
RNG = np.random.default_rng(0)
MM = {"type": "metric", "unit": "mm"}


def save(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    match path.suffix:
        case ".npy":
            np.save(path, values)
        case ".pfm":  # Middlebury's scale is not 1
            header = f"Pf\n{values.shape[1]} {values.shape[0]}\n-0.003922\n".encode()
            path.write_bytes(header + values[::-1].astype("<f4").tobytes())
        case ".tiff":
            tifffile.imwrite(path, values)
        case ".exr":
            OpenEXR.File({"type": OpenEXR.scanlineimage}, dict(values)).write(str(path))
        case _:
            Image.fromarray(values).save(path)


def picture(seed=0, shape=SHAPE):
    return np.random.default_rng(seed).integers(40, 255, (*shape, 3), dtype=np.uint8, endpoint=True)


def depths_of(values, root, name="depth/0001.png", **choice):
    """A clip of one pair whose chart holds these values, seen by a view with the same pixels."""
    save(root / "rgb/0001.png", picture())
    save(root / name, values)
    return clip_of(root, **choice)


def source_of(root, **choice):
    given = {"path": root, "images": "rgb", "depths": "depth", "depth": MM} | choice
    if given["path"].suffix == ".csv":
        del given["images"], given["depths"]
    plugin = resolve("source", "rgb_depth")
    view = given.pop("view", VIEW)
    return plugin.function(view, **plugin.bind(given | {"path": str(given["path"])}))


def clip_of(root, index=0, **choice):
    return source_of(root, **choice).clip(index, RNG)


CODES = np.arange(1, 193, dtype=np.uint16).reshape(SHAPE)


class TestCodings:
    @pytest.mark.parametrize(
        ("depth", "codes", "metres"),
        [
            (MM, CODES, CODES * 1e-3),
            ({"type": "metric", "unit": "m", "codes_per_unit": 5000.0}, CODES * 9, CODES * 9 / 5000),  # TUM RGB-D
            ({"type": "metric", "unit": "cm"}, CODES.astype(np.uint8), CODES * 1e-2),
            # KITTI: uint16 of 256 times the disparity
            (
                {"type": "disparity", "focal_px": 721.5, "baseline_mm": 540.0, "codes_per_px": 256},
                CODES * 100,
                721.5 * 0.54 / (CODES * 100 / 256),
            ),
            # SimCol3D: code / 255 / 256 of 20 cm
            ({"type": "linear", "full_cm": 20, "full_code": 65280}, CODES * 300, CODES * 300 / 255 / 256 * 0.2),
            ({"type": "linear", "full_cm": 20}, CODES * 300, CODES * 300 / 65535 * 0.2),
            # a range 2 cm to 30 cm in which bright is near
            (
                {"type": "inverse", "full_cm": 2, "zero_cm": 30},
                CODES.astype(np.uint8),
                1 / (1 / 0.3 + CODES / 255 * (1 / 0.02 - 1 / 0.3)),
            ),
        ],
    )
    def test_what_numbers_mean(self, tmp_path, depth, codes, metres):
        clip = depths_of(codes, tmp_path, depth=depth)
        assert clip.valid.all()
        np.testing.assert_allclose(clip.depth_m[0], metres, rtol=2**-22)

    @pytest.mark.parametrize("suffix", [".npy", ".pfm", ".tiff", ".exr"])
    def test_floating_point_with_unknown_pixels(self, tmp_path, suffix):
        """Renderers write inf where nothing is hit, sensors NaN or 0; what is not known keeps its light."""
        metres = RNG.uniform(0.02, 0.4, SHAPE).astype(np.float32)
        metres[0, :3] = np.inf, np.nan, 0
        metres[1, 0] = -1
        values = {"Z": metres} if suffix == ".exr" else metres
        clip = depths_of(values, tmp_path, f"depth/0001{suffix}", depth={"type": "metric", "unit": "m"})
        unknown = np.zeros(SHAPE, bool)
        unknown[0, :3] = unknown[1, 0] = True
        assert np.array_equal(clip.valid[0], ~unknown)
        assert np.array_equal(clip.depth_m[0][~unknown], metres[~unknown])
        assert np.all(clip.depth_m[0][unknown] == np.float32(VIEW.far_m))
        assert clip.rgb[0][unknown].min() > 0
        assert clip.source["without_depth_share"] == 4 / 192

    def test_a_compressed_tiff(self, tmp_path):
        save(tmp_path / "rgb/0001.png", picture())
        (tmp_path / "depth").mkdir()
        Image.fromarray(CODES).save(tmp_path / "depth/0001.tif", compression="tiff_lzw")
        np.testing.assert_allclose(clip_of(tmp_path).depth_m[0], CODES * 1e-3, rtol=2**-23)

    def test_grey_with_alpha(self, tmp_path):
        depth = np.arange(6, dtype=np.uint16).reshape(2, 3)
        tifffile.imwrite(tmp_path / "m.tif", np.dstack([depth, np.full_like(depth, 9)]), extrasamples="unassalpha")
        assert np.array_equal(read_chart(tmp_path / "m.tif"), depth)

    def test_an_exr_of_blender_holds_depth_three_times(self, tmp_path):
        metres = RNG.uniform(0.02, 0.4, SHAPE).astype(np.float32)
        choice = {"depth": {"type": "metric", "unit": "m"}}
        clip = depths_of(dict.fromkeys("RGB", metres), tmp_path, "depth/0001.exr", **choice)
        assert np.array_equal(clip.depth_m[0], metres)
        layered = {"ViewLayer.Depth.Z": metres, "ViewLayer.Combined.R": metres + 1}
        assert np.array_equal(depths_of(layered, tmp_path, "depth/0001.exr", **choice).depth_m[0], metres)
        for wrong in ({"A": metres, "B": metres}, dict(zip("RGB", (metres, metres, metres + 1), strict=True))):
            with pytest.raises(InputError, match=r"0001\.exr: "):
                depths_of(wrong, tmp_path, "depth/0001.exr", **choice)

    def test_unknown_by_number_or_mask(self, tmp_path):
        codes = CODES.copy()
        codes[0], codes[1] = 0, 65535
        assert np.array_equal(depths_of(codes, tmp_path).valid[0], codes > 0)
        clip = depths_of(codes, tmp_path, invalid=[0.0, 65535.0])
        assert np.array_equal(clip.valid[0], (codes > 0) & (codes < 65535))
        assert depths_of(CODES - 1, tmp_path, depth={"type": "linear", "full_cm": 30, "zero_cm": 2}).valid.all()
        mask = np.full(SHAPE, 255, np.uint8)
        mask[:, :3], mask[:, 3:5] = 0, 128  # Middlebury's: occluded pixels have a depth
        save(tmp_path / "masks/0001.png", mask)
        source = source_of(tmp_path, masks="masks")
        assert np.array_equal(source.clip(0, RNG).valid[0], (CODES - 1 > 0) & (mask > 0))
        assert tmp_path / "masks/0001.png" in source.inputs

    def test_lengths_along_rays_and_scale(self, tmp_path):
        """On a sphere of radius R about the camera z is R cos(theta); a model of half the size is half as far away."""
        x, y = (np.arange(16) - 7.5) / FOCAL_PX, (np.arange(12) - 5.5) / FOCAL_PX
        expected = 0.1 / np.sqrt(1 + x**2 + y[:, None] ** 2)
        sphere, choice = np.full(SHAPE, 100, np.uint16), {"intrinsics": CAMERA, "field": "angles"}
        clip = depths_of(sphere, tmp_path, depth_along="ray", **choice)
        np.testing.assert_allclose(clip.depth_m[0], expected, rtol=2**-23)
        half = depths_of(sphere, tmp_path, depth_along="ray", scale=0.5, **choice)
        np.testing.assert_allclose(half.depth_m[0], expected / 2, rtol=2**-23)
        assert np.array_equal(half.rgb, clip.rgb)
        near = depths_of(CODES, tmp_path, range_cm=[5, 20], scale=1.5)
        assert np.array_equal(near.valid[0], (CODES > 33) & (CODES < 134))
        with pytest.raises(
            InputError, match=r"depth/0001\.png: .*depths of 0\.1 to 19\.2 cm, with range_cm \[30, 50\]"
        ):
            depths_of(CODES, tmp_path, range_cm=[30, 50])

    def test_a_chart_of_fewer_pixels_is_not_interpolated(self, tmp_path):
        small = CODES[:6, :8]
        clip = depths_of(small, tmp_path)
        np.testing.assert_allclose(clip.depth_m[0], small.repeat(2, 0).repeat(2, 1) * 1e-3, rtol=2**-23)
        three_quarters = depths_of(CODES[:9, :12], tmp_path).depth_m[0]
        rows, columns = (
            [np.abs((np.arange(n * 3 // 4) + 0.5) * 4 / 3 - 0.5 - k).argmin() for k in range(n)] for n in SHAPE
        )
        np.testing.assert_allclose(three_quarters, CODES[np.ix_(rows, columns)] * 1e-3, rtol=2**-23)
        for wrong in (CODES[:6], np.ones((24, 32), np.uint16)):
            with pytest.raises(InputError, match=r"depth/0001\.png: got .* x .* pixels"):
                depths_of(wrong, tmp_path)

    def test_light_is_linear(self, tmp_path):
        clip = depths_of(CODES, tmp_path)
        encoded = picture() / 255.0  # all codes are at least 40, on the curved part of IEC 61966-2-1
        np.testing.assert_allclose(clip.rgb[0], ((encoded + 0.055) / 1.055) ** 2.4, rtol=0, atol=1e-6)

    @pytest.mark.parametrize(
        ("values", "name"),
        [
            (np.zeros(SHAPE, np.uint16), "depth/0001.png"),
            (picture(), "depth/0001.png"),
            (np.full(SHAPE, np.nan, np.float32), "depth/0001.npy"),
            (np.ones((2, *SHAPE), np.float32), "depth/0001.npy"),
            (np.ones(SHAPE, complex), "depth/0001.npy"),
        ],
    )
    def test_charts_that_say_nothing(self, tmp_path, values, name):
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            depths_of(values, tmp_path, name)


def middlebury(root, scenes=("Adirondack-perfect", "artroom1", "artroom2")):
    """As the data sets of 2014 and 2021 are laid out, with the numbers of Adirondack at a 185th of its size."""
    focal, baseline, doffs = 3997.684 / 185.25, 193.001, 131.111 / 185.25
    for seed, scene in enumerate(scenes):
        metres = np.random.default_rng(seed).uniform(1.0, 4.0, SHAPE)
        disparity = focal * baseline * 1e-3 / metres - doffs
        disparity[:2, seed:5] = np.inf
        for camera in (0, 1):
            save(root / scene / f"im{camera}.png", picture(seed + 10 * camera))
            save(root / scene / f"disp{camera}.pfm", disparity.astype(np.float32))
        for other in ("disp0-sd.pfm", "disp0y.pfm"):  # deviations, and vertical disparities
            save(root / scene / other, np.ones(SHAPE, np.float32))
        save(root / scene / "im1E.png", picture(seed))
        numbers = [f"cam{k}=[{focal} 0 {cx}; 0 {focal} 5.5; 0 0 1]" for k, cx in enumerate((7.5, 7.5 + doffs))]
        numbers += [f"doffs={doffs}", f"baseline={baseline}", "width=16", "height=12", "ndisp=4", "isint=0"]
        (root / scene / "calib.txt").write_text("\n".join(numbers))
    return root


def simcol(root):
    """As SimCol3D is: PNG of four channels of 16 bits, depth in all three of its colours, poses and cam.txt beside."""
    codes = RNG.integers(1, 32000, (4, *SHAPE), dtype=np.uint16)
    for sequence in ("Frames_S1", "Frames_S2"):
        folder = root / "SyntheticColon_I" / sequence
        folder.mkdir(parents=True)
        for number, chart in enumerate(codes[:2] if sequence == "Frames_S1" else codes[2:]):
            opaque = np.full(SHAPE, 65535, np.uint16)
            cv2.imwrite(str(folder / f"Depth_{number:04}.png"), np.dstack([chart, chart, chart, opaque]))
            cv2.imwrite(
                str(folder / f"FrameBuffer_{number:04}.png"), np.dstack([picture(number) * np.uint16(257), opaque])
            )
    (root / "SyntheticColon_I/cam.txt").write_text("20 0 7.5 0 20 5.5 0 0 1")
    (root / "SyntheticColon_I/SavedPosition_S1.txt").write_text("0 0 0\n")
    return codes


class TestLayouts:
    def test_middlebury(self, tmp_path):
        """Unknown disparities are inf; z = f B / (d + doffs), by each scene's own calib.txt."""
        middlebury(tmp_path)
        source = source_of(
            tmp_path, images="*/im0.png", depths="*/disp0.pfm", depth={"type": "disparity"}, intrinsics_file="calib.txt"
        )
        assert [pair.sequence for pair in source.pairs] == ["Adirondack-perfect", "artroom1", "artroom2"]
        assert (len(source), source.groups, source.problems) == (3, (0, 1, 2), ())
        assert {path.name for path in source.inputs} == {"im0.png", "disp0.pfm", "calib.txt"}
        for index in range(3):
            clip = source.clip(index, RNG)
            metres = np.random.default_rng(index).uniform(1.0, 4.0, SHAPE)
            assert clip.valid.sum() == 192 - 2 * (5 - index)
            assert not clip.valid[0, :2, index:5].any()
            # single precision of the disparity, of which doffs is a part
            np.testing.assert_allclose(clip.depth_m[0][clip.valid[0]], metres[clip.valid[0]], rtol=1e-6)
        assert clip.source["depth"]["baseline_mm"] == 193.001
        right = source_of(
            tmp_path, images="*/im1.png", depths="*/disp1.pfm", depth={"type": "disparity"}, intrinsics_file="calib.txt"
        )
        assert right.clip(0, RNG).source["intrinsics"]["cx"] == 7.5 + 131.111 / 185.25

    def test_middlebury_is_recognised(self, tmp_path):
        likeness = recognises(middlebury(tmp_path))
        assert likeness is not None
        assert likeness.sure == "sure"
        assert likeness.why.startswith("3 of 3 charts pair with an image by folder; charts are PFM in floating point, ")
        found = survey(tmp_path)
        assert found.found == {
            "images": "*/im0.png",
            "depths": "*/disp0.pfm",
            "depth": {"type": "disparity"},
            "intrinsics_file": "calib.txt",
        }
        assert (found.usable, found.problems, found.facts["unknown"]) == (3, (), "4.2% of pixels")  # 24 of 576

    def test_a_single_scene_of_middlebury(self, tmp_path):
        scene = middlebury(tmp_path) / "artroom1"
        found = survey(scene)
        assert (found.found["images"], found.found["depths"], found.usable) == ("im0.png", "disp0.pfm", 1)
        assert [pair.sequence for pair in source_of(scene, **found.found).pairs] == ["artroom1"]

    def test_simcol3d(self, tmp_path):
        codes = simcol(tmp_path)
        choice = {"images": "**/FrameBuffer_*.png", "depths": "**/Depth_*.png", "intrinsics_file": "cam.txt"}
        depth = {"type": "linear", "full_cm": 20, "full_code": 65280}
        source = source_of(tmp_path, depth=depth, field="angles", frames=2, frames_per_second=30.0, **choice)
        assert (len(source), source.groups) == (2, (0, 1))
        clip = pickle.loads(pickle.dumps(source)).clip(1, RNG)
        np.testing.assert_allclose(clip.depth_m, codes[2:] / 255 / 256 * 0.2, rtol=2**-22)
        assert clip.source["sequence"] == "SyntheticColon_I/Frames_S2"
        assert isinstance(source, SceneSource)
        found = survey(tmp_path)
        assert found.found["depth"] == depth
        assert found.found["intrinsics_file"] == "cam.txt"
        assert (found.usable, found.facts["sequences"]) == (4, "2")

    @pytest.mark.parametrize(
        ("image", "chart", "patterns"),
        [
            ("rgb/{:06}.jpg", "depth/{:06}.png", ("rgb/*.jpg", "depth/*.png")),
            (
                "cecum_t1_a/{:04}_color.png",
                "cecum_t1_a/{:04}_depth.tiff",
                ("cecum_t1_a/*_color.png", "cecum_t1_a/*_depth.tiff"),
            ),
            (
                "train_frame/image_{:04}.png",
                "train_depth/aov_image_{:04}.png",
                ("train_frame/image_*.png", "train_depth/aov_image_*.png"),
            ),
            (
                "nyu_depth_v2/image_{}.png",
                "nyu_depth_v2/depth_{}.png",
                ("nyu_depth_v2/image_*.png", "nyu_depth_v2/depth_*.png"),
            ),
        ],
    )
    def test_what_is_proposed(self, tmp_path, image, chart, patterns):
        for number in range(8, 12):
            save(tmp_path / image.format(number), picture(number))
            save(tmp_path / chart.format(number), CODES)
        likeness = recognises(tmp_path)
        assert likeness is not None
        assert (likeness.sure, likeness.why[:11]) == ("sure", "4 of 4 char")
        found = survey(tmp_path)
        assert (found.found["images"], found.found["depths"], found.usable) == (*patterns, 4)
        assert [pair.number for pair in source_of(tmp_path, **found.found).pairs] == [8, 9, 10, 11]

    def test_sequences_in_folders_of_their_own(self, tmp_path):
        for name in ("s1/color/{}.png", "s2/color/{}.png", "s1/depth/{}.png", "s2/depth/{}.png"):
            for number in range(3):
                save(tmp_path / name.format(number), CODES if "depth" in name else picture(number))
        found = survey(tmp_path)
        assert (found.found["images"], found.found["depths"], found.usable) == ("*/color/*.png", "*/depth/*.png", 6)
        source = source_of(tmp_path, **found.found)
        assert [pair.sequence for pair in source.pairs] == ["s1"] * 3 + ["s2"] * 3

    def test_what_is_not_taken_for_depth(self, tmp_path):
        assert recognises(tmp_path / "nowhere") is None
        for number in range(3):
            for folder in ("a", "b"):
                save(tmp_path / "films" / folder / f"{number}.png", picture(number))
                save(tmp_path / "grey" / folder / f"{number}.png", CODES)
        assert recognises(tmp_path / "films") is None
        assert recognises(tmp_path / "grey") is None

    @pytest.mark.shared
    def test_the_real_flyingthings3d(self, shared_data):
        """The same pixels and depths as by the importer of its own, in its own geometry."""
        root = shared_data / "flyingthings3d/SCENE_FLOW"
        view = replace(VIEW, shape=(540, 960), pixel_pitch_m=1e-6, distance_m=1050e-6)
        depth = {"type": "disparity", "focal_px": 1050.0, "baseline_mm": 10.0}
        camera = CAMERA | {"fx": 1050.0, "fy": 1050.0, "cx": 479.5, "cy": 269.5}
        patterns = {"images": "RGB_cleanpass/left", "depths": "disparity/left"}
        clip = clip_of(root, view=view, depth=depth, intrinsics=camera, field="angles", **patterns)
        own = flyingthings3d(view, path=root, depth_scaling="fixed", metres_per_unit=0.01, downscale=1).clip(0, RNG)
        assert clip.valid.all()
        np.testing.assert_allclose(clip.depth_m, own.depth_m, rtol=2**-22)
        np.testing.assert_allclose(clip.rgb, own.rgb, rtol=0, atol=1e-6)
        found = survey(shared_data / "flyingthings3d")
        assert found.usable == 2, "left and right"
        assert found.facts["numbers of charts"] == "1.20638 to 130.365"

    @pytest.mark.shared
    def test_the_real_endoslam(self, shared_data):
        """The same as by its own importer where no border is asked for."""
        root = shared_data / "endoslam/new_code/data"
        view = replace(VIEW, shape=(64, 64))
        likeness = recognises(root)
        assert likeness is not None
        assert (likeness.sure, "20 of 20 charts pair with an image by number" in likeness.why) == ("likely", True)
        found = survey(root)
        patterns = {name: found.found[name] for name in ("images", "depths")}
        assert patterns == {"images": "train_frame/image_*.png", "depths": "train_depth/aov_image_*.png"}
        coding = {"type": "inverse", "full_cm": 0.4}
        clips = {"frames": 20, "frames_per_second": 30.0}
        clip = clip_of(root, view=view, depth=coding, **patterns, **clips)
        endoslam = resolve("source", "endoslam")
        parameters = {
            "path": str(root),
            "depth_code": "inverse",
            "depth_scale_cm": 0.4,
            "border": "none",
            "max_cm": 1e6,
        }
        own = endoslam.function(view, **endoslam.bind(parameters | clips)).clip(0, RNG)
        assert np.array_equal(clip.rgb, own.rgb)
        assert np.array_equal(clip.depth_m, own.depth_m)
        assert np.array_equal(clip.valid, own.valid)


class TestTables:
    def table(self, root, *rows, columns="image,depth"):
        for name in {cell.strip() for row in rows for cell in row.split(",")}:
            if "/" in name and "no" not in name:
                save(root / name, CODES if "depth" in name or "mask" in name else picture(len(name)))
        (root / "pairs.csv").write_text("\n".join(["# of the kitchen", columns, *rows]))
        return root / "pairs.csv"

    def test_rows_are_stills_unless_they_name_clips(self, tmp_path):
        table = self.table(tmp_path, "rgb/a.png,depth/x.png", "rgb/b.png , depth/y.png")
        stills = source_of(table)
        assert (len(stills), stills.groups) == (2, (0, 1))
        assert stills.inputs[-1] == table
        rows = [f"rgb/{k}.png,depth/{k}.png,{'ab'[k // 3]},{k},{'pouring' if k < 3 else ''}" for k in (2, 0, 1, 3, 4)]
        table = self.table(tmp_path, *rows, columns="image,depth,clip,frame,label")
        clips = source_of(table, frames=2, frames_per_second=10.0)
        assert (len(clips), clips.groups) == (2, (0, 1))
        assert [pair.number for pair in clips.pairs] == [0, 1, 2, 3, 4]
        assert [clips.clip(k, RNG).label for k in range(2)] == ["pouring", None]
        likeness = recognises(table)
        assert likeness is not None
        assert likeness.sure == "sure"
        found = survey(table)
        assert (found.usable, found.found) == (5, {"depth": MM})

    def test_frames_are_numbered_as_they_come(self, tmp_path):
        table = self.table(
            tmp_path, *(f"rgb/{k}.png,depth/{k}.png,{'ab'[k % 2]}" for k in range(6)), columns="image,depth,clip"
        )
        assert [pair.image.name for pair in source_of(table).pairs] == [
            "0.png",
            "2.png",
            "4.png",
            "1.png",
            "3.png",
            "5.png",
        ]

    def test_a_mask(self, tmp_path):
        table = self.table(tmp_path, "rgb/a.png,depth/x.png,mask/m.png", columns="image,depth,mask")
        save(tmp_path / "mask/m.png", (CODES > 99).astype(np.uint8))
        assert np.array_equal(clip_of(table).valid[0], CODES > 99)

    def test_rows_whose_files_are_missing_are_problems(self, tmp_path):
        table = self.table(tmp_path, "rgb/a.png,depth/x.png", "rgb/b.png,depth/none.png")
        (problem,) = source_of(table).problems
        assert problem.startswith("pairs.csv:4: there is no file depth/none.png")

    @pytest.mark.parametrize(
        ("rows", "columns", "place"),
        [
            (["rgb/a.png,depth/x.png"], "picture,depth", r"pairs\.csv: "),
            (["rgb/a.png,depth/x.png"], "image,depth,depth", r"pairs\.csv: "),
            (["rgb/a.png,depth/x.png", "rgb/b.png"], "image,depth", r"pairs\.csv:4: "),
            (["rgb/a.png,depth/x.png,first"], "image,depth,frame", r"pairs\.csv:3: "),
            (["rgb/a.png,depth/x.png,1", "rgb/b.png,depth/y.png,1"], "image,depth,frame", r"pairs\.csv: .*frame 1"),
            (["none/a.png,none/x.png"], "image,depth", r"pairs\.csv: "),
            ([], "image,depth", r"pairs\.csv: "),
        ],
    )
    def test_mistakes_are_named_with_their_line(self, tmp_path, rows, columns, place):
        with pytest.raises(InputError, match=place):
            source_of(self.table(tmp_path, *rows, columns=columns))


class TestPairs:
    def pairs(self, root, pictures, charts, **where):
        for name in pictures:
            save(root / name, picture(1))
        for name in charts:
            save(root / name, CODES)
        return source_of(root, **where)

    @pytest.mark.parametrize(
        "together",
        [
            {"rgb/b.png": "depth/b.png", "rgb/a.jpg": "depth/a.png"},
            {"rgb/a_0002.png": "depth/a_0002.png", "rgb/a_0010.png": "depth/a_0010.png"},
            {"rgb/frame-000002.color.png": "depth/frame-000002.depth.png"},  # 7-Scenes
            {"rgb/left_2.png": "depth/0002.png", "rgb/left_10.png": "depth/0010.png"},  # by their numbers alone
            {"rgb/s1/2.png": "depth/s1/2.png", "rgb/s2/2.png": "depth/s2/2.png"},
        ],
    )
    def test_files_belong_together_by_name_or_number(self, tmp_path, together):
        source = self.pairs(tmp_path, together, reversed(together.values()))
        assert source.problems == ()
        assert {pair.image.as_posix(): pair.depth.as_posix() for pair in source.pairs} == together

    @pytest.mark.parametrize(
        "pattern", ["rgb/*/*", "rgb/*/*.png", "**/rgb/**/*.png", "rgb/s*(a)/i_*.png", "rgb/s*/i_*.p*"]
    )
    def test_stars(self, tmp_path, pattern):
        """Parentheses and dots stand for themselves; endings are no part of a name."""
        (tmp_path / "rgb/s2(a)").mkdir(parents=True)
        (tmp_path / "rgb/s2(a)/i_3.txt").touch()
        pictures = [f"rgb/s{k}(a)/i_{k}.png" for k in (2, 10)]
        depths = pattern.replace("rgb", "depth")
        source = self.pairs(
            tmp_path, pictures, [name.replace("rgb", "depth") for name in pictures], images=pattern, depths=depths
        )
        assert [(pair.image.as_posix(), pair.depth.as_posix()) for pair in source.pairs] == [
            (name, name.replace("rgb", "depth")) for name in pictures
        ]
        assert source.groups == (0, 1)
        assert [pair.number for pair in source.pairs] == [2, 10]

    def test_numbers_sort_as_numbers_and_gaps_break_clips(self, tmp_path):
        names = [f"{number}.png" for number in (8, 9, 10, 12)]
        charts = [f"depth/{name}" for name in names]
        source = self.pairs(tmp_path, [f"rgb/{name}" for name in names], charts, frames=3, frames_per_second=30.0)
        assert [pair.number for pair in source.pairs] == [8, 9, 10, 12]
        assert (len(source), source.starts) == (1, (0,))
        assert source_of(tmp_path).groups == (0, 0, 0, 0)
        assert source_of(tmp_path, independent=True).groups == (0, 1, 2, 3)
        assert "independent: true" in survey(tmp_path).notes[-1]

    def test_files_without_partner_are_problems(self, tmp_path):
        source = self.pairs(tmp_path, ["rgb/1.png", "rgb/2.png"], ["depth/2.png", "depth/3.png"])
        assert len(source.pairs) == 1
        assert [line.partition(": ")[0] for line in source.problems] == [
            f"{tmp_path}/rgb/1.png",
            f"{tmp_path}/depth/3.png",
        ]

    @pytest.mark.parametrize(
        ("images", "charts", "where", "key"),
        [
            (
                ["rgb/1.png", "rgb/1.jpg"],
                ["depth/1.png"],
                {},
                r"images, depths: rgb/1\.(png|jpg), rgb/1\.(png|jpg) all belong",
            ),
            (
                ["rgb/left_1.png", "rgb/right_1.png"],
                ["depth/1.png"],
                {},
                "images, depths: rgb/left_1.png, rgb/right_1.png all",
            ),
            (["rgb/a.png"], ["depth/b.png"], {}, "images, depths: no file of rgb"),
            (["rgb/1.png"], ["depth/1.png"], {"depths": "deph"}, "depths: "),
            (["rgb/1.png"], ["depth/1.png"], {"depths": "*/disp*.png"}, "depths: "),
            (["rgb/1.png"], ["depth/1.png"], {"images": None}, "images: "),
            (["rgb/1.png"], ["depth/1.png"], {"depths": "rgb"}, "images, depths: "),
            (["rgb/1.png"], ["depth/1.png"], {"masks": "masks"}, "masks: "),
        ],
    )
    def test_what_is_ambiguous_or_missing_is_refused(self, tmp_path, images, charts, where, key):
        with pytest.raises(InputError, match=f"^{key}"):
            self.pairs(tmp_path, images, charts, **where)


class TestMistakes:
    def test_parameters_that_contradict_one_another(self, tmp_path):
        depths_of(CODES, tmp_path)
        (tmp_path / "cam.txt").write_text("20 0 7.5 0 20 5.5 0 0 1")
        for choice, message in [
            ({"intrinsics": CAMERA, "intrinsics_file": "cam.txt"}, "^intrinsics, intrinsics_file: "),
            ({"field": "angles"}, "^field: angles: "),
            ({"depth_along": "ray"}, "^depth_along: ray: "),
            ({"frames": 2}, "^frames_per_second: "),
            ({"independent": True, "frames": 2, "frames_per_second": 9.0}, "^independent: "),
            ({"range_cm": [5, 5]}, "^range_cm: "),
            ({"intrinsics_file": "calib.txt"}, "^intrinsics_file: "),
            ({"depth": {"type": "disparity"}}, r"^depth\.focal_px: "),
            ({"depth": {"type": "disparity"}, "intrinsics": CAMERA}, r"^depth\.baseline_mm: "),
            ({"path": tmp_path / "nowhere"}, "^path: "),
        ]:
            with pytest.raises(InputError, match=message):
                source_of(tmp_path, **choice)
        for depth in (
            {"type": "metric"},
            {"type": "metre"},
            {"type": "linear", "full_cm": 0},
            {"type": "metric", "unit": "inch"},
        ):
            with pytest.raises(ParameterError, match="depth"):
                source_of(tmp_path, depth=depth)

    def test_whole_numbers_without_a_largest_one(self, tmp_path):
        with pytest.raises(InputError, match=r"^depth\.full_code: "):
            depths_of(CODES.astype(np.int32), tmp_path, "depth/0001.npy", depth={"type": "linear", "full_cm": 20})

    def test_a_survey_finds_what_cannot_be_used(self, tmp_path):
        for number in range(3):
            save(tmp_path / f"rgb/{number}.png", picture(number))
            save(tmp_path / f"depth/{number}.png", CODES * (number > 0))
        (tmp_path / "rgb/2.png").write_bytes(b"no picture")
        found = survey(tmp_path)
        assert found.usable == 1
        assert [line.partition(": ")[0] for line in found.problems] == [
            f"{tmp_path}/depth/0.png",
            f"{tmp_path}/rgb/2.png",
        ]
        assert found.facts["depths"] == "0.1 to 19.2 cm"
        (tmp_path / "depth/camera.json").write_text(json.dumps(CAMERA))
        assert survey(tmp_path, depth=None, intrinsics_file=None).facts["intrinsics"].startswith("none")
