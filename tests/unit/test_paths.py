"""The paper's six paths as methods, with networks whose answers are known."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from exwarp_cli.domain.decision import EXTRAPOLATE, HOLD, NODES, PATHS, WARP
from exwarp_cli.domain.frame import Float32, KeyFrame
from exwarp_cli.domain.network_api import NetworkPictures
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.synthesis.extrapolation import encode
from exwarp_cli.synthesis.history import older_key_frames
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS, Predicted
from exwarp_cli.synthesis.motion_fields import settle_motion
from tests.matrix import spread
from tests.unit.scenes import town

SLOTS = (1, 2, 3)
FIXED = [f"s{i}" for i in range(1, 7)]
W, E, H = WARP, EXTRAPOLATE, HOLD
TABLE = {
    "S1": (H, E, H), "S2": (H, E, W), "S3": (W, E, E),
    "S4": (W, E, W), "S5": (W, W, E), "S6": (W, W, W),
}  # fmt: skip
"""What makes P1, P2 and P3: the table of possible scenarios in the paper's section IV-B."""


@dataclass
class Painter:
    """Paints each slot in a colour of its own, and remembers when it was asked."""

    asked: list[float] = field(default_factory=list)
    checksum: str = "0" * 64

    def __call__(self, inputs: NetworkPictures) -> Float32:
        self.asked.append(inputs.time)
        shape = (3, *inputs.shape)
        colour = encode(np.full(shape, self.colour(inputs.time), np.float32))
        return np.asarray(colour, np.float32)

    @staticmethod
    def colour(time: float) -> float:
        return 10 + time


@functools.cache
def key(index: int) -> KeyFrame:
    """Return a key frame with dots: new frames stay between what lies around each place."""
    frame = town().view(float(index)).key(1001 + index)
    assert frame.gbuffer is not None
    pixels = frame.image.pixels.copy()
    pixels[::2, ::2], pixels[1::2, 1::2] = 9, 12
    image = replace(frame.image, pixels=pixels)
    return replace(frame, image=image, gbuffer=settle_motion(frame.gbuffer))


def interval(older: int = 2) -> Interval:
    """Key frame 1003 with so many key frames before it."""
    keys = [key(index) for index in range(2, 1 - older, -1)]
    return Interval(keys[0], None, (), older_key_frames(keys), Painter())


def shown(name: str, given: Interval) -> list[Predicted]:
    return [METHODS[name].predict(given, slot) for slot in SLOTS]


def painted(slot: int) -> float:
    return Painter.colour(slot / 4)


def test_the_tree():
    assert {name: path.made_by for name, path in PATHS.items()} == TABLE
    assert {node for path in PATHS.values() for node in path.choices} == set(NODES)
    choices = [tuple(path.choices.items()) for path in PATHS.values()]
    assert len(set(choices)) == 6
    for path in PATHS.values():
        assert len(path.choices) == (2 if path.choices["d1"] == EXTRAPOLATE else 3)


def test_which_methods_extrapolate():
    extrapolating = [method.name for method in METHODS.values() if method.extrapolates]
    assert extrapolating == ["causal", *FIXED[:5], "oracle", "oracle-return"]


@pytest.mark.parametrize("name", FIXED)
def test_kinds_makers_and_sources(name):
    found = shown(name, interval())
    made_by = TABLE[name.upper()]
    assert tuple(frame.made_by for frame in found) == made_by
    assert [frame.method for frame in found] == [name] * 3
    kinds = {HOLD: FrameKind.DROPPED, WARP: FrameKind.GENERATED, EXTRAPOLATE: FrameKind.GENERATED}
    assert [frame.kind for frame in found] == [kinds[maker] for maker in made_by]
    # P2 = E stays in what P3 is made of; F alone is behind the others
    network = [maker == E or (i == 2 and made_by[1] == E) for i, maker in enumerate(made_by)]
    expected = [(1001, 1002, 1003) if seen else (1003,) for seen in network]
    assert [frame.sources for frame in found] == expected
    for frame in found:
        assert frame.pixels.shape == key(2).image.pixels.shape
        assert frame.pixels.dtype == np.float32 and np.isfinite(frame.pixels).all()


@pytest.mark.parametrize("name", FIXED)
def test_extrapolated_frames_are_the_network_s_at_their_slot(name):
    for slot, frame in zip(SLOTS, shown(name, interval()), strict=True):
        if TABLE[name.upper()][slot - 1] == E:
            np.testing.assert_allclose(frame.pixels[..., :3], painted(slot), rtol=1e-5)


@pytest.mark.parametrize("name", FIXED)
def test_warped_frames_come_from_what_was_rendered_or_extrapolated_last(name):
    s6 = shown("s6", interval())
    made_by = TABLE[name.upper()]
    for slot, frame in zip(SLOTS, shown(name, interval()), strict=True):
        if made_by[slot - 1] != W:
            continue
        if slot == 3 and made_by[1] == E:
            np.testing.assert_allclose(frame.pixels[..., :3], painted(2), rtol=1e-5)
        else:
            np.testing.assert_array_equal(frame.pixels, s6[slot - 1].pixels)


@pytest.mark.parametrize("name", FIXED)
def test_repeats_show_the_frame_before(name):
    found = shown(name, interval())
    before = [key(2).image.pixels, *(frame.pixels for frame in found)]
    for earlier, frame in zip(before, found, strict=False):
        if frame.kind is FrameKind.DROPPED:
            np.testing.assert_array_equal(frame.pixels, earlier)


@pytest.mark.parametrize(
    ("name", "times"),
    [("s1", [0.5]), ("s2", [0.5]), ("s3", [0.5, 0.75]), ("s4", [0.5]), ("s5", [0.75]), ("s6", [])],
)
def test_the_network_runs_once_for_each_slot_that_it_makes(name, times):
    given = interval()
    shown(name, given)
    shown(name, given)
    assert isinstance(given.extrapolator, Painter)
    assert given.extrapolator.asked == times


@pytest.mark.parametrize("slot", spread(SLOTS, 2))
def test_a_single_slot_is_the_same_as_in_a_row(slot):
    """A run that goes on from an earlier one may begin at any slot."""
    for name in FIXED:
        alone = METHODS[name].predict(interval(), slot)
        np.testing.assert_array_equal(alone.pixels, shown(name, interval())[slot - 1].pixels)


@pytest.mark.parametrize(("older", "sources"), [(0, (1003,)), (1, (1002, 1003))])
def test_with_less_history(older, sources):
    found = METHODS["s3"].predict(interval(older), 2)
    assert found.sources == sources
    np.testing.assert_allclose(found.pixels[..., :3], painted(2), rtol=1e-5)
