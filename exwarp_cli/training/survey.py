"""Trying both choices of every decision on rendered scenes: how policy tables are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.io.dataset import BENCHMARK, RenderedScene, find_scenes
from exwarp_cli.io.files import make_folder
from exwarp_cli.io.models import shipped_folder
from exwarp_cli.pipeline.bench.side_by_side import follow_parent, side_by_side
from exwarp_cli.runtime.machine import processors
from exwarp_cli.training.measuring import VIEWS, Measured, View, fits, measure, network
from exwarp_cli.training.policy_table import PolicyTable, joined, load_table, save_table
from exwarp_cli.training.tile_table import (
    TileTable,
    load_tile_table,
    measure_tiles,
    save_tile_table,
)

Say = Callable[[str], None]

Table = TypeVar("Table", PolicyTable, TileTable)

TABLES = "tables"
"""Folder of tables, beside the models."""


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
        Receives a line for each view that is measured.

    Raises
    ------
    UsageError
        When both are given, or options of the survey without data.
    InputError
        When there are none.
    """
    if not survey.data:
        # Refuse options of a survey where nothing is surveyed.
        given = {"--extrapolator": survey.model, "--cache": survey.cache, "--jobs": survey.jobs}
        if vain := [option for option, value in given.items() if value is not None]:
            raise UsageError(f"{vain[0]} is for measuring scenes; give --data too, or leave it out")
        return _tables_in(tables or shipped_folder() / TABLES, load_table, "policy table")
    _require_no_tables(tables)
    made = build_tables(survey, say)
    make_folder(output / TABLES)
    paths = [output / TABLES / f"{table.scene}.npz" for table in made]
    for path, table in zip(paths, made, strict=True):
        save_table(path, table)
    # Read back, so that a training from the files gives the same network.
    return [load_table(path) for path in paths]


def _tables_in(folder: Path, load: Callable[[Path], Table], kind: str) -> list[Table]:
    """Read all tables of a folder; raises InputError where it has none."""
    found = [load(path) for path in sorted(folder.glob("*.npz"))]
    if not found:
        raise InputError(f"{folder} holds no {kind}; make some with --data")
    return found


def _require_no_tables(tables: Path | None) -> None:
    """Refuse tables where scenes are measured; raises UsageError."""
    if tables is not None:
        raise UsageError("--data makes tables and --tables takes those that are there; give one")


TILE_TABLES = "tiles"
"""Folder of the tables of tiles, beside the models."""


def find_tile_tables(
    data: Path | None, model: Path | None, tables: Path | None, output: Path, say: Say
) -> list[TileTable]:
    """Measure the tiles of benchmark scenes and write their tables, or read those that are there.

    A scene whose table is in the output folder, made with the same network, is not measured again.
    Parameters and errors are those of `find_tables`.
    """
    if data is None:
        if model is not None:
            raise UsageError("--extrapolator is for measuring scenes; give --data too")
        folder = tables or shipped_folder() / TILE_TABLES
        return _tables_in(folder, load_tile_table, "table of tiles")
    _require_no_tables(tables)
    make_folder(output / TILE_TABLES)
    return [_tiles_of(scene, model, output, say) for scene in find_scenes(data, BENCHMARK)]


def _tiles_of(scene: RenderedScene, model: Path | None, output: Path, say: Say) -> TileTable:
    """Return the table of a scene as its file has it, which is made where there is none."""
    path = output / TILE_TABLES / f"{scene.name}.npz"
    if path.exists():
        known = load_tile_table(path)
        if known.network == network(model).checksum:
            return known
    save_tile_table(path, measure_tiles(scene, network(model), say))
    return load_tile_table(path)


def build_tables(survey: Survey, say: Say) -> list[PolicyTable]:
    """Measure the benchmark scenes of some data sets; return a table a scene, by name.

    Raises
    ------
    UsageError
        When a scene is there twice at one size.
    """
    data, model = survey.data, survey.model
    cache = survey.cache or data[0].resolve().parent / "policy"
    jobs = survey.jobs or processors().usable
    found = [scene for folder in data for scene in find_scenes(folder, BENCHMARK)]
    scenes = [scene.as_far_as_rendered() for scene in found]
    _require_different(scenes)
    checksum = network(model).checksum
    tasks = [(scene, view) for view in VIEWS for scene in scenes if fits(scene, view)]
    measured: dict[tuple[str, str, str], Measured] = {}
    work = [(scene, view, model, cache) for scene, view in tasks]
    with closing(side_by_side(measure, work, jobs, follow_parent)) as done:
        for (scene, view, *_), result in done:
            measured[scene.name, scene.manifest.size, view.name] = result
            count = len(result.outcomes)
            say(f"{scene.name} {scene.manifest.size} {view.name}: {count} key intervals")
    parts: dict[str, list[tuple[str, View, Measured]]] = {}
    for scene, view in tasks:
        size = scene.manifest.size
        result = measured[scene.name, size, view.name]
        parts.setdefault(scene.name, []).append((size, view, result))
    return [joined(name, parts[name], checksum) for name in sorted(parts)]


def _require_different(scenes: Sequence[RenderedScene]) -> None:
    """Refuse the same scene twice at one size: one would be measured, and count double."""
    seen: dict[tuple[str, str], RenderedScene] = {}
    for scene in scenes:
        other = seen.setdefault((scene.name, scene.manifest.size), scene)
        if other is not scene:
            raise UsageError(
                f"{other.folder} and {scene.folder} are the same scene at {scene.manifest.size}; "
                "give --data one of them"
            )
