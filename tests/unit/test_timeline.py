"""Numbering of key frames, slots and selections."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.domain.timeline import FACTOR, Slot, Timeline, parse_frames, ranges
from exwarp_cli.errors import MissingFrameError, UsageError

FACTORS = st.fractions(Fraction(41, 40), 8, max_denominator=40)
FRAMES = st.sets(st.integers(-2000, 20_000), min_size=1, max_size=40)


def written(timeline: Timeline, keys: tuple[int, ...]) -> list[int]:
    return [timeline.number(slot) for key in keys for slot in timeline.slots_of(key)]


class TestNumbering:
    def test_steps_of_one_are_spread_densely_from_the_first_number(self):
        timeline = Timeline.of([1001, 1002, 1003])
        assert written(timeline, (0, 1, 2)) == list(range(1001, 1013))
        assert timeline.number(Slot(1, 0)) == 1005

    def test_steps_of_the_factor_have_their_gaps_filled(self):
        timeline = Timeline.of([10, 14, 18])
        assert written(timeline, (0, 1, 2)) == list(range(10, 22))
        assert [timeline.number(Slot(k, 0)) for k in range(3)] == [10, 14, 18]

    def test_the_start_can_be_set(self):
        for start in (-2, 0):
            timeline = Timeline.of([7, 8], start=start)
            assert written(timeline, (0, 1)) == list(range(start, start + 8))

    def test_no_tail_stops_at_the_last_key_frame(self):
        timeline = Timeline.of([1, 2, 3], tail=False)
        assert written(timeline, (0, 1, 2)) == list(range(1, 4 * 2 + 2))

    def test_a_single_frame_has_four_slots(self):
        assert written(Timeline.of([5]), (0,)) == [5, 6, 7, 8]

    def test_order_and_duplicates_of_the_input_do_not_matter(self):
        assert Timeline.of([3, 1, 2, 2]) == Timeline.of([1, 2, 3])

    def test_slots_know_their_time(self):
        timeline = Timeline.of([1, 2, 3])
        assert [timeline.time(Slot(2, i)) for i in range(FACTOR)] == [0.0, 0.25, 0.5, 0.75]
        assert timeline.order(Slot(2, 3)) == 11

    @given(st.integers(-50, 5000), st.integers(1, 30), st.sampled_from([1, 4]), st.booleans())
    def test_any_split_of_the_range_is_the_whole(self, first, count, step, tail):
        timeline = Timeline.of([first + step * i for i in range(count)], tail=tail)
        whole = written(timeline, timeline.select(None))
        cut = first + step * (count // 2)
        chunks = [f"{first}-{cut}", f"{cut + step}-{first + step * (count - 1)}"]
        chunks = [
            f"{c}x{step}" for c in (chunks if count > 1 and count // 2 < count - 1 else chunks[:1])
        ]
        parts = [n for c in chunks for n in written(timeline, timeline.select(c))]
        assert parts == whole == list(range(whole[0], whole[-1] + 1))
        assert len(whole) == (4 * count if tail else 4 * (count - 1) + 1)


class TestRates:
    def test_a_third_of_the_interval_at_three_times_the_rate(self):
        timeline = Timeline.of([5, 6], factor=3)
        assert timeline.steps == 3
        assert [timeline.time(slot) for slot in timeline.slots_of(0)] == [
            0,
            Fraction(1, 3),
            Fraction(2, 3),
        ]
        assert written(timeline, (0, 1)) == [5, 6, 7, 8, 9, 10]

    def test_from_24_to_60_every_other_key_frame_is_shown(self):
        timeline = Timeline.of([1, 2, 3, 4, 5], factor=Fraction(5, 2))
        assert timeline.steps is None
        assert [timeline.shows(key) for key in range(5)] == [True, False, True, False, True]
        times = [[timeline.time(slot) for slot in timeline.slots_of(key)] for key in (0, 1)]
        assert times == [[0, Fraction(2, 5), Fraction(4, 5)], [Fraction(1, 5), Fraction(3, 5)]]
        assert written(timeline, (0, 1, 2)) == [1, 2, 3, 4, 5, 6, 7, 8]
        assert timeline.made_of(0) == (Slot(0, 1), Slot(0, 2))
        assert timeline.made_of(1) == timeline.slots_of(1) == (Slot(1, 1), Slot(1, 2))

    def test_without_tail_nothing_comes_after_the_last_key_frame(self):
        odd = Timeline.of([1, 2, 3, 4], tail=False, factor=Fraction(5, 2))
        assert odd.slots_of(3) == ()
        assert len(Timeline.of([1, 2, 3], tail=False, factor=Fraction(5, 2)).slots_of(2)) == 1

    @given(FACTORS, st.integers(1, 40), st.booleans())
    def test_every_output_instant_is_there_once_and_in_time(self, factor, count, tail):
        timeline = Timeline.of(list(range(7, 7 + count)), tail=tail, factor=factor)
        slots = [slot for key in range(count) for slot in timeline.slots_of(key)]
        assert [timeline.order(slot) for slot in slots] == list(range(len(slots)))
        for slot in slots:
            assert slot.key + timeline.time(slot) == timeline.order(slot) / factor
            assert 0 <= timeline.time(slot) < 1 and (slot.index == 0) == (timeline.time(slot) == 0)
        end = len(slots) / factor
        assert end >= count if tail else end > count - 1
        assert (len(slots) - 1) / factor < count if tail else (len(slots) - 1) / factor <= count - 1

    @given(FACTORS, st.integers(0, 40))
    def test_the_slots_between_key_frames_are_those_of_the_whole(self, factor, key):
        timeline = Timeline.of(list(range(50)), factor=factor)
        assert timeline.made_of(key) == timeline.between(key)
        assert timeline.shows(key) == (Slot(key, 0) in timeline.slots_of(key))


class TestMissingFrames:
    @pytest.mark.parametrize(
        ("numbers", "missing"),
        [
            ([1, 2, 4], "frame 3 is missing from the sequence 1-2,4"),
            ([10, 14, 22], "frame 18 is missing"),
            ([1, 2, 5, 6, 8], "frame 3-4,7 is missing"),
            ([1, 4, 6], "frame 3 is missing"),
        ],
    )
    def test_a_gap_is_named(self, numbers, missing):
        with pytest.raises(MissingFrameError, match=missing):
            Timeline.of(numbers)

    def test_a_stray_far_number_is_cheap_to_refuse(self):
        with pytest.raises(MissingFrameError, match="frame 3-999999999999 is missing"):
            Timeline.of([1, 2, 10**12])

    def test_no_frames_at_all(self):
        with pytest.raises(MissingFrameError, match="no frames"):
            Timeline.of([])

    def test_selecting_an_absent_frame_names_it_and_what_there_is(self):
        with pytest.raises(MissingFrameError, match=r"frame 4-5 of --frames 2-5 .* has 1-3"):
            Timeline.of([1, 2, 3]).select("2-5")


class TestParseFrames:
    @pytest.mark.parametrize(
        ("text", "numbers"),
        [
            ("1001-1004", [1001, 1002, 1003, 1004]),
            ("1-10x3", [1, 4, 7, 10]),
            ("1-10:3", [1, 4, 7, 10]),
            ("5, 1,5 ,9-11", [1, 5, 9, 10, 11]),
            ("-3--1", [-3, -2, -1]),
            ("-2", [-2]),
            ("3-1", [1, 2, 3]),
            ("0001-0002", [1, 2]),
        ],
    )
    def test_forms(self, text, numbers):
        assert parse_frames(text) == numbers

    @pytest.mark.parametrize(
        "text", ["", " ", "a", "1-", "1-5x0", "1e3", "1-99999999999", "1..5", "1-3x", "+5", "1-3 5"]
    )
    def test_other_text_is_refused_with_an_example(self, text):
        with pytest.raises(UsageError, match="1001-1100"):
            parse_frames(text)

    @pytest.mark.parametrize("text", ["1.5", "1-2x0.5", "1,2.25"])
    def test_subframes_are_refused_not_rounded(self, text):
        with pytest.raises(UsageError, match="subframe"):
            parse_frames(text)

    @given(FRAMES)
    def test_what_messages_write_can_be_parsed(self, numbers):
        assert parse_frames(ranges(list(numbers))) == sorted(numbers)

    @given(FRAMES)
    def test_a_plain_list_round_trips(self, numbers):
        assert parse_frames(",".join(map(str, numbers))) == sorted(numbers)

    @given(st.text(alphabet="0123456789-,x:.y #a", max_size=12))
    def test_no_text_gives_anything_but_numbers_or_a_sentence(self, text):
        try:
            found = parse_frames(text)
        except UsageError:
            return
        assert found == sorted(set(found)) and all(type(n) is int for n in found)


def test_ranges_of_nothing():
    assert ranges([]) == ""
