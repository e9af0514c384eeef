"""Tables of states and outcomes: all that a policy is trained and judged on, one file a scene.

A row is a key interval of one view of a scene: its features, and how good the frame of either
choice is at every node. Everything else follows from these: states, rewards, returns, oracles.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import NODES, Features
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.atomic import atomic_write_bytes
from exwarp_cli.io.policy_files import Array, pack, unpack
from exwarp_cli.policy.state import INPUTS, OLDER_KEYS, StateHistory
from exwarp_cli.training.measuring import Measured, View

F64 = npt.NDArray[np.float64]

SCHEMA = "exwarp.policy-table/1"


@dataclass(frozen=True)
class PolicyTable:
    """The key intervals of one scene, group by group: a group is one view at one size.

    Attributes
    ----------
    scene
        Name.
    groups
        Names, as in "key-phase0-speed1 427x240"; intervals that are looked at as beginnings are
        groups of their own, of one name.
    group
        int16 [N]: which group a row belongs to; rows of a group are together, in order of time.
    features
        float64 [N, 3, 8]: the fields of `Features` at t, t + 1/4 and t + 1/2.
    outcomes
        float64 [N, 5, 2, 2], see `exwarp_cli.policy.outcomes`.
    network
        Checksum of the network whose frames were judged.
    """

    scene: str
    groups: tuple[str, ...]
    group: npt.NDArray[np.int16]
    features: F64
    outcomes: F64
    network: str

    def __len__(self) -> int:
        return len(self.group)

    @cached_property
    def states(self) -> F64:
        """The network's inputs at every node of every interval, float64 [N, 5, 44]."""
        out = np.empty((len(self), len(NODES), INPUTS))
        for row, surroundings in enumerate(self.surroundings()):
            for column, node in enumerate(NODES):
                out[row, column] = surroundings.inputs(node)
        return out

    def surroundings(self) -> Iterator[StateHistory]:
        """Yield what the states of each interval are made of."""
        found = [[_features(fields) for fields in row] for row in self.features]
        for row, (first, second, third) in enumerate(found):
            older = range(row - 1, max(row - 1 - OLDER_KEYS, -1), -1)
            before = tuple(found[i][0] for i in older if self.group[i] == self.group[row])
            yield StateHistory((first, second, third), before)


def joined(scene: str, parts: Sequence[tuple[str, View, Measured]], network: str) -> PolicyTable:
    """Return a scene's table from what was measured.

    Parameters
    ----------
    scene
        Name.
    parts
        Size, as in "427x240", view, and what was found.
    network
        Checksum of the network whose frames were judged.
    """
    names: list[str] = []
    counts: list[int] = []
    for size, view, measured in parts:
        count = len(measured.outcomes)
        alone = [1] * count if view.begins else [count]
        names += [f"{view.name} {size}"] * len(alone)
        counts += alone
    return PolicyTable(
        scene,
        tuple(names),
        np.repeat(np.arange(len(counts), dtype=np.int16), counts),
        np.concatenate([measured.features for _, _, measured in parts]),
        np.concatenate([measured.outcomes for _, _, measured in parts]),
        network,
    )


def save_table(path: Path, table: PolicyTable) -> None:
    """Write a table, whole or not at all; the same table gives the same bytes."""
    about = {
        "schema": SCHEMA,
        "scene": table.scene,
        "groups": table.groups,
        "network": table.network,
    }
    arrays: dict[str, Array] = {
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
        "group": table.group,
        "features": table.features,
        # Some millionths of a decibel are lost.
        "outcomes": table.outcomes.astype(np.float32),
    }
    atomic_write_bytes(path, pack(arrays, compressed=True))


def load_table(path: Path) -> PolicyTable:
    """Read a table.

    Raises
    ------
    InputError
        When there is none, or it is damaged.
    """
    with reading_table(path, "policy table"):
        kept = unpack(path.read_bytes())
        about = json.loads(kept["about"].tobytes())
        if about["schema"] != SCHEMA:
            raise ValueError(f"its schema is {about['schema']!r}, not {SCHEMA}")
        table = PolicyTable(
            about["scene"],
            tuple(about["groups"]),
            kept["group"].astype(np.int16),
            kept["features"].astype(np.float64),
            kept["outcomes"].astype(np.float64),
            about["network"],
        )
        # Refuse a table whose arrays do not fit together; raises ValueError.
        count = len(table.group)
        if not count:
            raise ValueError("it has no key interval")
        for found, shape in ((table.features, (3, 8)), (table.outcomes, (len(NODES), 2, 2))):
            if found.shape != (count, *shape):
                raise ValueError(f"an array is {found.shape}, not {(count, *shape)}")
            if not np.isfinite(found).all():
                raise ValueError("a number is not finite")
        if table.group.min() < 0 or table.group.max() >= len(table.groups):
            raise ValueError("a group has no name")
    return table


@contextmanager
def reading_table(path: Path, kind: str) -> Iterator[None]:
    """Say of a table what its reader means by the errors that it meets.

    Raises
    ------
    InputError
        When there is none.
    DamagedFileError
        When it cannot be read.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise InputError(f"there is no {kind} {path}; check the path") from error
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise DamagedFileError(
            f"{path} is no {kind} that can be read ({reason}); make it again with --data"
        ) from error


def _features(fields: F64) -> Features:
    """Return features from their fields in order."""
    objects, emd_normal, emd_position, var_x, var_y, width, height, distance = fields.tolist()
    return Features(
        int(objects), emd_normal, emd_position, var_x, var_y, int(width), int(height), distance
    )
