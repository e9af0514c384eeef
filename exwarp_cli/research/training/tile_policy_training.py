"""Training the policy of tiles: deep Q-learning on what each choice gains in every tile.

Tables of tiles, one file a scene, say what a policy sees of each tile, and how wrong every maker's
pixels are there, so that a policy is trained and judged again without rendering or E. Written to
the output folder: ``tile-policy.npz`` in integers, ``tile-policy.json`` with what every scene
gained when it was left out, beside simpler rules at equal cost, and the file's checksum.
`policy_training` trains the paper's policy of whole frames.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from exwarp_cli.accelerator.mlp import QuantisedMlp
from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.network_api import NetworkModel
from exwarp_cli.domain.tiles import TILE_FEATURES, TILE_STATE
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import UsageError
from exwarp_cli.io.dataset import BENCHMARK, RenderedScene, find_scenes
from exwarp_cli.io.files import atomic_write_text, make_folder
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.picture_network import OnnxExtrapolator
from exwarp_cli.models.policy_files import SHIPPED_TILE_POLICY, save_network
from exwarp_cli.policy.state import TILE_NODES, scale_tile_features, tile_inputs
from exwarp_cli.research.training.augmentation import PLAIN, Look, Variant
from exwarp_cli.research.training.outcome_tables import (
    F64,
    GIVE_ONE,
    Say,
    TrainingTable,
    extrapolator,
    read_tables,
)
from exwarp_cli.research.training.policy_training import (
    add_checksums,
    describe_policy,
    markdown_table,
    require_two_scenes,
)
from exwarp_cli.research.training.q_learning import fit_network, integer_values, quantise
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.research.training.training_settings import TilePolicySettings
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.interval import tile_features
from exwarp_cli.synthesis.methods import predict_path

Margins = npt.NDArray[Any]

SCHEMA = "exwarp.tile-policy-scores/1"
REPORT = "tile-policy.json"

# Squared display levels that a reward of 1 stands for.
UNIT = 30.0

# Largest reward that is learned from, either way: a tile in a hundred gains more.
MOST = 10.0

# Shares of the area that E would compute everywhere, at which choices are compared.
SHARES = (0.1, 0.25, 0.5, 0.75)

# Shares of the area whose price is kept with the policy.
EFFORTS = tuple(i / 20 for i in range(1, 20))

# What errors are of: a slot, and a path that warps it, has E make it, or warps what E made.
MADE = ((2, "S6"), (2, "S3"), (3, "S6"), (3, "S3"), (3, "S4"))

# Folder of the tables of tiles, beside the models.
TILE_TABLES = "tiles"

# Variants of each scene: every instant as a key frame, and time in both directions.
VARIANTS = tuple(
    Variant(phase, backwards=back) for back in (False, True) for phase in range(FACTOR)
)


class TableOfTiles(TrainingTable, ABC):
    """A table of a scene's tiles.

    What is chosen follows from margins, [N, nodes]: by how much a network's frame is worth more at
    each node. The network makes it where that is more than a price.
    """

    kind, row = "table of tiles", "tile"
    folder: ClassVar[Path]  # of tables, beside the models and in the output
    option: ClassVar[str]  # that names the network
    policy: ClassVar[str]  # name of the file of the policy that is trained on it
    load_network: ClassVar[Callable[[Path | None], NetworkModel]]
    # By the index of a node, those of the nodes after either choice.
    after: ClassVar[Mapping[int, tuple[int, int]]] = {}

    @property
    @abstractmethod
    def states(self) -> F64:
        """The policy's inputs at each node that decides, float64 [N, nodes, 44]."""

    @property
    @abstractmethod
    def gains(self) -> F64:
        """What either choice takes from a tile's error, float64 [N, nodes, 2], at a price of 0.

        In squared display levels, against doing without the network.
        """

    @classmethod
    @abstractmethod
    def measure(cls, scene: RenderedScene, network: Any, say: Say) -> Self:
        """Make frames of a scene with and without the network, and measure their tiles."""

    @staticmethod
    def cost(margins: Margins, price: float) -> float:
        """Return the share of the area that the network computes."""
        return float((margins > price).mean())

    @abstractmethod
    def error(self, margins: Margins, price: float) -> float:
        """Return the mean squared error of the frames, squared display levels."""

    def fixed_errors(self) -> tuple[float, float]:
        """Return the errors without the network, and with the network everywhere."""
        margins = np.zeros(self.gains.shape[:2])
        return self.error(margins, np.inf), self.error(margins, -np.inf)


Table = TypeVar("Table", bound=TableOfTiles)


@dataclass(frozen=True)
class TileTable(TableOfTiles):
    """All tiles of a scene's key intervals; the network is E."""

    schema = "exwarp.tile-table/1"
    facts = ("scene", "width", "network")
    folder, option, policy = Path(TILE_TABLES), "--extrapolator", SHIPPED_TILE_POLICY
    load_network = staticmethod(extrapolator)
    arrays: ClassVar = {
        "interval": (np.int32, np.int32, ()),
        "features": (np.float32, np.float64, (3, len(TILE_FEATURES))),
        "errors": (np.float32, np.float64, (len(MADE),)),
    }
    # After d2: d5 if it warps, d4 if it extrapolates.
    after: ClassVar = {TILE_NODES.index("d2"): (TILE_NODES.index("d5"), TILE_NODES.index("d4"))}

    scene: str
    width: int  # Of its frames, pixels
    interval: npt.NDArray[np.int32]  # int32 [N]: which key interval a tile belongs to.
    features: F64  # float64 [N, 3, 6]: of slots 1 to 3, in the order of `TILE_FEATURES`.
    errors: F64  # float64 [N, 5]: mean squared error, squared display levels, of what `MADE` names.
    network: str  # Checksum of the network whose frames were judged.

    @cached_property
    def states(self) -> F64:
        """The policy's inputs at each of `TILE_NODES`, float64 [N, 3, 44]."""
        slots = [
            scale_tile_features(self.features[:, slot], self.width) for slot in range(FACTOR - 1)
        ]
        return np.stack([tile_inputs(slots, node) for node in TILE_NODES], axis=1)

    @cached_property
    def gains(self) -> F64:
        """What either choice at each of `TILE_NODES` gains against warping, float64 [N, 3, 2]."""
        warped_2, made_2, warped_3, made_3, rewarped_3 = self.errors.T
        none = np.zeros(len(self))
        nodes = {
            "d2": (none, warped_2 - made_2),
            "d4": (warped_3 - rewarped_3, warped_3 - made_3),
            "d5": (none, warped_3 - made_3),
        }
        return np.stack([np.stack(nodes[node], axis=-1) for node in TILE_NODES], axis=1)

    @staticmethod
    def cost(margins: Margins, price: float) -> float:
        """Return the share of slots 2 and 3 that E computes."""
        d2, d4, d5 = np.greater(margins.T, price)  # whether `TILE_NODES` extrapolate
        return float((d2.mean() + np.where(d2, d4, d5).mean()) / 2)

    def error(self, margins: Margins, price: float) -> float:
        """Return the mean squared error of slots 2 and 3, squared display levels."""
        warped_2, made_2, warped_3, made_3, rewarped_3 = self.errors.T
        d2, d4, d5 = np.greater(margins.T, price)  # whether `TILE_NODES` extrapolate
        second = np.where(d2, made_2, warped_2)
        after_e, after_w = np.where(d4, made_3, rewarped_3), np.where(d5, made_3, warped_3)
        third = np.where(d2, after_e, after_w)
        return float((second.mean() + third.mean()) / 2)

    @classmethod
    def measure(
        cls,
        scene: RenderedScene,
        network: OnnxExtrapolator,
        say: Say,
        look: Look = PLAIN,  # as which it is delivered
        variants: Sequence[Variant] = VARIANTS,
    ) -> Self:
        """Make the frames of all makers of a scene's key intervals, and measure their tiles.

        Of a scene that is not rendered to the end its first unbroken run of key frames counts.
        """
        scene = scene.as_far_as_rendered()
        parts: list[tuple[npt.NDArray[np.int32], F64, F64]] = []
        clips = SceneClip(scene)
        played = (clips.seen_as(variant, look) for variant in variants)
        intervals = ((clip, k) for clip in played for k in clip.intervals)
        for clip, k in intervals:
            truth = {slot: encode_display(clip.truth(k, slot).pixels) for slot in (2, 3)}
            interval = replace(clip.causal(k, "key"), extrapolator=network)
            by_slot = [tile_features(interval, slot) for slot in range(1, FACTOR)]
            features = np.stack(by_slot, axis=2).reshape(-1, FACTOR - 1, len(TILE_FEATURES))
            errors = []
            for slot, path in MADE:
                frame = encode_display(predict_path(path, interval, slot).pixels)
                squares = np.square(frame[..., :3] - truth[slot][..., :3]).mean(axis=-1)
                errors.append(interval.mosaic.means(squares).ravel())
            numbers = np.full(len(features), len(parts), np.int32)
            parts.append((numbers, features, np.stack(errors, axis=-1)))
            say(f"{scene.name}: {len(parts)} key intervals")
            check_stop()
        numbers, features, errors_of = (np.concatenate(part) for part in zip(*parts, strict=True))
        width = scene.manifest.width
        return cls(scene.name, width, numbers, features, errors_of, network.checksum)


def find_tile_tables(
    kind: type[Table],
    data: Path | None,
    model: Path | None,
    tables: Path | None,
    output: Path,
    say: Say,
) -> list[Table]:
    """Measure the tiles of benchmark scenes and write their tables, or read those there are.

    A scene whose table is in the output folder, made with the same network, is not measured again.
    Parameters and errors are those of `outcome_tables.find_tables`.
    """
    if data is None:
        if model is not None:
            raise UsageError(f"{kind.option} is for measuring scenes; give --data too")
        return read_tables(kind, tables or shipped_folder() / kind.folder)
    if tables is not None:
        raise UsageError(GIVE_ONE)
    folder = output / kind.folder
    make_folder(folder)
    scenes = find_scenes(data, BENCHMARK)
    network = kind.load_network(model)
    found = []
    for scene in scenes:
        path = folder / f"{scene.name}.npz"
        table = kind.load(path) if path.exists() else None
        if table is None or table.network != network.checksum:
            kind.measure(scene, network, say).save(path)
            table = kind.load(path)
        found.append(table)
    return found


def train_tiles(tables: Sequence[Table], settings: TilePolicySettings) -> QuantisedMlp:
    """Learn what choices gain, and the best that follows them; return the integer network.

    Scenes count alike. The same on one kind of processor.
    """
    states = [torch.from_numpy(table.states).float() for table in tables]
    rewards = [
        torch.from_numpy(np.clip(table.gains / UNIT, -MOST, MOST)).float() for table in tables
    ]
    count = -(-settings.batch // len(states))

    def draw(target: nn.Module) -> tuple[Tensor, Tensor]:
        """Draw tiles, as many of each scene: states [B, nodes, 44], and returns [B, nodes, 2]."""
        rows = [torch.randint(len(scene), (count,)) for scene in states]
        state, aim = (
            torch.cat([scene[row] for scene, row in zip(part, rows, strict=True)])
            for part in (states, rewards)
        )
        if after := tables[0].after:
            best = target(state).amax(dim=-1)
            for node, following in after.items():
                aim[:, node] += best[:, list(following)]
        return state, aim

    network = fit_network(settings, draw, functional.smooth_l1_loss)
    return quantise(network, np.concatenate([table.states for table in tables]))


def margins_unseen(
    tables: Sequence[Table], settings: TilePolicySettings, say: Say
) -> list[Margins]:
    """Return the margins of each scene by a network that was trained on the others."""
    unseen = []
    for index, table in enumerate(tables):
        say(f"without {table.scene}")
        network = train_tiles([t for i, t in enumerate(tables) if i != index], settings)
        unseen.append(choice_margins(network, table))
    return unseen


def choice_margins(network: QuantisedMlp, table: TableOfTiles) -> npt.NDArray[np.int64]:
    """Return by how much a network's frame is worth more at each node, int64 [N, nodes]."""
    outputs = integer_values(network, table.states)
    return outputs[..., 1] - outputs[..., 0]


def price_for(
    share: float, margins: Sequence[Margins], cost_of: Callable[[Margins, float], float]
) -> float:
    """Return the price at which a network computes a share of the scenes' area on average."""
    low, high = (float(f(np.concatenate([m.ravel() for m in margins]))) for f in (np.min, np.max))
    low -= 1
    for _ in range(60):
        middle = (low + high) / 2
        if np.mean([cost_of(m, middle) for m in margins]) > share:
            low = middle
        else:
            high = middle
    return high


def gain_percent(tables: Sequence[TableOfTiles], margins: Sequence[Margins], price: float) -> float:
    """Return what margins gain at a price, in % of the network's gain in dB over all scenes."""
    gained = everything = 0.0
    for table, margin in zip(tables, margins, strict=True):
        without, alone = table.fixed_errors()
        gained += np.log10(without / table.error(margin, price))
        everything += np.log10(without / alone)
    return 100 * float(gained / everything)


def score_choices(
    tables: Sequence[TableOfTiles], margins: Mapping[str, Sequence[Margins]], network: str
) -> dict[str, Any]:
    """Return what a scores file has of a network, and of choices: `margins` by their names.

    ``tiles`` counts those of each scene. ``…_gain_db`` is what the network gains everywhere, by
    scene. ``gain_percent`` is what each choice gains at each of `SHARES`.
    """
    gains: dict[str, dict[str, float]] = {}
    for name, of_choice in margins.items():
        gains[name] = {}
        for share in SHARES:
            price = price_for(share, of_choice, tables[0].cost)
            gains[name][f"{share:g}"] = round(gain_percent(tables, of_choice, price), 1)
    everywhere: dict[str, float] = {}
    for table in tables:
        without, alone = table.fixed_errors()
        everywhere[table.scene] = round(10 * float(np.log10(without / alone)), 3)
    return {
        "tiles": {table.scene: len(table) for table in tables},
        f"{network}_gain_db": everywhere,
        "gain_percent": gains,
    }


def train_tile_policy(
    tables: Sequence[TileTable], output: Path, settings: TilePolicySettings, say: Say
) -> dict[str, Any]:
    """Train with every scene left out once, then on all; return what ``tile-policy.json`` holds."""
    require_two_scenes(len(tables))
    make_folder(output)
    margins = {"policy, scene left out": margins_unseen(tables, settings, say)}
    say(f"on all {len(tables)} scenes")
    network = train_tiles(tables, settings)
    own = [choice_margins(network, table) for table in tables]
    about = "ExWarp's predictor of tiles: deep Q-learning on rendered scenes"
    metadata = describe_policy(about, TILE_STATE, tables, settings)
    metadata["efforts"] = [[s, round(price_for(s, own, TileTable.cost))] for s in EFFORTS]
    save_network(output / SHIPPED_TILE_POLICY, network, metadata)
    for table in tables:
        toss = np.random.default_rng(settings.seed).random((len(table), len(TILE_NODES)))
        holes = [table.features[:, slot, :2].sum(axis=-1) for slot in (1, 2, 2)]
        residual = table.features[:, 0, 4:].sum(axis=-1, keepdims=True)
        rules = {
            "coin": toss,
            # A trace of chance parts what is equal.
            "holes": np.stack(holes, axis=-1) + 1e-6 * toss,
            "key residual": residual + 1e-6 * toss,
            "truth": table.gains[..., 1] - np.maximum(table.gains[..., 0], 0),
        }
        for name, of_table in rules.items():
            margins.setdefault(name, []).append(of_table)
    # Slot 2 is extrapolated everywhere, and warped on.
    always_s4 = [np.tile([float(node == "d2") for node in TILE_NODES], (len(t), 1)) for t in tables]
    report = {
        "schema": SCHEMA,
        "settings": asdict(settings),
        **score_choices(tables, margins, "extrapolator"),
        "always_s4_percent": round(gain_percent(tables, always_s4, 0.5), 1),
    }
    atomic_write_text(output / REPORT, json.dumps(report, indent=1) + "\n")
    add_checksums(output, [SHIPPED_TILE_POLICY])
    return report


def gain_card(report: dict[str, Any]) -> str:
    """Return what a scores file holds: what choices gain at some shares of the area.

    In per cent of what the network gains everywhere, which is said for each scene, dB.
    """
    if "extrapolator_gain_db" in report:
        network, by_scene = "E", report["extrapolator_gain_db"]
        always = f" Always S4, at half of the area, gains {report['always_s4_percent']:.0f} %."
    else:
        network, by_scene, always = "The network", report["network_gain_db"], ""
    curves = report["gain_percent"]
    shares = list(next(iter(curves.values())))
    titles = ["choice", *(f"{float(share):.0%} of the area" for share in shares)]
    rows = [[name, *(f"{gains[s]:.0f} %" for s in shares)] for name, gains in curves.items()]
    everywhere = ", ".join(f"{scene} {gain:+.2f}" for scene, gain in by_scene.items())
    summary = f"{network} everywhere gains, in dB: {everywhere}.{always}"
    return f"{markdown_table(titles, rows)}\n\n{summary}"
