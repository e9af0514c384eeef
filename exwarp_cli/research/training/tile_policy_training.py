"""Training the policy of tiles: deep Q-learning on what each choice gains in every tile.

Written to the output folder: ``tile-policy.npz`` in integers, ``tile-policy.json`` with what
every scene gained when it was left out, beside simpler rules at equal cost, and the file's
checksum. `policy_training` trains the paper's policy of whole frames.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from exwarp_cli.accelerator.mlp import QuantisedMlp, to_fixed
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import EXTRAPOLATE, WARP
from exwarp_cli.domain.tiles import REWARP, TILE_STATE
from exwarp_cli.io.files import atomic_write_text, make_folder
from exwarp_cli.models.policy_files import SHIPPED_TILE_POLICY, save_network
from exwarp_cli.policy.state import INPUTS, TILE_NODES, tile_paths
from exwarp_cli.research.training.policy_training import add_checksums, require_two_scenes
from exwarp_cli.research.training.q_learning import fit_network, quantise
from exwarp_cli.research.training.tile_tables import TileTable
from exwarp_cli.research.training.training_settings import TilePolicySettings

F64 = npt.NDArray[np.float64]
Margins = npt.NDArray[Any]
Chosen = Mapping[str, npt.NDArray[np.bool_]]
Say = Callable[[str], None]

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

# The nodes after warping and after extrapolating; none after slot 3.
AFTER = {"d2": ("d5", "d4"), "d4": None, "d5": None}


def gains(table: TileTable) -> F64:
    """Return what each choice at each node of `DECIDED` takes from a tile's squared error.

    float64 [N, 3, 2], squared display levels, against warping from the key frame at a price of 0.
    """
    second = table.error(2, WARP) - table.error(2, EXTRAPOLATE)
    third, again = (table.error(3, WARP) - table.error(3, name) for name in (EXTRAPOLATE, REWARP))
    none = np.zeros(len(table))
    nodes = {"d2": (none, second), "d4": (again, third), "d5": (none, third)}
    return np.stack([np.stack(nodes[node], axis=-1) for node in TILE_NODES], axis=1)


def train_tiles(tables: Sequence[TileTable], settings: TilePolicySettings) -> QuantisedMlp:
    """Learn from the tables of some scenes, which count alike; return the integer network.

    The same on one kind of processor.
    """
    states = [torch.from_numpy(table.states).float() for table in tables]
    rewards = [
        torch.from_numpy(np.clip(gains(table) / UNIT, -MOST, MOST)).float() for table in tables
    ]
    count = -(-settings.batch // len(states))

    def draw(target: nn.Module) -> tuple[Tensor, Tensor]:
        """Draw tiles, as many of each scene: states [B, 3, 44], and the returns [B, 3, 2]."""
        rows = [torch.randint(len(scene), (count,)) for scene in states]
        state, aim = (
            torch.cat([scene[row] for scene, row in zip(part, rows, strict=True)])
            for part in (states, rewards)
        )
        best = target(state).amax(dim=-1)
        for index, node in enumerate(TILE_NODES):
            following = AFTER[node]
            if following is not None:
                ahead = [best[:, TILE_NODES.index(name)] for name in following]
                aim[:, index] += torch.stack(ahead, dim=-1)
        return state, aim

    layers = fit_network(settings, draw, functional.smooth_l1_loss)
    all_states = np.concatenate([table.states.reshape(-1, INPUTS) for table in tables])
    return quantise([w for w, _ in layers], [b for _, b in layers], all_states)


def choice_margins(network: QuantisedMlp, table: TileTable) -> npt.NDArray[np.int64]:
    """Return by how much extrapolating is worth more than warping, int64 [N, 3]."""
    outputs, _ = MlpKernel(network).decide_many(to_fixed(table.states.reshape(-1, INPUTS)))
    margins = outputs[:, 1].astype(np.int64) - outputs[:, 0].astype(np.int64)
    return margins.reshape(-1, len(TILE_NODES))


def choose(margins: Margins, price: float) -> Chosen:
    """Return whether each node extrapolates: where that is worth more than a price."""
    return {node: margins[:, index] > price for index, node in enumerate(TILE_NODES)}


def cost(chosen: Chosen) -> float:
    """Return the share of slots 2 and 3 that E computes."""
    third = np.where(chosen["d2"], chosen["d4"], chosen["d5"])
    return float((chosen["d2"].mean() + third.mean()) / 2)


def error_of(table: TileTable, chosen: Chosen) -> float:
    """Return the mean squared error of slots 2 and 3, squared display levels."""
    paths = tile_paths(chosen)
    second = np.where(chosen["d2"], table.error(2, EXTRAPOLATE), table.error(2, WARP))
    third = np.select(
        [(paths == "S3") | (paths == "S5"), paths == "S4"],
        [table.error(3, EXTRAPOLATE), table.error(3, REWARP)],
        table.error(3, WARP),
    )
    return float((second.mean() + third.mean()) / 2)


def price_for(share: float, margins: Sequence[Margins]) -> float:
    """Return the price at which E computes a share of the scenes' area on average."""
    low, high = (float(f(np.concatenate([m.ravel() for m in margins]))) for f in (np.min, np.max))
    low -= 1
    for _ in range(60):
        middle = (low + high) / 2
        if np.mean([cost(choose(m, middle)) for m in margins]) > share:
            low = middle
        else:
            high = middle
    return high


def gain_at(share: float, tables: Sequence[TileTable], margins: Sequence[Margins]) -> float:
    """Return what a choice gains at a share of the area, in % of E's gain in dB over all scenes."""
    price = price_for(share, margins)
    return _gain(tables, [choose(margin, price) for margin in margins])


def _gain(tables: Sequence[TileTable], chosen: Sequence[Chosen]) -> float:
    gained = everything = 0.0
    for table, choice in zip(tables, chosen, strict=True):
        warped, extrapolated = _fixed_errors(table)
        gained += np.log10(warped / error_of(table, choice))
        everything += np.log10(warped / extrapolated)
    return 100 * float(gained / everything)


def _fixed_errors(table: TileTable) -> tuple[float, float]:
    """Return the errors of warping everything, and of extrapolating everything."""
    warp, extrapolate = (
        {node: np.full(len(table), choice) for node in TILE_NODES} for choice in (False, True)
    )
    return error_of(table, warp), error_of(table, extrapolate)


def rule_margins(table: TileTable, seed: int) -> dict[str, F64]:
    """Return the margins of simpler rules, float64 [N, 3], and of knowing the truth."""
    holes = np.stack([table.features[:, slot, :2].sum(axis=-1) for slot in (1, 2, 2)], axis=-1)
    residual = table.features[:, 0, 4:].sum(axis=-1)
    toss = np.random.default_rng(seed).random((len(table), len(TILE_NODES)))
    truth = gains(table)
    return {
        "coin": toss,
        # A trace of chance parts what is equal.
        "holes": holes + 1e-6 * toss,
        "key residual": np.repeat(residual[:, None], len(TILE_NODES), axis=1) + 1e-6 * toss,
        "truth": truth[..., 1] - np.maximum(truth[..., 0], 0),
    }


def train_tile_policy(
    tables: Sequence[TileTable], output: Path, settings: TilePolicySettings, say: Say
) -> dict[str, Any]:
    """Train with every scene left out once, then on all; return what ``tile-policy.json`` holds."""
    require_two_scenes(len(tables))
    make_folder(output)
    unseen: list[Margins] = []
    for index, table in enumerate(tables):
        say(f"without {table.scene}")
        network = train_tiles([t for i, t in enumerate(tables) if i != index], settings)
        unseen.append(choice_margins(network, table))
    say(f"on all {len(tables)} scenes")
    network = train_tiles(tables, settings)
    own = [choice_margins(network, table) for table in tables]
    metadata = {
        "about": "ExWarp's predictor of tiles: deep Q-learning on rendered scenes",
        "state": TILE_STATE,
        "scenes": [table.scene for table in tables],
        "settings": asdict(settings),
        "extrapolator": sorted({table.network for table in tables}),
        "efforts": [[share, round(price_for(share, own))] for share in EFFORTS],
    }
    save_network(output / SHIPPED_TILE_POLICY, network, metadata)
    margins = {"policy, scene left out": unseen}
    for table in tables:
        for name, of_table in rule_margins(table, settings.seed).items():
            margins.setdefault(name, []).append(of_table)
    # Slot 2 is extrapolated everywhere, and warped on.
    always_s4 = [{n: np.full(len(table), n == "d2") for n in TILE_NODES} for table in tables]
    errors = {table.scene: _fixed_errors(table) for table in tables}
    report = {
        "schema": SCHEMA,
        "settings": asdict(settings),
        "tiles": {table.scene: len(table) for table in tables},
        "extrapolator_gain_db": {
            scene: round(10 * float(np.log10(warped / extrapolated)), 3)
            for scene, (warped, extrapolated) in errors.items()
        },
        "gain_percent": {
            name: {f"{share:g}": round(gain_at(share, tables, m), 1) for share in SHARES}
            for name, m in margins.items()
        },
        "always_s4_percent": round(_gain(tables, always_s4), 1),
    }
    atomic_write_text(output / REPORT, json.dumps(report, indent=1) + "\n")
    add_checksums(output, [SHIPPED_TILE_POLICY])
    return report
