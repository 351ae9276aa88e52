"""Films and stills: what the log says at an instant is what the picture shows."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image, ImageSequence

import logs
from logs import render
from logs.colors import OUTAGE_COLOR, ap_color, rgb
from logs.errors import LogError
from logs.moments import moments, run_span
from logs.records import LINKS, OUTAGE, Blockages, Disturbance, RunEnd, Sample
from logs.render import MAX_FRAMES, Painter, plan_film, write_film, write_still
from tests.cli_tools import twin
from tests.logs.good_logs import log_of
from tests.logs.tamper import forge


@pytest.fixture(scope="module")
def run():
    """The tutorial's run."""
    return logs.read(log_of())


def has_color(image: Image.Image, color: tuple[float, float, float]) -> int:
    """How many pixels have exactly that colour."""
    wanted = np.round(np.array(color) * 255)
    return int((np.asarray(image) == wanted).all(axis=2).sum())


# --- moments --------------------------------------------------------------------------------------


def test_at_a_sample_everything_is_as_the_sample_says(run):
    """Places, APs and links of all robots, for every sample of the run."""
    samples = run.of(Sample)
    found = list(moments(run, [s.t_s for s in samples]))
    assert len(found) == len(samples)
    for moment, sample in zip(found, samples, strict=True):
        assert moment.slot == sample.slot
        assert moment.robot.tolist() == list(sample.robot)
        np.testing.assert_allclose(moment.xy_m[:, 0], sample.x_m)
        assert moment.ap.tolist() == list(sample.ap)
        assert moment.link.tolist() == list(sample.link)


def test_between_samples_robots_are_between_their_places(run):
    """Half-way in time is half-way in space; a robot that is gone in the next one stays put."""
    samples = run.of(Sample)
    for a, b in pairwise(samples[3:10]):
        (moment,) = moments(run, [(a.t_s + b.t_s) / 2])
        there = dict(zip(b.robot, b.x_m, strict=True))
        expected = [(x + there.get(i, x)) / 2 for i, x in zip(a.robot, a.x_m, strict=True)]
        np.testing.assert_allclose(moment.xy_m[:, 0], expected)


def test_times_before_and_after_the_run_are_its_ends(run):
    """Nobody before the first sample; behind the last one all stays as it was."""
    _, end = run_span(run)
    before, after = moments(run, [-1.0, end.t_s + 99.0])
    assert len(before.robot) == 0
    assert after.robot.tolist() == list(run.of(Sample)[-1].robot)


def test_a_film_made_in_one_go_equals_single_moments(run):
    """Going through the log once gives what asking for each time anew gives."""
    times = [0.0, 0.3, 1.1, 1.2, 7.7, 7.7, 20.0]
    together = list(moments(run, times))
    for moment, t_s in zip(together, times, strict=True):
        (alone,) = moments(run, [t_s])
        np.testing.assert_array_equal(moment.xy_m, alone.xy_m)
        assert (moment.slot, moment.event, moment.out) == (alone.slot, alone.event, alone.out)


# --- pictures -------------------------------------------------------------------------------------


def test_robots_have_the_colours_of_their_aps(run):
    """Those served show their AP's colour, those without connection the outage's."""
    sample = run.of(Sample)[0]
    (moment,) = moments(run, [sample.t_s])
    painter = Painter(run)
    image = painter.frame(moment)
    for ap in set(sample.ap):
        assert has_color(image, ap_color(ap)) > 20
    assert has_color(image, rgb(OUTAGE_COLOR)) == 0
    lost = replace(moment, link=np.full(len(moment.link), LINKS.index(OUTAGE)))
    assert has_color(painter.frame(lost), rgb(OUTAGE_COLOR)) > 20


def test_a_frame_leaves_nothing_behind(run):
    """The same moment looks the same, whatever was drawn before it."""
    early, late = moments(run, [1.0, 9.0])
    painter = Painter(run)
    first = painter.frame(early).tobytes()
    assert painter.frame(late).tobytes() != first
    assert painter.frame(early).tobytes() == first


def test_blockages_and_aps_that_are_out_are_drawn(tmp_path):
    """A fork-lift is a box where it is, and an AP that is out says so."""
    sample = logs.read(log_of()).of(Sample)[2]
    box = Blockages(
        sample.t_s, 0, ("$fork_lift$",), (8.0,), (5.0,), (1.0,), (0.0,), (2.5,), (1.2,), (2.0,)
    )
    out = Disturbance(sample.t_s, 0, "ap-outage", "storm", "", "west", True, 0, -1.0, "is out")
    log = forge(
        log_of(),
        tmp_path / "f.mcap",
        record=lambda r: (box, out, r) if r == sample else r,
    )
    run = logs.read(log)
    before, after = moments(run, [0.0, sample.t_s])
    assert (before.blockages, before.out) == (None, ())
    assert (after.blockages, after.out) == (box, ("west",))
    painter = Painter(run)
    orange = rgb("#d95f02")
    assert has_color(painter.frame(before), orange) == 0
    assert has_color(painter.frame(after), orange) > 100


def test_a_still_is_a_slot_of_the_run(run, tmp_path):
    """The beginning of the slot; a slot that the run has not is refused with those there are."""
    write_still(run, tmp_path / "s.png", 2)
    with Image.open(tmp_path / "s.png") as image:
        assert image.width >= 600
    with pytest.raises(LogError, match="has no slot 999; give one from 0 to"):
        write_still(run, tmp_path / "t.png", 999)
    assert not (tmp_path / "t.png").exists()


# --- films ----------------------------------------------------------------------------------------


def test_a_film_lasts_about_as_long_as_people_watch(run):
    """Round speeds, the first and the last instant, and a bound on the number of frames."""
    _, end = run_span(run)
    film = plan_film(run)
    assert film.speed in {1, 2, 5, 10}
    assert film.times_s[0] == 0.0
    assert end.t_s - film.times_s[-1] <= film.speed / film.fps / 2 + 1e-9
    assert len(film.times_s) <= 10 * 30
    assert len(plan_film(run, fps=5, speed=2).times_s) == int(end.t_s / 2 * 5) + 1
    with pytest.raises(LogError, match=f"at most {MAX_FRAMES}"):
        plan_film(run, fps=60, speed=0.01)


def test_a_run_without_an_end_makes_no_film(tmp_path):
    """Times that are no numbers, and logs that do not end, are refused."""
    cut = forge(
        log_of(), tmp_path / "f.mcap", record=lambda r: None if isinstance(r, RunEnd) else r
    )
    with pytest.raises(LogError, match="does not tell"):
        plan_film(logs.read(cut))


def test_gif_and_frames_have_every_frame(run, tmp_path):
    """As many pictures as planned, and progress for each."""
    film = plan_film(run, fps=1, speed=5)
    told = []
    write_film(run, tmp_path / "r.gif", film, on_frame=lambda *done: told.append(done))
    n = len(film.times_s)
    assert told == [(k, n) for k in range(1, n + 1)]
    with Image.open(tmp_path / "r.gif") as gif:
        assert sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif)) == n * 1000
    write_film(run, tmp_path / "frames", film)
    assert [p.name for p in sorted((tmp_path / "frames").iterdir())] == [
        f"frame_{k:04}.png" for k in range(n)
    ]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frames", "r.gif"]


def test_mp4_is_written_where_ffmpeg_is(run, tmp_path):
    """A film that ffmpeg's own probe can read, with every frame."""
    if shutil.which("ffmpeg") is None or shutil.which("ffprobe") is None:
        pytest.skip("ffmpeg is not installed")
    film = plan_film(run, fps=1, speed=5)
    write_film(run, tmp_path / "r.mp4", film)
    probe = ["ffprobe", "-v", "error", "-count_frames", "-of", "json"]
    probe += ["-show_entries", "stream=nb_read_frames"]
    done = subprocess.run([*probe, tmp_path / "r.mp4"], capture_output=True, text=True, check=True)
    assert int(json.loads(done.stdout)["streams"][0]["nb_read_frames"]) == len(film.times_s)


def test_mp4_without_ffmpeg_says_what_to_do(tmp_path, monkeypatch):
    """One sentence with the remedy, before anything is drawn."""
    monkeypatch.setattr(render.shutil, "which", lambda name: None)
    told = twin("render", log_of(), "-o", tmp_path / "r.mp4")
    assert told.code == 2
    assert "ffmpeg is not installed" in told.err
    assert ".gif" in told.err


def test_the_command_writes_and_refuses(tmp_path):
    """Names that do not fit, and places that are taken, are refused before the work."""
    still = tmp_path / "s.png"
    assert twin("render", log_of(), "--slot", "1", "-o", still).code == 0
    again = twin("render", log_of(), "--slot", "1", "-o", still)
    assert (again.code, "--overwrite" in again.err) == (2, True)
    assert twin("render", log_of(), "-o", tmp_path / "x.png").code == 2
    assert twin("render", log_of(), "-o", tmp_path / "x.avi").code == 2
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("")
    told = twin("render", log_of(), "-o", tmp_path / "mine", "--overwrite")
    assert (told.code, "notes.txt" in told.err) == (2, True)
    assert (tmp_path / "mine" / "notes.txt").exists()
    frames = twin("render", log_of(), "-o", tmp_path / "f", "--fps", "1", "--speed", "8", "--json")
    assert frames.json["frames"] == len(list((tmp_path / "f").iterdir()))
