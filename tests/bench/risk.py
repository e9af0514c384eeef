"""How well the error of new frames is predicted, on the judged scenes, each left out in turn.

``python -m tests.bench.risk --out FOLDER``: prints figures, and weights for
`synthesis.predicted_error`. What was measured of a scene is kept in FOLDER, so that a second run
fits again in seconds.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.stats import spearmanr

from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.tiles import TILE_ROWS, tile_edges
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.dataset import RenderedScene, find_scenes
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.synthesis import predicted_error
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS, terms_of_warp
from exwarp_cli.synthesis.predicted_error import TERMS, Formula, terms_of, weigh_terms
from tests.bench.pictures import rendered_intervals
from tests.bench.quality import shown_pixels

F64 = npt.NDArray[np.float64]

SCENES = ("lab", "town", "tropical", "village", "arena", "courtyard")

KINDS = {
    "softsplat": predicted_error.MIXED,
    "s6": predicted_error.WARPED,
    "s6, first": predicted_error.FIRST_WARPED,
}
"""Kinds of frames, each with its formula; those after the first key frame are one of their own."""

LEAST = 0.25
"""Mean squared error, squared display levels, below which tiles count as equally good."""

BINS = (0.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 20.0, 255.0)
"""Edges of predicted errors, RMS display levels, for the table of reliability."""


@dataclass(frozen=True)
class Samples:
    """Frames of one kind.

    Attributes
    ----------
    times
        float64 [N], of the slots.
    terms
        float64 [N, len(TERMS), rows, columns].
    squares
        float64 [N, rows, columns]: true mean squared error of each tile, squared display levels.
    """

    times: F64
    terms: F64
    squares: F64

    def predict(self, formula: Formula) -> F64:
        """Return the predicted mean squared error of each tile, [N, rows, columns]."""
        pairs = zip(self.terms, self.times, strict=True)
        return np.stack(
            [weigh_terms(terms, formula, float(time)).sum(axis=0) for terms, time in pairs]
        )


Measured = dict[str, Samples]
"""By kind."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.risk", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("~/.cache/exwarp/scenes").expanduser())
    parser.add_argument("--scenes", nargs="*", default=SCENES)
    parser.add_argument("--out", type=Path, required=True, help="folder for what was measured")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    found = find_scenes(options.data, "benchmark", list(options.scenes))
    measured = {scene.name: _measured(scene, options.out) for scene in found}
    for kind, shipped in KINDS.items():
        samples = {name: of_scene[kind] for name, of_scene in measured.items()}
        _report(kind, samples, shipped)
    return 0


def _measured(scene: RenderedScene, folder: Path) -> Measured:
    """Measure a scene, or read what was measured."""
    file = folder / f"{scene.name}.npz"
    if not file.is_file():
        made = measure(scene)
        np.savez_compressed(
            file,
            **{
                f"{kind}/{field}": getattr(samples, field)
                for kind, samples in made.items()
                for field in ("times", "terms", "squares")
            },
        )
    kept = np.load(file)
    return {
        kind: Samples(*(kept[f"{kind}/{field}"] for field in ("times", "terms", "squares")))
        for kind in KINDS
    }


def measure(scene: RenderedScene) -> Measured:
    """Make the frames of a scene by both methods, and compare them with the truth."""
    footage = SceneClip(scene)
    rows: dict[str, list[tuple[float, F64, F64]]] = {kind: [] for kind in KINDS}
    for k in range(rendered_intervals(scene)):
        ahead, causal = footage.interval(k, "key"), footage.causal(k, "key")
        warped = "s6" if causal.past else "s6, first"
        for slot in range(1, FACTOR):
            instant = scene.manifest.instants.first + FACTOR * k + slot
            truth = shown_pixels(scene.folder / "instants" / f"{scene.name}.{instant:04d}.exr")
            rows["softsplat"].append(_mixed(ahead, slot, truth))
            rows[warped].append(_warped(causal, slot, truth))
    print(f"{scene.name}: {sum(map(len, rows.values()))} frames measured", flush=True)
    return {kind: Samples(*map(np.array, zip(*own, strict=True))) for kind, own in rows.items()}


def _mixed(interval: Interval, slot: int, truth: Float32) -> tuple[float, F64, F64]:
    """Return time, terms and true error of a frame of both key frames."""
    assert interval.following is not None
    mixer = interval.look_ahead(slot)
    made = mixer.make(interval.key.image.pixels, interval.following.image.pixels)
    assert mixer.evidence is not None
    terms = terms_of(interval.tiles, mixer.evidence, interval.residual, made)
    return interval.time(slot), terms, _squares(interval, made, truth)


def _warped(interval: Interval, slot: int, truth: Float32) -> tuple[float, F64, F64]:
    """Return time, terms and true error of a frame of the key frame before."""
    predict = METHODS["s6"].predict
    assert predict is not None
    made = predict(interval, slot).pixels
    terms = terms_of_warp(interval, slot, made)
    return interval.time(slot), terms, _squares(interval, made, truth)


def _squares(interval: Interval, made: Float32, truth: Float32) -> F64:
    """Return the true mean squared error of each tile, of all its pixels."""
    apart = ((encode_display(made) - encode_display(truth)) ** 2).mean(axis=-1, dtype=np.float64)
    down, across = (
        tile_edges(apart.shape[0], TILE_ROWS),
        tile_edges(apart.shape[1], interval.tiles.columns),
    )
    sums = np.add.reduceat(np.add.reduceat(apart, down[:-1], axis=0), across[:-1], axis=1)
    return np.asarray(sums / np.outer(np.diff(down), np.diff(across)))


def fit(each: Iterable[Samples], like: Formula) -> Formula:
    """Return the weights, 0 or more, whose logarithm of the error is least wrong.

    Parameters
    ----------
    each
        Frames of one kind, by scene.
    like
        Of the kind; terms of weight 0 stay out.
    """
    parts = list(each)
    used = [i for i, weight in enumerate(like.weights) if weight > 0]
    columns, squares = [], np.concatenate([part.squares.ravel() for part in parts])
    for i in used:
        alone = Formula(tuple(float(i == j) for j in range(len(TERMS))), like.two_sided)
        columns.append(np.concatenate([part.predict(alone).ravel() for part in parts]))
    terms, goal = np.stack(columns, axis=1), np.log(squares + LEAST)

    def loss(logs: F64) -> float:
        wrong = np.log(terms @ np.exp(logs) + LEAST) - goal
        # Tiles that are wrong for reasons that nothing tells must not lead.
        return float(np.mean(np.sqrt(1 + wrong * wrong))) + 1e-4 * float(np.mean(logs * logs))

    start = np.full(len(used), math.log(0.05))
    found = minimize(loss, start, method="L-BFGS-B", bounds=[(-12, 3)] * len(used)).x
    weights = [0.0] * len(TERMS)
    for i, value in zip(used, np.exp(found), strict=True):
        weights[i] = float(value)
    return Formula(tuple(weights), like.two_sided)


def _report(kind: str, samples: dict[str, Samples], shipped: Formula) -> None:
    """Print how good predictions are of scenes that the weights never saw, then the weights."""
    print(f"\n{kind}\n| scene | tiles | tiles of a frame | frames | predicted | measured |")
    print("|---|---:|---:|---:|---:|---:|")
    predicted, true = [], []
    for name, own in samples.items():
        others = (part for scene, part in samples.items() if scene != name)
        expected = own.predict(fit(others, shipped))
        predicted.append(expected)
        true.append(own.squares)
        print(_row(name, expected, own.squares))
    every = np.concatenate(predicted), np.concatenate(true)
    print(_row("all", *every))
    _print_reliability(*every)
    weights = fit(samples.values(), shipped).weights
    print("weights:", ", ".join(f"{name} {w:.4g}" for name, w in zip(TERMS, weights, strict=True)))
    print("shipped:", shipped.weights)


def _row(name: str, predicted: F64, true: F64) -> str:
    """Write rank correlations over all tiles, within frames and of frames; and RMS errors."""
    frames = predicted.mean(axis=(1, 2)), true.mean(axis=(1, 2))
    within = np.mean([_rank(a, b) for a, b in zip(predicted, true, strict=True)])
    ranks = f"{_rank(predicted, true):.2f} | {within:.2f} | {_rank(*frames):.2f}"
    rms = [math.sqrt(float(squares.mean())) for squares in (predicted, true)]
    return f"| {name} | {ranks} | {rms[0]:.1f} | {rms[1]:.1f} |"


def _rank(one: F64, other: F64) -> float:
    return float(spearmanr(one.ravel(), other.ravel())[0])


def _print_reliability(predicted: F64, true: F64) -> None:
    """Print the measured error of tiles by what was predicted, in bins."""
    expected, found = np.sqrt(predicted).ravel(), true.ravel()
    print("| predicted RMS | tiles | mean predicted | measured |\n|---|---:|---:|---:|")
    for low, high in pairwise(BINS):
        inside = (expected >= low) & (expected < high)
        if inside.any():
            mean = math.sqrt(float((expected[inside] ** 2).mean()))
            measured = math.sqrt(float(found[inside].mean()))
            print(f"| {low:g}-{high:g} | {inside.sum()} | {mean:.1f} | {measured:.1f} |")


if __name__ == "__main__":
    sys.exit(main())
