"""What a run tells while it works."""

from __future__ import annotations

import io
import json
from collections import Counter
from typing import ClassVar

import pytest

from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import MissingFrameError, UsageError
from exwarp_cli.pipeline.progress import (
    INTERVAL_S,
    KINDS,
    REPORTERS,
    BarProgress,
    JsonProgress,
    OpenJdProgress,
    PlainProgress,
    Progress,
    kind_of,
    reporting,
)

NASTY = "shot\nopenjd_env: PATH=/evil\r\x85openjd_fail: no\u2028\x1b[2J\udcff"
"""A name that a farm, or a terminal, would obey."""


class FakeClock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class TestEstimate:
    def test_the_first_frame_counts_only_while_it_is_alone(self):
        clock = FakeClock()
        estimate = Progress(clock=clock)
        estimate.start(5)
        assert estimate.eta_s is None
        clock.now += 10  # compiling
        estimate.advance(1)
        assert estimate.eta_s == 40
        clock.now += 1
        estimate.advance(1)
        assert estimate.eta_s == 3
        assert estimate.tenths == 40

    def test_it_is_done_at_100_percent_only(self):
        estimate = Progress(clock=FakeClock())
        estimate.start(1000)
        for _ in range(999):
            estimate.advance(1)
        assert estimate.tenths == 99.9
        estimate.advance(1)
        assert (estimate.tenths, estimate.eta_s) == (100, 0)

    def test_more_than_all_is_all(self):
        estimate = Progress(clock=FakeClock())
        estimate.start(1)
        estimate.advance(1)
        estimate.advance(1)
        assert (estimate.tenths, estimate.eta_s) == (100, 0)

    def test_nothing_to_do_is_done(self):
        estimate = Progress(clock=FakeClock())
        estimate.start(0)
        assert estimate.tenths == 100


class TestKindsOfWork:
    """Of `exwarp`: a key frame takes 0.1 s, a warp 1 s, an extrapolated frame 10 s."""

    SECONDS: ClassVar = {"key": 0.1, "slot 1": 1, "slot 2": 10, "slot 3": 10}
    INTERVAL = sum(SECONDS.values())

    @staticmethod
    def estimate(clock: FakeClock, intervals: int, at_once: int = 1) -> Progress:
        slots = [Slot(key, index) for key in range(intervals) for index in range(4)]
        estimate = Progress(clock=clock)
        estimate.start(len(slots), Counter(kind_of(slot.index) for slot in slots), at_once)
        return estimate

    def test_time_left_is_unknown_until_each_kind_that_is_left_was_seen(self):
        clock = FakeClock()
        estimate = self.estimate(clock, 9)
        left = []
        for kind, seconds in self.SECONDS.items():
            clock.now += seconds
            estimate.advance(1, kind=kind)
            left.append(estimate.left)
        assert left == ["time left unknown"] * 3 + ["2:49 left"]
        assert estimate.eta_s == pytest.approx(8 * self.INTERVAL)

    def test_cheap_frames_that_were_done_last_do_not_shorten_the_rest(self):
        clock = FakeClock()
        estimate = self.estimate(clock, 5)
        for _ in range(3):
            for kind, seconds in self.SECONDS.items():
                clock.now += seconds
                estimate.advance(1, kind=kind)
        clock.now += 0.1
        estimate.advance(1, kind="key")
        assert estimate.eta_s == pytest.approx(2 * self.INTERVAL - 0.1)

    def test_the_first_of_each_kind_pays_for_compiling(self):
        clock = FakeClock()
        estimate = self.estimate(clock, 3)
        for compiling in (20, 0):
            for kind, seconds in self.SECONDS.items():
                clock.now += seconds + compiling
                estimate.advance(1, kind=kind)
        assert estimate.eta_s == pytest.approx(self.INTERVAL)

    def test_frames_of_an_earlier_run_say_nothing_of_those_that_are_missing(self):
        clock = FakeClock()
        estimate = self.estimate(clock, 4)
        for _ in range(2):
            for kind in self.SECONDS:
                clock.now += 0.001
                estimate.advance(1, kind=kind, made=False)
        assert estimate.eta_s is None
        for kind, seconds in self.SECONDS.items():
            clock.now += seconds
            estimate.advance(1, kind=kind)
        assert estimate.eta_s == pytest.approx(self.INTERVAL)

    def test_several_at_once_begin_together(self):
        clock = FakeClock()
        estimate = Progress(clock=clock)
        estimate.start(8, None, at_once=2)
        clock.now += 60  # both compile, and end at nearly the same time
        estimate.advance(1)
        assert estimate.eta_s == 7 * 60 / 2
        clock.now += 1
        estimate.advance(1)
        assert estimate.eta_s == 6 * 61 / 2
        for seconds in (9, 1):
            clock.now += seconds
            estimate.advance(1)
        assert estimate.eta_s == 4 * 5

    def test_a_log_a_farm_and_a_terminal_say_that_it_is_unknown(self):
        for kind in (PlainProgress, OpenJdProgress, BarProgress):
            stream, clock = io.StringIO(), FakeClock()
            progress = kind(stream, clock)
            progress.start(8, {"key": 2, "slot 1": 2, "slot 2": 2, "slot 3": 2})
            clock.now += 1
            progress.advance(1, "key", "key")
            progress.finish()
            assert "time left unknown" in stream.getvalue(), kind

    def test_a_program_gets_null(self):
        stream = io.StringIO()
        progress = JsonProgress(stream, FakeClock())
        progress.start(2, {"key": 1, "slot 1": 1})
        progress.advance(1, "key", "key")
        progress.advance(2, "s6", "slot 1")
        lines = [json.loads(line) for line in stream.getvalue().splitlines()]
        assert [line.get("eta_s") for line in lines] == [None, None, 0]


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

    def test_a_failure_is_an_event(self):
        stream = io.StringIO()
        progress = JsonProgress(stream)
        progress.start(9)
        progress.finish()
        progress.fail(NASTY, 3)
        (line,) = stream.getvalue().splitlines()[2:]
        assert json.loads(line) == {
            "event": "fail", "done": 0, "total": 9, "text": NASTY, "exit_code": 3
        }  # fmt: skip


class TestOpenJd:
    """Lines of https://github.com/OpenJobDescription/openjd-specifications, How Jobs Are Run."""

    def test_progress_and_status_go_together_and_messages_are_the_log_s(self):
        stream, clock = io.StringIO(), FakeClock()
        progress = OpenJdProgress(stream, clock)
        progress.message("motion as Blender writes it")
        progress.start(3)
        for frame, note in ((1001, "key"), (1002, None), (1003, "skipped")):
            clock.now += 30
            progress.advance(frame, note)
        progress.finish()
        assert stream.getvalue().splitlines() == [
            "exwarp: motion as Blender writes it",
            "openjd_progress: 0.0",
            "openjd_status: 3 frames to do",
            "openjd_progress: 33.3",
            "openjd_status: 1/3, frame 1001 (key), 1:00 left",
            "openjd_progress: 66.6",
            "openjd_status: 2/3, frame 1002, 0:30 left",
            "openjd_progress: 100.0",
            "openjd_status: 3 frames done",
        ]

    def test_what_was_left_out_as_requested_is_no_failure(self):
        stream = io.StringIO()
        OpenJdProgress(stream).fail("1 of 5 key intervals was left out", 12)
        assert stream.getvalue() == "openjd_status: 1 of 5 key intervals was left out\n"

    def test_a_farm_s_log_stays_readable(self):
        stream, clock = io.StringIO(), FakeClock()
        progress = OpenJdProgress(stream, clock)
        progress.start(1000)
        for frame in range(1000):
            clock.now += 4 * INTERVAL_S / 1000
            progress.advance(frame)
        lines = stream.getvalue().splitlines()
        percentages = [line for line in lines if line.startswith("openjd_progress: ")]
        assert 2 * len(percentages) == len(lines)
        assert 5 <= len(percentages) <= 7
        assert lines[-2:] == ["openjd_progress: 100.0", "openjd_status: 1000 frames done"]

    def test_nothing_to_do(self):
        stream = io.StringIO()
        progress = OpenJdProgress(stream)
        progress.start(0)
        progress.finish()
        assert stream.getvalue() == "openjd_progress: 100.0\nopenjd_status: 0 frames to do\n"

    def test_names_put_in_no_lines_of_their_own(self):
        stream = io.StringIO()
        progress = OpenJdProgress(stream)
        progress.message(f"reading {NASTY}")
        progress.start(1)
        progress.advance(1, NASTY)
        progress.fail(f"{NASTY} is damaged", 3)
        kinds = [line.split(": ")[0] for line in stream.getvalue().splitlines()]
        pair = ["openjd_progress", "openjd_status"]
        assert kinds == ["exwarp", *pair, *pair, "openjd_fail"]

    @pytest.mark.parametrize("text", ["", "\n", "  "])
    def test_a_failure_has_a_reason(self, text):
        stream = io.StringIO()
        OpenJdProgress(stream).fail(text, 5)
        assert stream.getvalue() == "openjd_fail: exit code 5\n"

    def test_streams_that_cannot_write_everything(self):
        raw = io.BytesIO()
        stream = io.TextIOWrapper(raw, encoding="ascii", errors="strict")
        OpenJdProgress(stream).message("größer \udcff 東")
        assert raw.getvalue() == b"exwarp: gr\\xf6\\xdfer \\udcff \\u6771\n"


class TestBar:
    def test_it_counts_and_ends_with_the_last_frame(self):
        stream = io.StringIO()
        progress = BarProgress(stream)
        progress.message("before")
        progress.start(2)
        progress.advance(1001)
        progress.message("[not] markup\nor \x1b[2J lines")
        progress.advance(1002, "skipped")
        progress.finish()
        progress.finish()
        output = stream.getvalue()
        assert "exwarp: before" in output and "exwarp: [not] markup or \\x1b[2J lines\n" in output
        assert "2/2" in output and "frame 1002 (skipped)" in output


class TestReporters:
    @pytest.mark.parametrize("results", [False, True])
    @pytest.mark.parametrize("kind", REPORTERS)
    def test_each_kind_works_from_start_to_end_on_one_stream(self, kind, results, capsys):
        with reporting(kind, results_on_stdout=results) as progress:
            progress.start(1)
            progress.message("notice")
            progress.advance(1)
            progress.finish()
            progress.fail("wrong", 1)
        out, err = capsys.readouterr()
        if kind == "openjd" and not results:
            out, err = err, out
        assert out == "" and "notice" in err
        assert ("wrong" in err) == (kind in ("json", "openjd"))

    @pytest.mark.parametrize("kind", [kind for kind in REPORTERS if kind != "json"])
    def test_a_message_is_a_line_whatever_it_holds(self, kind, capsys):
        with reporting(kind) as progress:
            progress.message(NASTY)
        (line,) = "".join(capsys.readouterr()).splitlines()
        assert line == ("exwarp: shot openjd_env: PATH=/evil openjd_fail: no \\x1b[2J\\udcff")

    def test_no_progress_says_nothing_by_itself(self, capsys):
        with reporting("none") as progress:
            assert type(progress) is Progress
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
        with reporting("auto") as progress:
            assert isinstance(progress, kind)

    def test_other_names_are_refused(self):
        names = "auto, bar, plain, json, openjd, none"
        with pytest.raises(UsageError, match=names), reporting("fancy"):
            pass
        assert KINDS[0] == "auto"


class TestReporting:
    @staticmethod
    def events(capsys):
        return [json.loads(line) for line in capsys.readouterr().err.splitlines()]

    def test_a_block_that_succeeds_is_no_failure(self, capsys):
        with reporting("json") as progress:
            progress.start(1)
            progress.finish()
        assert [event["event"] for event in self.events(capsys)] == ["start", "finish"]

    @pytest.mark.parametrize(
        ("error", "text", "code"),
        [
            (
                MissingFrameError("frame 7 is missing; render it"),
                "frame 7 is missing; render it",
                3,
            ),
            (ZeroDivisionError("oops"), "unexpected ZeroDivisionError: oops", 1),
            (MemoryError(), "the memory does not suffice", 11),
        ],
    )
    def test_what_goes_wrong_is_reported_last_and_goes_on(self, capsys, error, text, code):
        with pytest.raises(type(error)) as raised, reporting("json") as progress:
            progress.start(1)
            try:
                raise error
            finally:
                progress.finish()
        assert raised.value is error
        *_, finish, fail = self.events(capsys)
        assert (finish["event"], fail["event"]) == ("finish", "fail")
        assert (fail["text"], fail["exit_code"]) == (text, code)

    def test_an_interruption_is_no_failure(self, capsys):
        with pytest.raises(KeyboardInterrupt), reporting("json"):
            raise KeyboardInterrupt
        assert capsys.readouterr() == ("", "")

    def test_a_listener_that_left_does_not_hide_the_reason(self, monkeypatch):
        class Closed(io.StringIO):
            def write(self, text):
                raise BrokenPipeError

        monkeypatch.setattr("sys.stdout", Closed())
        with pytest.raises(MissingFrameError), reporting("openjd"):
            raise MissingFrameError("frame 7 is missing; render it")

    def test_results_have_stdout_for_themselves(self, capsys):
        with pytest.raises(UsageError), reporting("openjd", results_on_stdout=True):
            raise UsageError("--frames x is no range")
        assert capsys.readouterr() == ("", "openjd_fail: --frames x is no range\n")
