"""Compiled functions whose values are kept as values: they do what Python does."""

from __future__ import annotations

import math
import sys
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.codegen import CPUCodeLibrary

from exwarp_cli.compiled import builds

pytestmark = pytest.mark.usefixtures("uncached")


def compiled(function: Any, *given: Any) -> Any:
    return builds.compiled(function)(*given)


class TestLoops:
    def test_they_run_through_the_same_numbers(self):
        def run(first, stop, step, found):
            count = 0
            for number in range(stop):
                found[0, count % 9] += number
            for number in range(first, stop):
                found[1, count % 9] += number * number
                count += 1
            for number in range(first, stop, step):
                found[2, count % 9] += number
                count -= 1
            return count, len(range(first, stop, step))

        ran = builds.compiled(run)
        for first in (-3, 0, 2, 7):
            for stop in (-5, 0, 2, 6):
                for step in (-2, -1, 1, 3):
                    ours, theirs = np.zeros((3, 9), np.int64), np.zeros((3, 9), np.int64)
                    assert ran(first, stop, step, ours) == run(first, stop, step, theirs)
                    assert np.array_equal(ours, theirs)

    def test_steps_of_nothing_are_an_error(self):
        def run(step):
            for number in range(0, 4, step):
                return number
            return -1

        assert compiled(run, 2) == 0
        with pytest.raises(ValueError, match="must not be zero"):
            compiled(run, 0)

    def test_what_is_set_in_a_turn_is_there_in_the_next(self):
        def run(values):
            last = before = np.float64(0)
            for k in range(values.shape[0]):
                row = values[k]
                part = row if k % 2 == 0 else row[1:]
                before, last = last, part[0] + before
            return last, before

        values = np.arange(12.0).reshape(4, 3)
        assert compiled(run, values) == run(values)

    def test_they_go_on_in_pairs(self):
        def run(count, step, found):
            pairs = zip(range(count), range(0, 9, step))  # noqa: B905 - numba has no other
            for k, (number, other) in enumerate(pairs):
                found[k] += 10 * number + other

        ran = builds.compiled(run)
        for count in (0, 3, 7):
            for step in (1, 2):
                ours, theirs = np.zeros(9, np.int64), np.zeros(9, np.int64)
                ran(count, step, ours)
                run(count, step, theirs)
                assert np.array_equal(ours, theirs)

    @pytest.mark.parametrize("kind", [np.uint64, np.int32])
    def test_of_other_kinds_of_numbers(self, kind):
        def run(first, stop):
            turns, last = 0, first
            for number in range(first, stop):
                turns, last = turns + 1, number
            return turns, last

        ran = builds.compiled(run)
        assert ran(kind(3), kind(7)) == (4, 6) and ran(kind(7), kind(3)) == (0, 7)
        highest = int(np.iinfo(kind).max)
        assert ran(kind(highest - 2), kind(highest)) == (2, highest - 1)


class TestSlices:
    def test_they_end_where_the_array_does(self):
        def run(values, first, stop):
            return values[first:stop], values[first:stop:2], values[stop:first:-1]

        ran, values = builds.compiled(run), np.arange(5)
        for first in (None, -9, -3, 0, 2, 5, 9):
            for stop in (None, -9, -2, 0, 3, 5, 9):
                expected = run(values, first, stop)
                for one, other in zip(ran(values, first, stop), expected, strict=True):
                    assert np.array_equal(one, other)

    def test_after_numbers_they_are_those_of_numpy(self):
        def row(values, at, first, stop):
            return values[at, first:stop]

        def part(values, first, stop):
            return values[first:stop], values[:stop], values[first:], values[1, 2, 1:], values[0:2]

        cube = np.arange(60).reshape(3, 4, 5)
        ran, ran_part = builds.compiled(row), builds.compiled(part)
        for first in (-9, -2, 0, 1, 5):
            for stop in (-9, -1, 0, 2, 9):
                ours = [ran(cube, at, first, stop) for at in (-1, 0, 2)]
                theirs = [row(cube, at, first, stop) for at in (-1, 0, 2)]
                ours += ran_part(cube, first, stop)
                theirs += part(cube, first, stop)
                for one, other in zip(ours, theirs, strict=True):
                    assert np.array_equal(one, other) and one.strides == other.strides
                    assert one.size == 0 or np.shares_memory(one, cube)


class TestShapes:
    @pytest.mark.parametrize("name", ["rows", "columns", "part", "nothing"])
    def test_all_of_it_in_a_row(self, name):
        def run(values):
            return values.reshape(-1)

        cube = np.arange(60).reshape(3, 4, 5)
        values = {
            "rows": cube,
            "columns": np.asfortranarray(cube),
            "part": cube[1:],
            "nothing": cube[:, :0],
        }[name]
        if name == "columns":
            with pytest.raises((TypeError, NotImplementedError, numba.TypingError)):
                compiled(run, values)
            return
        found = compiled(run, values)
        assert found.strides == (8,) and np.array_equal(found, values.reshape(-1))
        assert found.size == 0 or np.shares_memory(found, values)

    def test_in_other_shapes(self):
        def run(values):
            return values.reshape(4, -1), values.reshape((5, 12)), values.reshape(60)

        values = np.arange(60).reshape(3, 4, 5)
        for one, other in zip(compiled(run, values), run(values), strict=True):
            assert np.array_equal(one, other) and one.shape == other.shape


class TestDivision:
    @pytest.mark.parametrize("kind", [np.int64, np.int32, np.uint8])
    def test_it_rounds_down_and_by_nothing_there_is_nothing(self, kind):
        def run(number, by):
            return number // by, number % by

        ran, limits = builds.compiled(run), np.iinfo(kind)
        some = {limits.min, limits.min + 1, limits.max, 0, 1, 2, 3, 7, 8}
        some |= {-1, -3, -8} if limits.min < 0 else set()
        for number in some:
            for by in some:
                fits = by != 0 and (number, by) != (-(2**63), -1)
                expected = (number // by, number % by) if fits else (0, 0)
                assert ran(kind(number), kind(by)) == expected, (number, by)

    def test_by_what_is_known(self):
        def run(number):
            return number // 8, number % 8, number // 6, number % 6, number // -3, number % -3

        ran = builds.compiled(run)
        for number in (-(2**63), -17, -16, -6, -1, 0, 5, 6, 8, 2**63 - 1):
            assert ran(number) == run(number)
            assert ran(np.int32(number % 1000 - 500)) == run(number % 1000 - 500)


class TestNumbers:
    @pytest.mark.parametrize(
        "pair",
        [
            (1.5, math.nan),
            (math.nan, 1.5),
            (0.0, -0.0),
            (-0.0, 0.0),
            (2, 3.5),
            (np.float32(2.25), 2),
            (np.int32(-4), 7),
            (-1, np.uint32(3)),
        ],
        ids=str,
    )
    def test_the_larger_and_the_smaller(self, pair):
        def run(a, b):
            return max(a, b), min(a, b), max(a, b, 1), min(0, a, b)

        for ours, theirs in zip(compiled(run, *pair), run(*pair), strict=True):
            assert np.array_equal(ours, theirs, equal_nan=True)
            assert math.copysign(1, ours) == math.copysign(1, theirs)

    @pytest.mark.parametrize("value", [2.75, -2.75, np.float32(7.5), np.uint8(200), -3], ids=str)
    def test_without_their_fractions(self, value):
        def run(value):
            return int(value)

        assert compiled(run, value) == int(value)


class TestArrays:
    def test_new_ones_are_given_back(self):
        def run(count):
            row, plane = np.empty(count, np.float32), np.empty((count, 2), np.int16)
            row[:] = 3
            plane[:, 0] = 1
            plane[:, 1] = 2
            kept = row
            for _ in range(3):
                kept = np.empty(count, np.float32)
                kept[:] = row
            return kept, plane

        kept, plane = compiled(run, 4)
        assert kept.dtype == np.float32 and kept.tolist() == [3] * 4
        assert plane.dtype == np.int16 and plane.tolist() == [[1, 2]] * 4

    def test_they_are_given_back_once_wherever_they_end(self):
        def run(out):
            other = np.full(4, 7.0)
            for k in range(out.size):
                row = np.full(4, 1.0 * k)
                if k % 2 == 0:  # it ends here, and after both branches
                    other = np.full(4, 7.0)  # where that was
                else:
                    for j in range(row.size):
                        out[k] += row[j]
                last = np.full(4, 9.0)
                out[k] += 100 * other[0] + last[0]

        out, expected = np.zeros(6), np.zeros(6)
        compiled(run, out)
        run(expected)
        assert out.tolist() == expected.tolist()

    def test_those_that_are_lent_are_counted_as_before(self):
        def take(values, out):
            out[0] = values[0]

        def pick(values, which):
            return (values, values[1:])[which]

        values, out = np.arange(3.0), np.zeros(1)
        before = sys.getrefcount(values)
        compiled(take, values, out)
        assert sys.getrefcount(values) == before
        picked = compiled(pick, (values, values)[0], 1)
        assert np.shares_memory(picked, values) and picked.tolist() == [1, 2]
        del picked
        assert sys.getrefcount(values) == before


@builds.part
def checked(value: float) -> float:
    """Fail below nothing."""
    if value < 0:
        raise ValueError("below")
    return math.sqrt(value)


@builds.part
def unfailing(value: float) -> float:
    return value * value


class TestCalls:
    def test_errors_of_parts_come_out(self):
        def run(values, out):
            for k in range(values.size):
                out[k] = checked(unfailing(values[k]) - 1)

        out = np.zeros(2)
        compiled(run, np.array([1.0, 3.0]), out)
        assert out.tolist() == [0, math.sqrt(8)]
        with pytest.raises(ValueError, match="below"):
            compiled(run, np.array([1.0, 0.5]), out)

    def test_errors_of_parts_are_caught(self):
        def run(values, out):
            for k in range(values.size):
                try:
                    out[k] = checked(values[k])
                except Exception:
                    out[k] = -1

        out = np.zeros(3)
        compiled(run, np.array([4.0, -1.0, 9.0]), out)
        assert out.tolist() == [2, -1, 3]

    def test_only_those_that_may_fail_are_asked(self, monkeypatch):
        texts: dict[str, str] = {}
        add = CPUCodeLibrary.add_ir_module

        def adding(self, module):
            texts[self.name] = texts.get(self.name, "") + str(module)
            add(self, module)

        monkeypatch.setattr(CPUCodeLibrary, "add_ir_module", adding)

        def sure(value, out):
            out[0] = unfailing(value)

        def unsure(value, out):
            out[0] = checked(value)

        for run in (sure, unsure):
            compiled(run, 2.0, np.zeros(1))
        handed_on = {name.rpartition(".")[2]: "ret i32 %" in text for name, text in texts.items()}
        assert not handed_on["sure"] and handed_on["unsure"]
