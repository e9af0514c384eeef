"""A network that weighs what both key frames show of a slot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import Float32, KeyFrame
from exwarp_cli.domain.network_api import (
    CANDIDATES,
    LOOKAHEAD_INTERFACE,
    SIDES,
    KeptPart,
    LazyInputs,
    NetworkPictures,
)
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.kernels import blend
from exwarp_cli.models.picture_network import load_lookahead
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import settle_motion
from tests.unit import tiny_lookahead
from tests.unit.scenes import town


@dataclass
class Chooser:
    """Gives one candidate all weight, in tiles of some rows; remembers what it was given."""

    candidate: int = 0
    rows: int = 7
    checksum: str = "0" * 64
    given: list[NetworkPictures] = field(default_factory=list)

    def weigh(self, inputs: LazyInputs) -> Iterator[tuple[KeptPart, Float32]]:
        height, width = inputs.shape
        for first in range(0, height, self.rows):
            end = min(first + self.rows, height)
            rows, columns = slice(first, end), slice(0, width)
            part = inputs.part(rows, columns)
            self.given.append(part)
            weights = np.zeros((CANDIDATES, end - first, width), np.float32)
            weights[self.candidate] = 1
            yield (rows, columns), weights


def key(index: int) -> KeyFrame:
    frame = town().view(float(index)).key(1001 + index)
    assert frame.gbuffer is not None
    return replace(frame, gbuffer=settle_motion(frame.gbuffer))


def interval(network: Chooser | None = None, **more: object) -> Interval:
    return replace(Interval(key(0), key(1), (), (), None, network), **more)


def made(name: str, given: Interval, slot: int = 2) -> Float32:
    predict = METHODS[name].predict
    assert predict is not None
    return predict(given, slot).pixels


def test_the_first_candidate_is_what_softsplat_makes():
    expected = made("softsplat", interval())
    np.testing.assert_array_equal(made("lookahead", interval(Chooser())), expected)


def test_softsplat_asks_no_network():
    network = Chooser(1)
    made("softsplat", interval(network))
    assert not network.given


def test_a_side_is_what_its_key_frame_shows():
    before, after = (made("lookahead", interval(Chooser(1 + side)), 1) for side in (0, 1))
    truth = town().view(0.25).colour
    assert np.abs(before - truth).mean() < np.abs(after - truth).mean()


def test_layers_are_mixed_by_the_weights_of_the_beauty():
    """Light passes that add up to the beauty do so after mixing, whatever was chosen."""
    given = interval(Chooser(2), linear=True)
    mixer = given.look_ahead(2, weighs=True)
    frames = given.key.image.pixels, given.following.image.pixels
    beauty = mixer.make(*frames)
    parts = [mixer.make(*(share * frame for frame in frames)) for share in (0.25, 0.75)]
    np.testing.assert_allclose(parts[0] + parts[1], beauty, atol=2e-5)


def test_what_the_network_is_given():
    network = Chooser(rows=1000)
    made("lookahead", interval(network))
    (given,) = network.given
    assert {n: p.shape[0] for n, p in given.pictures.items()} == dict(LOOKAHEAD_INTERFACE.inputs)
    assert all(np.isfinite(picture).all() for picture in given.pictures.values())
    assert set(np.unique(given.pictures["masks"])) <= {0, 1}
    assert given.pictures["agreement"].min() >= 0 and given.pictures["agreement"].max() <= 1
    assert given.time == 0.5


class TestKernel:
    def test_it_is_the_weighted_mean(self):
        rng = np.random.default_rng(0)
        mixed = rng.random((6, 7, 4), np.float32)
        sides = tuple(rng.random((6, 7, 4), np.float32) for _ in range(SIDES))
        weights = rng.random((CANDIDATES, 6, 7), np.float32)
        weights /= weights.sum(0)
        out = np.empty_like(mixed)
        blend.mix_candidates(mixed, sides, weights, (0, 0), out)
        expected = weights[0, ..., None] * mixed
        for n, side in enumerate(sides):
            expected += weights[1 + n, ..., None] * side
        np.testing.assert_allclose(out, expected, atol=1e-5)

    def test_equal_candidates_stay_as_they_are(self):
        """Also where rounded weights do not add up to 1."""
        flat = np.full((4, 5, 3), 7.3, np.float32)
        weights = np.full((CANDIDATES, 4, 5), 0.19, np.float32)
        out = np.empty_like(flat)
        blend.mix_candidates(flat, (flat,) * SIDES, weights, (0, 0), out)
        np.testing.assert_array_equal(out, flat)


class TestFiles:
    def test_any_tiling_gives_the_same_bytes(self, tmp_path, monkeypatch):
        path = tiny_lookahead.save(tmp_path / "tiny.onnx", tiny_lookahead.nearer_side())
        frames = []
        for pixels in (10**9, 3000):
            monkeypatch.setattr("exwarp_cli.models.picture_network.MAX_PIXELS", pixels)
            network = load_lookahead(path, 1, "cpu")
            frames.append(made("lookahead", interval(network)))
        np.testing.assert_array_equal(*frames)

    def test_weights_must_add_up(self, tmp_path):
        path = tiny_lookahead.save(tmp_path / "tiny.onnx", tiny_lookahead.nearer_side(gain=2.0))
        with pytest.raises(InputError, match="do not add up to 1; use another model"):
            load_lookahead(path, 1, "cpu")

    def test_an_extrapolator_is_refused(self, tmp_path):
        from tests.unit import tiny_models

        path = tiny_models.save(tmp_path / "other.onnx", tiny_models.filled_warp())
        with pytest.raises(LayoutError):
            load_lookahead(path, 1, "cpu")
