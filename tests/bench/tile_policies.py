"""What the policy of tiles gains when it learns from coarse depth, still cameras and a bad E, too.

``python -m tests.bench.tile_policies --out FOLDER``. Tables are measured once, and kept. Each
judged scene is left out with all that was made of it, and judged with full and with coarse depth.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from exwarp_cli.io.dataset import BENCHMARK, TRAINING, RenderedScene, find_scenes
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.picture_network import (
    SHIPPED_EXTRAPOLATOR,
    OnnxExtrapolator,
    load_extrapolator,
)
from exwarp_cli.research.training.augmentation import PLAIN, Look
from exwarp_cli.research.training.outcome_tables import read_tables
from exwarp_cli.research.training.tile_policy_training import (
    SHARES,
    TILE_TABLES,
    VARIANTS,
    TileTable,
    choice_margins,
    gain_percent,
    price_for,
    train_tiles,
)
from exwarp_cli.research.training.training_settings import TilePolicySettings

COARSE = Look(depth="coarse")

# Every second variant: what is measured is learned from beside the tables that come with ExWarp.
HALF = VARIANTS[::2]

# Standard deviation of the noise that spoils a kernel's weights, in that of the weights.
SPOILT = 0.2

LEARNED = ((), ("coarse",), ("still",), ("coarse", "still"), ("coarse", "still", "spoilt"))


def main() -> None:
    parser = argparse.ArgumentParser("tests.bench.tile_policies", description=__doc__)
    cache = Path.home() / ".cache" / "exwarp"
    parser.add_argument("--data", type=Path, default=cache / "scenes")
    parser.add_argument("--still", type=Path, default=cache / "still", help="Rendered shots.")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    own, bad = load_extrapolator(None, 1, "cpu"), spoilt(options.out)
    judged, still = find_scenes(options.data, BENCHMARK), find_scenes(options.still, TRAINING)
    shipped = read_tables(TileTable, shipped_folder() / TILE_TABLES)
    others = {
        "coarse": [measured(options.out, "coarse", s, own, COARSE) for s in judged],
        "still": [measured(options.out, "still", s, own) for s in still],
        "spoilt": [measured(options.out, "spoilt", s, bad) for s in judged],
    }
    for kinds in LEARNED:
        extra = list(itertools.chain.from_iterable(others[kind] for kind in kinds))
        print(", ".join(kinds) or "nothing else", *scores(shipped, extra, others["coarse"]))


def spoilt(folder: Path) -> OnnxExtrapolator:
    """Write E with noise on its kernels, and load it."""
    model, rng = onnx.load(shipped_folder() / SHIPPED_EXTRAPOLATOR), np.random.default_rng(0)
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.ndim == 4:
            noise = rng.standard_normal(values.shape).astype(np.float32)
            made = values + SPOILT * values.std() * noise
            tensor.CopyFrom(numpy_helper.from_array(made.astype(np.float32), tensor.name))
    path = folder / "spoilt.onnx"
    onnx.save(model, path)
    return load_extrapolator(path, 1, "cpu")


def measured(
    folder: Path, kind: str, scene: RenderedScene, network: OnnxExtrapolator, look: Look = PLAIN
) -> TileTable:
    """Measure a scene's tiles, or read what was measured before."""
    variants = VARIANTS if kind == "still" else HALF
    path = folder / f"{scene.name}-{kind}.npz"
    table = TileTable.load(path) if path.exists() else None
    if table is None or table.network != network.checksum:
        TileTable.measure(scene, network, print, look, variants).save(path)
        table = TileTable.load(path)
    return table


def scores(
    tables: Sequence[TileTable], extra: Sequence[TileTable], coarse: Sequence[TileTable]
) -> tuple[str, str]:
    """Return what is gained in % at each of `SHARES`, with full and with coarse depth."""
    unseen: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    for table in tables:
        others = [one for one in (*tables, *extra) if one.scene != table.scene]
        network = train_tiles(others, TilePolicySettings())
        of_scene = next(one for one in coarse if one.scene == table.scene)
        for margins, judged in zip(unseen, (table, of_scene), strict=True):
            margins.append(choice_margins(network, judged))
    full, few_bits = (
        "/".join(
            f"{gain_percent(judged, margins, price_for(share, margins, TileTable.cost)):.0f}"
            for share in SHARES
        )
        for judged, margins in zip((tables, coarse), unseen, strict=True)
    )
    return f"full depth {full}", f"10 bits {few_bits}"


if __name__ == "__main__":
    main()
