"""Training the policy: one network for each scene left out, and one from all of them.

Written to the output folder: ``policy.npz`` (integers and floats, what ``exwarp upsample`` runs),
``policy.onnx`` and ``policy-int8.onnx``, ``policy-without-SCENE.npz`` for each scene,
``policy.json`` with every score, and the files' checksums.

The integers are the accelerator's (paper, section IV-C2): weights int8 with a scale for each
neuron, symmetric; biases int32 in the scale of the sums. Inputs lie in 0 … 1 by definition, so
theirs is 1/127; activations are scaled by the largest value that calibration states bring forth,
and saturate there. The last layer has one scale, as its two sums are compared.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.fixed_point import MAX_ACTIVATION, MAX_SHIFT, ONE, to_fixed
from exwarp_cli.accelerator.mlp import MlpKernel, QuantisedLayer, QuantisedMlp, Requantisation
from exwarp_cli.domain.decision import NODES, PATHS
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.atomic import atomic_write_text, make_folder
from exwarp_cli.io.models import CHECKSUMS
from exwarp_cli.io.policy_files import SHIPPED_POLICY, left_out, save_network
from exwarp_cli.policy.outcomes import choice_rewards
from exwarp_cli.policy.state import INPUTS, STATE_VERSION
from exwarp_cli.training.dqn import train, values
from exwarp_cli.training.policy_onnx import export_float, export_integer
from exwarp_cli.training.policy_scores import (
    NAMES,
    PolicyScore,
    fixed,
    oracles,
    score_paths,
    score_random,
    taken,
)
from exwarp_cli.training.policy_table import PolicyTable
from exwarp_cli.training.settings import PolicySettings

F64 = npt.NDArray[np.float64]
F32 = npt.NDArray[np.float32]
Say = Callable[[str], None]

SCHEMA = "exwarp.policy-scores/1"
REPORT = "policy.json"
FLOAT_MODEL, INTEGER_MODEL = "policy.onnx", "policy-int8.onnx"

ALL = "all"
"""Name of all rows of a table, beside "key 427x240" and the like."""


@dataclass(frozen=True)
class Learned:
    """A trained network in both arithmetics.

    Attributes
    ----------
    floats
        Weights float64 [out, in] and biases [out] of each layer.
    network
        In integers.
    """

    floats: tuple[tuple[F64, F64], ...]
    network: QuantisedMlp

    @property
    def single(self) -> list[tuple[F32, F32]]:
        """The float network's weights and biases in the precision that it was trained in."""
        return [(w.astype(np.float32), b.astype(np.float32)) for w, b in self.floats]

    def values(self, table: PolicyTable) -> F64:
        """Return the float network's outputs, float64 [N, 5, 2]."""
        return values(self.floats, table)

    def outputs(self, table: PolicyTable) -> F64:
        """Return the integer network's outputs, float64 [N, 5, 2]."""
        states = to_fixed(table.states.reshape(-1, INPUTS))
        found, _ = MlpKernel(self.network).decide_many(states)
        return found.astype(np.float64).reshape(-1, len(NODES), 2)


def learn(tables: Sequence[PolicyTable], settings: PolicySettings) -> Learned:
    """Train a network on some scenes and quantise it; they are the calibration states too."""
    floats = train(tables, settings)
    states = np.concatenate([table.states.reshape(-1, INPUTS) for table in tables])
    return Learned(floats, quantise([w for w, _ in floats], [b for _, b in floats], states))


def train_policy(
    tables: Sequence[PolicyTable], output: Path, settings: PolicySettings, say: Say
) -> dict[str, Any]:
    """Train the policy with every scene left out once, then on all scenes.

    Parameters
    ----------
    tables
        Two scenes at least.
    output
        Folder for the models; made.
    settings
        Of every one of the trainings.
    say
        Receives what is being done, in lines.

    Returns
    -------
    dict
        What ``policy.json`` holds.
    """
    if len(tables) < 2:
        raise InputError(
            "a policy is judged on a scene that it was not trained on, and there is only one; "
            "render another, or name it with --tables"
        )
    _require_different(tables)
    make_folder(output)
    folds, written = {}, []
    for index, table in enumerate(tables):
        others = [other for i, other in enumerate(tables) if i != index]
        say(f"without {table.scene}: training on {', '.join(other.scene for other in others)}")
        found = learn(others, settings)
        name = left_out(table.scene)
        _save(output / name, found, others, settings)
        written.append(name)
        folds[table.scene] = _judge(found, table, others)
        say(f"without {table.scene}: {_line(folds[table.scene][ALL])}")
    say(f"training on all {len(tables)} scenes")
    final = learn(tables, settings)
    _save(output / SHIPPED_POLICY, final, tables, settings, whole=True)
    floats = final.single
    export_float([w for w, _ in floats], [b for _, b in floats], output / FLOAT_MODEL)
    export_integer(final.network, output / INTEGER_MODEL)
    report = {
        "schema": SCHEMA,
        "settings": asdict(settings),
        "tables": {
            table.scene: {
                "intervals": len(table),
                "points": len(table) * len(NODES),
                "groups": _sizes(table),
                "extrapolator": table.network,
            }
            for table in tables
        },
        "left_out": folds,
    }
    atomic_write_text(output / REPORT, json.dumps(report, separators=(",", ":")) + "\n")
    note_checksums(output, [SHIPPED_POLICY, FLOAT_MODEL, INTEGER_MODEL, *written])
    return report


def _require_different(tables: Sequence[PolicyTable]) -> None:
    """Refuse two tables of one scene: each would be judged by a network that saw the other."""
    names = [table.scene for table in tables]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"two tables are of the scene {twice[0]}; keep one of them")


def parts_of(table: PolicyTable) -> dict[str, npt.NDArray[np.bool_]]:
    """Return the rows of each part of a table: all, and each setting at each size."""
    names = np.array([f"{name.split('-')[0]} {name.split()[-1]}" for name in table.groups])
    of_row = names[table.group]
    parts = {ALL: np.ones(len(table), np.bool_)}
    return parts | {str(name): of_row == name for name in sorted(set(names))}


def _sizes(table: PolicyTable) -> dict[str, int]:
    """Return how many rows the groups of each name have."""
    of_row = np.array(table.groups)[table.group]
    return {name: int((of_row == name).sum()) for name in dict.fromkeys(table.groups)}


def _judge(learned: Learned, table: PolicyTable, others: Sequence[PolicyTable]) -> dict[str, Any]:
    """Score a policy on a scene that it never saw, beside what it competes with."""
    real, whole = learned.values(table), learned.outputs(table)
    policies = {
        "exwarp": taken(whole),
        "float": taken(real),
        "regressor": taken(predicted(regress(others), table)),
        **oracles(table),
        **{name: fixed(table, name) for name in PATHS},
    }
    same = (real[..., 1] > real[..., 0]) == (whole[..., 1] > whole[..., 0])
    met = _met(policies["exwarp"])
    found: dict[str, Any] = {}
    for part, rows in parts_of(table).items():
        scores = {name: asdict(score_paths(table, paths, rows)) for name, paths in policies.items()}
        scores["random"] = asdict(score_random(table, rows))
        found[part] = {
            "scores": scores,
            "agreement": float(same[rows].mean()),
            "agreement_met": float(same[rows][met[rows]].mean()),
        }
    return found


def _met(paths: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """bool [N, 5]: the nodes that the paths pass."""
    passed = np.array([[node in PATHS[name].choices for node in NODES] for name in NAMES])
    return np.asarray(passed[paths])


def _save(
    path: Path,
    learned: Learned,
    tables: Sequence[PolicyTable],
    settings: PolicySettings,
    whole: bool = False,
) -> None:
    """Write a policy in integers; the whole of it keeps the network before quantisation too."""
    metadata = {
        "about": "ExWarp's predictor: deep Q-learning on rendered scenes",
        "state": STATE_VERSION,
        "scenes": [table.scene for table in tables],
        "settings": asdict(settings),
        "extrapolator": sorted({table.network for table in tables}),
    }
    save_network(path, learned.network, metadata, learned.single if whole else ())


def note_checksums(folder: Path, names: Sequence[str]) -> None:
    """Write the files' checksums beside those that are there."""
    path = folder / CHECKSUMS
    try:
        known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(
            f"{path} is no JSON ({error}); remove it, or write to another folder with -o"
        ) from error
    for name in names:
        known[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    atomic_write_text(path, json.dumps(known, indent=1, sort_keys=True) + "\n")


def _line(part: dict[str, Any]) -> str:
    scores = {name: PolicyScore(**score) for name, score in part["scores"].items()}
    best = max((scores[name] for name in PATHS), key=lambda score: score.psnr_db)
    own, oracle = scores["exwarp"], scores["oracle"]
    return (
        f"return {own.reward:.3f}, PSNR {own.psnr_db:.3f} dB; best fixed path {best.psnr_db:.3f}, "
        f"oracle {oracle.psnr_db:.3f}; int8 agrees on {part['agreement']:.2%}"
    )


RIDGE = 1e-2
"""Weight of the squared coefficients beside the mean squared error, in units of the inputs."""


def regress(tables: Sequence[PolicyTable]) -> F64:
    """Fit the reward of both choices at each node to the states of some scenes.

    Returns
    -------
    float64 [5, 45, 2]
        Coefficients of the 44 inputs and of a constant, by node and choice.
    """
    states = np.concatenate([table.states for table in tables])
    gains = np.concatenate([choice_rewards(table.outcomes) for table in tables])
    weights = np.concatenate([np.full(len(table), 1 / len(table)) for table in tables])
    out = []
    for node in range(len(NODES)):
        x = np.concatenate([states[:, node], np.ones((len(states), 1))], axis=1)
        scaled = x * weights[:, None] / weights.sum()
        out.append(
            np.linalg.solve(scaled.T @ x + RIDGE * np.eye(x.shape[1]), scaled.T @ gains[:, node])
        )
    return np.array(out)


def predicted(coefficients: F64, table: PolicyTable) -> F64:
    """Return the expected reward of both choices at every node, float64 [N, 5, 2]."""
    states = table.states
    x = np.concatenate([states, np.ones((*states.shape[:2], 1))], axis=2)
    return np.asarray(np.einsum("nki,kic->nkc", x, coefficients))


MULTIPLIER_BITS = 31

MOST_BIAS = 2.0**30
"""Weights are scaled so that no bias is larger, which leaves the sums as much again."""


def quantise(weights: Sequence[F64], biases: Sequence[F64], states: F64) -> QuantisedMlp:
    """Return a network in integers.

    Parameters
    ----------
    weights, biases
        Of every layer, float64 [out, in] and [out].
    states
        float64 [N, in], 0 to 1: what activations are calibrated on.
    """
    unit = 1 / MAX_ACTIVATION
    inputs = factors(np.full(states.shape[1], MAX_ACTIVATION / ONE))
    layers: list[QuantisedLayer] = []
    activations = states
    for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        last = number == len(weights) - 1
        largest = np.abs(weight).max(axis=1) / MAX_ACTIVATION
        scale = np.maximum(np.maximum(largest, np.abs(bias) / (MOST_BIAS * unit)), 1e-14)
        if last:
            scale = np.full(bias.shape, scale.max())
        whole = np.rint(weight / scale[:, None]).astype(np.int8)
        offset = np.rint(bias / (scale * unit)).astype(np.int32)
        activations = activations @ weight.T + bias
        if last:
            layers.append(QuantisedLayer(whole, offset))
            break
        activations = np.maximum(activations, 0)
        following = max(float(activations.max()), 1e-12) / MAX_ACTIVATION
        layers.append(QuantisedLayer(whole, offset, factors(scale * unit / following)))
        unit = following
    return QuantisedMlp(inputs, tuple(layers))


def factors(ratios: F64) -> Requantisation:
    """Return positive ratios as int32 multipliers and shifts, to 30 bits where they fit."""
    multipliers, shifts = np.empty(ratios.shape, np.int32), np.empty(ratios.shape, np.uint8)
    for i, ratio in enumerate(ratios):
        _, exponent = math.frexp(float(ratio))
        shift = min(max(MULTIPLIER_BITS - exponent, 0), MAX_SHIFT)
        multiplier = round(float(ratio) * 2.0**shift)
        multipliers[i] = min(max(multiplier, 1), 2**MULTIPLIER_BITS - 1)
        shifts[i] = shift
    return Requantisation(multipliers, shifts)
