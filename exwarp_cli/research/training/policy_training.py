"""Training of the policy: one network for each scene left out, and one from all of them.

Written to the output folder: ``policy.npz`` (integers and floats, what ``exwarp upsample`` runs),
``policy.onnx`` and ``policy-int8.onnx``, ``policy-without-SCENE.npz`` for each scene,
``policy.json`` with every score, and the files' checksums. Policies are scored on a table beside
fixed paths, oracles and a linear regression.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.mlp import QuantisedMlp
from exwarp_cli.domain.decision import EXTRAPOLATE, NODES, PATHS, WARP, walk_tree
from exwarp_cli.domain.frame import Bool
from exwarp_cli.domain.settings import DEFAULT_FPS
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.files import atomic_write_text, make_folder
from exwarp_cli.models.model_file import CHECKSUMS
from exwarp_cli.models.policy_files import SHIPPED_POLICY, policy_name_without, save_network
from exwarp_cli.policy import outcomes
from exwarp_cli.policy.state import STATE_VERSION
from exwarp_cli.research.training import q_learning
from exwarp_cli.research.training.onnx_export import export_float, export_integer
from exwarp_cli.research.training.outcome_tables import F64, PolicyTable, Say, TrainingTable
from exwarp_cli.research.training.training_settings import PolicySettings, TilePolicySettings

Paths = npt.NDArray[np.intp]

SCHEMA = "exwarp.policy-scores/1"
ABOUT = "ExWarp's predictor: deep Q-learning on rendered scenes"  # in the policy's metadata
REPORT = "policy.json"
FLOAT_MODEL, INTEGER_MODEL = "policy.onnx", "policy-int8.onnx"

# Name of all rows of a table, beside "key 427x240" and the like.
ALL = "all"

NAMES = tuple(PATHS)

# Weight of the squared coefficients beside the mean squared error, in units of the inputs.
RIDGE = 1e-2

# Of the Markdown tables, and how some policies are called there.
COLUMNS = ("exwarp", *PATHS, "oracle", "oracle-return", "regressor", "random")
TITLES = {
    "exwarp": "policy",
    "oracle": "best PSNR",
    "oracle-return": "best return",
    "regressor": "regression",
}


def train_policy(
    tables: Sequence[PolicyTable], output: Path, settings: PolicySettings, say: Say
) -> dict[str, Any]:
    """Train with every scene left out once, then on all; return what ``policy.json`` holds."""
    require_two_scenes(len(tables))
    counts = Counter(table.scene for table in tables)
    if twice := sorted(scene for scene, count in counts.items() if count > 1):
        # Each would be judged by a network that saw the other.
        raise InputError(f"two tables are of the scene {twice[0]}; keep one of them")
    make_folder(output)
    folds: dict[str, Any] = {}
    written = [SHIPPED_POLICY, FLOAT_MODEL, INTEGER_MODEL]
    for left_out in tables:
        known = [table for table in tables if table is not left_out]
        say(f"without {left_out.scene}: training on {', '.join(table.scene for table in known)}")
        floats = q_learning.train_decisions(known, settings)
        network = q_learning.quantise(floats, np.concatenate([table.states for table in known]))
        written.append(policy_name_without(left_out.scene))
        metadata = describe_policy(ABOUT, STATE_VERSION, known, settings)
        save_network(output / written[-1], network, metadata)
        folds[left_out.scene] = _judge(floats, network, left_out, known)
        whole = folds[left_out.scene][ALL]
        scores = whole["scores"]
        own, oracle = scores["exwarp"], scores["oracle"]
        best = max(scores[path]["psnr_db"] for path in PATHS)
        say(
            f"without {left_out.scene}: return {own['reward']:.3f}, PSNR {own['psnr_db']:.3f} dB; "
            f"best fixed path {best:.3f}, oracle {oracle['psnr_db']:.3f}; "
            f"int8 agrees on {whole['agreement']:.2%}"
        )
    say(f"training on all {len(tables)} scenes")
    floats = q_learning.train_decisions(tables, settings)
    network = q_learning.quantise(floats, np.concatenate([table.states for table in tables]))
    # In the precision that they were trained in.
    single = [(w.astype(np.float32), b.astype(np.float32)) for w, b in floats]
    metadata = describe_policy(ABOUT, STATE_VERSION, tables, settings)
    save_network(output / SHIPPED_POLICY, network, metadata, single)
    export_float(single, output / FLOAT_MODEL)
    export_integer(network, output / INTEGER_MODEL)
    report = {
        "schema": SCHEMA,
        "settings": asdict(settings),
        "tables": {
            table.scene: {
                "intervals": len(table),
                "points": len(table) * len(NODES),
                "groups": {
                    name: int((np.array(table.groups)[table.group] == name).sum())
                    for name in dict.fromkeys(table.groups)
                },
                "extrapolator": table.network,
            }
            for table in tables
        },
        "left_out": folds,
    }
    atomic_write_text(output / REPORT, json.dumps(report, separators=(",", ":")) + "\n")
    add_checksums(output, written)
    return report


def describe_policy(
    about: str,
    state: str | int,
    tables: Sequence[TrainingTable],
    settings: PolicySettings | TilePolicySettings,
) -> dict[str, Any]:
    """Return the metadata of a policy; `state` is the version of its inputs."""
    return {
        "about": about,
        "state": state,
        "scenes": [table.scene for table in tables],
        "settings": asdict(settings),
        "extrapolator": sorted({table.network for table in tables}),
    }


def require_two_scenes(count: int) -> None:
    """Raise InputError for fewer scenes than a policy can be judged with."""
    if count < 2:
        raise InputError(
            "a policy is judged on a scene that it was not trained on, and there is only one; "
            "render another, or name it with --tables"
        )


def _judge(
    network_floats: q_learning.Layers,
    network: QuantisedMlp,
    table: PolicyTable,
    training_tables: Sequence[PolicyTable],
) -> dict[str, Any]:
    """Score a policy on a scene that it never saw, beside what it competes with."""
    floats = q_learning.q_values(network_floats, table)
    integers = q_learning.integer_values(network, table.states)
    taken = greedy_paths(integers)
    policies = {
        "exwarp": taken,
        "float": greedy_paths(floats),
        "regressor": greedy_paths(predict_rewards(training_tables, table)),
        "oracle": outcomes.best_psnr(table.outcomes),
        "oracle-return": outcomes.best_return(table.outcomes),
        **{name: np.full(len(table), index) for index, name in enumerate(NAMES)},
        "random": None,
    }
    agrees = (floats[..., 1] > floats[..., 0]) == (integers[..., 1] > integers[..., 0])
    passed = np.array([[node in PATHS[name].choices for node in NODES] for name in NAMES])
    is_met = passed[taken]  # [N, 5]: the nodes that the policy's paths pass
    judgement: dict[str, Any] = {}
    # The parts of the table: all, and each setting at each size.
    names = np.array([f"{name.split('-')[0]} {name.split()[-1]}" for name in table.groups])
    part_of_row = names[table.group]
    parts: dict[str, Bool] = {ALL: np.ones(len(table), np.bool_)}
    parts |= {str(part): part_of_row == part for part in sorted(set(part_of_row))}
    for part, rows in parts.items():
        judgement[part] = {
            "scores": {name: score_paths(table, paths, rows) for name, paths in policies.items()},
            "agreement": float(agrees[rows].mean()),
            "agreement_met": float(agrees[rows][is_met[rows]].mean()),
        }
    return judgement


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


def score_paths(table: PolicyTable, paths: Paths | None, rows: Bool) -> dict[str, Any]:
    """Score the paths, an index each, that some rows of a table took: means over key intervals.

    None is for what tossing a coin at every node comes to on average, exactly.
    """
    judged = table.outcomes[rows]
    taken: list[int] = []
    decisions = np.array([len(path.choices) for path in PATHS.values()])
    if paths is None:
        shares = np.tile(0.5**decisions, (len(judged), 1))
    else:
        shares = np.eye(len(NAMES))[paths[rows]]
        taken = [int(n) for n in shares.sum(axis=0)]
    quality = outcomes.slot_quality(judged).mean(axis=-2)
    generated = np.array([path.generated for path in PATHS.values()])
    warps = np.array([list(path.choices.values()).count(WARP) for path in PATHS.values()])
    per_path = shares.mean(axis=0)
    return {
        "intervals": len(judged),
        # Undiscounted sum of the rewards of an interval.
        "reward": float((shares * outcomes.path_returns(judged)).sum(axis=1).mean()),
        # Of what is shown at slots 1 to 3.
        "psnr_db": float((shares * quality[..., 0]).sum(axis=1).mean()),
        "ssim": float((shares * quality[..., 1]).sum(axis=1).mean()),
        # Of an interval; effective FPS is base FPS times one more than this.
        "new_frames": float(per_path @ generated),
        "warp_share": float(per_path @ warps / (per_path @ decisions)),  # of the decisions, 0 to 1
        "paths": taken,  # intervals by path, S1 to S6
    }


def greedy_paths(values: npt.NDArray[Any]) -> Paths:
    """Return the path of each interval by values [N, 5, 2]: the larger wins, ties go to warping."""
    paths = []
    for row in np.where(values[..., 1] > values[..., 0], EXTRAPOLATE, WARP).tolist():
        choices = dict(zip(NODES, row, strict=True))
        paths.append(NAMES.index(walk_tree(choices.__getitem__)))
    return np.array(paths, np.intp)


def predict_rewards(tables: Sequence[PolicyTable], table: PolicyTable) -> F64:
    """Return the reward of both choices at every node of a table, float64 [N, 5, 2].

    A linear regression, node by node, of some scenes' rewards on the 44 inputs and a constant.
    """
    states = np.concatenate([known.states for known in tables])
    gains = np.concatenate([outcomes.choice_rewards(known.outcomes) for known in tables])
    # Scenes count alike, whatever their size.
    weights = np.concatenate([np.full(len(known), 1 / len(known)) for known in tables])
    coefficients = []
    for node in range(len(NODES)):
        x = np.concatenate([states[:, node], np.ones((len(states), 1))], axis=1)
        scaled = x * weights[:, None] / weights.sum()
        coefficients.append(
            np.linalg.solve(scaled.T @ x + RIDGE * np.eye(x.shape[1]), scaled.T @ gains[:, node])
        )
    inputs = np.concatenate([table.states, np.ones((len(table), len(NODES), 1))], axis=2)
    return np.asarray(np.einsum("nki,kic->nkc", inputs, np.array(coefficients)))


def policy_card(report: dict[str, Any]) -> str:
    """Return the tables of what ``policy.json`` holds: every scene when it was left out.

    One table for PSNR and SSIM, one for return, one for what was chosen.
    """
    rows = [
        (scene, part, scores)
        for scene, parts in report["left_out"].items()
        for part, scores in parts.items()
        if part != "all"
    ]
    titles = [TITLES.get(name, name) for name in COLUMNS]
    quality, gains, choices = list[list[str]](), list[list[str]](), list[list[str]]()
    for scene, part, entry in rows:
        scores = [entry["scores"][name] for name in COLUMNS]
        best = max(score["psnr_db"] for score in scores[1 : 1 + len(PATHS)])
        cells = [f"{score['psnr_db']:.2f} / {score['ssim']:.3f}" for score in scores]
        marked = (
            f"**{cell}**" if score["psnr_db"] == best and name in PATHS else cell
            for name, score, cell in zip(COLUMNS, scores, cells, strict=True)
        )
        quality.append([scene, part, *marked])
        gains.append([scene, part, *(f"{score['reward']:.2f}" for score in scores)])
        own = entry["scores"]["exwarp"]
        fps = float(DEFAULT_FPS) * (1 + own["new_frames"])
        counts = (str(count) for count in (own["intervals"], *own["paths"]))
        shares = (f"{own['warp_share']:.1%}", f"{fps:.1f}", f"{entry['agreement']:.2%}")
        choices.append([scene, part, *counts, *shares])
    means = (
        sum(entry["scores"][name]["reward"] for _, _, entry in rows) / len(rows) for name in COLUMNS
    )
    gains.append(["**mean**", "", *(f"{mean:.3f}" for mean in means)])
    shares_of = ("intervals", *PATHS, "warps", "effective fps", "int8 = float")
    tables = (
        markdown_table(["scene", "frames", *titles], quality),
        markdown_table(["return", "frames", *titles], gains),
        markdown_table(["scene", "frames", *shares_of], choices),
    )
    return "\n\n".join(tables)


def markdown_table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (titles, *rows)]
    lines.insert(1, "|" + "---|" * len(titles))
    return "\n".join(lines)
