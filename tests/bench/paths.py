"""Quality of every method on rendered scenes, in both settings; E against W where E works.

``python -m tests.bench.paths --data FOLDER``: needs the five benchmark scenes, which
``make scenes`` renders. Each scene and setting is kept as it is done, so a broken run goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import SURFACE_PARTS, Bool, Float32
from exwarp_cli.domain.network_api import Extrapolator
from exwarp_cli.domain.results import FrameKind, Score
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.dataset import find_scenes
from exwarp_cli.kernels import _row_bands
from exwarp_cli.metrics.registry import METRICS, score_frame
from exwarp_cli.models.picture_network import load_extrapolator
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.synthesis.methods import METHODS
from tests.bench.card import table
from tests.unit.filled import without

ALONE = {name: made.predict for name, made in METHODS.items() if made.predict is not None}
"""How methods that no judge chooses paths for make a frame."""

SETTINGS = ("key", "slot")
DROPPED = {
    "full": (),
    "diffuse": SURFACE_PARTS[1:],
    "none": SURFACE_PARTS,
}
"""What of the surface is left out, by the name of what is there."""

FIRST = 2
"""Of the key frames that are judged: from here on all have two others before them."""


@dataclass(frozen=True)
class Task:
    """One scene in one setting."""

    data: Path
    scene: str
    setting: str
    model: Path | None
    surface: str
    every: int
    methods: tuple[str, ...]
    out: Path


def main(arguments: Sequence[str] | None = None) -> int:
    options = _options(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    found = find_scenes(options.data, None if options.scenes else "benchmark", options.scenes)
    tasks = [
        Task(
            options.data, scene.name, setting, options.model, options.surface, options.every,
            tuple(options.methods), options.out,
        )
        for scene in found
        for setting in options.settings
    ]  # fmt: skip
    if options.jobs == 1:
        rows = [_judge(task) for task in tasks]
    else:
        with ProcessPoolExecutor(options.jobs) as pool:
            rows = list(pool.map(_judge, tasks))
    (options.out / "paths.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(table(rows))
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m tests.bench.paths", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("~/.cache/exwarp/scenes").expanduser())
    parser.add_argument("--scenes", nargs="*", default=[])
    parser.add_argument("--settings", nargs="*", default=SETTINGS, choices=SETTINGS)
    parser.add_argument("--methods", nargs="*", default=list(ALONE), choices=list(ALONE))
    parser.add_argument("--model", type=Path, help="default: the one that comes with ExWarp")
    parser.add_argument("--surface", choices=DROPPED, default="full", help="AOVs that are there")
    parser.add_argument("--every", type=int, default=1, help="judge every so many key intervals")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, required=True, help="folder for what was measured")
    return parser.parse_args(arguments)


def _judge(task: Task) -> dict[str, Any]:
    """Score one scene in one setting, or take what an earlier run found."""
    network = load_extrapolator(task.model, 1, "cpu")
    token = f"{task.scene}-{task.setting}-{network.checksum[:12]}-{task.surface}-{task.every}"
    token += f"-{hashlib.sha256(','.join(task.methods).encode()).hexdigest()[:6]}"
    kept = task.out / f"{token}.json"
    if kept.exists():
        found: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return found
    _row_bands.set_threads(1)
    (scene,) = find_scenes(task.data, names=[task.scene])
    footage = SceneClip(scene)
    sums: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for k in range(FIRST, len(footage.intervals), task.every):
        for name, values in _interval(footage, k, task, network):
            for key, value in values.items():
                sums[name][key].append(value)
    row = {
        "scene": task.scene, "setting": task.setting, "surface": task.surface, "every": task.every,
        "checksum": network.checksum, "methods": {n: _means(v) for n, v in sums.items()},
    }  # fmt: skip
    kept.write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
    print(f"{task.scene} {task.setting} done", file=sys.stderr, flush=True)
    return row


def _interval(
    footage: SceneClip, k: int, task: Task, network: Extrapolator
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield method, or method and slot, with the scores of one frame."""
    causal, ahead = footage.causal(k, task.setting), footage.interval(k, task.setting)
    interval = replace(
        without(causal, *DROPPED[task.surface]), following=ahead.following, extrapolator=network
    )
    known: dict[bytes, tuple[Score, Score | None]] = {}
    for slot in range(1, FACTOR):
        truth = footage.truth(k, slot).pixels
        mask = interval.hole_mask(slot)
        for name in task.methods:
            made = ALONE[name](interval, slot)
            scores = _scored(truth, made.pixels, mask, known)
            values = _flat(*scores) | {"new": float(made.kind is not FrameKind.DROPPED)}
            yield name, values
            yield f"{name}@{slot}", values


def _scored(
    truth: Float32, made: Float32, mask: Bool | None, known: dict[bytes, Any]
) -> tuple[Score, Score | None]:
    """Score a frame, once for all the methods that show it."""
    token = hashlib.sha1(truth.tobytes() + made.tobytes()).digest()
    if token not in known:
        known[token] = score_frame(truth, made, mask)
    found: tuple[Score, Score | None] = known[token]
    return found


def _flat(everywhere: Score, holes: Score | None) -> dict[str, float]:
    out = {name: value for name, value in asdict(everywhere).items() if name in METRICS}
    if holes is not None:
        out |= {f"holes_{name}": value for name, value in asdict(holes).items() if name in METRICS}
    return out


def _means(values: dict[str, list[float]]) -> dict[str, float]:
    return {key: float(np.mean(found)) for key, found in values.items()} | {
        "frames": len(values["psnr_db"])
    }


if __name__ == "__main__":
    sys.exit(main())
