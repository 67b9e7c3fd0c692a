"""Measured PSFs: the same numbers through every file format, background, binning, frame, the one scale, mistakes."""

import json

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image
from scipy.ndimage import gaussian_filter

from simulator.errors import InputError
from simulator.optics.measured import cut_edges, load_measured_psf

PITCH = 10e-6
AREA = 3e-6
DEPTHS = [0.04, 0.2]


def load(files, depths=(0.1,), **changes):
    settings = {"pixel_pitch_m": PITCH, "frame": "stored", "background": "none", "throughput_m2": AREA, **changes}
    return load_measured_psf(files, depths, **settings)


def refuses(match, files, *arguments, **changes):
    with pytest.raises(InputError, match=match):
        load(files, *arguments, **changes)


def save(path, image):
    """Write ``(H, W)`` or ``(H, W, 3)`` by a writer that is not ours."""
    if path.suffix == ".npy":
        np.save(path, image if image.ndim == 2 else np.moveaxis(image, -1, 0))
    elif path.suffix == ".tif":
        tifffile.imwrite(path, image, photometric="rgb" if image.ndim == 3 else "minisblack")
    elif path.suffix == ".exr":
        import OpenEXR

        names = "RGB" if image.ndim == 3 else "Y"
        planes = [image] if image.ndim == 2 else [image[..., c] for c in range(3)]
        channels = {n: np.ascontiguousarray(p, np.float32) for n, p in zip(names, planes, strict=True)}
        OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, channels).write(str(path))
    elif image.dtype == np.uint16:
        cv2.imwrite(str(path), image)
    else:
        Image.fromarray(image).save(path)
    return path


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.fixture
def grey(rng):
    return rng.integers(0, 200, (9, 13), dtype=np.uint8)


def expected(image):
    """The one scale: sum H p^2 is the throughput on average."""
    image = image.astype(float)
    planes = np.stack([image] * 3) if image.ndim == 2 else np.moveaxis(image, -1, 0)
    return planes * AREA / (planes.sum((1, 2)).mean() * PITCH**2)


class TestFormats:
    @pytest.mark.parametrize(("shape", "dtype"), [((9, 13), np.uint8), ((9, 13, 3), np.uint8), ((9, 13), np.uint16)])
    @pytest.mark.parametrize("suffix", [".tif", ".png", ".npy", ".exr"])
    def test_grey_serves_all_channels_and_colour_comes_in_rgb_order(self, tmp_path, rng, suffix, shape, dtype):
        image = rng.integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)
        stack = load([save(tmp_path / f"psf{suffix}", image)])
        assert stack.values.dtype == np.float32
        np.testing.assert_allclose(stack.values[0], expected(image), rtol=1e-6)
        assert stack.provenance["same_psf_for_all_channels"] is (len(shape) == 2)

    def test_planar_tiff(self, tmp_path, rng):
        image = rng.integers(0, 200, (3, 9, 13), dtype=np.uint16)
        tifffile.imwrite(tmp_path / "psf.tif", image, photometric="rgb", planarconfig="separate")
        np.testing.assert_allclose(
            load([tmp_path / "psf.tif"]).values[0], expected(np.moveaxis(image, 0, -1)), rtol=1e-6
        )

    @pytest.mark.parametrize("shape", [(2, 9, 13), (2, 3, 9, 13)])
    def test_one_npy_holds_all_depths(self, tmp_path, rng, shape):
        values = rng.uniform(size=shape)
        np.save(tmp_path / "stack.npy", values)
        stack = load([tmp_path / "stack.npy"], DEPTHS)
        ours = np.broadcast_to(values.reshape(2, -1, 9, 13), (2, 3, 9, 13))
        np.testing.assert_allclose(stack.values, ours * (stack.values[0, 0, 0, 0] / ours[0, 0, 0, 0]), rtol=1e-5)

    def test_other_channel_names(self, tmp_path, grey):
        stack = load([save(tmp_path / "psf.tif", grey)], channels=("mono",))
        assert stack.values.shape == (1, 1, 9, 13)
        assert stack.channels == ("mono",)


class TestLight:
    def test_one_scale_for_the_whole_stack(self, tmp_path, rng):
        values = rng.uniform(size=(2, 3, 9, 13)) * np.array([1.0, 5.0])[:, None, None, None]
        np.save(tmp_path / "stack.npy", values)
        stack = load([tmp_path / "stack.npy"], DEPTHS)
        assert stack.energy_m2().mean() == pytest.approx(AREA, rel=1e-6)
        ratios = stack.energy_m2() / values.sum((2, 3))
        assert np.ptp(ratios) / ratios.mean() < 1e-6  # what differed in the files still differs alike
        assert stack.provenance["scale_per_count"] == pytest.approx(ratios.mean() / PITCH**2, rel=1e-6)

    def test_border_takes_the_median_of_the_outer_frame_per_channel(self, tmp_path, rng):
        light = np.zeros((100, 60, 3))
        light[40:60, 20:40] = rng.uniform(50, 100, (20, 20, 3))
        levels = np.array([7.0, 20.0, 31.0])
        image = np.rint(light + levels).astype(np.uint16)
        image[0, :5] = 60000  # a few hot pixels in the frame must not matter
        stack = load([save(tmp_path / "psf.tif", image)], background="border")
        (record,) = stack.provenance["images"]
        assert record["background"] == levels.tolist()
        assert record["negative_share"] == [0, 0, 0]
        inside = np.rint(light)[5:]
        np.testing.assert_allclose(
            stack.values[0, :, 5:], np.moveaxis(inside, -1, 0) * stack.provenance["scale_per_count"], rtol=1e-5
        )

    def test_a_number_and_negative_residues(self, tmp_path):
        image = np.array([[1, 5, 9], [5, 5, 5], [5, 5, 6]], np.uint8)
        stack = load([save(tmp_path / "psf.tif", image)], background=5.0)
        (record,) = stack.provenance["images"]
        assert record["background"] == [5.0]
        assert record["negative_share"] == [pytest.approx(4 / 9)]  # 4 below, 4 + 1 above
        np.testing.assert_allclose(stack.values[0, 1] / stack.values.max(), [[0, 0, 1], [0, 0, 0], [0, 0, 0.25]])

    @pytest.mark.parametrize("dark_channels", [1, 3])
    def test_a_dark_image(self, tmp_path, rng, dark_channels):
        shape = (9, 13, 3)
        light, dark = rng.integers(1, 100, shape, np.uint16), rng.integers(1, 9, shape, np.uint16)
        dark = dark[..., :1].repeat(3, -1) if dark_channels == 1 else dark
        stored = dark[..., 0] if dark_channels == 1 else dark
        file = save(tmp_path / "dark.tif", stored)
        stack = load([save(tmp_path / "psf.tif", light + dark)], background=file)
        np.testing.assert_allclose(stack.values[0], expected(light), rtol=1e-6)
        assert stack.provenance["background"] == "dark.tif"
        assert stack.provenance["images"][0]["background"] == pytest.approx(dark.mean((0, 1)).tolist())

    def test_binning_comes_before_clipping(self, tmp_path):
        noise = np.indices((8, 8)).sum(0) % 2 * 2.0 - 1  # averages to zero in every block of 2 x 2
        image = (10 + noise).astype(np.float32)
        image[4:6, 4:6] += 8
        stack = load([save(tmp_path / "psf.tif", image)], background=10.0, binning=2)
        assert np.count_nonzero(stack.values[0, 0]) == 1
        assert stack.values[0, 0, 2, 2] > 0
        assert stack.provenance["images"][0]["negative_share"] == [0]

    def test_blocks_are_averaged_and_the_rest_is_cropped_in_the_centre(self, tmp_path, rng):
        image = rng.uniform(1, 2, (8, 11)).astype(np.float32)
        stack = load([save(tmp_path / "psf.npy", image)], binning=3)
        by_hand = [[image[1 + 3 * r : 4 + 3 * r, 1 + 3 * c : 4 + 3 * c].mean() for c in range(3)] for r in range(2)]
        np.testing.assert_allclose(stack.values[0, 0], expected(np.array(by_hand))[0], rtol=1e-6)
        assert stack.provenance["images"][0]["cropped_px"] == [2, 2]
        assert stack.pixel_pitch_m == PITCH  # the pitch given is that of the binned pixels


class TestFrame:
    @pytest.mark.parametrize("shape", [(9, 13), (8, 12), (9, 12), (8, 13)])
    def test_rotating_keeps_the_origin_on_its_sample(self, tmp_path, rng, shape):
        image = rng.uniform(1, 2, shape)
        image[shape[0] // 2, shape[1] // 2] = 50.0  # the origin
        image[shape[0] // 2 - 2, shape[1] // 2 + 1] = 20.0  # above and to the right: must come out below, left
        values = load([save(tmp_path / "psf.npy", image)], frame="physical").values[0, 0]
        rows, columns = values.shape
        assert (rows % 2, columns % 2) == (1, 1)
        assert np.unravel_index(values.argmax(), values.shape) == (rows // 2, columns // 2)
        assert values[rows // 2 + 2, columns // 2 - 1] == pytest.approx(values.max() * 0.4)
        # Every sample x of the rotated PSF is sample -x of the measured one.
        for y in range(-(rows // 2), rows // 2 + 1):
            for x in range(-(columns // 2), columns // 2 + 1):
                ratio = values[rows // 2 + y, columns // 2 + x] / image[shape[0] // 2 - y, shape[1] // 2 - x]
                assert ratio == pytest.approx(values.max() / 50.0, rel=1e-5)

    def test_a_centre_of_mass_far_out_is_noted(self, tmp_path):
        image = np.zeros((41, 41))
        image[35:39, 3] = 1e4
        stack = load([save(tmp_path / "psf.npy", image)])
        (record,) = stack.provenance["images"]
        assert record["centre_of_mass_px"] == pytest.approx([16.5, -17], abs=1e-6)
        (warning,) = stack.provenance["warnings"]
        assert "PSF of 0.1 m" in warning
        image[2:6, 37] = 1e4
        assert load([save(tmp_path / "even.npy", image)]).provenance["warnings"] == []

    def test_a_psf_that_its_image_cuts_is_noted_with_its_edges(self, tmp_path, rng):
        """Speckle within a circle: complete, and with its upper part beyond the image."""
        rows, columns = np.indices((120, 120)) - 60
        speckle = gaussian_filter(rng.exponential(1, (120, 120)), 1) * (np.hypot(rows, columns) < 45)
        complete = 100 + 1000 * speckle + rng.normal(0, 5, speckle.shape)
        whole = load([save(tmp_path / "whole.npy", complete)], background="border")
        assert whole.provenance["warnings"] == []
        cut = load([save(tmp_path / "cut.npy", complete[30:])], background=100.0)
        (warning,) = cut.provenance["warnings"]
        assert "(top)" in warning
        light = complete[30:] - 100
        assert cut_edges(light) == {"top": pytest.approx(light[:2].mean() / light.mean())}


class TestColours:
    def test_a_mosaic_is_split_cropped_and_binned_in_this_order(self, tmp_path, rng):
        mosaic, dark = rng.integers(100, 4000, (24, 30), np.uint16), rng.integers(0, 99, (24, 30), np.uint16)
        told = {"cfa": "GRBG", "crop": "8x12+2+1", "background": save(tmp_path / "dark.tif", dark), "binning": 2}
        stack = load([save(tmp_path / "psf.tif", mosaic)], **told)
        light = mosaic.astype(float) - dark
        colours = [light[::2, 1::2], (light[::2, ::2] + light[1::2, 1::2]) / 2, light[1::2, ::2]]
        by_hand = np.array(
            [[[c[i : i + 2, j : j + 2].mean() for j in range(1, 13, 2)] for i in range(2, 10, 2)] for c in colours]
        )
        by_hand *= AREA / (by_hand.sum(axis=(1, 2)).mean() * PITCH**2)
        np.testing.assert_allclose(stack.values[0], by_hand, rtol=1e-6)
        assert (stack.provenance["cfa"], stack.provenance["crop"]) == ("GRBG", "8x12+2+1")

    def test_a_mosaic_of_which_nothing_is_said_is_refused_and_none_insists(self, tmp_path, rng):
        light = gaussian_filter(rng.exponential(1, (200, 260)), 3)
        light[::2, ::2] *= 0.5
        light[1::2, 1::2] *= 0.6
        file = save(tmp_path / "psf.tif", (4e4 * light / light.max()).astype(np.uint16))
        refuses("^cfa: ", [file])
        assert load([file], cfa="none").provenance["same_psf_for_all_channels"]

    def test_without_names_the_channels_are_the_files(self, tmp_path, rng, grey):
        colour = rng.integers(0, 200, (9, 13, 3), dtype=np.uint8)
        assert load([save(tmp_path / "c.png", colour)], channels=None).channels == ("R", "G", "B")
        assert load([save(tmp_path / "g.png", grey)], channels=None).channels == ("grey",)
        refuses(r"c\.png: ", [tmp_path / "c.png"], channels=("Y",))


class TestRecord:
    def test_fingerprint_follows_everything_that_decides_the_values(self, tmp_path, grey):
        file = save(tmp_path / "psf.tif", grey)
        (tmp_path / "another").mkdir()
        darks = [
            save(folder / "dark.tif", np.full_like(grey, n))
            for n, folder in enumerate((tmp_path, tmp_path / "another"))
        ]
        first = load([file]).fingerprint
        assert load([save(tmp_path / "copy.tif", grey)]).fingerprint == first
        changes = [
            {"frame": "physical"},
            {"binning": 2},
            {"background": "border"},
            {"background": 1.0},
            *({"background": dark} for dark in darks),
            {"throughput_m2": 2 * AREA},
            {"pixel_pitch_m": 2 * PITCH},
            {"channels": ("r", "g", "b")},
            {"depths": (0.2,)},
        ]
        found = {first, *(load([file], **change).fingerprint for change in changes)}
        grey[4, 4] += 1
        found.add(load([save(tmp_path / "psf.tif", grey)]).fingerprint)
        assert len(found) == len(changes) + 2

    def test_provenance_is_strict_json_even_at_infinity(self, tmp_path, grey):
        stack = load([save(tmp_path / "psf.tif", grey)], depths=(np.inf,))
        assert json.loads(json.dumps(stack.provenance, allow_nan=False)) == stack.provenance

    @pytest.mark.shared
    def test_the_real_diffuser(self, shared_data):
        file = shared_data / "diffusercam/tutorial/psf_sample.tif"
        stack = load([file], frame="physical", binning=4, background="border", throughput_m2=1e-5)
        assert stack.values.shape == (1, 3, 299, 399)
        assert stack.energy_m2() == pytest.approx(1e-5 * np.ones((1, 3)), rel=1e-6)
        (record,) = stack.provenance["images"]
        assert record["background"] == pytest.approx([32], abs=16)  # the note: about 32
        raw = tifffile.imread(file).astype(float)
        binned = np.maximum(raw.reshape(300, 4, 400, 4).mean((1, 3)) - record["background"][0], 0)
        peak = np.unravel_index(binned[1:, 1:].argmax(), (299, 399))
        found = np.unravel_index(stack.values[0, 0].argmax(), (299, 399))
        assert found == (298 - peak[0], 398 - peak[1])


class TestMistakes:
    def test_files_and_depths_do_not_match(self, tmp_path, grey):
        file = save(tmp_path / "psf.tif", grey)
        refuses(r"^files: got 1 for 2 depths", [file], DEPTHS)
        np.save(tmp_path / "stack.npy", np.ones((3, 9, 13)))
        refuses(r"stack\.npy: ", [tmp_path / "stack.npy"], DEPTHS)
        refuses("depths_m", [file, file], DEPTHS[::-1])
        refuses("depths_m", [file], (-0.1,))

    def test_files_that_differ(self, tmp_path, grey):
        files = [save(tmp_path / "a.tif", grey), save(tmp_path / "b.tif", grey[1:])]
        refuses(r"^b\.tif: ", files, DEPTHS)
        files[1] = save(tmp_path / "c.png", np.stack([grey, grey // 2, grey], -1))
        refuses(r"^c\.png: .* 3 channels", files, DEPTHS)

    def test_a_dark_psf_is_named(self, tmp_path, grey):
        files = [save(tmp_path / "a.tif", grey), save(tmp_path / "b.tif", np.full_like(grey, 3))]
        refuses(r"^b\.tif: .*0\.2 m .*\[3\.0\]", files, DEPTHS, background="border")

    def test_values_that_are_no_light(self, tmp_path, grey):
        image = grey.astype(np.float32)
        image[2, 2] = np.nan
        refuses(r"psf\.tif: ", [save(tmp_path / "psf.tif", image)])
        np.save(tmp_path / "wave.npy", grey + 1j)
        refuses(r"wave\.npy: .*complex128", [tmp_path / "wave.npy"])

    @pytest.mark.parametrize("suffix", [".tif", ".png", ".npy", ".exr"])
    def test_unreadable_files_are_named(self, tmp_path, rng, suffix):
        path = tmp_path / f"psf{suffix}"
        refuses(path.name, [path])
        path.write_bytes(b"this is no image at all")
        refuses(path.name, [path])
        save(path, rng.integers(0, 255, (90, 130), dtype=np.uint8))
        path.write_bytes(path.read_bytes()[:4000])
        refuses(path.name, [path])

    def test_pickles_and_archives_are_not_opened(self, tmp_path, grey):
        np.save(tmp_path / "objects.npy", np.array([{}], object), allow_pickle=True)
        refuses(r"objects\.npy: ", [tmp_path / "objects.npy"])
        with (tmp_path / "many.npy").open("wb") as file:
            np.savez(file, grey)
        refuses(r"many\.npy: ", [tmp_path / "many.npy"])

    def test_shapes_and_kinds_that_are_not_expected(self, tmp_path, grey):
        tifffile.imwrite(tmp_path / "pages.tif", np.stack([grey, grey]), photometric="minisblack")
        refuses(r"pages\.tif: ", [tmp_path / "pages.tif"])
        np.save(tmp_path / "a.npy", np.ones((2, 9, 13)))
        refuses(r"a\.npy: .*\(2, 9, 13\)", [tmp_path / "a.npy", tmp_path / "a.npy"], DEPTHS)
        Image.fromarray(grey).save(tmp_path / "psf.jpg")
        refuses(r"psf\.jpg", [tmp_path / "psf.jpg"])

    def test_a_background_that_does_not_fit(self, tmp_path, grey):
        file = save(tmp_path / "psf.tif", grey)
        refuses(r"^background: dark\.tif ", [file], background=save(tmp_path / "dark.tif", grey[1:]))
        for level in (-1.0, np.nan):
            refuses("background", [file], background=level)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"frame": "upright"}, "^frame: "),
            ({"pixel_pitch_m": 2.4}, "^pixel_pitch_m: "),
            ({"binning": 0}, "^binning: "),
            ({"binning": 10}, "^binning: "),
            ({"throughput_m2": 0.0}, "^throughput_m2: "),
            ({"throughput_m2": 10.0}, "^throughput_m2: "),
        ],
    )
    def test_numbers_out_of_range(self, tmp_path, grey, change, message):
        refuses(message, [save(tmp_path / "psf.tif", grey)], **change)
