"""Reports read back from their files: nothing is lost on the way, and damage is reported."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain.decision import CHOICES, NODES, PATHS, Decision, Features, Trial
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.domain.results import (
    BrokenPixels,
    FrameKind,
    FrameRecord,
    InputSummary,
    InterpolatorSummary,
    LeftOut,
    NetworkSummary,
    PolicySummary,
    RunSummary,
    Score,
    WrittenFile,
)
from exwarp_cli.domain.tiles import Risk
from exwarp_cli.domain.timeline import Cut
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.report.frames_csv import frames_csv
from exwarp_cli.report.reading import frames_of, read_report
from exwarp_cli.report.summary import report, to_json
from tests.unit.sample_runs import interval, path_run, run

numbers = st.integers(-(10**6), 10**6)
counts = st.integers(0, 10**9)
values = st.one_of(
    st.floats(-1e9, 1e9, allow_nan=False), st.integers(-1000, 1000).map(float), numbers
)
positive = st.floats(1e-3, 1e6)
shares = st.floats(0, 1, width=32)
words = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0\r"), min_size=1)
maybe: Callable[[st.SearchStrategy[Any]], st.SearchStrategy[Any]] = lambda s: st.none() | s  # noqa: E731

features = st.builds(
    Features, *(counts, values, values, values, values), st.integers(1, 9999), counts, values
)
decisions = st.builds(
    Decision,
    st.sampled_from(NODES),
    st.sampled_from(CHOICES),
    maybe(features),
    st.lists(numbers, max_size=44).map(tuple),
    maybe(st.tuples(values, values)),
)
scores = st.builds(Score, *[maybe(values)] * 7)
of_whole_frames = {metric.field: None for metric in METRICS if not metric.in_holes}
hole_scores = scores.map(lambda score: replace(score, **of_whole_frames))
risks = st.builds(
    Risk,
    st.floats(0, 255, width=32),
    st.just(1),
    st.just(2),
    st.tuples(st.integers(0, 128), st.integers(0, 128)),
    st.tuples(st.integers(0, 2), st.integers(0, 2)),
)
trials = st.just(Trial()) | st.builds(Trial.measured, numbers, st.floats(0, 100), st.floats(0, 100))
all_records = st.builds(
    FrameRecord,
    *(numbers, words, numbers, st.integers(0, 9), st.sampled_from(FrameKind), words),
    st.lists(numbers, max_size=3).map(tuple),
    hole_fraction=maybe(shares),
    nonfinite_pixels=maybe(counts),
    score=maybe(scores),
    hole_score=maybe(hole_scores),
    resumed=st.booleans(),
    timing_ms=st.dictionaries(st.sampled_from(["read", "warp", "score", "a b"]), values),
    made_by=maybe(st.sampled_from(["warp", "extrapolate", "interpolate", "lookahead", "hold"])),
    path=maybe(st.sampled_from(list(PATHS))),
    decision=maybe(decisions),
    render=maybe(st.tuples(positive, words)),
    key_pulse=maybe(values),
    risk=maybe(risks),
    trial=maybe(trials),
    rendered_sources=st.lists(numbers, max_size=2).map(tuple),
)
records = all_records.map(  # key frames are compared with only where there is no ground truth
    lambda one: one if one.score is None else replace(one, key_pulse=None)
)
inputs = st.builds(
    InputSummary,
    *(words, numbers, numbers, counts, counts, words, maybe(words), maybe(words)),
    dynamic=maybe(st.lists(words).map(tuple)),
    step=st.integers(1, 100),
)
runs = st.builds(
    RunSummary,
    *(words, st.sampled_from(["key", "slot"]), st.booleans(), inputs, positive, words),
    wall_seconds=st.floats(0, 1e6),
    frames=st.lists(records, max_size=6, unique_by=lambda frame: frame.number).map(
        lambda frames: tuple(sorted(frames, key=lambda frame: frame.number))
    ),
    decides=st.booleans(),
    extrapolator=maybe(st.builds(NetworkSummary, words, words, words, st.booleans())),
    policy=maybe(st.builds(PolicySummary, words, words, maybe(words), st.tuples(words))),
    interpolator=maybe(st.builds(InterpolatorSummary, *[words] * 5)),
    factor=st.fractions(2, 8),
    cuts=maybe(st.lists(st.builds(Cut, numbers, words)).map(tuple)),
    views=st.lists(words).map(tuple),
    layers=st.lists(words).map(tuple),
    keys=st.sets(numbers, max_size=5).map(lambda keys: tuple(sorted(keys))),
    version=words,
    left_out=st.lists(st.builds(LeftOut, numbers, st.tuples(numbers), words)).map(tuple),
    files=st.lists(st.builds(WrittenFile, words, maybe(numbers), words, words)).map(tuple),
    verified=maybe(counts),
    nonfinite=st.lists(
        st.builds(BrokenPixels, numbers, st.integers(0, 9), words, words, counts)
    ).map(tuple),
)


def write(folder: Path, made: RunSummary) -> Path:
    """Write the files of a report that are read back; its page takes long."""
    folder.mkdir(exist_ok=True)
    (folder / "report.json").write_bytes(to_json(report(made)).encode())
    (folder / "frames.csv").write_bytes(frames_csv(made.frames).encode())
    return folder


@settings(max_examples=150, deadline=None)
@given(made=runs)
def test_every_field_comes_back(made: RunSummary) -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = read_report(write(Path(folder), made))
    assert found == replace(made, keys=made.selected)
    assert report(found) == report(made)


@settings(max_examples=150, deadline=None)
@given(made=st.lists(records, max_size=4))
def test_the_table_is_written_again_as_it_was(made: list[FrameRecord]) -> None:
    text = frames_csv(tuple(made))
    assert frames_of(text) == tuple(made)
    assert frames_csv(frames_of(text)) == text


def test_what_was_not_measured_stays_so(tmp_path: Path) -> None:
    """A score without values is one: the frame had ground truth, and counts as scored."""
    frames = interval(1001, "ggg", 1001)
    frames[1] = replace(frames[1], score=Score(), hole_score=Score())
    found = read_report(write(tmp_path, run(frames)))
    assert found.frames[1].score == found.frames[1].hole_score == Score()
    assert found.frames[2].score is None
    assert report(found)["quality"]["holes"]["frames"] == 1


def test_a_wall_time_that_is_not_known_stays_unknown(tmp_path: Path) -> None:
    made = run(interval(1, "ggg", 1), wall_seconds=math.nan)
    found = read_report(write(tmp_path, made))
    assert math.isnan(found.wall_seconds) and report(found) == report(made)


def test_file_names_that_are_no_unicode_are_spelled_out(tmp_path: Path) -> None:
    frame = replace(interval(1, "", 1)[0], file="a\udcff.exr")
    made = run([frame])
    pattern = replace(made.input, pattern="/in/\udcff.####.exr")
    found = read_report(write(tmp_path, replace(made, input=pattern)))
    assert found.frames[0].file == "a\\udcff.exr"
    assert found.input.pattern == "/in/\udcff.####.exr"


def test_a_factor_keeps_all_its_digits(tmp_path: Path) -> None:
    exact = Fraction(60 * 1001, 24000)
    found = read_report(write(tmp_path, run(interval(1, "gg", 1), factor=exact)))
    assert found.factor == exact


def test_means_of_another_computer_may_differ_in_their_last_digits(tmp_path: Path) -> None:
    folder = write(tmp_path, path_run("S4", scored=True))
    file = folder / "report.json"
    document = json.loads(file.read_text())
    document["quality"]["all"]["flip"] *= 1 + 1e-15
    file.write_text(json.dumps(document))
    assert len(read_report(folder).frames) == 12


def change(text: str, *keys: str, value: Any = None, drop: bool = False) -> str:
    """Set an entry of a JSON text, or leave it out."""
    document = part = json.loads(text)
    for key in keys[:-1]:
        part = part[key]
    if drop:
        del part[keys[-1]]
    else:
        part[keys[-1]] = value
    return json.dumps(document)


CHANGES = {
    "count": lambda text: change(text, "frames", "written", value=7),
    "mean": lambda text: change(text, "quality", "all", "psnr_db", value=30.5),
    "null": lambda text: change(text, "input", value=None),
    "text for a number": lambda text: change(text, "input", "first", value="1001"),
    "no step": lambda text: change(text, "input", "step", value=0),
    "no factor": lambda text: change(text, "fps", "factor", value="1/0"),
    "no range": lambda text: change(text, "input", "selected", value="all"),
    "huge range": lambda text: change(text, "input", "selected", value=f"1-{10**15}"),
    "missing": lambda text: change(text, "layers", drop=True),
    "more": lambda text: change(text, "input", "more", value=1),
    "number for text": lambda text: change(text, "version", value=1),
    "number for a path": lambda text: change(text, "input", "pattern", value=1.5),
    "list for text": lambda text: change(text, "input", "dynamic", value=[["a"]]),
    "table for text": lambda text: change(text, "method", value={}),
    "truth for a number": lambda text: change(text, "wall_s", value=True),
    "other setting": lambda text: change(text, "setting", value="both"),
    "endless": lambda text: change(text, "input", "last", value=10**12),
}
TABLES = {
    "row": lambda text: "".join(text.splitlines(True)[:-1]),
    "cut off": lambda text: text[:-40],
    "column": lambda text: text.replace("psnr_db_holes", "psnr_holes"),
    "number": lambda text: text.replace(",20.0,", ",20.5,"),
    "word": lambda text: text.replace(",generated,", ",made,"),
    "spreadsheet": lambda text: text.replace(",", ";"),
    "other lines": lambda text: text.replace("\n", "\r\n"),
    "empty": lambda text: "",
    "quote": lambda text: text + '"',
}


@pytest.mark.parametrize("name", [*CHANGES, *TABLES])
def test_what_was_changed_is_refused(tmp_path: Path, name: str) -> None:
    folder = write(tmp_path, path_run("S4", scored=True))
    file = folder / ("report.json" if name in CHANGES else "frames.csv")
    before = file.read_bytes().decode()
    after = (CHANGES | TABLES)[name](before)
    assert after != before
    file.write_bytes(after.encode())
    with pytest.raises(DamagedFileError, match=r"do not go together|was written by") as error:
        read_report(folder)
    assert str(folder) in str(error.value)
    assert "again" in str(error.value) or name == "number for text"


def test_files_of_two_runs_do_not_go_together(tmp_path: Path) -> None:
    one, other = write(tmp_path / "1", path_run("S1")), write(tmp_path / "6", path_run("S6"))
    (one / "frames.csv").write_bytes((other / "frames.csv").read_bytes())
    with pytest.raises(DamagedFileError, match="do not go together"):
        read_report(one)


@pytest.mark.parametrize("name", ["report.json", "frames.csv"])
@pytest.mark.parametrize("data", [b"\xff\xfe", None])
def test_files_that_cannot_be_read(tmp_path: Path, name: str, data: bytes | None) -> None:
    folder = write(tmp_path, path_run("S4"))
    (folder / name).unlink()
    if data is not None:
        (folder / name).write_bytes(data)
    with pytest.raises(InputError, match="is damaged" if data else "cannot read") as error:
        read_report(folder)
    assert str(folder / name) in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is damaged"),
        ("[" * 200_000, "is damaged"),
        (f'{{"schema": {"9" * 5000}}}', "is damaged"),
        ("[]", "no report of schema"),
        ('{"schema": "exwarp.bench/1"}', "no report of schema"),
        ('{"schema": "exwarp.compare/1"}', "of a comparison"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "report.json").write_text(text)
    with pytest.raises(InputError, match=message):
        read_report(tmp_path)


def test_a_report_of_another_version_that_tells_less(tmp_path: Path) -> None:
    folder = write(tmp_path, path_run("S4"))
    file = folder / "report.json"
    file.write_text(change(change(file.read_text(), "version", value="0.1"), "wall_s", drop=True))
    with pytest.raises(DamagedFileError, match=r"written by ExWarp 0\.1"):
        read_report(folder)
