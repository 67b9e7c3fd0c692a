"""Which distance and exposure a picture has, what is averaged, and when a pixel is full."""

from pathlib import Path

import numpy as np
import pytest

from simulator.calibrate import pictures
from simulator.calibrate.pictures import Group, find_groups, left_out, read_picture
from simulator.errors import InputError
from simulator.io.measurements import READABLE, MeasuredImage


def save(folder, *names, image=None) -> None:
    for name in names:
        np.save(folder / f"{name}.npy", np.ones((8, 8)) if image is None else image)


class TestNames:
    def test_distances_exposures_and_dark_frames(self, tmp_path) -> None:
        save(tmp_path, "12.5cm", "z120mm_1", "z120mm_2", "psf_30cm_4ms", "1m", "2,5cm", "dark_4ms", "Dark")
        groups, dark = find_groups(tmp_path)
        told = [(g.distance_m, g.exposure_s, len(g.files)) for g in groups]
        assert told == [(0.025, None, 1), (0.12, None, 2), (0.125, None, 1), (0.3, 0.004, 1), (1.0, None, 1)]
        assert sorted((g.exposure_s or 0, len(g.files)) for g in dark) == [(0, 1), (0.004, 1)]

    @pytest.mark.parametrize("name", ["psf_10_cm_4_ms", "psf-10-cm 4 ms", "z10cm_4ms", "psf_0_10 cm-4-ms"])
    def test_units_may_be_set_apart(self, tmp_path, name) -> None:
        save(tmp_path, name)
        (group,), _ = find_groups(tmp_path)
        assert (group.distance_m, group.exposure_s) == (0.1, 0.004)

    @pytest.mark.parametrize("names", [["psf_a"], ["3cm_4cm"], ["3cm_1ms", "3cm_2ms"]])
    def test_what_cannot_be_told_is_named(self, tmp_path, names) -> None:
        save(tmp_path, "5cm", *names)
        with pytest.raises(InputError, match=names[0]):
            find_groups(tmp_path)

    def test_no_pictures(self, tmp_path) -> None:
        with pytest.raises(InputError, match=tmp_path.name):
            find_groups(tmp_path)
        with pytest.raises(InputError, match="nowhere"):
            find_groups(tmp_path / "nowhere")

    def test_every_kind_of_file_that_can_be_read_is_taken(self, tmp_path) -> None:
        for suffix in READABLE:
            (tmp_path / f"5cm{suffix.upper()}").write_bytes(b"")
        (group,), _ = find_groups(tmp_path)
        assert len(group.files) == len(READABLE)

    def test_what_is_left_out_is_counted_by_kind(self, tmp_path) -> None:
        save(tmp_path, "5cm", "dark")
        for name in ("6cm.jpg", "7cm.JPG", "notes.txt", ".hidden", "distances.csv"):
            (tmp_path / name).write_text("file,distance_cm\n5cm.npy,5\n")
        (tmp_path / "folder.jpg").mkdir()
        assert left_out(tmp_path, [Path(tmp_path / "5cm.npy")]) == "2 .jpg, 1 .npy, 1 .txt"


class TestTable:
    def test_it_tells_what_names_do_not(self, tmp_path) -> None:
        save(tmp_path, "a", "b", "c", "d")
        text = "file,distance_mm,exposure_ms\nb.npy,50,2\na.npy,20,2\nc.npy,dark,2\nd.npy,20,2\n"
        (tmp_path / "distances.csv").write_text(text)
        groups, dark = find_groups(tmp_path)
        assert [(g.distance_m, g.exposure_s, [f.name for f in g.files]) for g in groups] == [
            (0.02, 0.002, ["a.npy", "d.npy"]),
            (0.05, 0.002, ["b.npy"]),
        ]
        assert [f.name for g in dark for f in g.files] == ["c.npy"]

    def test_as_spreadsheets_save_it(self, tmp_path) -> None:
        save(tmp_path, "a", "b")
        (tmp_path / "distances.csv").write_text("File; Distance_cm\na.npy;3,6\nb.npy;dark\n")
        (group,), dark = find_groups(tmp_path)
        assert (group.distance_m, len(dark)) == (0.036, 1)

    @pytest.mark.parametrize(
        ("text", "place"),
        [
            ("file,distance_cm\na.npy,2\na.npy,3\n", r"distances\.csv:3: "),
            ("file,distance\na.npy,2\n", r"distances\.csv: "),
            ("file,distance_cm\nno.npy,2\n", r"distances\.csv:2: "),
            ("file,distance_cm\na.npy,near\n", r"distances\.csv:2: "),
        ],
    )
    def test_mistakes_are_named(self, tmp_path, text, place) -> None:
        save(tmp_path, "a")
        (tmp_path / "distances.csv").write_text(text)
        with pytest.raises(InputError, match=place):
            find_groups(tmp_path)


def picture(folder, **options):
    groups, dark = find_groups(folder)
    return read_picture(groups[0], dark, **options)


class TestReading:
    def test_frames_are_averaged_and_darkness_taken_off(self, tmp_path) -> None:
        rng = np.random.default_rng(0)
        light = np.zeros((64, 64))
        light[20:40, 20:40] = 500
        for number in range(4):
            save(tmp_path, f"5cm_{number}", image=100 + light + rng.normal(0, 8, light.shape))
            save(tmp_path, f"dark_{number}", image=100 + rng.normal(0, 1, light.shape))
        found = picture(tmp_path, bits=12)
        assert found.light.shape == (1, 64, 64)
        assert found.light[0, 25:35, 25:35].mean() == pytest.approx(500, abs=3)
        assert found.noise == pytest.approx(4, rel=0.1)  # 8 by the square root of four frames
        assert found.saturated == 0
        assert picture(tmp_path, bits=12, binning=2).noise == pytest.approx(2, rel=0.1)

    def test_noise_of_a_single_frame(self, tmp_path) -> None:
        save(tmp_path, "5cm", image=np.random.default_rng(0).normal(1000, 8, (64, 64)))
        found = picture(tmp_path, bits=12)
        # Of neighbours the darker of a pair is likelier below the median: a few percent.
        assert found.noise == pytest.approx(8, rel=0.25)
        assert (found.background, len(found.notes)) == ("border", 1)

    def test_full_pixels(self, tmp_path) -> None:
        image = np.random.default_rng(0).integers(0, 3000, (40, 40)).astype(np.uint16)
        image[:5, :6] = 4095
        save(tmp_path, "5cm", "dark", image=image)
        assert picture(tmp_path, bits=12).saturated == pytest.approx(30 / 1600)
        # 12 bits in 16: nobody said so, but so many pixels are alike.
        told = picture(tmp_path)
        assert told.saturated == pytest.approx(30 / 1600)
        assert any("4095" in note for note in told.notes)
        with pytest.raises(InputError, match=r"5cm\.npy: "):
            picture(tmp_path, bits=11)

    def test_a_type_of_more_bits_than_the_sensor_is_a_guess(self, tmp_path) -> None:
        save(tmp_path, "5cm", image=np.random.default_rng(0).integers(0, 2560, (40, 40)).astype(np.uint16))
        assert picture(tmp_path).guessed
        assert not picture(tmp_path, bits=12).guessed

    def test_a_binning_that_leaves_pixels_over_is_refused(self, tmp_path) -> None:
        save(tmp_path, "5cm")
        for binning in (3, 64):
            with pytest.raises(InputError, match=r"^--binning: "):
                picture(tmp_path, binning=binning)

    def test_what_reading_assumed_is_noted_once(self, tmp_path) -> None:
        save(tmp_path, "5cm_0", "5cm_1", image=np.ones((8, 8, 3)))
        save(tmp_path, "dark")
        found = picture(tmp_path)
        assert [note for note in found.notes if "its last axis" in note] == found.notes[:1]

    def test_noise_is_that_of_picture_and_dark_frames(self, tmp_path) -> None:
        rng = np.random.default_rng(0)
        for number in range(4):
            save(tmp_path, f"5cm_{number}", f"dark_{number}")
            for name in ("5cm", "dark"):
                save(tmp_path, f"{name}_{number}", image=rng.normal(100, 8, (64, 64)))
        found = picture(tmp_path, bits=12)
        assert found.noise == pytest.approx(np.sqrt(2) * 4, rel=0.05)
        assert found.light.std() == pytest.approx(found.noise, rel=0.05)

    def test_dark_frames_of_another_exposure_are_noted(self, tmp_path) -> None:
        save(tmp_path, "5cm_4ms", "dark_2ms", "dark_9ms")
        assert any("another exposure" in note for note in picture(tmp_path).notes)
        save(tmp_path, "dark_4ms")
        assert picture(tmp_path).notes == []

    def test_dark_frames_of_another_size_are_named(self, tmp_path) -> None:
        save(tmp_path, "5cm")
        save(tmp_path, "dark", image=np.ones((4, 4)))
        with pytest.raises(InputError, match=r"dark\.npy: "):
            picture(tmp_path)


class TestMosaic:
    def test_one_full_green_of_two_is_full(self, tmp_path) -> None:
        image = np.random.default_rng(0).integers(0, 3000, (24, 20)).astype(np.uint16)
        image[6, 7] = image[12:14, 8:10] = 4095  # one green, and all four of another pixel
        save(tmp_path, "10cm", image=image)
        assert picture(tmp_path, bits=12, cfa="RGGB").saturated == pytest.approx(2 / (12 * 10))

    @pytest.mark.parametrize(("told", "stated"), [("RGGB", None), (None, "RGGB")])
    def test_each_2_x_2_is_a_pixel_whoever_says_so(self, tmp_path, monkeypatch, told, stated) -> None:
        """A raw file states its mosaic itself; the pixels of the stack are twice as large all the same."""
        values = np.random.default_rng(0).random((1, 24, 20), np.float32)
        monkeypatch.setattr(pictures, "read_measured_image", lambda _: MeasuredImage(values, cfa=stated))
        found = read_picture(Group(0.1, None, (tmp_path / "10cm.dng",)), [], cfa=told, binning=2)
        assert (found.light.shape, found.pixels) == ((3, 6, 5), 4)
        monkeypatch.setattr(pictures, "read_measured_image", lambda _: MeasuredImage(values))
        assert read_picture(Group(0.1, None, (tmp_path / "10cm.tif",)), [], binning=2).pixels == 2
