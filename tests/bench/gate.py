"""What the gate is worth: PSNR of the default beside both methods that it chooses from.

``python -m tests.bench.gate --out FOLDER``: on the judged scenes, as far as they are rendered, with
the networks that come with ExWarp and with spoilt ones. `--causal` is for W and E.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from exwarp_cli.io.dataset import RenderedScene, find_scenes
from exwarp_cli.models.model_file import shipped_folder

SEED = 1

SMALL = 64
"""Values of an array that is left as it is, at most."""


def main(arguments: Sequence[str] | None = None) -> int:
    options = _options(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    shipped = "extrapolator" if options.causal else "lookahead"
    cheap, dear = ("s6", "s3") if options.causal else ("softsplat", "lookahead")
    default = ["--causal"] if options.causal else []
    option = "--extrapolator" if options.causal else "--interpolator"
    scenes = find_scenes(options.data, None if options.scenes else "benchmark", options.scenes)
    rows: list[dict[str, Any]] = []
    path = shipped_folder() / f"{shipped}.onnx"
    models = {noise: spoil(path, noise, options.out) for noise in options.noise}
    for scene in scenes:
        warped = _run(scene, options.out, "-m", cheap)
        for noise, model in models.items():
            found = {
                "gate": _run(scene, options.out, *default, option, model),
                cheap: warped,
                dear: _run(scene, options.out, "-m", dear, option, model),
            }
            scores = {name: part["quality"]["all"]["psnr_db"] for name, part in found.items()}
            trials = found["gate"]["decisions"]["gate"]
            gain = scores["gate"] - max(scores[cheap], scores[dear])
            rows.append({"scene": scene.name, "noise": noise, **scores, "trials": trials})
            used = ", ".join(f"{trial['used']} {len(trial['keys'])}" for trial in trials)
            values = " | ".join(f"{score:.2f}" for score in scores.values())
            print(f"| {scene.name} | {noise:g} | {values} | {gain:+.3f} | {used} |", flush=True)
    text = json.dumps(rows, indent=1) + "\n"
    (options.out / "gate.json").write_text(text, encoding="utf-8")
    return 0


def spoil(path: Path, noise: float, folder: Path) -> Path:
    """Return a copy of a model with noise on its weights, as a share of their deviation."""
    if not noise:
        return path
    model, chance = onnx.load(path), np.random.default_rng(SEED)
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype.kind == "f" and values.size > SMALL:
            spread = noise * float(values.astype(np.float32).std())
            noisy = values + chance.normal(0, spread, values.shape)
            tensor.CopyFrom(numpy_helper.from_array(noisy.astype(values.dtype), tensor.name))
    spoilt = folder / f"{path.stem}-{noise:g}.onnx"
    onnx.save(model, spoilt)
    return spoilt


def _run(scene: RenderedScene, folder: Path, *options: object) -> dict[str, Any]:
    """Upsample a scene's key frames; return the report."""
    instants = scene.folder / "instants"
    command = [
        *(sys.executable, "-m", "exwarp_cli", "upsample", scene.folder / "keys"),
        *("-o", folder / "frames", "--overwrite", "--ground-truth", instants, "--no-tail"),
        *("--progress", "none", "--json", *options),
    ]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True)
    report: dict[str, Any] = json.loads(done.stdout)
    return report


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path.home() / ".cache" / "exwarp" / "scenes")
    parser.add_argument("--scenes", nargs="*", default=[], help="Names; default: all judged ones.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--causal", action="store_true", help="W and E, past key frames alone.")
    parser.add_argument(
        "--noise", type=float, nargs="*", default=[0.0, 0.3, 1.0], help="On the weights."
    )
    return parser.parse_args(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
