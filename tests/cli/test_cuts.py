"""Sequences of several shots: nothing is taken across the cuts between them."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.shots import SMALL, VECTORS
from tests.cli.street import Street
from tests.matrix import combinations, spread

FIRST = 4
"""Key frame after the cut, of 1 to 6."""

PLACES = (-20.0, 6.0)
"""Times of the two shots' first frames: the camera sees other parts of the street."""

SETTINGS = ("key", "slot")
METHODS = [*combinations(("softsplat", "s3", "causal"), SETTINGS), ("blend", "key")]


def joined(frame: shots.FrameWriter, length: float) -> shots.FrameWriter:
    """Write frames of two shots of some length, in key intervals, one after the other."""

    def write(path: Path, street: Street, time: float) -> None:
        later = time >= length
        frame(path, street, PLACES[later] + time - length * later)

    return write


def beyond(path: Path, street: Street, time: float) -> None:
    """Write a key frame; what lies at the cut has vectors that lead to the other shot."""
    parts = {k: v for group in shots.blender_passes(street, time) for k, v in group.items()}
    for at, channels in ((PLACES[0] + FIRST - 2, "ZW"), (PLACES[1], "XY")):
        if time == at:
            for channel in channels:
                parts[f"Vector.{channel}"] = np.full_like(parts[f"Vector.{channel}"], 7.0)
    shots.write(path, {"": parts})


@pytest.fixture(scope="module")
def two(tmp_path_factory) -> dict[str, Path]:
    """Six key frames of two shots, G-buffers of all slots, and the truth; read only."""
    root = tmp_path_factory.mktemp("two")
    keys, slots = range(1, 7), range(1, 25)
    frames: dict[str, tuple[shots.FrameWriter, range, float]] = {
        "keys": (shots.blender4, keys, 1.0),
        "crossing": (beyond, keys, 1.0),
        "slots": (shots.slot_gbuffer, slots, 0.25),
        "truth": (shots.colour_only, slots, 0.25),
    }
    return {
        name: shots.sequence(root / name, joined(frame, FIRST - 1), numbers, SMALL, step)
        for name, (frame, numbers, step) in frames.items()
    }


def part(folder: Path, into: Path, numbers: range) -> Path:
    """Copy some frames of a sequence."""
    into.mkdir()
    for number in numbers:
        shutil.copy(folder / f"shot.{number:04d}.exr", into)
    return into


@pytest.fixture
def run(upsample, network, tmp_path) -> Callable[..., Path]:
    """Upsample into a folder by a method; return the folder."""

    def run(
        name: str, keys: Path, method: str, *options: object, slots: Path | None = None
    ) -> Path:
        model = ("--extrapolator", network) if method in ("s3", "causal") else ()
        geometry = () if slots is None else ("--gbuffers", slots)
        out = tmp_path / name
        upsample(keys, out, "-m", method, *VECTORS, *model, *geometry, *options)
        return out

    return run


def content_of(path: Path) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What a frame's file holds, but for what tells how it came about and when to make it anew."""
    header, planes = shots.read(path)
    known = {k: str(v) for k, v in header.items() if k not in ("exwarp:recipe", "exwarp:xxh128")}
    return known, {name: plane.tobytes() for name, plane in planes.items()}


def report_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "report.json").read_text())


def rows_of(folder: Path) -> dict[int, dict[str, str]]:
    with (folder / "frames.csv").open(newline="") as file:
        return {int(row["frame"]): row for row in csv.DictReader(file)}


@pytest.mark.parametrize(("method", "setting"), METHODS)
def test_each_shot_is_made_as_if_it_were_alone(run, two, tmp_path, method, setting):
    """No colour, history, feature or vector comes from the other; both ends are as ends are."""
    slots = two["slots"] if setting == "slot" else None
    whole = run("whole", two["keys"], method, slots=slots)
    assert len(shots.names(whole)) == 24
    for keys in (range(1, FIRST), range(FIRST, 7)):
        numbers = range(4 * keys[0] - 3, 4 * keys[-1] + 1)
        place = tmp_path / f"alone{keys[0]}"
        place.mkdir()
        mine = part(two["keys"], place / "keys", keys)
        around = None if slots is None else part(slots, place / "slots", numbers)
        start = ("--start-frame", numbers[0])
        alone = run(f"out{keys[0]}", mine, method, *start, slots=around)
        for number in numbers:
            name = f"shot.{number:04d}.exr"
            assert content_of(whole / name) == content_of(alone / name), name


@pytest.mark.parametrize(
    ("method", "setting", "rate"),
    spread(
        [
            ("softsplat", "key", ("--fps", 24, "--to-fps", 60)),
            ("softsplat", "key", ()),
            ("s3", "slot", ()),
            ("causal", "key", ()),
            ("causal", "slot", ()),
        ],
        3,
    ),
)
def test_any_split_into_chunks_gives_the_same_bytes(run, two, method, setting, rate):
    slots = two["slots"] if setting == "slot" else None
    whole = run("whole", two["crossing"], method, *rate, slots=slots)
    for chunk in ("4", "3,5"):
        parts = run("parts", two["crossing"], method, *rate, "--frames", chunk, slots=slots)
    shots.require_part(parts, whole, 8 if rate else 12)


@pytest.mark.parametrize(
    ("method", "setting"), spread([("softsplat", "slot"), ("s6", "key"), ("causal", "key")], 2)
)
def test_a_shot_without_cuts_has_the_same_bytes_looked_for_or_not(run, shot, method, setting):
    keys, *rest = shot[setting]
    looked, blind = (run(cuts, keys, method, *rest, "--cuts", cuts) for cuts in ("auto", "none"))
    assert shots.contents(looked) == shots.contents(blind)


@pytest.mark.parametrize(
    ("cuts", "found"),
    [
        ("auto", [(4, "detected")]),
        ("4", [(4, "given")]),
        ("2", [(2, "given")]),
        ("2,auto", [(2, "given"), (4, "detected")]),
        ("none", None),
        ("1", []),
    ],
)
def test_the_report_says_where_cuts_are(run, two, tmp_path, cuts, found):
    """The causal prediction goes on to the cut."""
    report = tmp_path / "report"
    out = run("out", two["keys"], "softsplat", "--cuts", cuts, "--report", report)
    listed = None if found is None else [{"frame": n, "source": s} for n, s in found]
    assert report_of(report)["cuts"] == listed
    ends = {4 * n - 4 for n, _ in found or ()} | {24}
    made = {n: row["method"] for n, row in rows_of(report).items() if row["slot"] != "0"}
    last = {number for end in ends for number in range(end - 2, end + 1)}
    assert {number for number, method in made.items() if method == "s6"} == last
    assert {made[number] for number in made.keys() - last} == {"softsplat"}
    page = (report / "report.html").read_text()
    assert ("nothing is interpolated across" in page) == bool(found)
    assert ("not looked for" in page) == (found is None)
    assert len(shots.names(out)) == 24


def test_the_console_says_it_too(upsample, two, tmp_path):
    options = ("-m", "hold", "--cuts", "2,3,auto", *VECTORS)
    said = upsample(two["keys"], tmp_path / "out", *options).out
    line = "cuts before key frames 2, 3 (given), 4 (detected); nothing is interpolated across"
    assert line in said.splitlines()
    once = upsample(two["keys"], tmp_path / "once", "-m", "hold", "--frames", "4").out
    assert "cut before key frame 4 (detected); nothing is interpolated across" in once
    before = upsample(two["keys"], tmp_path / "before", "-m", "hold", "--frames", "1-2").out
    assert "cut" not in before


def test_a_cut_found_or_given_makes_the_same_frames(run, two):
    found, given = (
        run(cuts, two["keys"], "softsplat", "--cuts", cuts, "--frames", "3,4")
        for cuts in ("auto", "4")
    )
    assert shots.contents(found) == shots.contents(given)
    blended = run("none", two["keys"], "softsplat", "--cuts", "none", "--frames", "3,4")
    assert shots.contents(found) != shots.contents(blended)


def test_a_cut_costs_nothing_where_it_is(run, two, tmp_path):
    """Without it, the frames before it are mixtures of two places."""
    quality = {}
    for cuts in ("auto", "none"):
        report = tmp_path / cuts
        options = ("--cuts", cuts, "--ground-truth", two["truth"], "--report", report)
        run(f"out-{cuts}", two["keys"], "softsplat", "--frames", "3", *options)
        rows = rows_of(report)
        quality[cuts] = min(float(rows[number]["psnr_db"]) for number in (10, 11, 12))
    assert quality["auto"] > quality["none"] + 8


@pytest.mark.parametrize("method", spread(["softsplat", "s6", "causal"], 2))
def test_vectors_that_lead_to_the_other_shot_are_left_out(run, two, tmp_path, method):
    """At the cut the others are gone on along, at constant speed."""
    options = ("--ground-truth", two["truth"], "--metrics", "psnr", "--frames", "3,4")
    worst = {}
    for name in ("keys", "crossing"):
        report = tmp_path / name
        run(f"out-{name}", two[name], method, *options, "--report", report)
        values = [row["psnr_db"] for row in rows_of(report).values() if row["psnr_db"]]
        worst[name] = min(map(float, values))
    assert len(values) == 6
    assert worst["crossing"] > worst["keys"] - 3
    run("none", two["crossing"], method, *options, "--cuts", "none", "--report", tmp_path / "none")
    rows = rows_of(tmp_path / "none").values()
    assert min(float(row["psnr_db"]) for row in rows if row["psnr_db"]) < worst["crossing"] - 5


def test_flicker_ends_at_the_cut(run, two, tmp_path):
    """The jump to the next shot is no flicker: the last frames score as those of a sequence do."""
    scores = []
    for name, keys in (("whole", range(1, 7)), ("alone", range(1, FIRST))):
        mine = part(two["keys"], tmp_path / f"{name}-keys", keys)
        options = ("--ground-truth", two["truth"], "--metrics", "flicker", "--frames", "3")
        run(name, mine, "s6", *options, "--report", tmp_path / name / "report")
        rows = rows_of(tmp_path / name / "report")
        scores.append([rows[number]["flicker"] for number in (10, 11, 12)])
    assert scores[0] == scores[1]
    assert all(scores[0])


def test_benchmarks_end_flicker_there_too(exwarp, run, two, tmp_path):
    options = ("--ground-truth", two["truth"], "--metrics", "flicker", "--frames", "3", *VECTORS)
    alone = ("--systems", "s6", "--jobs", 1, "--progress", "none")
    found = exwarp("bench", two["keys"], "-o", tmp_path / "bench", *options, *alone)
    assert found.code == 0, found.err
    (part,) = (tmp_path / "bench" / "parts").glob("*/3.json")
    measured = [slot["all"]["flicker"] for slot in json.loads(part.read_text())["systems"]["s6"]]
    run("out", two["keys"], "s6", *options[:-2], "--report", tmp_path / "report")
    rows = rows_of(tmp_path / "report")
    assert measured == [float(rows[number]["flicker"]) for number in (10, 11, 12)]


class TestConvention:
    """What crosses a cut is no motion, and says nothing of what vectors mean."""

    def test_it_is_not_measured_across_a_given_cut(self, exwarp, two):
        """The first pair tells all; it would be 1-2."""
        options = ("--progress", "plain", "--threads", 1, "-m", "s6", "--frames", "1")
        out = two["keys"].parent
        for cuts, pairs in (("2", "frames 2-3:"), ("none", "frames 1-2:")):
            found = exwarp(
                "upsample", two["keys"], "-o", out / f"out{cuts}", "--cuts", cuts, *options
            )
            assert found.code == 0, found.err
            assert pairs in found.err

    def test_where_it_explains_nothing_cuts_are_looked_for(self, exwarp, tmp_path):
        """Of three frames one pair is across the cut, and the names are wrong."""

        def negated(path: Path, street: Street, time: float) -> None:
            shots.blender5(path, street, time, -1.0)

        whole = shots.sequence(tmp_path / "whole", joined(negated, 4), range(1, 6), SMALL)
        keys = part(whole, tmp_path / "keys", range(3, 6))
        options = ("--progress", "plain", "--threads", 1, "-m", "s6")
        found = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        assert found.code == 0, found.err
        assert "previous=-X,Y next=Z,-W measured on frames 3-4:" in found.err
        blind = exwarp("upsample", keys, "-o", tmp_path / "none", "--cuts", "none", *options)
        assert blind.code == 4
        assert "frames 3-4, 4-5" in blind.err


def test_resuming_makes_new_only_what_other_cuts_change(run, upsample, two, tmp_path):
    keys, out = two["keys"], run("out", two["keys"], "softsplat")

    def again(*options: object) -> set[int]:
        go_on = ("-m", "softsplat", *VECTORS, "--skip-existing", *options)
        report = tmp_path / "report"
        return shots.changed_by(lambda: upsample(keys, out, *go_on, "--report", report), out)

    assert again() == set()
    assert report_of(tmp_path / "report")["cuts"] == [{"frame": 4, "source": "detected"}]
    assert again("--cuts", "4") == set()
    assert again("--cuts", "4,2") == shots.generated(1, 2)
    assert again("--cuts", "none") == shots.generated(1, 2, 3, 4)


def features_of(text: str) -> dict[tuple[int, str], dict[str, str]]:
    rows = csv.DictReader(io.StringIO(text))
    return {(int(row["key"]), row["node"]): row for row in rows}


@pytest.mark.parametrize("setting", SETTINGS)
def test_features_compare_nothing_across(exwarp, two, setting):
    options = ("--gbuffers", two["slots"]) if setting == "slot" else ()
    command = ("features", two["keys"], *VECTORS, *options, "--progress", "none")
    found, blind = (exwarp(*command, "--cuts", cuts) for cuts in ("auto", "none"))
    assert found.code == blind.code == 0, found.err
    after, across = (features_of(done.out)[FIRST, "d1"] for done in (found, blind))
    assert float(after["EMD_Wp"]) == 0 < float(across["EMD_Wp"])
    assert after["inputs"] != across["inputs"]
    assert features_of(found.out)[FIRST - 1, "d1"] == features_of(blind.out)[FIRST - 1, "d1"]
    part_of = exwarp(*command, "--frames", "6")
    assert features_of(part_of.out)[6, "d3"] == features_of(found.out)[6, "d3"]
    assert features_of(blind.out)[6, "d1"] != features_of(found.out)[6, "d1"]


@pytest.mark.parametrize(
    ("cuts", "code", "words"),
    [
        ("7", 3, ("frame 7 of --cuts", "1-6")),
        ("never", 2, ("--cuts 'never'", "auto, none")),
        ("4.5", 2, ("--cuts", "no whole frame")),
    ],
)
def test_cuts_that_cannot_be_are_refused(exwarp, two, tmp_path, cuts, code, words):
    out = tmp_path / "out"
    found = exwarp("upsample", two["keys"], "-o", out, "--progress", "none", "--cuts", cuts)
    found.refused(code, *words)
    assert not out.exists()
