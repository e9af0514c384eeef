"""Ids from the pixels of a Cryptomatte: which surface a pixel shows, and never a bit lost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.errors import DamagedFileError
from exwarp_cli.io.cryptomatte import (
    LEAD,
    Cryptomatte,
    DynamicObjects,
    IdKind,
    IdReading,
    hash_name,
    refine_ids_by_depth,
    require_lossless_ids,
    surface_ids,
)
from exwarp_cli.kernels.raw_channels import decode_id
from exwarp_cli.kernels.silhouettes import SAME_DEPTH
from tests.reference import ranked as reference
from tests.unit.interpreted import same_when_interpreted
from tests.unit.ranked_cases import case, everything

A, B, SKY = hash_name("a"), hash_name("b"), 0


def pixels(*ranks: tuple[int, float, int, float]) -> np.ndarray:
    """One row of pixels: id, share, id, share."""
    out = np.zeros((1, len(ranks), 4), np.float32)
    bits = out.view(np.uint32)
    for j, (first, share, second, other) in enumerate(ranks):
        bits[0, j, 0], bits[0, j, 2] = first, second
        out[0, j, 1], out[0, j, 3] = share, other
    return out


class TestSurfaces:
    @pytest.mark.parametrize(
        ("ranks", "expected"),
        [
            ((A, 1, 0, 0), A),
            ((A, 0.6, B, 0.4), A),
            ((A, 0.53, B, 0.47), -1),  # nothing leads
            ((A, 0.3, B, 0.6), B),  # ranks may stand in any order
            ((0, 0, 0, 0), SKY),
            ((A, 0.3, 0, 0), SKY),  # the rest is background
            ((A, 0.6, 0, 0), A),
            ((A, 0.48, 0, 0), -1),  # as much background
            ((A, 0.3, B, 0.3), -1),  # what is left may be a third surface
            ((A, 0.05, B, 0.05), SKY),  # and here cannot be four more
            ((A, 0.35, B, 0.2), -1),
            ((A, 0.75, B, 0.5), A),  # transparent surfaces sum to more than 1
            ((A, 1.0, A, 0.0), A),
            ((A, np.nan, B, 1), B),
            ((A, np.nan, 0, 0), SKY),
            ((0, 1, 0, 0), SKY),  # background that is written as an id
            ((1 << 31, 1, 0, 0), SKY),
            ((0, 0.7, A, 0.3), SKY),
        ],
    )
    def test_what_prevails(self, ranks, expected):
        expected = expected if expected < 0 else reference.identity(expected)
        assert surface_ids(pixels(ranks))[0, 0] == expected

    @pytest.mark.parametrize("rounded", [False, True])
    @pytest.mark.parametrize("seed", range(4))
    def test_as_its_twin(self, seed, rounded):
        ranks = case(seed)
        found = surface_ids(ranks, rounded)
        expected = reference.image(reference.surface, ranks, LEAD, rounded)
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == np.int32 and {-1, 0} < set(found.ravel())

    def test_ids_are_bits(self):
        """Patterns that arithmetic on floats would change: NaN, denormal, infinite, negative."""
        bits = np.array([0x7FC12345, 0x7F812345, 0x00000001, 0x7F800000, 0x80800000], np.uint32)
        ranks = np.zeros((1, len(bits), 4), np.float32)
        ranks.view(np.uint32)[0, :, 0], ranks[0, :, 1] = bits, 1
        np.testing.assert_array_equal(surface_ids(ranks)[0], bits & 0x7FFFFFFF)

    def test_an_id_is_the_same_wherever_it_stands(self):
        here = pixels((A, 1, 0, 0), (B, 1, 0, 0))
        there = pixels((B, 1, 0, 0), (0, 0, 0, 0), (A, 0.9, B, 0.1))
        assert surface_ids(here)[0, 0] == surface_ids(there)[0, 2]
        assert surface_ids(here)[0, 1] == surface_ids(there)[0, 0]

    @given(st.integers(0, 2**32 - 1))
    def test_ids_are_positive_whatever_the_hash(self, bits):
        for rounded in (False, True):
            shown = int(decode_id(np.uint32(bits), rounded))
            assert shown == reference.identity(bits, rounded)
            assert int(decode_id(np.uint32(shown), rounded)) == shown
        assert reference.identity(bits) == bits % 2**31

    def test_a_view_of_any_layout(self):
        ranks = case(9)
        wide = np.zeros((*ranks.shape[:2], 9), np.float32)
        wide[..., 1::2] = ranks
        np.testing.assert_array_equal(surface_ids(wide[..., 1::2]), surface_ids(ranks))

    @pytest.mark.parametrize(
        "wrong",
        [np.zeros((4, 4, 4)), np.zeros((4, 4), np.float32), np.zeros((4, 4, 3), np.float32)],
    )
    def test_other_arrays_are_refused(self, wrong):
        with pytest.raises(ValueError, match="ranks are float32"):
            surface_ids(wrong)


class TestDynamic:
    @pytest.mark.parametrize(
        ("ranks", "expected"),
        [
            ((A, 1, 0, 0), A),
            ((B, 1, 0, 0), 0),
            ((0, 0, 0, 0), 0),
            ((A, 0.7, B, 0.3), A),
            ((B, 0.7, A, 0.3), 0),
            ((A, 0.52, B, 0.48), -1),
            ((B, 0.52, hash_name("c"), 0.48), 0),  # two that stand still
            ((A, 0.1, 0, 0), 0),
            ((B, 1, A, 0), 0),  # an id without a share is none
        ],
    )
    def test_only_what_moves_has_an_id(self, ranks, expected):
        found = surface_ids(pixels(ranks), dynamic=[reference.identity(A)])[0, 0]
        assert found == (reference.identity(expected) if expected > 0 else expected)

    @pytest.mark.parametrize("rounded", [False, True])
    @pytest.mark.parametrize("count", [0, 1, 3, 7])
    def test_as_its_twin(self, count, rounded):
        ranks = case(17)
        ids = sorted({int(i) for i in surface_ids(ranks, rounded).ravel()} - {0, -1})[-count:]
        dynamic = ids if count else []
        found = surface_ids(ranks, rounded, dynamic[::-1])
        expected = reference.image(reference.moving, ranks, set(dynamic), LEAD, rounded)
        np.testing.assert_array_equal(found, expected)
        assert bool(count) == bool(found.any())


class TestByDepth:
    def test_a_filtered_silhouette_goes_to_the_surface_at_its_depth(self):
        depth = np.full((7, 9), 10, np.float32)
        depth[:, 4:] = 4
        ids = np.where(depth > 5, 1, 2).astype(np.int32)
        filtered = ids.copy()
        filtered[:, 3], filtered[2, 4] = -1, 1  # nothing leads, and the wrong one leads
        np.testing.assert_array_equal(refine_ids_by_depth(filtered, depth), ids)

    def test_thin_and_lone_things_stay(self):
        depth = np.full((7, 9), np.inf, np.float32)
        ids = np.zeros((7, 9), np.int32)
        depth[:, 4], ids[:, 4] = 3, 7  # a pole before the sky
        depth[3, 1], ids[3, 1] = 5, 8  # a single pixel, alone at its depth
        depth[5, 7], ids[5, 7] = 6, -1
        np.testing.assert_array_equal(refine_ids_by_depth(ids, depth), ids)

    @pytest.mark.parametrize("seed", range(3))
    def test_as_its_twin(self, seed):
        rng = np.random.default_rng(seed)
        ids = rng.choice(np.array([-1, 0, 3, 5], np.int32), (9, 11))
        depth = rng.choice(np.array([1, 1.03, 1.06, 2, np.inf, np.nan], np.float32), (9, 11))
        expected = reference.by_depth(ids, depth, SAME_DEPTH)
        np.testing.assert_array_equal(refine_ids_by_depth(ids, depth), expected)
        assert (expected != ids).any() and (expected < 0).any()


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_any_case_as_its_twin(seed, rounded):
    ranks = case(seed, 3, 5)
    expected = reference.image(reference.surface, ranks, LEAD, rounded)
    np.testing.assert_array_equal(surface_ids(ranks, rounded), expected)


class TestDamage:
    def hashes(self, count: int = 12) -> np.ndarray:
        """A picture in which every surface has a part."""
        names = [f"object {i}" for i in range(count)]
        ids = np.array([hash_name(name) for name in names], np.uint32)
        ranks = np.zeros((16, 24, 4), np.float32)
        ranks.view(np.uint32)[..., 0] = ids[np.arange(16 * 24).reshape(16, 24) % count]
        ranks[..., 1] = 1
        return ranks

    def test_sound_ids_pass(self):
        require_lossless_ids(self.hashes(), "a.exr")
        require_lossless_ids(np.zeros((4, 4, 4), np.float32), "a.exr")

    def test_ids_that_were_halves(self):
        ranks = self.hashes()
        with np.errstate(over="ignore"):
            ranks = ranks.astype(np.float16).astype(np.float32)
        with pytest.raises(DamagedFileError, match=r"a\.exr has Cryptomatte ids that came through"):
            require_lossless_ids(ranks, "a.exr")

    def test_one_id_that_looks_like_it_is_chance(self):
        ranks = self.hashes(1)
        ranks.view(np.uint32)[..., 0] = 0x3F800000
        require_lossless_ids(ranks, "a.exr")


def test_compiled_and_interpreted_agree(tmp_path):
    # Numpy scalars warn of NaN, where compiled code just computes.
    same_when_interpreted(
        "tests.unit.ranked_cases", tmp_path / "found.npz", everything(), "RuntimeWarning"
    )


class TestReadingFrames:
    """A filtered pixel of neither lead, beside an object of its own depth."""

    MATTE = Cryptomatte("", "crypto", IdKind.OBJECT, ())

    def ranks(self) -> np.ndarray:
        ids = np.full((3, 4), hash_name("box"), np.uint32).view(np.float32)
        shares = np.ones((3, 4), np.float32)
        shares[1, 2], ids[:, 3], shares[:, 3] = 0.5, 0, 0
        none = np.zeros_like(shares)
        return np.stack([ids, shares, none, none], axis=-1)

    @pytest.mark.parametrize("moving", [None, (reference.identity(hash_name("box")),)])
    def test_depth_decides_where_shares_do_not(self, moving):
        dynamic = None if moving is None else DynamicObjects(moving, ("box",))
        reading = IdReading(self.MATTE, dynamic=dynamic)
        depth = np.full((3, 4), 5, np.float32)
        depth[:, 3] = np.inf
        found = [reading.read(self.ranks(), given, "it") for given in (depth, None)]
        which = 1 if moving is None else 0
        assert all(pair[1 - which] is None for pair in found)
        assert [pair[which][1, 2] for pair in found] == [reference.identity(hash_name("box")), -1]
