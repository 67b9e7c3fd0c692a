"""Films and folders of pictures become clips: what is found, in which order, how it is decoded, and what is refused."""

import pickle

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.importers.film import film, recognises, survey
from simulator.io.exr import write_exr
from simulator.types import View

VIEW = View(shape=(24, 24), pixel_pitch_m=19.2e-6, distance_m=1.9e-3, near_m=0.04, far_m=0.2)


def write_pictures(folder, pictures, pattern="frame{}.png", first=8):
    folder.mkdir(parents=True, exist_ok=True)
    for number, picture in enumerate(pictures, start=first):
        Image.fromarray(picture).save(folder / pattern.format(number))


def clip_of(source, index=0, seed=0):
    return source.clip(index, np.random.default_rng(seed))


def test_a_film_becomes_clips_of_consecutive_frames(films, tmp_path):
    path = films.write(tmp_path / "a.webm", films.numbered(10))
    source = film(VIEW, path=path, frames=4)
    clip = clip_of(pickle.loads(pickle.dumps(source)))
    start = clip.source["first_frame"]
    assert [films.number_of(frame) for frame in clip.rgb] == list(range(start, start + 4))
    assert clip.rgb.shape == (4, 24, 24, 3)
    np.testing.assert_allclose(np.diff(clip.frame_edges_s), 1 / 12)
    assert (clip.source["video"], clip.source["colour_matrix"]) == ("a.webm", "BT.601 (untagged)")
    assert source.inputs == [path]
    assert source.packages == ("av", "opencv-python-headless")
    assert source.problems == ()


def test_pictures_are_taken_in_the_order_of_their_numbers(films, tmp_path):
    write_pictures(tmp_path / "seq", films.numbered(5))  # frame8, frame9, frame10, frame11, frame12
    source = film(VIEW, path=tmp_path / "seq", frames=5, frames_per_second=100)
    clip = clip_of(source)
    assert [films.number_of(frame) for frame in clip.rgb] == [0, 1, 2, 3, 4]
    assert clip.frame_edges_s[-1] == pytest.approx(0.05)
    assert clip.source["video"] == "seq"
    assert clip.source["pictures"] == ["frame8.png", "frame12.png"]
    assert [file.name for file in source.inputs][:3] == ["frame8.png", "frame9.png", "frame10.png"]
    with pytest.raises(InputError, match=r"^frames_per_second: "):
        film(VIEW, path=tmp_path / "seq", frames=2)


def test_exr_pictures_are_linear_light_as_they_are_and_may_exceed_white(tmp_path):
    values = np.random.default_rng(1).uniform(0, 7, (3, 24, 24, 3)).astype(np.float32)
    for number, picture in enumerate(values):
        write_exr(tmp_path / f"{number}.exr", {name: picture[..., i] for i, name in enumerate("RGB")}, {})
    clip = clip_of(film(VIEW, path=tmp_path, frames=3, frames_per_second=10))
    np.testing.assert_array_equal(clip.rgb, values)


def test_a_folder_of_films_and_picture_folders_holds_a_video_each(films, tmp_path):
    for number in (2, 10, 1):
        films.write(tmp_path / f"v{number}.webm", films.numbered(4))
    write_pictures(tmp_path / "v3", films.numbered(5))
    films.write(tmp_path / "more" / "x.mkv", films.numbered(4), codec="libx264")
    (tmp_path / ".hidden.webm").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("")
    source = film(VIEW, path=tmp_path, frames=3, frames_per_second=10, clips_per_video=2)
    assert [video.name for video in source.videos] == ["more/x.mkv", "v1.webm", "v2.webm", "v3", "v10.webm"]
    assert source.groups == (0, 0, 1, 1, 2, 2, 3, 3, 4, 4)
    assert films.number_of(clip_of(source, 7).rgb[0]) == 2


def test_broken_and_short_films_are_problems_by_name(films, tmp_path):
    good = films.write(tmp_path / "good.webm", films.numbered(6))
    (tmp_path / "cut.webm").write_bytes(good.read_bytes()[:-1500])
    (tmp_path / "text.mp4").write_text("no film")
    films.write(tmp_path / "short.webm", films.numbered(3))
    source = film(VIEW, path=tmp_path, frames=4)
    assert len(source) == 1
    names = sorted(problem.partition(":")[0] for problem in source.problems)
    assert names == ["cut.webm", "short.webm", "text.mp4"]
    assert any("has 3 frames, but a clip of 4 takes 4" in problem for problem in source.problems)
    found = survey(tmp_path, frames=4)
    assert found.usable == 1
    assert sorted(found.problems) == sorted(source.problems)
    assert survey(tmp_path).usable == 2


def test_survey_decodes_everything_and_tells_its_progress(films, tmp_path):
    films.write(tmp_path / "a.webm", films.numbered(4))
    films.write(tmp_path / "b.webm", films.numbered(7, (32, 32)), rate=1000, times_ms=[0, 30, 60, 200, 230, 260, 290])
    write_pictures(tmp_path / "seq", films.numbered(5))
    steps = []
    found = survey(tmp_path, lambda done, total: steps.append((done, total)))
    assert steps == [(1, 3), (2, 3), (3, 3)]
    assert (found.importer, found.usable, found.problems) == ("film", 3, ())
    assert found.facts["films"] == "2"
    assert found.facts["image folders"] == "1"
    assert found.facts["frames"] == "16 (4 to 7 per video)"
    assert found.facts["sizes"] == "32 x 32, 48 x 64"
    assert len(found.notes) == 1
    assert found.notes[0].startswith("b.webm: its frame rate varies")


def test_survey_names_damage_that_only_decoding_shows_and_pictures_that_differ(films, tmp_path):
    path = films.write(tmp_path / "bad.webm", films.numbered(6))
    films.edit_packet(path, 3, lambda byte: byte ^ 0xC0)  # VP9's frame marker
    path = films.write(tmp_path / "hidden.webm", films.numbered(6))
    films.edit_packet(path, 3, lambda byte: byte & ~0x02)  # VP9's show_frame
    write_pictures(tmp_path / "seq", films.numbered(2))
    write_pictures(tmp_path / "seq", films.numbered(1, (40, 40)), first=20)
    write_pictures(tmp_path / "torn", films.numbered(2))
    (tmp_path / "torn" / "frame9.png").write_bytes((tmp_path / "torn" / "frame8.png").read_bytes()[:60])
    found = survey(tmp_path)
    assert found.usable == 0
    names = [problem.partition(":")[0] for problem in found.problems]
    assert names == ["bad.webm", "hidden.webm", "seq", "torn/frame9.png"]
    source = film(VIEW, path=tmp_path, frames=3, frames_per_second=10)
    with pytest.raises(InputError, match=r"^seq: "):
        clip_of(source, [video.name for video in source.videos].index("seq"))


@pytest.mark.parametrize("name", ["none", "empty", "mixed", "mixed/frame8.png"])
def test_what_cannot_be_read_is_refused(films, tmp_path, name):
    (tmp_path / "empty" / "inner").mkdir(parents=True)
    write_pictures(tmp_path / "mixed", films.numbered(1))
    (tmp_path / "mixed" / "a.webm").write_bytes(b"")
    with pytest.raises(InputError, match=r"^path: "):
        film(VIEW, path=tmp_path / name, frames=2)
    assert not recognises(tmp_path / name)


def test_films_and_pictures_are_recognised_by_name(films, tmp_path):
    write_pictures(tmp_path / "top" / "seq", films.numbered(1))
    (tmp_path / "films").mkdir()
    (tmp_path / "films" / "a.MP4").write_bytes(b"")
    for name in ("top", "top/seq", "films", "films/a.MP4"):
        assert recognises(tmp_path / name)
    for name in ("labelled", "parts"):
        (tmp_path / name / "clips").mkdir(parents=True)
        (tmp_path / name / "clips" / "a.webm").write_bytes(b"")
    (tmp_path / "labelled" / "train.json").write_text("[]")
    (tmp_path / "parts" / "labels").mkdir()
    assert not recognises(tmp_path / "labelled")
    assert not recognises(tmp_path / "parts")


def test_folders_in_whose_count_pictures_are_missing_are_problems(films, tmp_path):
    write_pictures(tmp_path / "whole", films.numbered(4))
    write_pictures(tmp_path / "torn", films.numbered(4))
    write_pictures(tmp_path / "torn", films.numbered(2), first=15)
    source = film(VIEW, path=tmp_path, frames=2, frames_per_second=10)
    assert [video.name for video in source.videos] == ["whole"]
    (problem,) = source.problems
    assert problem.startswith("torn: ")
    assert survey(tmp_path).problems == source.problems


def test_interpolation_puts_frames_between(films, tmp_path):
    path = films.write(tmp_path / "a.webm", films.numbered(3))
    clip = clip_of(film(VIEW, path=path, frames=5, interpolate_by=2))
    assert clip.rgb.shape[0] == 5
    assert [films.number_of(frame) for frame in clip.rgb[::2]] == [0, 1, 2]
    assert clip.source["interpolation"]["name"] == "optical_flow"
    np.testing.assert_allclose(np.diff(clip.frame_edges_s), 1 / 24)


def test_interpolated_images_were_filmed_more_slowly(films, tmp_path):
    write_pictures(tmp_path / "seq", films.numbered(3))
    clip = clip_of(film(VIEW, path=tmp_path / "seq", frames=5, frames_per_second=100, interpolate_by=2))
    assert "own_frames_per_second" not in clip.source  # images have none
    np.testing.assert_allclose(np.diff(clip.frame_edges_s), 0.01)
