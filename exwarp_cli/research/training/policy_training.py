"""Training of the policy: one network for each scene left out, and one from all of them.

Written to the output folder: ``policy.npz`` (integers and floats, what ``exwarp upsample`` runs),
``policy.onnx`` and ``policy-int8.onnx``, ``policy-without-SCENE.npz`` for each scene,
``policy.json`` with every score, and the files' checksums.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.mlp import QuantisedMlp, to_fixed
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import NODES, PATHS
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.files import atomic_write_text, make_folder
from exwarp_cli.models.model_file import CHECKSUMS
from exwarp_cli.models.policy_files import SHIPPED_POLICY, policy_name_without, save_network
from exwarp_cli.policy.state import INPUTS, STATE_VERSION
from exwarp_cli.research.training.onnx_export import export_float, export_integer
from exwarp_cli.research.training.outcome_tables import PolicyTable
from exwarp_cli.research.training.policy_scores import (
    NAMES,
    PolicyScore,
    fit_regression,
    fixed_path,
    greedy_paths,
    oracle_paths,
    predict_rewards,
    score_paths,
    score_random,
)
from exwarp_cli.research.training.q_learning import Layers, q_values, quantise, train_decisions
from exwarp_cli.research.training.training_settings import PolicySettings

F64 = npt.NDArray[np.float64]
F32 = npt.NDArray[np.float32]
Say = Callable[[str], None]

SCHEMA = "exwarp.policy-scores/1"
REPORT = "policy.json"
FLOAT_MODEL, INTEGER_MODEL = "policy.onnx", "policy-int8.onnx"

# Name of all rows of a table, beside "key 427x240" and the like.
ALL = "all"


@dataclass(frozen=True)
class LearnedNetwork:
    """A trained network in both arithmetics."""

    floats: Layers  # Weights float64 [out, in] and biases [out] of each layer.
    network: QuantisedMlp  # In integers

    @property
    def single(self) -> list[tuple[F32, F32]]:
        """The float network's weights and biases in the precision that it was trained in."""
        return [(w.astype(np.float32), b.astype(np.float32)) for w, b in self.floats]

    def values(self, table: PolicyTable) -> F64:
        """Return the float network's outputs, float64 [N, 5, 2]."""
        return q_values(self.floats, table)

    def outputs(self, table: PolicyTable) -> F64:
        """Return the integer network's outputs, float64 [N, 5, 2]."""
        states = to_fixed(table.states.reshape(-1, INPUTS))
        outputs, _ = MlpKernel(self.network).decide_many(states)
        return outputs.astype(np.float64).reshape(-1, len(NODES), 2)


def learn(tables: Sequence[PolicyTable], settings: PolicySettings) -> LearnedNetwork:
    """Train a network on some scenes and quantise it; they are the calibration states too."""
    floats = train_decisions(tables, settings)
    states = np.concatenate([table.states.reshape(-1, INPUTS) for table in tables])
    return LearnedNetwork(floats, quantise([w for w, _ in floats], [b for _, b in floats], states))


def train_policy(
    tables: Sequence[PolicyTable], output: Path, settings: PolicySettings, say: Say
) -> dict[str, Any]:
    """Train the policy with every scene left out once, then on all scenes.

    Takes two scenes at least; returns what ``policy.json`` holds.
    """
    require_two_scenes(len(tables))
    counts = Counter(table.scene for table in tables)
    if twice := sorted(scene for scene, count in counts.items() if count > 1):
        # Each would be judged by a network that saw the other.
        raise InputError(f"two tables are of the scene {twice[0]}; keep one of them")
    make_folder(output)
    folds, written = {}, []
    for index, table in enumerate(tables):
        training_tables = [t for i, t in enumerate(tables) if i != index]
        say(f"without {table.scene}: training on {', '.join(t.scene for t in training_tables)}")
        learned = learn(training_tables, settings)
        name = policy_name_without(table.scene)
        _save(output / name, learned, training_tables, settings)
        written.append(name)
        folds[table.scene] = _judge(learned, table, training_tables)
        say(f"without {table.scene}: {_score_text(folds[table.scene][ALL])}")
    say(f"training on all {len(tables)} scenes")
    final = learn(tables, settings)
    _save(output / SHIPPED_POLICY, final, tables, settings, has_floats=True)
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
                "groups": _group_sizes(table),
                "extrapolator": table.network,
            }
            for table in tables
        },
        "left_out": folds,
    }
    atomic_write_text(output / REPORT, json.dumps(report, separators=(",", ":")) + "\n")
    add_checksums(output, [SHIPPED_POLICY, FLOAT_MODEL, INTEGER_MODEL, *written])
    return report


def require_two_scenes(count: int) -> None:
    """Raise InputError for fewer scenes than a policy can be judged with."""
    if count < 2:
        raise InputError(
            "a policy is judged on a scene that it was not trained on, and there is only one; "
            "render another, or name it with --tables"
        )


def rows_by_part(table: PolicyTable) -> dict[str, npt.NDArray[np.bool_]]:
    """Return the rows of each part of a table: all, and each setting at each size."""
    names = np.array([f"{name.split('-')[0]} {name.split()[-1]}" for name in table.groups])
    names = names[table.group]
    parts = {ALL: np.ones(len(table), np.bool_)}
    return parts | {str(name): names == name for name in sorted(set(names))}


def _group_sizes(table: PolicyTable) -> dict[str, int]:
    names = np.array(table.groups)[table.group]
    return {name: int((names == name).sum()) for name in dict.fromkeys(table.groups)}


def _judge(
    learned: LearnedNetwork, table: PolicyTable, training_tables: Sequence[PolicyTable]
) -> dict[str, Any]:
    """Score a policy on a scene that it never saw, beside what it competes with."""
    floats, integers = learned.values(table), learned.outputs(table)
    policies = {
        "exwarp": greedy_paths(integers),
        "float": greedy_paths(floats),
        "regressor": greedy_paths(predict_rewards(fit_regression(training_tables), table)),
        **oracle_paths(table),
        **{name: fixed_path(table, name) for name in PATHS},
    }
    agrees = (floats[..., 1] > floats[..., 0]) == (integers[..., 1] > integers[..., 0])
    passed = np.array([[node in PATHS[name].choices for node in NODES] for name in NAMES])
    is_met = passed[policies["exwarp"]]  # [N, 5]: the nodes that the policy's paths pass
    judgement: dict[str, Any] = {}
    for part, rows in rows_by_part(table).items():
        scores = {name: asdict(score_paths(table, paths, rows)) for name, paths in policies.items()}
        scores["random"] = asdict(score_random(table, rows))
        judgement[part] = {
            "scores": scores,
            "agreement": float(agrees[rows].mean()),
            "agreement_met": float(agrees[rows][is_met[rows]].mean()),
        }
    return judgement


def _save(
    path: Path,
    learned: LearnedNetwork,
    tables: Sequence[PolicyTable],
    settings: PolicySettings,
    has_floats: bool = False,
) -> None:
    metadata = {
        "about": "ExWarp's predictor: deep Q-learning on rendered scenes",
        "state": STATE_VERSION,
        "scenes": [table.scene for table in tables],
        "settings": asdict(settings),
        "extrapolator": sorted({table.network for table in tables}),
    }
    save_network(path, learned.network, metadata, learned.single if has_floats else ())


def add_checksums(folder: Path, names: Sequence[str]) -> None:
    """Write the files' checksums beside those that are there."""
    path = folder / CHECKSUMS
    try:
        checksums = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(
            f"{path} is no JSON ({error}); remove it, or write to another folder with -o"
        ) from error
    for name in names:
        checksums[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    atomic_write_text(path, json.dumps(checksums, indent=1, sort_keys=True) + "\n")


def _score_text(part: dict[str, Any]) -> str:
    scores = {name: PolicyScore(**score) for name, score in part["scores"].items()}
    best = max(scores[name].psnr_db for name in PATHS)
    own, oracle = scores["exwarp"], scores["oracle"]
    return (
        f"return {own.reward:.3f}, PSNR {own.psnr_db:.3f} dB; best fixed path {best:.3f}, "
        f"oracle {oracle.psnr_db:.3f}; int8 agrees on {part['agreement']:.2%}"
    )
