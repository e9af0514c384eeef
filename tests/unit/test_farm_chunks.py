"""Chunks: none lost, none twice, and written so that farms and ``--frames`` read the same."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from openjd.model import IntRangeExpr

from exwarp_cli.domain.timeline import parse_frames
from exwarp_cli.farm.farm_job import FarmJob, frames_text, split
from exwarp_cli.farm.openjd import Workers, job_template

NUMBERS = st.lists(st.integers(-300, 300), min_size=1, max_size=40, unique=True).map(sorted)


@pytest.mark.parametrize(
    ("numbers", "size", "chunks"),
    [
        (range(1, 6), 2, ["1-2", "3-4", "5"]),
        (range(1, 6), 9, ["1-5"]),
        (range(10, 42, 4), 3, ["10-18:4", "22-30:4", "34,38"]),
        (range(-8, 9, 4), 5, ["-8-8:4"]),
        (range(-12, -3), 9, ["-12--4"]),
        ((1, 2, 3, 7, 20), 4, ["1-3,7", "20"]),
    ],
)
def test_chunks_and_how_they_are_written(numbers, size, chunks):
    assert [frames_text(chunk) for chunk in split(tuple(numbers), size)] == chunks


@given(NUMBERS, st.integers(1, 12))
def test_every_key_frame_is_in_one_chunk(numbers, size):
    chunks = split(numbers, size)
    assert [n for chunk in chunks for n in chunk] == numbers
    assert all(len(chunk) == size for chunk in chunks[:-1]) and 0 < len(chunks[-1]) <= size


@given(NUMBERS)
def test_farms_and_frames_read_the_same(numbers):
    text = frames_text(numbers)
    assert parse_frames(text) == numbers == list(IntRangeExpr.from_str(text))


@given(NUMBERS)
def test_frames_takes_what_open_job_description_writes(numbers):
    assert parse_frames(str(IntRangeExpr.from_list(numbers))) == numbers


@pytest.mark.parametrize(
    ("numbers", "dense"),
    [((1, 2, 3), True), ((10, 14, 18), False), ((7,), True), ((1, 5, 6), True), ((1, 9), False)],
)
def test_dense_numbers_have_ranges_without_steps(numbers, dense):
    document = job_template(FarmJob((), numbers, 2, "a"), Workers(), None).document
    (frames,) = document["steps"][0]["parameterSpace"]["taskParameterDefinitions"]
    constraint = "CONTIGUOUS" if dense else "NONCONTIGUOUS"
    assert frames["chunks"]["rangeConstraint"] == constraint
