"""Tables of tiles: what a policy sees of each, and how wrong every maker's pixels are there.

One file a scene, so that a policy is trained and judged again without rendering or E.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import EXTRAPOLATE, WARP
from exwarp_cli.domain.tiles import REWARP, TILE_FEATURES
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import UsageError
from exwarp_cli.io.dataset import BENCHMARK, RenderedScene, find_scenes
from exwarp_cli.io.files import make_folder
from exwarp_cli.metrics.display import encode_display
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.picture_network import OnnxExtrapolator
from exwarp_cli.models.policy_files import Array
from exwarp_cli.policy.state import INPUTS, TILE_NODES, scale_tile_features, tile_inputs
from exwarp_cli.research.training.augmentation import Variant
from exwarp_cli.research.training.outcome_tables import (
    extrapolator,
    read_tables,
    reading_table,
    require_no_tables,
    require_shape,
    write_table,
)
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.interval import Interval, tile_features
from exwarp_cli.synthesis.methods import predict_path

F64 = npt.NDArray[np.float64]

SCHEMA = "exwarp.tile-table/1"

# What errors are of: slot, maker, and a path whose frame shows it.
MADE = ((2, WARP, "S6"), (2, EXTRAPOLATE, "S3"), (3, WARP, "S6"), (3, EXTRAPOLATE, "S3"),
        (3, REWARP, "S4"))  # fmt: skip

# Folder of the tables of tiles, beside the models.
TILE_TABLES = "tiles"

# Variants of each scene: every instant as a key frame, and time in both directions.
VARIANTS = tuple(
    Variant(phase, backwards=back) for back in (False, True) for phase in range(FACTOR)
)


@dataclass(frozen=True)
class TileTable:
    """All tiles of a scene's key intervals."""

    scene: str
    width: int  # Of its frames, pixels
    interval: npt.NDArray[np.int32]  # int32 [N]: which key interval a tile belongs to.
    features: F64  # float64 [N, 3, 6]: of slots 1 to 3, in the order of `TILE_FEATURES`.
    errors: F64  # float64 [N, 5]: mean squared error, squared display levels, of what `MADE` names.
    network: str  # Checksum of the network whose frames were judged.

    def __len__(self) -> int:
        return len(self.interval)

    @cached_property
    def slots(self) -> list[F64]:
        """Scaled features of slots 1 to 3, float64 [N, 6] each."""
        return [
            scale_tile_features(self.features[:, slot], self.width) for slot in range(FACTOR - 1)
        ]

    @cached_property
    def states(self) -> F64:
        """The network's inputs at each node of `DECIDED`, float64 [N, 3, 44]."""
        states = np.stack([tile_inputs(self.slots, node) for node in TILE_NODES], axis=1)
        assert states.shape[1:] == (len(TILE_NODES), INPUTS)
        return states

    def error(self, slot: int, maker: str) -> F64:
        """Return the errors of a slot's tiles by one maker, float64 [N]."""
        places = [(number, name) for number, name, _ in MADE]
        return np.asarray(self.errors[:, places.index((slot, maker))])


def measure_tiles(
    scene: RenderedScene, network: OnnxExtrapolator, say: Callable[[str], None]
) -> TileTable:
    """Make the frames of all makers of a scene's key intervals, and measure their tiles.

    Of a scene that is not rendered to the end its first unbroken run of key frames counts.
    """
    scene = scene.as_far_as_rendered()
    features: list[F64] = []
    errors: list[F64] = []
    numbers: list[npt.NDArray[np.int32]] = []
    for interval, truth in _intervals(scene, network):
        by_slot = [tile_features(interval, slot) for slot in range(1, FACTOR)]
        features.append(np.stack(by_slot, axis=2).reshape(-1, FACTOR - 1, len(TILE_FEATURES)))
        errors.append(_tile_errors(interval, truth))
        numbers.append(np.full(len(errors[-1]), len(numbers), np.int32))
        say(f"{scene.name}: {len(numbers)} key intervals")
        check_stop()
    return TileTable(
        scene.name,
        scene.manifest.width,
        np.concatenate(numbers),
        np.concatenate(features),
        np.concatenate(errors),
        network.checksum,
    )


def _intervals(
    scene: RenderedScene, network: OnnxExtrapolator
) -> Iterator[tuple[Interval, dict[int, npt.NDArray[np.float32]]]]:
    """Yield every key interval of a scene, with the encoded ground truth of slots 2 and 3."""
    clip = SceneClip(scene)
    for variant in VARIANTS:
        clip = clip.seen_as(variant)
        for k in clip.intervals:
            truth = {slot: encode_display(clip.truth(k, slot).pixels) for slot in (2, 3)}
            yield replace(clip.causal(k, "key"), extrapolator=network), truth


def _tile_errors(interval: Interval, truth: dict[int, npt.NDArray[np.float32]]) -> F64:
    """Return the errors of an interval's tiles, float64 [N, 5]."""
    errors = []
    for slot, _, path in MADE:
        frame = encode_display(predict_path(path, interval, slot).pixels)
        squares = np.square(frame[..., :3] - truth[slot][..., :3]).mean(axis=-1)
        errors.append(interval.mosaic.means(squares).ravel())
    return np.stack(errors, axis=-1)


def save_tile_table(path: Path, table: TileTable) -> None:
    """Write a table, whole or not at all; the same table gives the same bytes."""
    about = {
        "schema": SCHEMA, "scene": table.scene, "width": table.width, "network": table.network,
    }  # fmt: skip
    arrays: dict[str, Array] = {
        "interval": table.interval,
        "features": table.features.astype(np.float32),
        "errors": table.errors.astype(np.float32),
    }
    write_table(path, about, arrays)


def load_tile_table(path: Path) -> TileTable:
    """Read a table; raises InputError when there is none, or it is damaged."""
    with reading_table(path, SCHEMA, "table of tiles") as (about, arrays):
        table = TileTable(
            about["scene"],
            int(about["width"]),
            arrays["interval"].astype(np.int32),
            arrays["features"].astype(np.float64),
            arrays["errors"].astype(np.float64),
            about["network"],
        )
        count = len(table)
        if not count:
            raise ValueError("it has no tile")
        require_shape(table.features, (count, 3, len(TILE_FEATURES)))
        require_shape(table.errors, (count, len(MADE)))
    return table


def find_tile_tables(
    data: Path | None,
    model: Path | None,
    tables: Path | None,
    output: Path,
    say: Callable[[str], None],
) -> list[TileTable]:
    """Measure the tiles of benchmark scenes and write their tables, or read those that are there.

    A scene whose table is in the output folder, made with the same network, is not measured again.
    Parameters and errors are those of `outcome_tables.find_tables`.
    """
    if data is None:
        if model is not None:
            raise UsageError("--extrapolator is for measuring scenes; give --data too")
        folder = tables or shipped_folder() / TILE_TABLES
        return read_tables(folder, load_tile_table, "table of tiles")
    require_no_tables(tables)
    make_folder(output / TILE_TABLES)
    return [_tile_table_of(scene, model, output, say) for scene in find_scenes(data, BENCHMARK)]


def _tile_table_of(
    scene: RenderedScene, model: Path | None, output: Path, say: Callable[[str], None]
) -> TileTable:
    path, network = output / TILE_TABLES / f"{scene.name}.npz", extrapolator(model)
    if path.exists():
        table = load_tile_table(path)
        if table.network == network.checksum:
            return table
    save_tile_table(path, measure_tiles(scene, network, say))
    return load_tile_table(path)
