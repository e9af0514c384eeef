"""Tables of tiles: what a policy sees of each, and how wrong every maker's pixels are there.

One file a scene, so that a policy is trained and judged again without rendering or E.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import EXTRAPOLATE, WARP
from exwarp_cli.domain.tiles import REWARP, TILE_FEATURES
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.atomic import atomic_write_bytes
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.io.models import OnnxExtrapolator
from exwarp_cli.io.policy_files import Array, pack, unpack
from exwarp_cli.metrics.display import encode_display
from exwarp_cli.policy.state import INPUTS, TILE_NODES, scale_tile_features, tile_inputs
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import take
from exwarp_cli.synthesis.tile_features import tile_features
from exwarp_cli.training.footage import Footage
from exwarp_cli.training.policy_table import reading_table
from exwarp_cli.training.variant import Variant

F64 = npt.NDArray[np.float64]

SCHEMA = "exwarp.tile-table/1"

MADE = ((2, WARP, "S6"), (2, EXTRAPOLATE, "S3"), (3, WARP, "S6"), (3, EXTRAPOLATE, "S3"),
        (3, REWARP, "S4"))  # fmt: skip
"""What errors are of: slot, maker, and a path whose frame shows it."""

VARIANTS = tuple(
    Variant(phase, backwards=back) for back in (False, True) for phase in range(FACTOR)
)
"""How each scene is looked at: every instant as a key frame, and time both ways."""


@dataclass(frozen=True)
class TileTable:
    """All tiles of a scene's key intervals.

    Attributes
    ----------
    scene
        Name.
    width
        Of its frames, pixels.
    interval
        int32 [N]: which key interval a tile belongs to.
    features
        float64 [N, 3, 6]: of slots 1 to 3, in the order of `TILE_FEATURES`.
    errors
        float64 [N, 5]: mean squared error, squared display levels, of what `MADE` names.
    network
        Checksum of the network whose frames were judged.
    """

    scene: str
    width: int
    interval: npt.NDArray[np.int32]
    features: F64
    errors: F64
    network: str

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
        found = np.stack([tile_inputs(self.slots, node) for node in TILE_NODES], axis=1)
        assert found.shape[1:] == (len(TILE_NODES), INPUTS)
        return found

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
    number: list[npt.NDArray[np.int32]] = []
    for interval, truth in _intervals(scene, network):
        seen = [tile_features(interval, slot) for slot in range(1, FACTOR)]
        features.append(np.stack(seen, axis=2).reshape(-1, FACTOR - 1, len(TILE_FEATURES)))
        errors.append(_errors(interval, truth))
        number.append(np.full(len(errors[-1]), len(number), np.int32))
        say(f"{scene.name}: {len(number)} key intervals")
        check_stop()
    return TileTable(
        scene.name,
        scene.manifest.width,
        np.concatenate(number),
        np.concatenate(features),
        np.concatenate(errors),
        network.checksum,
    )


def _intervals(
    scene: RenderedScene, network: OnnxExtrapolator
) -> Iterator[tuple[Interval, dict[int, npt.NDArray[np.float32]]]]:
    """Yield every key interval of a scene, with the encoded ground truth of slots 2 and 3."""
    whole = Footage(scene)
    for variant in VARIANTS:
        footage = whole.seen_as(variant)
        for k in footage.intervals:
            truth = {slot: encode_display(footage.truth(k, slot).pixels) for slot in (2, 3)}
            yield replace(footage.causal(k, "key"), extrapolator=network), truth


def _errors(interval: Interval, truth: dict[int, npt.NDArray[np.float32]]) -> F64:
    """Return the errors of an interval's tiles, float64 [N, 5]."""
    found = []
    for slot, _, path in MADE:
        made = encode_display(take(path, interval, slot).pixels)
        squares = np.square(made[..., :3] - truth[slot][..., :3]).mean(axis=-1)
        found.append(interval.mosaic.means(squares).ravel())
    return np.stack(found, axis=-1)


def save_tile_table(path: Path, table: TileTable) -> None:
    """Write a table, whole or not at all; the same table gives the same bytes."""
    about = {
        "schema": SCHEMA, "scene": table.scene, "width": table.width, "network": table.network,
    }  # fmt: skip
    arrays: dict[str, Array] = {
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
        "interval": table.interval,
        "features": table.features.astype(np.float32),
        "errors": table.errors.astype(np.float32),
    }
    atomic_write_bytes(path, pack(arrays, compressed=True))


def load_tile_table(path: Path) -> TileTable:
    """Read a table.

    Raises
    ------
    InputError
        When there is none.
    DamagedFileError
        When it cannot be read.
    """
    with reading_table(path, "table of tiles"):
        kept = unpack(path.read_bytes())
        about = json.loads(kept["about"].tobytes())
        if about["schema"] != SCHEMA:
            raise ValueError(f"its schema is {about['schema']!r}, not {SCHEMA}")
        table = TileTable(
            about["scene"],
            int(about["width"]),
            kept["interval"].astype(np.int32),
            kept["features"].astype(np.float64),
            kept["errors"].astype(np.float64),
            about["network"],
        )
        _require_sound(table)
    return table


def _require_sound(table: TileTable) -> None:
    """Refuse arrays that do not fit together; raises ValueError."""
    count = len(table)
    shapes = ((table.features, (3, len(TILE_FEATURES))), (table.errors, (len(MADE),)))
    for found, shape in shapes:
        if not count or found.shape != (count, *shape):
            raise ValueError(f"an array is {found.shape}, not {(count, *shape)}")
        if not np.isfinite(found).all():
            raise ValueError("a number is not finite")
