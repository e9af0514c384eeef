"""What a run tells on stderr while it works."""

from __future__ import annotations

import io
import json

import pytest

from exwarp_cli.errors import UsageError
from exwarp_cli.pipeline.progress import (
    KINDS,
    REPORTERS,
    BarProgress,
    Estimate,
    JsonProgress,
    NoProgress,
    PlainProgress,
    make_progress,
)


class FakeClock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class TestEstimate:
    def test_the_first_frame_counts_only_while_it_is_alone(self):
        clock = FakeClock()
        estimate = Estimate(clock)
        estimate.start(5)
        assert estimate.eta_s is None
        clock.now += 10  # compiling
        estimate.advance()
        assert estimate.eta_s == 40
        clock.now += 1
        estimate.advance()
        assert estimate.eta_s == 3
        assert estimate.percent == 40

    def test_it_is_done_at_100_percent_only(self):
        estimate = Estimate(FakeClock())
        estimate.start(1000)
        for _ in range(999):
            estimate.advance()
        assert estimate.percent == 99
        estimate.advance()
        assert (estimate.percent, estimate.eta_s) == (100, 0)

    def test_nothing_to_do_is_done(self):
        estimate = Estimate(FakeClock())
        estimate.start(0)
        assert estimate.percent == 100


class TestPlain:
    def test_lines_have_percent_frame_and_estimate(self):
        stream, clock = io.StringIO(), FakeClock()
        progress = PlainProgress(stream, clock)
        progress.start(4)
        for frame in (1001, 1002, 1003, 1004):
            clock.now += 30
            progress.advance(frame, "skipped" if frame == 1002 else None)
        progress.finish()
        assert stream.getvalue().splitlines() == [
            "exwarp: 4 frames to do",
            "exwarp:  25% 1/4, frame 1001, 1:30 left",
            "exwarp:  50% 2/4, frame 1002 (skipped), 1:00 left",
            "exwarp:  75% 3/4, frame 1003, 0:30 left",
            "exwarp: 100% 4/4, frame 1004, 0:00 left",
        ]

    def test_fast_frames_do_not_flood_the_log(self):
        stream, clock = io.StringIO(), FakeClock()
        progress = PlainProgress(stream, clock)
        progress.start(1000)
        for frame in range(1000):
            clock.now += 0.02
            progress.advance(frame)
        lines = stream.getvalue().splitlines()
        assert 4 <= len(lines) <= 7
        assert "100% 1000/1000" in lines[-1]

    def test_long_estimates_have_hours(self):
        stream, clock = io.StringIO(), FakeClock()
        progress = PlainProgress(stream, clock)
        progress.start(2)
        clock.now += 3725
        progress.advance(1)
        assert "1:02:05 left" in stream.getvalue()


class TestJson:
    def test_every_line_is_an_object_with_the_counts(self):
        stream, clock = io.StringIO(), FakeClock()
        progress = JsonProgress(stream, clock)
        progress.start(2)
        progress.message('a "quoted"\nline')
        clock.now += 2
        progress.advance(7)
        progress.advance(8, "skipped")
        progress.finish()
        lines = [json.loads(line) for line in stream.getvalue().splitlines()]
        assert [line["event"] for line in lines] == ["start", "message", "frame", "frame", "finish"]
        assert [line["done"] for line in lines] == [0, 0, 1, 2, 2]
        assert {line["total"] for line in lines} == {2}
        assert lines[1]["text"] == 'a "quoted"\nline'
        assert lines[2] == {
            "event": "frame", "done": 1, "total": 2, "frame": 7, "note": None, "eta_s": 2.0
        }  # fmt: skip
        assert lines[3]["note"] == "skipped"


class TestBar:
    def test_it_counts_and_ends_with_the_last_frame(self):
        stream = io.StringIO()
        progress = BarProgress(stream)
        progress.message("before")
        progress.start(2)
        progress.advance(1001)
        progress.message("[not] markup")
        progress.advance(1002, "skipped")
        progress.finish()
        progress.finish()
        told = stream.getvalue()
        assert "exwarp: before" in told and "exwarp: [not] markup" in told
        assert "2/2" in told and "frame 1002 (skipped)" in told


class TestMakeProgress:
    @pytest.mark.parametrize("kind", REPORTERS)
    def test_each_kind_works_from_start_to_finish_on_stderr_alone(self, kind, capsys):
        progress = make_progress(kind)
        progress.start(1)
        progress.message("told")
        progress.advance(1)
        progress.finish()
        out, err = capsys.readouterr()
        assert out == "" and "told" in err

    def test_no_progress_says_nothing_by_itself(self, capsys):
        progress = make_progress("none")
        assert isinstance(progress, NoProgress)
        progress.start(1)
        progress.advance(1)
        progress.finish()
        assert capsys.readouterr() == ("", "")

    @pytest.mark.parametrize(
        ("terminal", "term", "kind"),
        [
            (True, "xterm", BarProgress),
            (True, "dumb", PlainProgress),
            (False, "xterm", PlainProgress),
        ],
    )
    def test_auto_looks_at_the_terminal(self, monkeypatch, terminal, term, kind):
        monkeypatch.setattr("sys.stderr.isatty", lambda: terminal)
        monkeypatch.setenv("TERM", term)
        assert isinstance(make_progress("auto"), kind)

    def test_other_names_are_refused(self):
        with pytest.raises(UsageError, match="auto, bar, plain, json, none"):
            make_progress("fancy")
        assert KINDS[0] == "auto"
