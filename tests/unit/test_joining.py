"""Runs of chunks, joined into one."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest

from exwarp_cli.domain.results import (
    InterpolatorSummary,
    NetworkSummary,
    PolicySummary,
    RunSummary,
)
from exwarp_cli.domain.timeline import Cut
from exwarp_cli.errors import InputError
from exwarp_cli.report.merge import merge_runs
from tests.unit.sample_runs import path_run

NETWORK = NetworkSummary("/a/e.onnx", "0" * 64, "cpu", demodulated=True)
POLICY = PolicySummary("/a/p.npz", "1" * 64, "ids", ("EMD_Wp",))
INTERPOLATOR = InterpolatorSummary("RIFE", "/a/r.onnx", "2" * 64, "3" * 64, "cpu")


def whole() -> RunSummary:
    """Eight key frames, 1001 to 1008."""
    made = path_run("S4", 8, scored=True)
    return replace(
        made,
        input=replace(made.input, last=1008),
        keys=tuple(range(1001, 1009)),
        cuts=(Cut(1003, "detected"), Cut(1006, "given")),
        extrapolator=NETWORK,
        policy=POLICY,
        wall_seconds=8.0,
    )


def part(of: RunSummary, *keys: int, **more: Any) -> RunSummary:
    """Return what a chunk of some key frames tells: of cuts those at its key frames or after."""
    assert of.cuts is not None
    return replace(
        of,
        frames=tuple(frame for frame in of.frames if frame.key in keys),
        keys=keys,
        cuts=tuple(cut for cut in of.cuts if {cut.number, cut.number - 1} & set(keys)),
        wall_seconds=float(len(keys)),
        **more,
    )


def merged(parts: Sequence[RunSummary], names: Sequence[str] = ()) -> RunSummary:
    return merge_runs(dict(zip(names or map(str, range(len(parts))), parts, strict=True)))


PARTS = ((1001, 1002), (1003,), (1004, 1006, 1008), (1005, 1007))


@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[::5])
def test_parts_make_the_whole_in_any_order(order: Sequence[int]) -> None:
    one = whole()
    assert merged([part(one, *PARTS[i]) for i in order]) == one


def test_joined_runs_are_joined_again() -> None:
    one = whole()
    first, *rest = (part(one, *keys) for keys in PARTS)
    assert merged([merged(rest), first]) == one
    assert merged([one]) == one


def test_parts_without_frames_count_as_done() -> None:
    """Of 24 fps brought to 60 without a tail, the last key frame may fall on no instant."""
    one = whole()
    kept = part(one, *range(1001, 1008))
    bare = replace(part(one, 1008), frames=())
    found = merged([bare, kept])
    assert found.frames == kept.frames and list(found.selected) == list(found.input.numbers)


def test_key_frames_of_the_sequence_go_by_its_steps() -> None:
    one = part(whole(), 1001, 1005)
    assert list(one.input.numbers) == list(range(1001, 1009)) and one.selected == (1001, 1005)
    stepped = replace(one, input=replace(one.input, first=1001, last=1009, step=4))
    assert list(stepped.input.numbers) == [1001, 1005, 1009]
    assert replace(stepped, keys=()).selected == (1001, 1005), "known from the frames"


def test_a_frame_twice_is_refused_by_the_names_of_both() -> None:
    one = whole()
    parts = [part(one, 1001, 1002), part(one, 1003), part(one, 1002, 1004)]
    with pytest.raises(InputError) as error:
        merged(parts, ["r/a", "r/b", "r/c"])
    assert "frame 1005 is in r/a and again in r/c" in str(error.value)


OTHERS: dict[str, dict[str, Any]] = {
    "version": {"version": "0.0.1"},
    "method": {"method": "s6"},
    "setting": {"setting": "slot"},
    "rate": {"base_fps": 25.0},
    "factor": {"factor": Fraction(5, 2)},
    "extrapolates": {"extrapolator": replace(NETWORK, sha256="9" * 64)},
    "network that extrapolates": {"extrapolator": replace(NETWORK, device="cuda")},
    "interpolates": {"interpolator": INTERPOLATOR},
    "policy": {"policy": None},
    "policy ": {"policy": replace(POLICY, missing=())},
    "cuts": {"cuts": None},
    "views": {"views": ("left", "right")},
    "layers": {"layers": ("Depth",)},
}
INPUTS: dict[str, dict[str, Any]] = {
    "input is shot.####.exr in the one and other": {"pattern": "/in/other.####.exr"},
    "range of its key frames": {"last": 1009},
    "size": {"width": 128},
    "program": {"producer": "Arnold"},
    "source of motion": {"motion_source": "given"},
    "reading": {"motion_evidence": "measured on two pairs"},
    "what moves": {"dynamic": ("car",)},
}


@pytest.mark.parametrize("name", [*OTHERS, *INPUTS])
def test_parts_of_different_runs_are_refused(name: str) -> None:
    one = whole()
    other = part(one, 1002)
    if name in OTHERS:
        other = replace(other, **OTHERS[name])
    else:
        other = replace(other, input=replace(other.input, **INPUTS[name]))
    with pytest.raises(InputError, match=name.strip()) as error:
        merged([other, part(one, 1001)], ["second", "first"])
    assert str(error.value).startswith("first and second are no parts of one run: the ")


def test_long_values_are_cut_in_messages() -> None:
    one = whole()
    other = replace(part(one, 1002), layers=tuple(f"layer {i}" for i in range(100)))
    with pytest.raises(InputError) as error:
        merged([part(one, 1001), other])
    assert len(str(error.value)) < 400


def test_where_machines_differ_the_first_part_tells() -> None:
    """Folders, and the last digits of what is measured."""
    one = whole()
    evidence = "read so: error 0.340, 0.896 for the next"
    first = part(one, 1001)
    first = replace(first, input=replace(first.input, motion_evidence=evidence))
    elsewhere = replace(
        part(one, 1002),
        extrapolator=replace(NETWORK, file="C:\\e.onnx"),
        policy=replace(POLICY, file="C:\\p.npz"),
        input=replace(
            first.input,
            pattern="Z:\\in\\shot.####.exr",
            motion_evidence=evidence.replace("340", "341"),
        ),
    )
    found = merged([elsewhere, first])
    assert (found.input, found.extrapolator, found.policy) == (first.input, NETWORK, POLICY)


def test_a_cut_that_is_given_anywhere_is_given() -> None:
    one = whole()
    found = merged(
        [
            replace(part(one, 1002), cuts=(Cut(1003, "given"),)),
            replace(part(one, 1003), cuts=(Cut(1003, "detected"),)),
        ]
    )
    assert found.cuts == (Cut(1003, "given"),)
