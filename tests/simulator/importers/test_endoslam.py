"""Pictures with depth charts become clips: layouts, codes at full range, depth's sense, undistortion, borders, mistakes."""

import json
import pickle
import warnings

import cv2
import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.importers.endoslam import recognises, survey
from simulator.plugins import ParameterError, resolve
from simulator.types import SceneSource, View

SHAPE = (16, 16)
FOCAL_PX = 20.0
VIEW = View(shape=SHAPE, pixel_pitch_m=1e-6, distance_m=FOCAL_PX * 1e-6, near_m=0.01, far_m=0.15)
CAMERA = {"type": "pinhole", "fx": FOCAL_PX, "fy": FOCAL_PX, "cx": 7.5, "cy": 7.5}
RNG = np.random.default_rng(0)


def save(path, array):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(array).save(path)


def picture(seed=0, shape=SHAPE):
    return np.random.default_rng(seed).integers(40, 255, (*shape, 3), dtype=np.uint8, endpoint=True)


def chart_rgba(codes):
    """As UnityCam writes it: R = G = B and an alpha that means nothing."""
    alpha = np.random.default_rng(9).integers(0, 255, codes.shape, dtype=np.uint8)
    return np.dstack([codes] * 3 + [alpha])


def unity(root, numbers=(0, 1, 2), sequence="UnityCam/Colon", codes=None):
    for number in numbers:
        grey = np.random.default_rng(number).integers(1, 120, SHAPE, dtype=np.uint8) if codes is None else codes
        save(root / sequence / "Frames" / f"image_{number:04}.png", picture(number))
        save(root / sequence / "Pixelwise Depths" / f"aov_image_{number:04}.png", chart_rgba(grey))
    return root


def simcol(root, codes, numbers=(0,), sequence="Frames_S1"):
    for number in numbers:
        save(root / sequence / f"FrameBuffer_{number:04}.png", picture(number, codes.shape))
        save(root / sequence / f"Depth_{number:04}.png", codes)
    return root


def source_of(root, **choice):
    given = {
        "path": root,
        "depth_scale_cm": 20.0,
        "depth_code": "linear",
        "intrinsics": CAMERA,
        "border": "none",
    } | choice
    plugin = resolve("source", "endoslam")
    plain = {name: str(value) if name in ("path", "intrinsics_file") else value for name, value in given.items()}
    return plugin.function(given.pop("view", VIEW), **plugin.bind({k: v for k, v in plain.items() if k != "view"}))


def clip_of(root, index=0, **choice):
    return source_of(root, **choice).clip(index, RNG)


class TestDepth:
    def test_every_16_bit_code_survives(self, tmp_path):
        """SimCol3D: code / 65280 x 20 cm; all 65536 codes are told apart where they are nearer than the limit."""
        codes = np.arange(65536, dtype=np.uint16).reshape(256, 256)
        simcol(tmp_path, codes)
        view = View((256, 256), 1e-6, 320e-6, 0.01, 0.3)
        camera = CAMERA | {"fx": 320.0, "fy": 320.0, "cx": 127.5, "cy": 127.5}
        choice = {"view": view, "intrinsics": camera, "field": "angles", "depth_full_code": 65280, "max_cm": 30.0}
        clip = clip_of(tmp_path, **choice)
        expected = codes / 255 / 256 * 0.20  # as their evaluation reads it
        assert clip.valid[0].ravel().tolist() == [False, *[True] * 65535]
        np.testing.assert_allclose(clip.depth_m[0][clip.valid[0]], expected[clip.valid[0]], rtol=2**-23)
        assert len(np.unique(clip.depth_m[0])) == 65536
        assert clip.source["without_depth_share"] == 1 / 65536
        whole = clip_of(tmp_path, **choice | {"depth_full_code": None})  # 65535 is then the full code
        np.testing.assert_allclose(whole.depth_m[0].ravel()[1:], np.arange(1, 65536) / 65535 * 0.20, rtol=2**-23)

    def test_simcol3d_s_own_files_of_four_channels_of_16_bits(self, tmp_path):
        codes = RNG.integers(1, 32000, (*SHAPE, 4), dtype=np.uint16)
        codes[..., 3] = 65535
        colour = codes[..., :3].copy()
        codes[..., :3] = codes[..., :1]
        folder = tmp_path / "SyntheticColon_I/Frames_S1"
        folder.mkdir(parents=True)
        cv2.imwrite(str(folder / "FrameBuffer_0000.png"), np.dstack((colour[..., ::-1], codes[..., 3])))
        cv2.imwrite(str(folder / "Depth_0000.png"), codes)
        found = survey(tmp_path, depth_scale_cm=20, depth_code="linear", depth_full_code=65280)
        assert (found.usable, found.problems) == (1, ())
        clip = clip_of(tmp_path, field="angles", depth_full_code=65280)
        np.testing.assert_allclose(clip.depth_m[0], codes[..., 0] / 65280 * 0.2, rtol=2**-22)
        encoded = colour / 65535
        light = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
        np.testing.assert_allclose(clip.rgb[0], light, rtol=0, atol=1e-6)

    @pytest.mark.parametrize(
        ("choice", "formula"),
        [
            ({"depth_code": "linear"}, lambda c: 0.2 * c),
            ({"depth_code": "inverse", "depth_scale_cm": 0.5}, lambda c: 0.005 / c),
            # A reversed depth buffer: c = n / (f - n) (f / z - 1), here solved for z.
            (
                {"depth_code": "inverse", "depth_scale_cm": 0.5, "depth_at_zero_cm": 30.0},
                lambda c: 0.3 / (1 + c * (0.3 - 0.005) / 0.005),
            ),
            # Bright is near and linear: 8 cm at black, 0.1 cm at white.
            ({"depth_scale_cm": 0.1, "depth_at_zero_cm": 8.0}, lambda c: 0.08 - c * 0.079),
        ],
    )
    def test_what_codes_mean(self, tmp_path, choice, formula):
        codes = np.arange(256, dtype=np.uint8).reshape(SHAPE)
        clip = clip_of(unity(tmp_path, codes=codes), **{"max_cm": 200.0, "field": "angles"} | choice)
        zero_is_a_depth = "depth_at_zero_cm" in choice
        assert np.array_equal(clip.valid[0], codes > 0 if not zero_is_a_depth else np.ones(SHAPE, bool))
        expected = formula(codes[clip.valid[0]] / 255)
        np.testing.assert_allclose(clip.depth_m[0][clip.valid[0]], expected, rtol=2**-22)
        assert np.all(clip.depth_m[~clip.valid] == np.float32(VIEW.far_m))

    def test_deeper_than_the_limit_is_not_valid_and_counted(self, tmp_path):
        codes = np.full(SHAPE, 127, np.uint8)  # 9.96 cm of 20
        codes[:4] = 128  # 10.04 cm
        clip = clip_of(unity(tmp_path, codes=codes), field="angles")
        assert np.array_equal(clip.valid[0], codes == 127)
        assert clip.source["beyond_max_share"] == 0.25
        assert clip.depth_m[clip.valid].max() <= 0.1
        assert clip.rgb[0, :4].min() > 0, "its light stays"

    def test_lengths_along_rays_become_z(self, tmp_path):
        """On a sphere of radius R about the camera z is R cos(theta)."""
        root = unity(tmp_path, codes=np.full(SHAPE, 51, np.uint8))  # R = 4 cm
        x = (np.arange(16) - 7.5) / FOCAL_PX
        expected = 0.04 / np.sqrt(1 + x[:, None] ** 2 + x**2)
        clip = clip_of(root, field="angles", depth_along="ray")
        np.testing.assert_allclose(clip.depth_m[0], expected, rtol=2**-23)
        np.testing.assert_allclose(clip_of(root, field="angles").depth_m[0], 0.04, rtol=2**-23)

    def test_each_frame_has_its_own_depth(self, tmp_path):
        for number in range(4):
            unity(tmp_path, (number,), codes=np.full(SHAPE, 10 * (number + 1), np.uint8))
        (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
        source = source_of(tmp_path, intrinsics=None, intrinsics_file=tmp_path / "camera.json", field="angles")
        assert source.lens == source_of(tmp_path, field="angles").lens
        assert source.inputs[-1] == tmp_path / "camera.json"
        clip = clip_of(tmp_path, frames=3, frames_per_second=30.0, field="angles")
        expected = np.float32([0.2 * code / 255 for code in (10, 20, 30)])
        np.testing.assert_allclose(clip.depth_m, np.broadcast_to(expected[:, None, None], (3, *SHAPE)), rtol=2**-22)

    def test_a_clip_beyond_the_limit_is_refused_with_the_depths_it_has(self, tmp_path):
        codes = np.linspace(100, 255, 256).astype(np.uint8).reshape(SHAPE)
        unity(tmp_path, codes=codes)
        choice = {"depth_scale_cm": 51.0, "field": "angles"}
        with pytest.raises(InputError, match=r"Depths/aov_image_0000\.png: .*depths of 20 to 51 cm.*max_cm 10"):
            clip_of(tmp_path, **choice)
        codes[0] = 25  # 5 cm
        unity(tmp_path, (1,), codes=codes)
        with pytest.warns(UserWarning, match="in which 94% of the pixels"):
            assert clip_of(tmp_path, 1, **choice).valid.sum() == 16
        assert clip_of(tmp_path, 0, **choice | {"max_cm": float("inf")}).valid.all()
        codes[:], codes[0, 0] = 0, 9  # outside the circle
        unity(tmp_path, (2,), codes=codes)
        with pytest.raises(InputError, match=r"aov_image_0002\.png: "):
            clip_of(tmp_path, 2, border=[8, 8, 5], field="angles")

    @pytest.mark.parametrize(("rows", "warned"), [(8, 0), (9, 1)])
    def test_a_clip_mostly_beyond_the_limit_is_warned_of_once(self, tmp_path, rows, warned):
        codes = np.full(SHAPE, 64, np.uint8)  # 5 cm
        codes[:rows] = 255
        source = source_of(unity(tmp_path, codes=codes), field="angles")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for index in range(3):
                source.clip(index, RNG)
        assert len(caught) == warned
        for warning in caught:
            assert "56% of the pixels are not valid (depths of 5.02 to 20 cm, with max_cm 10)" in str(warning.message)


class TestPictures:
    def test_colour_is_linear_light_seen_at_the_same_angles(self, tmp_path):
        clip = clip_of(unity(tmp_path), field="angles")
        encoded = picture(0) / 255.0  # all codes are at least 40, on the curved part of IEC 61966-2-1
        # Bilinear weights differ from 0 and 1 by a few roundings of the coordinates.
        np.testing.assert_allclose(clip.rgb[0], ((encoded + 0.055) / 1.055) ** 2.4, rtol=0, atol=1e-6)

    def test_without_intrinsics_the_picture_fills_the_view(self, tmp_path):
        clip = clip_of(unity(tmp_path), intrinsics=None)
        same = clip_of(unity(tmp_path), field="angles")
        np.testing.assert_allclose(clip.rgb, same.rgb, rtol=0, atol=1e-6)
        assert np.array_equal(clip.depth_m, same.depth_m)
        assert clip.source["intrinsics"] is clip.source["field_scale"] is None

    def test_the_black_rim_is_found_and_left_out(self, tmp_path):
        rows, columns = np.indices((64, 64))
        inside = np.hypot(columns - 30, rows - 33) <= 28
        for number in range(3):
            dark = np.where(inside[..., None], picture(number, (64, 64)), number)  # black is 0 to 2, not exactly 0
            dark[30:36, 28:32] = 0  # a dark lumen is no rim
            save(tmp_path / f"Frames/image_{number:04}.png", dark.astype(np.uint8))
            save(tmp_path / f"Pixelwise Depths/aov_image_{number:04}.png", chart_rgba(np.full((64, 64), 60, np.uint8)))
        view = View((64, 64), 1e-6, 60e-6, 0.01, 0.15)
        camera = CAMERA | {"fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 31.5}
        source = source_of(tmp_path, view=view, intrinsics=camera, field="angles", border="auto")
        column, row, radius = source.circle
        assert (column, row) == (pytest.approx(30, abs=0.2), pytest.approx(33, abs=0.2))
        assert radius == pytest.approx(28.5 - 1.5, abs=0.7)  # pixels at most 28 away; 1.5 px of margin
        clip = source.clip(0, RNG)
        assert np.array_equal(clip.valid[0], np.hypot(columns - column, rows - row) <= radius)
        assert not clip.rgb[~clip.valid].any()
        assert clip.source["unseen_share"] == pytest.approx(1 - clip.valid.mean())
        filled = source_of(tmp_path, view=view, intrinsics=None, border="auto").clip(0, RNG)
        assert filled.valid.all()

    @pytest.mark.parametrize("black", [np.s_[:10], np.s_[::63], np.s_[:, :5]])
    def test_a_straight_black_rim_is_no_circle(self, tmp_path, black):
        for number in range(3):
            barred = picture(number, (64, 64))
            barred[black] = 0
            save(tmp_path / f"Frames/image_{number:04}.png", barred)
            save(tmp_path / f"Pixelwise Depths/aov_image_{number:04}.png", np.full((64, 64), 60, np.uint8))
        with pytest.raises(InputError, match=r"^border: "):
            source_of(tmp_path, border="auto")
        assert source_of(tmp_path, border="none").circle is None
        assert source_of(tmp_path, border=[31.5, 30, 20]).circle == (31.5, 30.0, 20.0)
        assert survey(tmp_path).facts["image circle"] == "none found"


class TestClips:
    def test_consecutive_frames_groups_and_rate(self, tmp_path):
        unity(tmp_path, (0, 1, 2, 3, 5, 6), "UnityCam/Colon")
        unity(tmp_path, (7, 8), "UnityCam/Stomach")
        source = source_of(tmp_path, frames=2, frames_per_second=30.0)
        assert (len(source), list(source.groups), source.problems) == (4, [0, 0, 0, 1], ())
        clip = pickle.loads(pickle.dumps(source)).clip(6, RNG)  # 6 modulo 4
        assert [name.rpartition("_")[2] for name in clip.source["pictures"]] == ["0005.png", "0006.png"]
        np.testing.assert_allclose(clip.frame_edges_s, [0, 1 / 30, 2 / 30], rtol=1e-15)
        assert isinstance(source, SceneSource)
        stills = source_of(tmp_path)
        assert list(stills.groups) == [0] * 6 + [1] * 2
        assert np.array_equal(stills.clip(5, RNG).rgb[0], clip.rgb[1])
        assert stills.clip(7, RNG).frame_edges_s.tolist() == [0.0, 1.0]

    def test_layouts(self, tmp_path):
        unity(tmp_path / "a", (3, 4))
        simcol(tmp_path / "b/SyntheticColon_I", np.full(SHAPE, 9000, np.uint16), (0, 1), "Frames_S1")
        simcol(tmp_path / "b/SyntheticColon_I", np.full(SHAPE, 9000, np.uint16), (0,), "Frames_S2")
        for number in (0, 1):
            save(tmp_path / f"c/train_frame/image_{number:04}.png", picture())
            save(tmp_path / f"c/train_depth/aov_image_{number:04}.png", np.full(SHAPE, 9, np.uint8))
            save(tmp_path / f"c/eval_frame/image_{number:04}.png", picture())
            save(tmp_path / f"c/eval_depth/aov_image_{number:04}.png", np.full(SHAPE, 9, np.uint8))
        for folder, expected in {
            "a": ["UnityCam/Colon/Frames"] * 2,
            "b": ["SyntheticColon_I/Frames_S1"] * 2 + ["SyntheticColon_I/Frames_S2"],
            "c": ["eval_frame"] * 2 + ["train_frame"] * 2,
        }.items():
            assert recognises(tmp_path / folder)
            assert [pair.sequence for pair in source_of(tmp_path / folder).pairs] == expected
        pair = source_of(tmp_path / "c").pairs[-1]
        assert (pair.image.as_posix(), pair.depth.as_posix()) == (
            "train_frame/image_0001.png",
            "train_depth/aov_image_0001.png",
        )

    def test_files_without_partner_are_problems_and_gaps(self, tmp_path):
        unity(tmp_path, range(5))
        (tmp_path / "UnityCam/Colon/Pixelwise Depths/aov_image_0002.png").unlink()
        (tmp_path / "UnityCam/Colon/Frames/image_0004.png").unlink()
        save(tmp_path / "MiroCam/frame_0001.png", picture())
        source = source_of(tmp_path, frames=2, frames_per_second=30.0)
        assert len(source) == 1
        lonely, chart, camera = sorted(source.problems, key=lambda line: ("MiroCam" in line, "aov" in line))
        assert lonely.startswith(f"{tmp_path}/UnityCam/Colon/Frames/image_0002.png: has no depth chart of its number")
        assert chart.startswith(f"{tmp_path}/UnityCam/Colon/Pixelwise Depths/aov_image_0004.png: has no image")
        assert camera.startswith(f"{tmp_path}/MiroCam: holds images without any depth chart (1)")


class TestMistakes:
    def test_parameters_that_must_be_there_and_finite(self, tmp_path):
        plain = {"path": str(tmp_path), "depth_scale_cm": 20, "depth_code": "linear"}
        wrong = [(name, plain | {name: float("inf")}) for name in ("depth_scale_cm", "frames_per_second")]
        wrong += [
            (name, {key: plain[key] for key in plain if key != name}) for name in ("depth_scale_cm", "depth_code")
        ]
        for name, params in wrong:
            with pytest.raises(ParameterError, match=f"{name}: "):
                resolve("source", "endoslam").bind(params)

    def test_parameters_that_contradict_one_another(self, tmp_path):
        root = unity(tmp_path)
        (tmp_path / "cam.txt").write_text("20 0 7.5 0 20 7.5 0 0 1")
        for choice, message in [
            ({"intrinsics_file": tmp_path / "cam.txt"}, "^intrinsics, intrinsics_file: "),
            ({"intrinsics": None, "field": "angles"}, "^field: angles: "),
            ({"intrinsics": None, "depth_along": "ray"}, "^depth_along: ray: "),
            ({"depth_at_zero_cm": 20.0}, "^depth_at_zero_cm, depth_scale_cm: "),
            ({"frames": 2}, "^frames_per_second: "),
            ({"frames": 4, "frames_per_second": 30.0}, "^frames: .*UnityCam/Colon/Frames', has 3"),
        ]:
            with pytest.raises(InputError, match=message):
                source_of(root, **choice)
        with pytest.raises(ParameterError, match=r"intrinsics\.type:"):
            source_of(root, intrinsics=CAMERA | {"type": "pinhol"})
        with pytest.raises(ParameterError, match=r"intrinsics\.distortion"):
            source_of(root, intrinsics=CAMERA | {"distortion": [0.1, 0.2, 0.3]})  # MATLAB's three radial ones?

    def test_depth_charts(self, tmp_path):
        root = unity(tmp_path, (0,))
        chart = tmp_path / "UnityCam/Colon/Pixelwise Depths/aov_image_0000.png"
        coloured = chart_rgba(np.full(SHAPE, 9, np.uint8))
        coloured[3, 4, 1] = 8
        for array in (coloured, chart_rgba(np.zeros(SHAPE, np.uint8)), np.full((8, 16), 9, np.uint8)):
            save(chart, array)
            with pytest.raises(InputError, match=r"aov_image_0000\.png: "):
                clip_of(root)
        save(chart, picture(0)[..., 0])
        chart.write_bytes(chart.read_bytes()[:150])
        with pytest.raises(InputError, match=r"aov_image_0000\.png"):
            clip_of(root)

    def test_a_broken_picture_spoils_its_own_clip_alone(self, tmp_path):
        unity(tmp_path)
        broken = tmp_path / "UnityCam/Colon/Frames/image_0000.png"
        broken.write_bytes(b"no picture")
        source = source_of(tmp_path, border="auto")
        assert source.clip(1, RNG).valid.any()
        with pytest.raises(InputError, match=r"image_0000\.png: "):
            source.clip(0, RNG)
        for number in (1, 2):
            (tmp_path / f"UnityCam/Colon/Frames/image_{number:04}.png").write_bytes(b"no picture")
        with pytest.raises(InputError, match=r"image_0000\.png: "):
            source_of(tmp_path)

    def test_folders(self, tmp_path):
        with pytest.raises(InputError, match=r"^path: "):
            source_of(tmp_path / "nowhere")
        with pytest.raises(InputError, match=r"^path: "):
            source_of(tmp_path)
        save(tmp_path / "Frames/image_0000.png", picture())
        with pytest.raises(InputError, match=r"^path: "):
            source_of(tmp_path)
        assert not recognises(tmp_path)
        assert not recognises(tmp_path / "nowhere")


class TestSurvey:
    def test_facts_and_problems(self, tmp_path):
        codes = np.arange(256, dtype=np.uint16).reshape(SHAPE) * 255
        simcol(tmp_path, codes, (0, 1, 2, 4))
        (tmp_path / "cam.txt").write_text("20 0 12 0 20 7.5 0 0 1")
        save(tmp_path / "Frames_S1/Depth_0001.png", np.zeros(SHAPE, np.uint16))
        (tmp_path / "Frames_S1/Depth_0004.png").unlink()
        seen = []
        found = survey(tmp_path, lambda done, total: seen.append((done, total)))
        assert seen == [(1, 3), (2, 3), (3, 3)]
        assert found.usable == 2
        assert found.facts["depth codes"] == "16 bit, 0 to 65025"
        assert found.facts["code zero"] == "2 pixels"
        assert found.facts["consecutive frames"] == "1 to 1"
        assert found.facts["image circle"] == "the whole image"
        assert [line.partition(":")[0].rpartition("/")[2] for line in found.problems] == [
            "FrameBuffer_0004.png",
            "Depth_0001.png",
        ]
        gaps, axis = found.notes
        assert gaps == "gaps in the numbering: 1, which no clip crosses"
        assert "puts the optical axis at column 12, row 7.5 of 16 x 16 pixels" in axis
        assert found.found == {"depth_scale_cm": 20, "depth_code": "linear", "depth_full_code": 65280}

    def test_codes_in_centimetres(self, tmp_path):
        """Codes from 128 of 255 are beyond the half of 20 cm; 0.5 cm / (code / 255) is beyond 10 cm below code 12.75."""
        unity(tmp_path, (0,), codes=np.arange(256, dtype=np.uint8).reshape(SHAPE))
        unity(tmp_path, (1,), codes=np.full(SHAPE, 255, np.uint8))
        linear = survey(tmp_path, depth_scale_cm=20.0, depth_code="linear")
        assert linear.facts["depths"] == f"0.07843 to 20 cm, {(128 + 256) / 511:.1%} of pixels beyond max_cm (10)"
        assert linear.notes[0].startswith("more than half of all depths lie beyond max_cm: check depth_scale_cm")
        assert (linear.usable, len(linear.problems)) == (1, 1)
        assert "aov_image_0001.png: has no depth of at most max_cm (10): check depth_scale_cm" in linear.problems[0]
        inverse = survey(tmp_path, depth_scale_cm=0.5, depth_code="inverse")
        assert inverse.facts["depths"] == f"0.5 to 127.5 cm, {12 / 511:.1%} of pixels beyond max_cm (10)"
        assert (inverse.usable, inverse.problems, inverse.notes) == (2, (), ())
        reverse = survey(tmp_path, depth_scale_cm=0.5, depth_code="inverse", depth_at_zero_cm=30, max_cm=40)
        assert reverse.facts["depths"] == "0.5 to 30 cm, 0.0% of pixels beyond max_cm (40)"
        full = survey(tmp_path, depth_scale_cm=20.0, depth_code="linear", depth_full_code=510, max_cm=5)
        assert full.facts["depths"].startswith("0.03922 to 10 cm, ")
        rays = survey(tmp_path, depth_scale_cm=10.1, depth_code="linear", depth_along="ray")
        assert rays.facts["depths"].endswith("beyond max_cm (10), along each ray")
        assert (rays.usable, rays.problems) == (2, ()), "10.1 cm along a slanting ray may be less in depth"
        assert "depths" not in survey(tmp_path).facts
        with pytest.raises(InputError, match=r"^depth_code: "):
            survey(tmp_path, depth_scale_cm=20.0)

    @pytest.mark.shared
    def test_the_real_sample(self, shared_data, monkeypatch):
        monkeypatch.setattr("simulator.importers.depth_codes._WARNED", set())
        folder = shared_data / "endoslam/new_code/data"
        assert recognises(folder)
        found = survey(folder)
        assert (found.usable, found.problems) == (20, ())
        assert found.facts["sizes"] == "320 x 320"
        assert found.facts["consecutive frames"] == "20 to 20"
        assert "column 178.56, row 181.804 of 320 x 320 pixels" in found.notes[0]
        view = View((64, 64), 38.4e-6, 1.9e-3, 0.01, 0.1)
        source = source_of(
            folder, view=view, frames=20, frames_per_second=30.0, depth_code="inverse", depth_scale_cm=0.4,
            border="auto", intrinsics=None,
        )  # fmt: skip
        with pytest.warns(UserWarning, match=r"62% of the pixels are not valid \(depths of 2.488 to 102 cm"):
            clip = source.clip(0, RNG)
        # The lens's circle, by eye 184 px about the middle of the 320 px frame, which it overfills.
        assert source.circle == pytest.approx((159.5, 160.5, 184), abs=1.5)
        assert clip.rgb.shape == (20, 64, 64, 3)
        top, bottom = clip.depth_m[0, 16:24, 24:40], clip.depth_m[0, 56:, 24:40]
        assert bottom.max() < 0.04 < top.min(), "the bright floor is near, the dark lumen far"
