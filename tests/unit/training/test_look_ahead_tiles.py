"""Between key frames: what a policy sees of each tile, and the network run in chosen ones alone."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.accelerator.mlp import PAPER_SIZES, infer_reference, to_fixed
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import LOOKAHEAD, NODES, SOFTSPLAT
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.network_api import KeptPart, LazyInputs
from exwarp_cli.domain.tiles import LOOK_AHEAD_FEATURES, LOOK_AHEAD_STATE, TileMakers
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.models.policy_files import SHIPPED_LOOK_AHEAD_POLICY, PolicyFile, load_policy
from exwarp_cli.policy.state import (
    STATE_SIZE,
    apply_price,
    choose_tiles,
    look_ahead_inputs,
)
from exwarp_cli.research.training.look_ahead_policy import (
    REPORT,
    LookAheadTable,
    rule_network,
    train_look_ahead_policy,
)
from exwarp_cli.research.training.tile_policy_training import (
    choice_margins,
    find_tile_tables,
    price_for,
)
from exwarp_cli.research.training.training_settings import TilePolicySettings
from exwarp_cli.synthesis.methods import METHODS, Predicted
from exwarp_cli.synthesis.predicted_error import (
    NEGLIGIBLE,
    KeyResidual,
    TileEvidence,
    look_ahead_features,
)
from tests.unit.test_lookahead import Chooser, interval, made

SETTINGS = TilePolicySettings(steps=150, batch=32, lag=20, seed=3)
SCENES = ("hall", "lab")
APART = LOOK_AHEAD_FEATURES.index("apart")
SAY = str


class Counting(Chooser):
    """Counts the pixels that it is asked to weigh."""

    pixels = 0

    def weigh(self, inputs: LazyInputs) -> Iterator[tuple[KeptPart, Float32]]:
        self.pixels += int(np.prod(inputs.shape))
        return super().weigh(inputs)


def only(*tiles: tuple[int, int]) -> Callable[[np.ndarray, float], Bool]:
    """Return what chooses these tiles, whatever is measured."""

    def choose(features: np.ndarray, time: float) -> Bool:
        chosen = np.zeros(features.shape[:2], np.bool_)
        for tile in tiles:
            chosen[tile] = True
        return chosen

    return choose


def everywhere(features: np.ndarray, time: float) -> Bool:
    return np.ones(features.shape[:2], np.bool_)


def predicted(network: Chooser, choose: Callable[[np.ndarray, float], Bool]) -> Predicted:
    predict = METHODS["exwarp"].predict
    assert predict is not None
    return predict(interval(network, chooser=choose), 2)


class TestFrames:
    def test_all_tiles_are_the_whole_frame_and_none_is_softsplat(self):
        whole, nothing = predicted(Chooser(2), everywhere), predicted(Chooser(2), only())
        np.testing.assert_array_equal(whole.pixels, made("lookahead", interval(Chooser(2))))
        np.testing.assert_array_equal(nothing.pixels, made("softsplat", interval()))
        assert (whole.made_by, nothing.made_by) == (LOOKAHEAD, SOFTSPLAT)
        assert whole.tiles is not None and whole.tiles.share(LOOKAHEAD) == 1
        assert nothing.tiles is not None and set(nothing.tiles.letters) == {"s"}

    def test_a_chosen_tile_is_the_network_s_and_no_seam_shows_beside_it(self):
        shown = predicted(Chooser(2), only((3, 4)))
        whole, plain = made("lookahead", interval(Chooser(2))), made("softsplat", interval())
        mosaic = interval().mosaic
        weight = mosaic.weight(only((3, 4))(np.zeros((8, len(mosaic.across), 6)), 0.5))
        np.testing.assert_array_equal(shown.pixels[weight == 1], whole[weight == 1])
        np.testing.assert_array_equal(shown.pixels[weight == 0], plain[weight == 0])
        ramp = (weight > 0) & (weight < 1)
        low, high = np.minimum(plain, whole)[ramp], np.maximum(plain, whole)[ramp]
        assert (shown.pixels[ramp] >= low - 1e-3).all()
        assert (shown.pixels[ramp] <= high + 1e-3).all()
        assert shown.tiles is not None
        assert np.argwhere(shown.tiles.made_by(LOOKAHEAD)).tolist() == [[3, 4]]

    def test_the_network_runs_in_chosen_tiles_alone(self):
        network = Counting(2)
        predicted(network, only((3, 4)))
        assert 0 < network.pixels < 0.3 * np.prod(interval().key.image.pixels.shape[:2])
        assert max(p.pictures["colour"].shape[2] for p in network.given) < 60

    def test_layers_add_up_to_the_beauty(self):
        given = interval(Chooser(2), linear=True, chooser=only((3, 4), (5, 1)))
        mixer = given.look_ahead(2, weighs=True)
        assert given.following is not None
        frames = given.key.image.pixels, given.following.image.pixels
        beauty = mixer.make(*frames)
        parts = [mixer.make(*(share * frame for frame in frames)) for share in (0.25, 0.75)]
        np.testing.assert_allclose(parts[0] + parts[1], beauty, atol=2e-5)

    def test_what_is_chosen_by_is_of_the_slot(self):
        seen = []

        def choose(features: np.ndarray, time: float) -> Bool:
            seen.append((features, time))
            return everywhere(features, time)

        predicted(Chooser(), choose)
        ((features, time),) = seen
        tiles = interval().tiles
        assert features.shape == (8, tiles.columns, 6) and time == 0.5
        assert (features >= 0).all() and features[..., APART].max() > 0

    def test_letters_are_read_again(self):
        found = TileMakers.chosen(np.array([[True, False, False]]))
        assert found.text == "3x1:lss" and TileMakers.parsed(found.text) == found
        assert found.share(LOOKAHEAD) == pytest.approx(1 / 3)


class TestState:
    def test_features_are_what_disagrees(self):
        two = np.array([[1.0, 0.0]])
        evidence, residual = TileEvidence(5 * two, 2 * two, 0.25 * two), KeyResidual(6 * two, two)
        first, second = look_ahead_features(evidence, residual)[0]
        assert first.tolist() == [0.25, 5, 2, 6, 1, 10.5 / (10.5 / 2 + NEGLIGIBLE)]
        assert not second.any()
        alone = look_ahead_features(evidence, KeyResidual(0 * two, 0 * two))[0, 0]
        assert alone.tolist() == [0.25, 5, 2, 0, 0, 7 / (7 / 2 + NEGLIGIBLE)]

    @pytest.mark.parametrize(
        ("time", "node"), [(0.1, "d1"), (0.5, "d2"), (0.75, "d3"), (0.9, "d3")]
    )
    def test_there_is_one_state_and_its_node_goes_by_the_time(self, time, node):
        found = look_ahead_inputs(np.ones((2, 6)), time).reshape(2, -1, STATE_SIZE)
        assert (found == found[:, :1]).all()
        assert found[0, 0, 6:].tolist() == [name == node for name in NODES]
        np.testing.assert_allclose(found[0, 0, :2], [1, np.log(2) / np.log(4001)])


@pytest.fixture(scope="module")
def shipped() -> PolicyFile:
    """The policy that comes with ExWarp."""
    return load_policy(None, SHIPPED_LOOK_AHEAD_POLICY)


class TestPolicy:
    def test_it_is_the_paper_s_network_in_integers(self, shipped):
        assert shipped.network.sizes == PAPER_SIZES
        assert shipped.metadata["state"] == LOOK_AHEAD_STATE and not shipped.of_tiles
        features = np.random.default_rng(0).random((8, 3, 6)) * [1, 300, 300, 300, 300, 4]
        states = to_fixed(look_ahead_inputs(features.reshape(-1, 6), 0.5))
        price = shipped.price(0.4)
        priced = apply_price(shipped.network, price)
        outputs = infer_reference(priced, states).accumulators[-1]
        chosen = choose_tiles(MlpKernel(priced), features, 0.5)
        assert chosen.ravel().tolist() == (outputs[:, 1] > outputs[:, 0]).tolist()

    def test_no_constant_decides_so(self, shipped):
        """Where the key frames disagree the network weighs them, and elsewhere it does not."""
        features = np.zeros((1, 2, 6))
        features[0, 1] = [0, 100, 100, 200, 200, 9]
        for effort in (0.1, 0.9):
            policy = MlpKernel(apply_price(shipped.network, shipped.price(effort)))
            assert choose_tiles(policy, features, 0.5).tolist() == [[False, True]]

    def test_more_effort_takes_more_tiles(self, shipped):
        features = np.exp(np.random.default_rng(1).normal(0, 1.5, (8, 14, 6)))
        priced = [apply_price(shipped.network, shipped.price(e)) for e in (0.1, 0.3, 0.5, 0.9)]
        counts = [choose_tiles(MlpKernel(network), features, 0.5) for network in priced]
        for fewer, more in itertools.pairwise(counts):
            assert (more | ~fewer).all() and more.sum() > fewer.sum()


def table(scene: str, seed: int, tells: int, count: int = 600) -> LookAheadTable:
    """Tiles in which the network gains by one feature alone, if it is large."""
    rng = np.random.default_rng(seed)
    features = np.exp(rng.normal(2, 1.5, (count, 6)))
    features[:, 0], features[:, APART] = rng.random(count), features[:, APART] / 10
    large = features[:, tells] > np.median(features[:, tells])
    gains = np.where(large, 20.0, -5.0)
    errors = np.stack([np.full(count, 100.0), 100 - gains], axis=-1)
    slots = rng.integers(1, 4, count).astype(np.int32)
    return LookAheadTable(scene, slots, features, errors, "n" * 64)


class TestTraining:
    def test_the_rule_goes_by_how_far_key_frames_are_apart(self):
        one = table("hall", 0, APART)
        margins = choice_margins(rule_network(one.states[:, 0]), one)[:, 0]
        order = np.argsort(one.features[:, APART])
        assert (np.diff(margins[order]) >= 0).all() and margins.max() > margins.min()

    def test_a_price_takes_no_more_than_its_share(self):
        margins = [np.random.default_rng(seed).random(500) for seed in range(3)]
        for share in (0.1, 0.5, 0.9):
            price = price_for(share, margins, LookAheadTable.cost)
            found = np.mean([(margin > price).mean() for margin in margins])
            assert share - 2e-3 < found <= share

    @pytest.mark.parametrize("tells", [APART, 1])
    def test_what_is_learned_has_to_be_better_than_the_rule(self, tells, tmp_path):
        tables = [table(scene, seed, tells) for seed, scene in enumerate(SCENES)]
        report = train_look_ahead_policy(tables, tmp_path, SETTINGS, SAY)
        assert report["is_learned"] == (tells != APART)
        assert json.loads((tmp_path / REPORT).read_text()) == report
        policy = load_policy(tmp_path / SHIPPED_LOOK_AHEAD_POLICY)
        sums = json.loads((tmp_path / "checksums.json").read_text())
        data = (tmp_path / SHIPPED_LOOK_AHEAD_POLICY).read_bytes()
        assert sums == {SHIPPED_LOOK_AHEAD_POLICY: hashlib.sha256(data).hexdigest()}
        priced = apply_price(policy.network, policy.price(0.25))
        margins = choice_margins(priced, tables[0])[:, 0]
        gains = tables[0].gains[:, 0, 1]
        pays = gains > 0
        assert gains[margins > 0].mean() > gains.mean() + 5
        assert pays[margins > 0].mean() > 0.9

    def test_one_scene_is_too_few(self, tmp_path):
        with pytest.raises(InputError, match="there is only one"):
            train_look_ahead_policy([table("hall", 0, 1)], tmp_path, SETTINGS, SAY)

    def test_a_network_is_for_measuring(self, tmp_path):
        with pytest.raises(UsageError, match="--interpolator is for measuring scenes"):
            find_tile_tables(LookAheadTable, None, Path("own.onnx"), None, tmp_path, SAY)

    def test_the_tables_that_come_with_exwarp_give_its_policy(self, tmp_path, shipped):
        tables = find_tile_tables(LookAheadTable, None, None, None, tmp_path, SAY)
        assert [one.scene for one in tables] == shipped.metadata["scenes"]
        rule = rule_network(np.concatenate([one.states[:, 0] for one in tables]))
        for made_again, kept in zip(rule.layers, shipped.network.layers, strict=True):
            np.testing.assert_array_equal(made_again.weights, kept.weights)
        assert all((one.errors[:, 0] > 0).all() for one in tables)
        again = replace(tables[0])
        again.save(tmp_path / "again.npz")
        np.testing.assert_array_equal(
            LookAheadTable.load(tmp_path / "again.npz").errors, tables[0].errors
        )
