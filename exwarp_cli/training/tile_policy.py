"""Training the policy of tiles: deep Q-learning on what each choice gains in every tile.

Written to the output folder: ``tile-policy.npz`` in integers, ``tile-policy.json`` with what
every scene gained when it was left out, beside simpler rules at equal cost, and the file's
checksum. `exwarp_cli.training.policy` trains the paper's policy of whole frames.
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

from exwarp_cli.accelerator.fixed_point import to_fixed
from exwarp_cli.accelerator.mlp import MlpKernel, QuantisedMlp
from exwarp_cli.domain.decision import EXTRAPOLATE, WARP
from exwarp_cli.domain.tiles import REWARP, TILE_STATE
from exwarp_cli.errors import InputError
from exwarp_cli.io.atomic import atomic_write_text, make_folder
from exwarp_cli.io.policy_files import SHIPPED_TILE_POLICY, save_network
from exwarp_cli.policy.state import INPUTS, TILE_NODES, tile_paths
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.training.dqn import FEATURE, layers_of, make_network, one_thread
from exwarp_cli.training.policy import note_checksums, quantise
from exwarp_cli.training.settings import TilePolicySettings
from exwarp_cli.training.tile_table import TileTable

F64 = npt.NDArray[np.float64]
Chosen = Mapping[str, npt.NDArray[np.bool_]]
Say = Callable[[str], None]

SCHEMA = "exwarp.tile-policy-scores/1"
REPORT = "tile-policy.json"

UNIT = 30.0
"""Squared display levels that a reward of 1 stands for."""

MOST = 10.0
"""Largest reward that is learned from, either way: a tile in a hundred gains more."""

SHARES = (0.1, 0.25, 0.5, 0.75)
"""Shares of the area that E would compute everywhere, at which choices are compared."""

EFFORTS = tuple(i / 20 for i in range(1, 20))
"""Shares of the area whose price is kept with the policy."""

AFTER = {"d2": ("d5", "d4"), "d4": None, "d5": None}
"""The nodes after warping and after extrapolating; none after slot 3."""


def gains(table: TileTable) -> F64:
    """Return what each choice at each node of `DECIDED` takes from a tile's squared error.

    Returns
    -------
    float64 [N, 3, 2]
        Squared display levels, against warping from the key frame; raw, at a price of 0.
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
    with one_thread():
        layers = layers_of(_trained(tables, settings))
    states = np.concatenate([table.states.reshape(-1, INPUTS) for table in tables])
    return quantise([w for w, _ in layers], [b for _, b in layers], states)


def _trained(tables: Sequence[TileTable], settings: TilePolicySettings) -> nn.Sequential:
    torch.manual_seed(settings.seed)
    network, target = make_network(), make_network()
    states = [torch.from_numpy(table.states).float() for table in tables]
    rewards = [
        torch.from_numpy(np.clip(gains(table) / UNIT, -MOST, MOST)).float() for table in tables
    ]
    optimiser = torch.optim.AdamW(
        network.parameters(), lr=settings.rate, weight_decay=settings.decay
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    for step in range(settings.steps):
        if step % settings.lag == 0:
            target.load_state_dict(network.state_dict())
        state, reward = _batch(states, rewards, settings.batch)
        with torch.no_grad():
            aim = _aim(target, state, reward)
        seen = state + settings.jitter * FEATURE * torch.randn_like(state)
        loss = nn.functional.smooth_l1_loss(network(seen), aim)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        check_stop()
    return network


def _batch(states: list[Tensor], rewards: list[Tensor], count: int) -> tuple[Tensor, Tensor]:
    """Draw tiles, as many of each scene: states [B, 3, 44] and rewards [B, 3, 2]."""
    share = -(-count // len(states))
    rows = [torch.randint(len(scene), (share,)) for scene in states]
    picked = [
        torch.cat([scene[row] for scene, row in zip(part, rows, strict=True)])
        for part in (states, rewards)
    ]
    return picked[0], picked[1]


def _aim(target: nn.Sequential, state: Tensor, reward: Tensor) -> Tensor:
    """Return rewards plus the best that the nodes after them promise, [B, 3, 2]."""
    best = target(state).amax(dim=-1)
    aim = reward.clone()
    for index, node in enumerate(TILE_NODES):
        following = AFTER[node]
        if following is not None:
            ahead = [best[:, TILE_NODES.index(name)] for name in following]
            aim[:, index] += torch.stack(ahead, dim=-1)
    return aim


def outputs(network: QuantisedMlp, table: TileTable) -> npt.NDArray[np.int64]:
    """Return by how much extrapolating is worth more than warping, int64 [N, 3]."""
    found, _ = MlpKernel(network).decide_many(to_fixed(table.states.reshape(-1, INPUTS)))
    margin = found[:, 1].astype(np.int64) - found[:, 0].astype(np.int64)
    return margin.reshape(-1, len(TILE_NODES))


def choose(margins: npt.NDArray[Any], price: float) -> Chosen:
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


def price_for(share: float, margins: Sequence[npt.NDArray[Any]]) -> float:
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


def gain_at(
    share: float, tables: Sequence[TileTable], margins: Sequence[npt.NDArray[Any]]
) -> float:
    """Return what a choice gains at a share of the area, in % of E's gain in dB over all scenes."""
    price = price_for(share, margins)
    return _gain(tables, [choose(margin, price) for margin in margins])


def _gain(tables: Sequence[TileTable], chosen: Sequence[Chosen]) -> float:
    """Return what choices gain, in % of E's gain in dB over all scenes."""
    gained = whole = 0.0
    for table, choice in zip(tables, chosen, strict=True):
        nothing, everything = (
            error_of(table, _everywhere(len(table), value)) for value in (False, True)
        )
        gained += np.log10(nothing / error_of(table, choice))
        whole += np.log10(nothing / everything)
    return 100 * float(gained / whole)


def _always_s4(count: int) -> Chosen:
    """Return the choice that extrapolates slot 2 alone, everywhere, and warps it on."""
    return {node: np.full(count, node == "d2") for node in TILE_NODES}


def _everywhere(count: int, value: bool) -> Chosen:
    return {node: np.full(count, value) for node in TILE_NODES}


def rules(table: TileTable, seed: int) -> dict[str, F64]:
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
    if len(tables) < 2:
        raise InputError(
            "a policy is judged on a scene that it was not trained on, and there is only one; "
            "render another, or name it with --tables"
        )
    make_folder(output)
    unseen = []
    for index, table in enumerate(tables):
        say(f"without {table.scene}")
        others = [other for place, other in enumerate(tables) if place != index]
        unseen.append(outputs(train_tiles(others, settings), table))
    say(f"on all {len(tables)} scenes")
    network = train_tiles(tables, settings)
    own = [outputs(network, table) for table in tables]
    efforts = [[share, round(price_for(share, own))] for share in EFFORTS]
    metadata = {
        "about": "ExWarp's predictor of tiles: deep Q-learning on rendered scenes",
        "state": TILE_STATE,
        "scenes": [table.scene for table in tables],
        "settings": asdict(settings),
        "extrapolator": sorted({table.network for table in tables}),
        "efforts": efforts,
    }
    save_network(output / SHIPPED_TILE_POLICY, network, metadata)
    report = {
        "schema": SCHEMA,
        "settings": asdict(settings),
        "tiles": {table.scene: len(table) for table in tables},
        "extrapolator_gain_db": {table.scene: _whole_gain(table) for table in tables},
        "gain_percent": _curves(tables, unseen, settings.seed),
        "always_s4_percent": round(_gain(tables, [_always_s4(len(table)) for table in tables]), 1),
    }
    atomic_write_text(output / REPORT, json.dumps(report, indent=1) + "\n")
    note_checksums(output, [SHIPPED_TILE_POLICY])
    return report


def _curves(
    tables: Sequence[TileTable], unseen: Sequence[npt.NDArray[Any]], seed: int
) -> dict[str, dict[str, float]]:
    """Return what the policy and the simpler rules gain at each of `SHARES`."""
    found: dict[str, list[npt.NDArray[Any]]] = {"policy, scene left out": list(unseen)}
    for table in tables:
        for name, margins in rules(table, seed).items():
            found.setdefault(name, []).append(margins)
    return {
        name: {f"{share:g}": round(gain_at(share, tables, margins), 1) for share in SHARES}
        for name, margins in found.items()
    }


def _whole_gain(table: TileTable) -> float:
    """Return by how many dB E everywhere is better than warping."""
    errors = [error_of(table, _everywhere(len(table), value)) for value in (False, True)]
    return round(10 * float(np.log10(errors[0] / errors[1])), 3)
