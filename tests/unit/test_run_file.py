"""run.json: nothing of a run is lost on the way, and what is damaged is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain.decision import CHOICES, NODES, PATHS, Decision, Features, Trial
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
from exwarp_cli.domain.tiles import Risk, TileMakers
from exwarp_cli.domain.timeline import Cut
from exwarp_cli.report.folder import format_run, parse_run
from exwarp_cli.report.schema import run_document
from tests.matrix import FULL
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
risks = st.builds(
    Risk,
    st.floats(0, 255, width=32),
    st.just(1),
    st.just(2),
    st.tuples(st.integers(0, 128), st.integers(0, 128)),
    st.tuples(st.integers(0, 2), st.integers(0, 2)),
)
trials = st.just(Trial()) | st.builds(Trial.measured, numbers, st.floats(0, 100), st.floats(0, 100))
records = st.builds(
    FrameRecord,
    *(numbers, words, numbers, st.integers(0, 9), st.sampled_from(FrameKind), words),
    st.lists(numbers, max_size=3).map(tuple),
    hole_fraction=maybe(shares),
    nonfinite_pixels=maybe(counts),
    score=maybe(scores),
    hole_score=maybe(scores),
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
inputs = st.builds(
    InputSummary,
    *(words, numbers, numbers, counts, counts, words, maybe(words), maybe(words)),
    dynamic=maybe(st.lists(words).map(tuple)),
    step=st.integers(1, 100),
)
runs = st.builds(
    RunSummary,
    *(words, st.sampled_from(["key", "slot"]), st.booleans(), inputs, positive, words),
    wall_seconds=st.floats(0, 1e6) | st.just(math.inf),
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


REPORT = "{}"


def written_and_read(made: RunSummary) -> RunSummary:
    return parse_run(format_run(made, REPORT), REPORT)


@settings(max_examples=150 if FULL else 40, deadline=None)
@given(made=runs)
def test_every_field_comes_back(made: RunSummary) -> None:
    found = written_and_read(made)
    assert found == made
    assert run_document(found) == run_document(made)


def test_what_was_not_measured_stays_so() -> None:
    """A score without values is one: the frame had ground truth, and counts as scored."""
    frames = interval(1001, "ggg", 1001)
    frames[1] = replace(frames[1], score=Score(), hole_score=Score())
    found = written_and_read(run(frames))
    assert found.frames[1].score == found.frames[1].hole_score == Score()
    assert found.frames[2].score is None
    assert run_document(found)["quality"]["holes"]["frames"] == 1


def test_tiles_and_all_their_makers_come_back() -> None:
    frames = interval(1, "ggg", 1)
    frames[2] = replace(frames[2], tiles=TileMakers(2, 2, "wewe"))
    assert written_and_read(run(frames)).frames == tuple(frames)


def test_a_wall_time_that_is_not_known_stays_unknown() -> None:
    found = written_and_read(run(interval(1, "ggg", 1), wall_seconds=math.nan))
    assert math.isnan(found.wall_seconds)


def test_numbers_of_numpy_are_written_as_numbers() -> None:
    frames = interval(1, "g", 1)
    frames[1] = replace(frames[1], hole_fraction=np.float32(0.25), nonfinite_pixels=np.int64(3))
    found = written_and_read(run(frames)).frames[1]
    assert (found.hole_fraction, found.nonfinite_pixels) == (0.25, 3)


def test_file_names_that_are_no_unicode_come_back() -> None:
    frame = replace(interval(1, "", 1)[0], file="a\udcff.exr")
    made = run([frame])
    made = replace(made, input=replace(made.input, pattern="/in/\udcff.####.exr"))
    assert written_and_read(made) == made


def test_fields_that_came_later_have_their_defaults() -> None:
    made = path_run("S4")
    document = json.loads(format_run(made, REPORT))
    del document["run"]["nonfinite"], document["run"]["frames"][0]["rendered_sources"]
    assert parse_run(json.dumps(document), REPORT) == made


def changed(text: str, *keys: str, value: Any = None, drop: bool = False) -> str:
    """Set an entry of a JSON text, or leave it out."""
    document = part = json.loads(text)
    for key in keys[:-1]:
        part = part[int(key) if isinstance(part, list) else key]
    if drop:
        del part[keys[-1]]
    else:
        part[keys[-1]] = value
    return json.dumps(document)


CHANGES = {
    "null": {"keys": ("run", "input"), "value": None},
    "text for a number": {"keys": ("run", "input", "first"), "value": "1001"},
    "text for a share": {"keys": ("run", "frames", "1", "hole_fraction"), "value": "half"},
    "no factor": {"keys": ("run", "factor"), "value": "1/0"},
    "missing": {"keys": ("run", "method"), "drop": True},
    "more": {"keys": ("run", "input", "more"), "value": 1},
    "number for text": {"keys": ("run", "version"), "value": 1},
    "list for text": {"keys": ("run", "input", "dynamic"), "value": [["a"]]},
    "table for text": {"keys": ("run", "method"), "value": {}},
    "truth for a number": {"keys": ("run", "wall_seconds"), "value": True},
    "number for truth": {"keys": ("run", "lookahead"), "value": 1},
    "a kind that is none": {"keys": ("run", "frames", "0", "kind"), "value": "new"},
    "another schema": {"keys": ("schema",), "value": "exwarp.run/2"},
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_was_changed_is_refused(name: str) -> None:
    text = format_run(path_run("S4", scored=True), REPORT)
    change = dict(CHANGES[name])
    with pytest.raises((AttributeError, ArithmeticError, LookupError, TypeError, ValueError)):
        parse_run(changed(text, *change.pop("keys"), **change), REPORT)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", "[" * 200_000])
def test_other_files_are_refused(text: str) -> None:
    with pytest.raises((LookupError, RecursionError, TypeError, ValueError)):
        parse_run(text, REPORT)


def test_a_run_belongs_to_its_report() -> None:
    with pytest.raises(ValueError, match="of another report"):
        parse_run(format_run(path_run("S4"), REPORT), "{} ")
