"""Tables of states and outcomes: all that a policy is trained and judged on, one file a scene.

A row is a key interval of one view of a scene: its features, and how good the frame of either
choice is at every node. Everything else follows from these: states, rewards, returns, oracles.
"""

from __future__ import annotations

import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.dataset import BENCHMARK
from exwarp_cli.domain.decision import NODES
from exwarp_cli.domain.features import Features
from exwarp_cli.errors import DamagedFileError, InputError, UsageError
from exwarp_cli.io.atomic import atomic_write_bytes, make_folder
from exwarp_cli.io.dataset import RenderedScene, find_scenes
from exwarp_cli.io.models import shipped_folder
from exwarp_cli.policy.state import INPUTS, KEYS_BACK, PASSED, Surroundings
from exwarp_cli.training.measuring import VIEWS, Measured, View, fits, measure, network

F64 = npt.NDArray[np.float64]
Say = Callable[[str], None]

SCHEMA = "exwarp.policy-table/1"

_ENTRIES = ("about", "group", "features", "outcomes")

_UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, MemoryError, struct.error),
    *(NotImplementedError, RuntimeError, KeyError, SyntaxError, OverflowError, TypeError),
)
"""What zipfile, numpy and a wrong entry raise on what is no table."""

TABLES = "tables"
"""Folder of tables, beside the models."""


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

    def states(self) -> F64:
        """Return the network's inputs at every node of every interval, float64 [N, 5, 44]."""
        out = np.empty((len(self), len(NODES), INPUTS))
        for row, surroundings in enumerate(self.surroundings()):
            for column, node in enumerate(NODES):
                out[row, column] = surroundings.inputs(node, PASSED[node])
        return out

    def surroundings(self) -> Iterator[Surroundings]:
        """Yield what the states of each interval are made of."""
        found = [[_features(fields) for fields in row] for row in self.features]
        for row, (first, second, third) in enumerate(found):
            older = range(row - 1, max(row - 1 - KEYS_BACK, -1), -1)
            before = tuple(found[i][0] for i in older if self.group[i] == self.group[row])
            yield Surroundings((first, second, third), before)

    def setting(self) -> npt.NDArray[np.bool_]:
        """bool [N]: whether a row has G-buffers of every slot."""
        slot = np.array([name.startswith("slot") for name in self.groups])
        return np.asarray(slot[self.group])


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


@dataclass(frozen=True)
class Survey:
    """How scenes are measured.

    Attributes
    ----------
    data
        Folders of rendered scenes: the same ones at several sizes. Of a scene that is not rendered
        to the end, its first unbroken run of key frames counts.
    model
        E's ONNX file; None for the one that comes with ExWarp.
    cache
        Folder for what was measured; None for one beside the first data folder.
    jobs
        How many views are measured side by side; None for one a core.
    """

    data: tuple[Path, ...]
    model: Path | None = None
    cache: Path | None = None
    jobs: int | None = None


def find_tables(survey: Survey, tables: Path | None, output: Path, say: Say) -> list[PolicyTable]:
    """Measure scenes and write their tables to the output, or read tables that are there.

    Parameters
    ----------
    survey
        Without data folders nothing is measured.
    tables
        Folder of tables; None for those that come with ExWarp.
    output
        Folder of the training; tables of measured scenes go to its folder `TABLES`.
    say
        Told of each view that is measured.

    Raises
    ------
    UsageError
        When both are given.
    InputError
        When there are none.
    """
    if not survey.data:
        folder = tables or shipped_folder() / TABLES
        found = [load_table(path) for path in sorted(folder.glob("*.npz"))]
        if not found:
            raise InputError(f"{folder} holds no policy table; make some with --data")
        return found
    if tables is not None:
        raise UsageError("--data makes tables and --tables takes those that are there; give one")
    made = build_tables(survey, say)
    make_folder(output / TABLES)
    paths = [output / TABLES / f"{table.scene}.npz" for table in made]
    for path, table in zip(paths, made, strict=True):
        save_table(path, table)
    # Read back, so that a training from the files gives the same network.
    return [load_table(path) for path in paths]


def build_tables(survey: Survey, say: Say) -> list[PolicyTable]:
    """Measure the benchmark scenes of some data sets; return a table a scene, by name.

    Raises
    ------
    UsageError
        When a scene is there twice at one size.
    """
    data, model = survey.data, survey.model
    cache = survey.cache or data[0].resolve().parent / "policy"
    jobs = survey.jobs or os.cpu_count() or 1
    found = [scene for folder in data for scene in find_scenes(folder, BENCHMARK)]
    scenes = [scene.as_far_as_rendered() for scene in found]
    _require_different(scenes)
    checksum = network(model).checksum
    tasks = [(scene, view) for view in VIEWS for scene in scenes if fits(scene, view)]
    parts: dict[str, list[tuple[str, View, Measured]]] = {}
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        work = [pool.submit(measure, scene, view, model, cache) for scene, view in tasks]
        try:
            for (scene, view), done in zip(tasks, work, strict=True):
                count = len(done.result().outcomes)
                parts.setdefault(scene.name, []).append((_size(scene), view, done.result()))
                say(f"{scene.name} {_size(scene)} {view.name}: {count} key intervals")
        except BaseException:
            # Else all that is left would be measured before anybody hears of it.
            pool.shutdown(cancel_futures=True)
            raise
    return [joined(name, parts[name], checksum) for name in sorted(parts)]


def _size(scene: RenderedScene) -> str:
    return f"{scene.manifest.width}x{scene.manifest.height}"


def _require_different(scenes: Sequence[RenderedScene]) -> None:
    """Refuse the same scene twice at one size: one would be measured, and count double."""
    seen: dict[tuple[str, str], RenderedScene] = {}
    for scene in scenes:
        other = seen.setdefault((scene.name, _size(scene)), scene)
        if other is not scene:
            raise UsageError(
                f"{other.folder} and {scene.folder} are the same scene at {_size(scene)}; "
                "give --data one of them"
            )


def save_table(path: Path, table: PolicyTable) -> None:
    """Write a table, whole or not at all; the same table gives the same bytes."""
    about = {
        "schema": SCHEMA,
        "scene": table.scene,
        "groups": table.groups,
        "network": table.network,
    }
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
        "group": table.group,
        "features": table.features,
        # Some millionths of a decibel are lost.
        "outcomes": table.outcomes.astype(np.float32),
    }
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            text = io.BytesIO()
            np.save(text, array, allow_pickle=False)
            # A fixed date, as the checksum goes by the bytes.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), text.getvalue(), zipfile.ZIP_DEFLATED)
    atomic_write_bytes(path, out.getvalue())


def load_table(path: Path) -> PolicyTable:
    """Read a table.

    Raises
    ------
    InputError
        When there is none, or it is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            kept = {entry: _member(archive, f"{entry}.npy") for entry in _ENTRIES}
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
        _require_whole(table)
    except FileNotFoundError as error:
        raise InputError(f"there is no policy table {path}; check the path") from error
    except _UNREADABLE as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise DamagedFileError(
            f"{path} is no policy table that can be read ({reason}); make it again with --data"
        ) from error
    return table


def _member(archive: zipfile.ZipFile, name: str) -> npt.NDArray[Any]:
    """Read one array of an archive."""
    text = io.BytesIO(archive.read(name))
    return np.asarray(np.lib.format.read_array(text, allow_pickle=False))


def _require_whole(table: PolicyTable) -> None:
    """Refuse a table whose arrays do not fit together; raises ValueError."""
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


def _features(fields: F64) -> Features:
    """Return features from their fields in order."""
    objects, emd_normal, emd_position, var_x, var_y, width, height, distance = fields.tolist()
    return Features(
        int(objects), emd_normal, emd_position, var_x, var_y, int(width), int(height), distance
    )
