"""Which distance and exposure a picture has, what is averaged, and when a pixel is full."""

import numpy as np
import pytest

from simulator.calibrate import pictures
from simulator.calibrate.pictures import Group, find_groups, read_picture
from simulator.errors import InputError
from simulator.io.measurements import MeasuredImage


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

    @pytest.mark.parametrize(
        ("text", "place"),
        [
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
        with pytest.raises(InputError, match=r"^bits: "):
            picture(tmp_path, bits=11)

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
    @pytest.mark.parametrize(("told", "stated"), [("RGGB", None), (None, "RGGB")])
    def test_each_2_x_2_is_a_pixel_whoever_says_so(self, tmp_path, monkeypatch, told, stated) -> None:
        """A raw file states its mosaic itself; the pixels of the stack are twice as large all the same."""
        values = np.random.default_rng(0).integers(0, 4000, (1, 24, 20), np.uint16)
        monkeypatch.setattr(pictures, "read_measured_image", lambda _: MeasuredImage(values, cfa=stated))
        found = read_picture(Group(0.1, None, (tmp_path / "10cm.dng",)), [], cfa=told, binning=2, bits=12)
        assert (found.light.shape, found.pixels) == ((3, 6, 5), 4)
        monkeypatch.setattr(pictures, "read_measured_image", lambda _: MeasuredImage(values))
        assert read_picture(Group(0.1, None, (tmp_path / "10cm.tif",)), [], binning=2, bits=12).pixels == 2
