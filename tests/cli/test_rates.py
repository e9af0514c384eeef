"""Other rates than four times the input's."""

from __future__ import annotations

import json
import shutil
from fractions import Fraction
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.shots import FORWARD, SMALL, VECTORS
from tests.cli.street import Street
from tests.matrix import combinations, spread

KEYS = range(1, 6)


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Five key frames, 1 to 5; read only."""
    return shots.sequence(tmp_path_factory.mktemp("rates") / "keys", shots.plain, KEYS, SMALL)


def truth_at(folder: Path, factor: Fraction) -> Path:
    """Write the truth at a factor, up to the last key frame."""
    count = int((len(KEYS) - 1) * factor) + 1
    numbers = range(1, count + 1)
    return shots.sequence(folder, shots.colour_only, numbers, SMALL, step=float(1 / factor))


def half_rate(path: Path, street: Street, time: float) -> None:
    """Write a slot's G-buffer, with vectors over half a key interval, twice those of a quarter."""
    planes = shots.slot_planes(street, time)
    shots.write(path, {"": {n: 2 * p if "Vector" in n else p for n, p in planes.items()}})


def scored(upsample, sequence: Path, out: Path, truth: Path, *options: object) -> dict:
    scores = ("--ground-truth", truth, "--metrics", "psnr", "--json")
    return json.loads(upsample(sequence, out, *scores, "--no-tail", *options).out)


@pytest.mark.parametrize(("factor", "method"), combinations([2, 3, 5, 8], ["s6", "softsplat"]))
def test_slots_lie_where_they_should_in_time(upsample, keys, tmp_path, factor, method):
    truth = truth_at(tmp_path / "truth", Fraction(factor))
    options = ("--factor", factor, "-m", method, *FORWARD)
    found = scored(upsample, keys, tmp_path / "out", truth, *options)
    assert found["frames"] == {
        "key": 5,
        "written": 4 * factor + 1,
        "generated": 4 * (factor - 1),
        "dropped": 0,
        "rendered": 0,
        "resumed": 0,
        "made": 4 * factor + 1,
        "replaced": 0,
    }
    assert found["fps"]["output"] == found["fps"]["effective"] == 30 * factor
    assert found["quality"]["all"]["frames"] == 4 * (factor - 1)
    held = scored(upsample, keys, tmp_path / "held", truth, "--factor", factor, "-m", "hold")
    gain = found["quality"]["all"]["psnr_db"] - held["quality"]["all"]["psnr_db"]
    assert gain > 5


@pytest.mark.parametrize("method", spread(["softsplat", "s6"], 1))
def test_from_24_to_60(upsample, keys, tmp_path, method):
    truth = truth_at(tmp_path / "truth", Fraction(5, 2))
    options = ("--fps", 24, "--to-fps", 60, "-m", method, *FORWARD)
    out = tmp_path / "out"
    found = scored(upsample, keys, out, truth, *options)
    assert shots.names(out) == [f"shot.{number:04d}.exr" for number in range(1, 12)]
    assert (found["frames"]["key"], found["frames"]["generated"]) == (3, 8)
    assert found["fps"]["output"] == found["fps"]["effective"] == 60
    for number, written in ((1, 1), (3, 6), (5, 11)):
        passed = shots.passed_through(keys / f"shot.{number:04d}.exr", 60)
        assert (out / f"shot.{written:04d}.exr").read_bytes() == passed
    header, _ = shots.read(out / "shot.0004.exr")
    assert header["framesPerSecond"] == 60
    assert (header["exwarp:key"], header["exwarp:slot"]) == (2, 1)
    held = scored(
        upsample, keys, tmp_path / "held", truth, "--fps", 24, "--to-fps", 60, "-m", "hold"
    )
    assert found["quality"]["all"]["psnr_db"] > held["quality"]["all"]["psnr_db"] + 5


def test_a_key_frame_that_is_shown_late_is_a_new_frame(upsample, keys, tmp_path):
    options = ("--fps", 24, "--to-fps", 60, "-m", "hold", "--json")
    found = json.loads(upsample(keys, tmp_path / "out", *options).out)
    assert found["fps"]["effective"] == pytest.approx(60 * 5 / 13)
    assert (found["frames"]["generated"], found["frames"]["dropped"]) == (2, 8)


@pytest.mark.parametrize(
    ("base", "asked", "rate"),
    [
        ("23.976", "60", Fraction(60000, 1001)),
        ("24", "59.94", Fraction(60)),
        ("23.98", "60", Fraction(60000, 1001)),
        ("24000/1001", "60000/1001", Fraction(60000, 1001)),
    ],
)
def test_broadcast_rates_keep_key_frames(exwarp, keys, tmp_path, base, asked, rate):
    """Exactly 60 out of 23.976 would keep one key frame in a thousand."""
    out, options = tmp_path / "out", ("--fps", base, "--to-fps", asked, "-m", "hold")
    found = exwarp("upsample", keys, "-o", out, "--progress", "plain", *options)
    assert found.code == 0, found.err
    assert ("--to-fps" in found.err) == (abs(Fraction(asked) - rate) > Fraction(1, 100))
    if asked != "60000/1001":
        assert f"is taken as {rate}" in found.err and "keeps one key frame in 2" in found.err
    assert shots.read(out / "shot.0002.exr")[0]["framesPerSecond"] == rate
    assert len(shots.names(out)) == 13
    for number, written in ((1, 1), (3, 6), (5, 11)):
        passed = shots.passed_through(keys / f"shot.{number:04d}.exr", rate)
        assert (out / f"shot.{written:04d}.exr").read_bytes() == passed


@pytest.mark.parametrize("rate", [("--factor", 2), ("--fps", 24, "--to-fps", 60)])
def test_a_rate_needs_no_method(exwarp, keys, tmp_path, rate):
    command = ("upsample", keys, "--progress", "plain", *FORWARD, *rate)
    found = exwarp(*command, "-o", tmp_path / "out")
    assert found.code == 0, found.err
    exwarp(*command, "-o", tmp_path / "named", "-m", "exwarp")
    assert shots.contents(tmp_path / "out") == shots.contents(tmp_path / "named")


def test_four_times_the_rate_keeps_the_usual_method(exwarp, keys, tmp_path):
    command = ("upsample", keys, "-o", tmp_path / "out", "--progress", "plain", *FORWARD)
    for rate in ((), ("--factor", 4), ("--to-fps", 120)):
        found = exwarp(*command, *rate, "--dry-run")
        assert found.code == 0 and "method exwarp" in found.out and "no --method" not in found.err


def test_any_split_into_chunks_gives_the_same_bytes(upsample, keys, tmp_path):
    options = ("--fps", 24, "--to-fps", 60, "-m", "softsplat", *FORWARD)
    upsample(keys, tmp_path / "whole", *options)
    for chunk in ("1", "2-3", "4,5"):
        upsample(keys, tmp_path / "parts", "--frames", chunk, *options)
    assert shots.contents(tmp_path / "parts") == shots.contents(tmp_path / "whole")
    assert len(shots.names(tmp_path / "whole")) == 13


def test_a_chunk_that_no_frame_falls_to_is_done(exwarp, keys, tmp_path):
    """Of four key frames at 2.5 times the rate the last one is no output instant."""
    few = tmp_path / "keys"
    few.mkdir()
    for number in range(1, 5):
        shutil.copy(keys / f"shot.{number:04d}.exr", few)
    options = ("--fps", 24, "--to-fps", 60, "--no-tail", "--frames", 4, "-m", "hold")
    report = ("--report", tmp_path / "report", "--progress", "json")
    found = exwarp("upsample", few, "-o", tmp_path / "out", *options, *report)
    assert found.code == 0, found.err
    assert found.out == f"no frame falls to {tmp_path / 'out'}\n"
    assert json.loads((tmp_path / "report" / "report.json").read_text())["frames"]["written"] == 0
    assert json.loads(found.err.splitlines()[-1]) == {"event": "finish", "done": 0, "total": 0}


@pytest.mark.parametrize("rate", [("--factor", 8), ("--to-fps", 75), ("--to-fps", 40)])
def test_all_layers_at_any_rate(upsample, keys, tmp_path, rate):
    """Where softsplat falls back to s6, too."""
    out = tmp_path / "out"
    upsample(keys, out, "-m", "softsplat", *rate, "--layers", "all", "--frames", "4-5", *FORWARD)
    for name in shots.names(out):
        _, planes = shots.read(out / name)
        assert planes.keys() == shots.read(keys / "shot.0001.exr")[1].keys()


def test_that_there_is_no_next_key_frame_is_reported_at_any_rate(exwarp, keys, tmp_path):
    """The fourth key frame is no output instant of 24 to 30, and one frame is made after it."""
    few = tmp_path / "keys"
    few.mkdir()
    for number in range(1, 5):
        shutil.copy(keys / f"shot.{number:04d}.exr", few)
    rate = ("--fps", 24, "--to-fps", 30, "-m", "blend", "--progress", "plain")
    found = exwarp("upsample", few, "-o", tmp_path / "out", *rate)
    assert "blend falls back to" in found.err


def test_a_video_of_one_key_frame_is_made_anew_where_that_is_another(upsample, keys, tmp_path):
    few, video = tmp_path / "keys", tmp_path / "out.mp4"
    shutil.copytree(keys, few)
    options = ("-m", "hold", "--no-tail", "--frames", 5, "--skip-existing")
    upsample(few, video, *options)
    before = video.read_bytes()
    upsample(few, video, *options)
    assert video.read_bytes() == before
    shutil.copy(few / "shot.0001.exr", few / "shot.0005.exr")
    upsample(few, video, *options)
    assert video.read_bytes() != before


def test_the_usual_rate_by_its_frames_per_second(upsample, keys, tmp_path):
    upsample(keys, tmp_path / "a", "-m", "s6", *FORWARD)
    upsample(keys, tmp_path / "b", "-m", "s6", "--to-fps", 120, *FORWARD)
    assert shots.contents(tmp_path / "a") == shots.contents(tmp_path / "b")


def test_a_run_goes_on_only_with_frames_of_its_own_rate(upsample, keys, tmp_path):
    out = tmp_path / "out"
    upsample(keys, out, "-m", "s6", "--factor", 2, "--frames", "1", *FORWARD)
    upsample(keys, out, "-m", "s6", "--factor", 3, "--skip-existing", *FORWARD)
    upsample(keys, tmp_path / "new", "-m", "s6", "--factor", 3, *FORWARD)
    assert shots.contents(out) == shots.contents(tmp_path / "new")


def test_g_buffers_at_twice_the_rate(upsample, keys, tmp_path):
    slots = shots.sequence(tmp_path / "slots", half_rate, range(1, 10), SMALL, step=0.5)
    truth = truth_at(tmp_path / "truth", Fraction(2))
    options = ("--factor", 2, "--gbuffers", slots, *VECTORS, "-m", "s6")
    found = scored(upsample, keys, tmp_path / "out", truth, *options)
    assert found["setting"] == "slot"
    held = scored(upsample, keys, tmp_path / "held", truth, "--factor", 2, "-m", "hold")
    assert found["quality"]["all"]["psnr_db"] > held["quality"]["all"]["psnr_db"] + 5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--factor", 2, "-m", "causal"), ("--method causal", "4 times", "s6, softsplat")),
        (("--factor", 8, "-m", "s3"), ("--method s3",)),
        (("--to-fps", 60, "--factor", 2, "-m", "s6"), ("--factor and --to-fps",)),
        (("--to-fps", 30, "-m", "s6"), ("--to-fps 30 is 1 times",)),
        (("--to-fps", 24, "-m", "s6"), ("--to-fps 24",)),
        (("--to-fps", 300, "-m", "s6"), ("at most 8",)),
        (("--to-fps", 75, "-m", "s6", "--gbuffers", "keys"), ("--gbuffers",)),
    ],
)
def test_what_cannot_be_is_refused(exwarp, keys, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(keys.parent)
    found = exwarp("upsample", keys, "-o", tmp_path / "out", "--progress", "none", *options)
    found.refused(2, *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["vmaf", "flicker"])
def test_no_scores_of_a_video_whose_key_frames_are_not_shown(exwarp, keys, tmp_path, name):
    truth = truth_at(tmp_path / "truth", Fraction(5, 2))
    options = ("--to-fps", 75, "-m", "s6", "--ground-truth", truth, "--metrics", name, *FORWARD)
    found = exwarp("upsample", keys, "-o", tmp_path / "out", "--progress", "none", *options)
    found.refused(2, name, "whole --factor")
