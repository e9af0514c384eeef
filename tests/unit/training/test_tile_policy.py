"""What a policy of tiles sees, how it decides at a price, and how it is trained and judged."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.accelerator.mlp import PAPER_SIZES, infer_reference, to_fixed
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import NODES
from exwarp_cli.domain.tiles import TILE_FEATURES, TILE_STATE
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.models.policy_files import SHIPPED_TILE_POLICY, PolicyFile, load_policy
from exwarp_cli.policy.state import (
    INPUTS,
    STATE_SIZE,
    apply_price,
    plan_tiles,
    scale_tile_features,
    tile_inputs,
)
from exwarp_cli.research.training.tile_policy_training import (
    REPORT,
    TileTable,
    choice_margins,
    gain_percent,
    price_for,
    train_tile_policy,
    train_tiles,
)
from exwarp_cli.research.training.training_settings import TilePolicySettings
from tests.unit.test_paths import SLOTS, interval

SETTINGS = TilePolicySettings(steps=150, batch=32, lag=20, seed=3)
SCENES = ("hall", "lab", "town")


def table(scene: str, count: int = 600, seed: int = 0) -> TileTable:
    """Tiles that E makes better where there are holes, and worse elsewhere."""
    rng = np.random.default_rng((seed, len(scene)))
    features = np.zeros((count, 3, len(TILE_FEATURES)))
    holes = rng.random(count) < 0.3
    features[:, :, 0] = np.where(holes, 0.4, 0.0)[:, None]
    features[:, :, 2:] = rng.random((count, 1, 4)) * 9
    errors = np.tile([100.0, 110.0, 150.0, 160.0, 170.0], (count, 1))
    errors[holes, 1::2] -= 50 + 20 * rng.random((holes.sum(), 1))[:, [0, 0]]  # E of slots 2 and 3
    return TileTable(scene, 427, np.zeros(count, np.int32), features, errors, "n" * 64)


@pytest.fixture(scope="module")
def tables() -> list[TileTable]:
    return [table(scene, seed=seed) for seed, scene in enumerate(SCENES)]


@pytest.fixture(scope="module")
def trained(tables, tmp_path_factory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("tile-policy")
    return folder, train_tile_policy(tables, folder, SETTINGS, lambda line: None)


@pytest.fixture(scope="module")
def shipped() -> PolicyFile:
    """The policy that comes with ExWarp."""
    return load_policy(None, SHIPPED_TILE_POLICY)


class TestState:
    def test_the_newest_state_comes_first_and_tells_the_way(self):
        slots = [np.full((2, 6), slot / 10) for slot in SLOTS]
        found = tile_inputs(slots, "d4").reshape(2, -1, STATE_SIZE)
        assert found.shape == (2, 4, STATE_SIZE) and found[0].size == INPUTS
        np.testing.assert_array_equal(found[0, :, 0], [0.3, 0.2, 0.1, 0.1])
        marked = [NODES[int(np.argmax(state[6:]))] for state in found[0]]
        assert marked == ["d4", "d2", "d1", "d1"]

    def test_features_are_scaled_by_hand(self):
        found = scale_tile_features(
            np.array([0.01, 1.0, 1e-7 * 16 * 100**2, 9e9, 0.0, 4000.0]), 100
        )
        expected = [np.log(2) / np.log(101), 1, np.log(2) / np.log(1e5 + 1), 1, 0, 1]
        np.testing.assert_allclose(found, expected)

    def test_paths_follow_from_nodes(self):
        chosen = {"d2": (1, 1, 0, 0), "d4": (1, 0, 1, 0), "d5": (1, 1, 1, 0)}

        class Scripted:
            def decide_many(self, states):
                node = NODES[int(np.argmax(states[0, 6:STATE_SIZE]))]
                return None, np.array(chosen[node])

        plan = plan_tiles(Scripted(), [np.zeros((1, 4, 6))] * 3, 64)
        assert plan.paths == ("S3", "S4", "S5", "S6")


class TestPolicy:
    def test_it_is_the_paper_s_network(self, shipped):
        assert shipped.network.sizes == PAPER_SIZES and shipped.of_tiles
        assert shipped.metadata["state"] == TILE_STATE
        shares, prices = (list(each) for each in zip(*shipped.metadata["efforts"], strict=True))
        assert shares == sorted(shares) and prices == sorted(prices, reverse=True)

    def test_no_constant_decides_so(self, shipped):
        """Tiles with holes and motion are extrapolated, still ones are warped."""
        features = np.zeros((1, 2, 6))
        features[0, 1] = [0.3, 0.1, 40.0, 20.0, 200.0, 400.0]
        plan = plan_tiles(
            MlpKernel(apply_price(shipped.network, shipped.price(0.5))), [features] * 3, 427
        )
        assert plan.paths == ("S6", "S3")

    def test_a_price_is_added_to_the_output_for_warping(self, shipped):
        states = to_fixed(np.random.default_rng(1).random((50, INPUTS)))
        plain, dear = (
            infer_reference(network, states).accumulators[-1]
            for network in (shipped.network, apply_price(shipped.network, 1234))
        )
        np.testing.assert_array_equal(dear - plain, np.tile([1234, 0], (50, 1)))

    def test_prices_lie_between_those_that_are_kept(self, shipped):
        stating = replace(shipped, metadata={"efforts": [[0.2, 90], [0.4, 10]]})
        assert stating.price(0.3) == 50 and stating.price(0.9) == 10
        assert replace(shipped, metadata={}).price(0.5) == 0

    def test_a_high_price_warps_everything(self, shipped):
        plan = plan_tiles(
            MlpKernel(apply_price(shipped.network, 2**29)), [np.ones((8, 3, 6))] * 3, 64
        )
        assert set(plan.paths) == {"S6"} and (plan.rows, plan.columns) == (8, 3)


class TestFeatures:
    def test_they_are_of_each_tile(self):
        from exwarp_cli.synthesis.interval import tile_features

        given = interval()
        for slot in SLOTS:
            found = tile_features(given, slot)
            hole = given.mosaic.means(given.back(slot).hole.astype(float))
            assert found.shape == (8, given.tiles.columns, 6)
            assert np.isfinite(found).all() and (found >= 0).all()
            assert found[..., 0][hole == 0].max() == 0 and found[..., 0].max() > 0
        np.testing.assert_array_equal(found[..., 4], given.residual.light)

    def test_after_the_first_key_frame_nothing_tells_of_residuals(self):
        from exwarp_cli.synthesis.interval import tile_features

        assert not tile_features(interval(0), 2)[..., 4:].any()


class TestTraining:
    def test_gains_are_against_warping(self):
        errors = np.array([[100.0, 90, 150, 170, 165]])
        found = replace(table("hall", 1), errors=errors)
        assert found.gains.tolist() == [[[0, 10], [-15, -20], [0, -20]]]

    def test_it_learns_where_extrapolation_pays(self, tables):
        network = train_tiles(tables[:2], SETTINGS)
        margins = choice_margins(network, tables[2])
        holes = tables[2].features[:, 0, 0] > 0
        assert margins[holes, 0].min() > margins[~holes, 0].max()
        again = train_tiles(tables[:2], SETTINGS)
        np.testing.assert_array_equal(choice_margins(again, tables[2]), margins)

    def test_it_extrapolates_where_only_the_slot_after_gains(self, tables):
        """What E makes of slot 2 is worse there, and slot 3 is best warped from it."""
        holes = tables[0].features[:, 0, 0] > 0
        errors = np.tile([100.0, 130.0, 150.0, 180.0, 180.0], (len(holes), 1))
        errors[holes] = [100.0, 110.0, 150.0, 160.0, 20.0]
        delayed = replace(tables[0], errors=errors)
        margins = choice_margins(train_tiles([delayed], replace(SETTINGS, steps=300)), delayed)
        assert margins[holes, 0].min() > 0 > margins[~holes, 0].max()
        assert (margins[holes, 1] < 0).all()

    def test_cost_and_error_by_hand(self, tables):
        one = tables[0]
        holes = one.features[:, 0, 0] > 0
        everywhere = np.ones((len(one), 3))
        assert one.cost(everywhere, 0) == 1
        assert one.error(everywhere, 0) == pytest.approx(one.errors[:, [1, 3]].mean())
        fixed = one.error(everywhere, np.inf), one.error(everywhere, -np.inf)
        assert fixed == pytest.approx((125, one.error(everywhere, 0)))
        rightly = np.stack([holes] * 3, axis=1).astype(float)
        assert one.cost(rightly, 0.5) == pytest.approx(holes.mean())
        assert 125 - 60 * holes.mean() < one.error(rightly, 0.5) < 125 - 40 * holes.mean()

    def test_each_path_costs_and_shows_what_it_makes(self, tables):
        """Of S3 to S6 in turn: which of slots 2 and 3 are extrapolated, and their errors."""
        errors = np.array([[100.0, 110.0, 150.0, 160.0, 170.0]])
        one = replace(tables[0], errors=errors)
        paths = {
            (1, 1, 0): (1, 135),
            (1, 0, 1): (0.5, 140),
            (0, 1, 1): (0.5, 130),
            (0, 1, 0): (0, 125),
        }
        for nodes, (share, error) in paths.items():
            margins = np.array([nodes], float)
            assert (one.cost(margins, 0.5), one.error(margins, 0.5)) == (share, error)

    def test_a_price_gives_a_share(self, tables):
        margins = [np.random.default_rng(seed).random((500, 3)) for seed in range(3)]
        for share in (0.1, 0.5, 0.9):
            price = price_for(share, margins, TileTable.cost)
            found = np.mean([TileTable.cost(margin, price) for margin in margins])
            assert found == pytest.approx(share, abs=2e-3)

    def test_what_is_written(self, trained, tables):
        folder, report = trained
        kept = json.loads((folder / REPORT).read_text())
        assert kept == json.loads(json.dumps(report))
        policy = load_policy(folder / SHIPPED_TILE_POLICY)
        assert policy.of_tiles and policy.metadata["scenes"] == list(SCENES)
        sums = json.loads((folder / "checksums.json").read_text())
        data = (folder / SHIPPED_TILE_POLICY).read_bytes()
        assert sums == {SHIPPED_TILE_POLICY: hashlib.sha256(data).hexdigest()}

    def test_a_scene_that_it_never_saw_gains_more_than_by_chance(self, trained, tables):
        curves = trained[1]["gain_percent"]
        own, coin, truth = (curves[n]["0.25"] for n in ("policy, scene left out", "coin", "truth"))
        assert own > coin + 20 and truth >= own
        margins = [one.gains[..., 1] for one in tables]
        price = price_for(0.25, margins, TileTable.cost)
        assert gain_percent(tables, margins, price) == pytest.approx(truth, abs=5)

    def test_one_scene_is_too_few(self, tables, tmp_path):
        with pytest.raises(InputError, match="there is only one"):
            train_tile_policy(tables[:1], tmp_path, SETTINGS, print)


class TestTables:
    def test_what_is_saved_is_read(self, tables, tmp_path):
        tables[0].save(tmp_path / "a.npz")
        found = TileTable.load(tmp_path / "a.npz")
        assert (found.scene, found.width, found.network) == ("hall", 427, "n" * 64)
        np.testing.assert_allclose(found.features, tables[0].features, rtol=1e-6)
        np.testing.assert_allclose(found.errors, tables[0].errors, rtol=1e-6)

    def test_damage_is_reported(self, tables, tmp_path):
        (tmp_path / "a.npz").write_bytes(b"nothing")
        with pytest.raises(DamagedFileError, match="make it again with --data"):
            TileTable.load(tmp_path / "a.npz")
        replace(tables[0], errors=tables[0].errors[:3]).save(tmp_path / "b.npz")
        with pytest.raises(DamagedFileError, match="an array is"):
            TileTable.load(tmp_path / "b.npz")
        with pytest.raises(InputError, match="there is no table"):
            TileTable.load(tmp_path / "c.npz")
