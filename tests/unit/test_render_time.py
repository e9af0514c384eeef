"""Render times from headers, and what they say a run saved."""

from __future__ import annotations

from dataclasses import replace

import pytest

from exwarp_cli.domain.results import FrameKind, FrameRecord, InputSummary, RunSummary
from exwarp_cli.io.exr.writer import parse_duration, render_seconds
from exwarp_cli.report.schema import render_time_saved
from exwarp_cli.report.sentences import format_time


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("00:42.85", 42.85),
        ("02:03.5", 123.5),
        ("1:02:03.45", 3723.45),
        (" 0h 28m 39.3s", 28 * 60 + 39.3),
        ("2h 57m 33.3s", 2 * 3600 + 57 * 60 + 33.3),
        ("12.5", 12.5),
        (7, 7.0),
        (0.25, 0.25),
        ("about an hour", None),
        ("1:2:3:4", None),
        ("-3", None),
        ("", None),
        (None, None),
        (True, None),
        (float("nan"), None),
        (-1.0, None),
        (b"00:42.85", None),
    ],
)
def test_durations_as_renderers_write_them(text, seconds):
    assert parse_duration(text) == (None if seconds is None else pytest.approx(seconds))


def test_the_whole_frames_time_comes_before_that_of_its_layers():
    layers = {"cycles.A.render_time": "00:10.00", "cycles.B.render_time": "00:05.50"}
    assert render_seconds([layers | {"RenderTime": "00:20.00"}]) == (20.0, "RenderTime")
    assert render_seconds([layers]) == (15.5, "cycles.*.render_time")
    # Every part of a file repeats the attributes of the whole frame.
    assert render_seconds([layers, layers]) == (15.5, "cycles.*.render_time")
    assert render_seconds([{"vrayInfo/rendertime": " 0h 1m 2.0s"}]) == (62.0, "vrayInfo/rendertime")


@pytest.mark.parametrize(
    "header", [{}, {"RenderTime": "soon"}, {"RenderTime": "00:00.00"}, {"rendertime": "00:01.00"}]
)
def test_headers_that_tell_nothing(header):
    assert render_seconds([header]) is None


def run(*frames: FrameRecord, seconds: float = 10.0) -> RunSummary:
    source = InputSummary("shot.#.exr", 1, 2, 4, 2, "", None, None)
    return RunSummary("s6", "key", False, source, 30.0, "header", seconds, frames)


def record(slot: int, kind: FrameKind, resumed: bool = False, **more: object) -> FrameRecord:
    return FrameRecord(slot, "", 1, slot, kind, "", (1,), resumed=resumed, **more)


def test_what_is_saved_is_what_was_not_rendered_less_the_tools_own_time():
    made = run(
        record(0, FrameKind.KEY, render=(40.0, "RenderTime")),
        record(0, FrameKind.KEY, render=(60.0, "RenderTime")),
        record(1, FrameKind.GENERATED),
        record(2, FrameKind.GENERATED, resumed=True),
        record(3, FrameKind.DROPPED),
        record(1, FrameKind.GENERATED),
    )
    found = render_time_saved(made)
    assert found is not None
    # Two frames of 50 s; a repeat is none, and the resumed one cost this run nothing.
    assert found["key_frame_s"] == 50 and found["key_frames"] == 2
    assert found["generated_frame_s"] == 5
    assert found["saved_s"] == 2 * 50 - 10
    assert found["saved_share"] == 90 / (4 * 50)
    assert found["source"] == "RenderTime"


def test_key_frames_that_are_not_shown_were_rendered_too():
    key = record(0, FrameKind.KEY, render=(40.0, "RenderTime"))
    slots = [replace(record(i, FrameKind.GENERATED), key=k) for k, i in ((1, 1), (2, 1), (2, 2))]
    found = render_time_saved(run(key, *slots))
    assert found is not None
    # Four frames at the output's rate, of two that were rendered.
    assert found["saved_s"] == 2 * 40 - 10 and found["saved_share"] == 70 / 160


def test_nothing_is_said_where_no_header_tells_or_nothing_was_made():
    key = record(0, FrameKind.KEY, render=(40.0, "RenderTime"))
    assert render_time_saved(run(record(0, FrameKind.KEY), record(1, FrameKind.GENERATED))) is None
    assert render_time_saved(run(key, record(1, FrameKind.DROPPED))) is None


def test_scoring_is_not_the_tools_time():
    key = record(0, FrameKind.KEY, render=(40.0, "RenderTime"))
    scored = [record(i, FrameKind.GENERATED, timing_ms={"score": 2000.0}) for i in (1, 2)]
    found = render_time_saved(run(key, *scored))
    assert found is not None
    assert found["generated_frame_s"] == (10 - 4) / 2 and found["saved_s"] == 80 - 6


def test_a_tool_slower_than_the_renderer_saves_less_than_nothing():
    key = record(0, FrameKind.KEY, render=(1.0, "RenderTime"))
    found = render_time_saved(run(key, record(1, FrameKind.GENERATED)))
    assert found is not None and found["saved_s"] == -9


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.25, "250 ms"), (119.9, "119.9 s"), (600, "10 min"), (7500, "2 h 5 min"), (-600, "-10 min")],
)
def test_times_in_words(seconds, text):
    assert format_time(seconds) == text
