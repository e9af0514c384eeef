"""The lists of what is most worth a look, and most worth rendering after all."""

from __future__ import annotations

from dataclasses import replace

import pytest

from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.domain.tiles import REASONS, TILE_ROWS, Risk, encode_level
from exwarp_cli.report.folder import write_report
from exwarp_cli.report.review import (
    frames_worth_rendering,
    places_of_frame,
    places_worth_a_look,
    summarise_review,
)
from exwarp_cli.report.schema import format_review_csv
from exwarp_cli.report.sentences import describe_review
from tests.plots import leave_plots_out
from tests.unit.sample_runs import no_pictures, record, run

COLUMNS = 16
SIZE = 64, 32
"""Of frames in `sample_runs`: tiles of 4x4 pixels."""


def risky(number: int, error: float, bad: dict[tuple[int, int], tuple[float, str]]) -> FrameRecord:
    """Return a frame with this error, and tiles (row, column) with theirs and its reason."""
    codes, reasons = [encode_level(1.0)] * (TILE_ROWS * COLUMNS), [0] * (TILE_ROWS * COLUMNS)
    for (row, column), (level, reason) in bad.items():
        codes[row * COLUMNS + column] = encode_level(level)
        reasons[row * COLUMNS + column] = REASONS.index(reason)
    risk = Risk(error, COLUMNS, TILE_ROWS, tuple(codes), tuple(reasons))
    return record(number, 1001, 1, FrameKind.GENERATED, risk=risk)


def test_tiles_side_by_side_are_one_place():
    bad = {(2, 3): (40.0, "holes"), (2, 4): (30.0, "light"), (3, 4): (25.0, "holes"),
           (0, 15): (45.0, "motion"), (7, 0): (20.0, "light")}  # fmt: skip
    places = places_of_frame(risky(12, 9.0, bad), SIZE)
    assert [(p.x, p.y, p.width, p.height, p.reason) for p in places] == [
        (60, 0, 4, 4, "motion"),
        (12, 8, 8, 8, "holes"),
    ]  # the last tile is far from the worst one's error
    assert [p.frame for p in places] == [12, 12]


def test_tiles_at_both_ends_of_neighbouring_rows_do_not_touch():
    bad = {(1, 15): (40.0, "light"), (2, 0): (40.0, "light")}
    assert len(places_of_frame(risky(12, 9.0, bad), SIZE)) == 2


def test_a_frame_without_visible_error_has_no_place():
    assert places_of_frame(risky(12, 1.0, {(0, 0): (5.0, "light")}), SIZE) == []


def test_the_worst_tenth_is_named_for_rendering():
    frames = [risky(number, number / 2, {}) for number in range(1, 31)]
    assert frames_worth_rendering(frames) == [28, 29, 30]
    assert frames_worth_rendering([replace(f, risk=None) for f in frames]) == []


def test_the_middle_of_an_interval_is_rendered_for_those_beside_it():
    """Where the frames between two key frames are made from both, and are about as wrong."""
    frames = [
        replace(risky(4 * key + slot, 9.0 + slot / 4, {}), key=key, slot=slot, made_by="softsplat")
        for key in range(10)
        for slot in (1, 2, 3)
    ]
    assert frames_worth_rendering(frames) == [2, 6, 10]
    worse = [replace(f, risk=replace(f.risk, error=19.0)) if f.number == 7 else f for f in frames]
    assert 7 in frames_worth_rendering(worse) and 6 not in frames_worth_rendering(worse)
    alone = [replace(frame, made_by="warp") for frame in frames]
    assert frames_worth_rendering(alone) == [3, 7, 11]


def test_frames_that_are_right_are_not_named():
    assert frames_worth_rendering([risky(number, 1.0, {}) for number in range(1, 31)]) == []


@pytest.mark.parametrize(("error", "text"), [(9.0, "1-2\n"), (1.0, "")])
def test_named_frames_are_a_list_that_farms_take(tmp_path, monkeypatch, error, text):
    leave_plots_out(monkeypatch)
    frames = [risky(number, error, {}) for number in range(1, 17)]
    write_report(tmp_path, run(frames), no_pictures())
    assert (tmp_path / "review.txt").read_text() == text


def test_the_list_begins_with_the_worst_place():
    made = run([risky(5, 2.0, {(0, 0): (20.0, "light")}), risky(6, 9.0, {(1, 1): (50.0, "holes")})])
    assert format_review_csv(places_worth_a_look(made)).splitlines() == [
        "frame,predicted_error,x,y,width,height,why",
        "6,50.5,4,4,4,4,holes",
        "5,19.7,0,0,4,4,light",
    ]


def test_a_run_without_predicted_errors_tells_nothing():
    made = run([record(1, 1001, 0, FrameKind.KEY)])
    assert (
        summarise_review(made) is None
        and format_review_csv(places_worth_a_look(made)).count("\n") == 1
    )


def test_the_summary_is_one_line():
    found = summarise_review(run([risky(6, 9.0, {(1, 1): (50.0, "holes")}), risky(7, 3.0, {})]))
    assert found == {
        "predicted_error": {"mean": 6.0, "worst": 9.0, "worst_frame": 6, "frames": 2},
        "places": 1,
        "render": "6",
    }
    assert describe_review(found) == (
        "predicted error 6.0 of 255 levels on average, worst 9.0 in frame 6; 1 place worth a look; "
        "frames most worth rendering: 6"
    )
