"""The policy of tiles between key frames: what a network gains there, and the rule that it pays by.

Where the two key frames disagree, moved to the slot, the look-ahead network gains most. The rule
that computes it there alone is put into the paper's network of 8-bit integers; a learned network is
trained beside it, left out on every scene, and takes the rule's place if it is clearly better.
Written to the output folder: ``look-ahead-policy.npz``, ``look-ahead-policy.json`` with what each
choice gains at equal cost, and the checksum of the first.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.mlp import PAPER_SIZES, QuantisedMlp
from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.tiles import LOOK_AHEAD_FEATURES, LOOK_AHEAD_STATE
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.io.files import atomic_write_text, make_folder
from exwarp_cli.models.picture_network import OnnxLookAhead, load_lookahead
from exwarp_cli.models.policy_files import SHIPPED_LOOK_AHEAD_POLICY, save_network
from exwarp_cli.policy.state import INPUTS, look_ahead_inputs
from exwarp_cli.research.training.outcome_tables import F64, Say
from exwarp_cli.research.training.policy_training import add_checksums, require_two_scenes
from exwarp_cli.research.training.q_learning import quantise
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.research.training.tile_policy_training import (
    EFFORTS,
    TILE_TABLES,
    VARIANTS,
    Margins,
    TableOfTiles,
    choice_margins,
    margins_unseen,
    price_for,
    score_choices,
    train_tiles,
)
from exwarp_cli.research.training.training_settings import TilePolicySettings
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.predicted_error import look_ahead_features

SCHEMA = "exwarp.look-ahead-policy-scores/1"
REPORT = "look-ahead-policy.json"

# Points of the network's gain, at a quarter of the area, by which a learned policy has to be
# better than the rule.
CLEARLY = 5.0
QUARTER = "0.25"

RULE, LEARNED = "both sides and key frames apart", "learned, scene left out"

# Rules that go by a sum of features alone.
SIMPLER = {
    "both sides apart": ("light", "motion"),
    "key residual alone": ("key_light", "key_motion"),
}


@dataclass(frozen=True)
class LookAheadTable(TableOfTiles):
    """All tiles of the slots between a scene's key frames."""

    schema = "exwarp.look-ahead-table/1"
    facts = ("scene", "network")
    folder, option = Path(TILE_TABLES, "look-ahead"), "--interpolator"
    policy = SHIPPED_LOOK_AHEAD_POLICY
    load_network = staticmethod(partial(load_lookahead, threads=1, device="cpu"))
    arrays: ClassVar = {
        "slot": (np.int32, np.int32, ()),
        "features": (np.float32, np.float64, (len(LOOK_AHEAD_FEATURES),)),
        "errors": (np.float32, np.float64, (2,)),
    }

    scene: str
    slot: npt.NDArray[np.int32]  # int32 [N], 1 to 3
    features: F64  # float64 [N, 6]
    # float64 [N, 2]: mean squared error, squared display levels, by `softsplat` and `lookahead`
    errors: F64
    network: str  # checksum of the network whose frames were judged

    @cached_property
    def states(self) -> F64:
        """The network's inputs, float64 [N, 1, 44]."""
        states = np.empty((len(self), 1, INPUTS))
        for slot in range(1, FACTOR):
            of_slot = self.slot == slot
            states[of_slot, 0] = look_ahead_inputs(self.features[of_slot], slot / FACTOR)
        return states

    @cached_property
    def gains(self) -> F64:
        """What the network takes from each tile's squared error, float64 [N, 1, 2]."""
        gain = self.errors[:, 0] - self.errors[:, 1]
        return np.stack([np.zeros(len(self)), gain], axis=-1)[:, None]

    def error(self, margins: Margins, price: float) -> float:
        """Return the mean squared error of slots 1 to 3, squared display levels."""
        return float(np.where(margins[:, 0] > price, self.errors[:, 1], self.errors[:, 0]).mean())

    @classmethod
    def measure(cls, scene: RenderedScene, network: OnnxLookAhead, say: Say) -> Self:
        """Make frames between key frames with and without the network, and measure tiles."""
        scene = scene.as_far_as_rendered()
        parts: list[tuple[npt.NDArray[np.int32], F64, F64]] = []
        clips = SceneClip(scene)
        intervals = ((clip, k) for clip in map(clips.seen_as, VARIANTS) for k in clip.intervals)
        for clip, k in intervals:
            interval = replace(clip.interval(k, "key"), interpolator=network)
            assert interval.following is not None
            frames = interval.key.image.pixels, interval.following.image.pixels
            for slot in range(1, FACTOR):
                truth = encode_display(clip.truth(k, slot).pixels)
                errors = []
                for weighs in (False, True):
                    mixer = interval.look_ahead(slot, weighs)
                    shown = encode_display(mixer.make(*frames))
                    squares = np.square(shown[..., :3] - truth[..., :3]).mean(axis=-1)
                    errors.append(interval.mosaic.means(squares).ravel())
                assert mixer.evidence is not None
                features = look_ahead_features(mixer.evidence, interval.residual)
                features = features.reshape(-1, len(LOOK_AHEAD_FEATURES))
                slots = np.full(len(features), slot, np.int32)
                parts.append((slots, features, np.stack(errors, axis=-1)))
                interval.forget(slot)
            say(f"{scene.name}: {len(parts) // (FACTOR - 1)} key intervals")
            check_stop()
        slots, features, errors_of = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(scene.name, slots, features, errors_of, network.checksum)


def rule_network(states: F64) -> QuantisedMlp:
    """Return the paper's network with a rule in it: its margin is how far key frames are apart.

    It is calibrated on states, float64 [N, 44].
    """
    weights = [np.zeros((out, into)) for into, out in pairwise(PAPER_SIZES)]
    for layer in weights:
        layer[0, 0] = 1.0
    weights[0][0] = np.arange(INPUTS) == LOOK_AHEAD_FEATURES.index("apart")
    weights[-1][:, 0] = 0.0, 1.0
    return quantise(tuple((layer, np.zeros(len(layer))) for layer in weights), states)


def train_look_ahead_policy(
    tables: Sequence[LookAheadTable], output: Path, settings: TilePolicySettings, say: Say
) -> dict[str, Any]:
    """Compare the rule with learning, and write the better; return what the scores file holds."""
    require_two_scenes(len(tables))
    make_folder(output)
    rule = rule_network(np.concatenate([table.states[:, 0] for table in tables]))
    margins: dict[str, list[Margins]] = {
        RULE: [choice_margins(rule, table) for table in tables],
        LEARNED: margins_unseen(tables, settings, say),
    }
    for name, features in SIMPLER.items():
        columns = [LOOK_AHEAD_FEATURES.index(feature) for feature in features]
        margins[name] = [t.features[:, columns].sum(axis=-1, keepdims=True) for t in tables]
    rng = np.random.default_rng(settings.seed)
    margins["coin"] = [rng.random((len(table), 1)) for table in tables]
    margins["the truth"] = [table.gains[..., 1] for table in tables]
    scores = score_choices(tables, margins, "network")
    gains = scores["gain_percent"]
    is_learned = bool(gains[LEARNED][QUARTER] >= gains[RULE][QUARTER] + CLEARLY)
    best, how = rule, "where both key frames are apart"
    if is_learned:
        say(f"on all {len(tables)} scenes")
        best, how = train_tiles(tables, settings), "learned on rendered scenes"
    own = [choice_margins(best, table) for table in tables]
    metadata = {
        "about": f"ExWarp's predictor of tiles between key frames: {how}",
        "state": LOOK_AHEAD_STATE,
        "scenes": [table.scene for table in tables],
        "efforts": [[s, round(price_for(s, own, LookAheadTable.cost))] for s in EFFORTS],
    }
    save_network(output / SHIPPED_LOOK_AHEAD_POLICY, best, metadata)
    report = {"schema": SCHEMA, "settings": asdict(settings), "is_learned": is_learned, **scores}
    atomic_write_text(output / REPORT, json.dumps(report, indent=1) + "\n")
    add_checksums(output, [SHIPPED_LOOK_AHEAD_POLICY])
    return report
