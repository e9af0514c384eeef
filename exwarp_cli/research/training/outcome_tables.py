"""Tables of states and outcomes: all that a policy is trained and judged on, one file a scene.

A row is a key interval of one view of a scene: its features, and how good the frame of either
choice is at every node. Everything else follows from these: states, rewards, returns, oracles.

Measuring takes about a second for each key interval of 427x240 pixels on one core, nearly all of
it for E; it is cached on disk by scene, view and network, so that it is done once.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import astuple, dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Self, TypeVar

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import NODES, Features
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import DamagedFileError, InputError, UsageError
from exwarp_cli.io.dataset import BENCHMARK, RenderedScene, find_scenes
from exwarp_cli.io.files import atomic_path, atomic_write_bytes, make_folder
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.picture_network import OnnxExtrapolator, load_extrapolator
from exwarp_cli.models.policy_files import Array, pack_arrays, unpack_arrays
from exwarp_cli.pipeline.decide import outcomes_of, with_ids
from exwarp_cli.pipeline.scheduling import use_threads
from exwarp_cli.policy.state import INPUTS, OLDER_KEYS, StateHistory, observe
from exwarp_cli.research.training.augmentation import Variant
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.runtime.machine import processors
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.runtime.worker_pool import run_tasks

# Raised whenever the same scene would give other numbers.
OUTCOMES_VERSION, FEATURES_VERSION = 2, 2

# Every interval of a view of beginnings in so many is measured. A sequence has one such interval,
# and from five views of a scene hardly anything was learned of it.
BEGINNING_EVERY = 6

# Folder of tables, beside the models.
TABLES = "tables"

FIELDS = 8  # of `Features`

# The message where both options are given.
GIVE_ONE = "--data makes tables and --tables takes those that are there; give one"

F64 = npt.NDArray[np.float64]
Say = Callable[[str], None]
Table = TypeVar("Table", bound="TrainingTable")


@dataclass(frozen=True)
class View:
    """One way of turning a render into a sequence with key frames."""

    setting: str  # "key" or "slot"
    variant: Variant  # Which instants are key frames
    # True if each interval is measured as if the sequence began with it: no key frame before, and
    # no features of one.
    begins: bool = False

    @property
    def name(self) -> str:
        """Short and fit for a file's name."""
        name = f"{self.setting}-phase{self.variant.phase}-speed{self.variant.speed}"
        return f"{name}-begins" if self.begins else name


# Every phase at normal speed, two at double speed, and beginnings, in both settings.
VIEWS = (
    *(
        View(setting, Variant(phase, speed=speed))
        for phase, speed in ((0, 1), (2, 1), (0, 2), (4, 2), (1, 1), (3, 1))
        for setting in ("key", "slot")
    ),
    *(View(s, Variant(speed=speed), begins=True) for speed in (1, 2) for s in ("key", "slot")),
)


@dataclass(frozen=True)
class Measured:
    """All key intervals of one view of a scene, in their order."""

    features: F64  # float64 [K, 3, 8]: the fields of `Features` at t, t + 1/4 and t + 1/2.
    outcomes: F64  # float64 [K, 5, 2, 2], see `exwarp_cli.policy.outcomes`.


@lru_cache(1)
def extrapolator(path: Path | None) -> OnnxExtrapolator:
    """Return E on one thread; scenes are measured side by side."""
    use_threads(1)
    return load_extrapolator(path, 1, "cpu")


def measure_view(scene: RenderedScene, view: View, model: Path | None, cache: Path) -> Measured:
    """Measure one view of a scene, or take from the cache folder what an earlier run measured.

    `model` is E's ONNX file; None for the one that comes with ExWarp.
    """
    clip, network = SceneClip(scene, view.variant), extrapolator(model)
    numbers = clip.intervals[:: BEGINNING_EVERY if view.begins else 1]
    name = f"{scene.name}-{scene.manifest.size}-{view.name}"
    paths = {
        "features": cache / f"{name}-features-v{FEATURES_VERSION}.npy",
        "outcomes": cache / f"{name}-{network.checksum[:12]}-v{OUTCOMES_VERSION}.npy",
    }
    make_folder(cache)
    both = scene.manifest.instants, scene.manifest.keys
    files = [scene.path(frames, number) for frames in both for number in frames.numbers]
    measured: dict[str, F64] = {}
    for part, path in paths.items():
        # An array is measured again if its file cannot be read, is older than a frame, or has
        # another number of rows.
        with suppress(OSError, ValueError, EOFError):
            if path.stat().st_mtime_ns < max(file.stat().st_mtime_ns for file in files):
                continue
            array: F64 = np.load(path, allow_pickle=False)
            if len(array) == len(numbers):
                measured[part] = array
    rows: dict[str, list[F64]] = {part: [] for part in paths if part not in measured}
    # Interval by interval, so that both find the same frames in memory.
    for k in numbers if rows else ():
        if "features" in rows:
            rows["features"].append(_interval_features(clip, view, k))
        if "outcomes" in rows:
            interval = replace(clip.causal(k, view.setting), extrapolator=network)
            if view.begins:
                interval = replace(interval, past=())
            truth = {slot: clip.truth(k, slot).pixels for slot in range(1, FACTOR)}
            rows["outcomes"].append(outcomes_of(interval, truth))
        check_stop()
    for part in rows:
        measured[part] = np.array(rows[part])
        with atomic_path(paths[part]) as temporary, temporary.open("wb") as file:
            np.save(file, measured[part])
    return Measured(**measured)


def _interval_features(clip: SceneClip, view: View, k: int) -> F64:
    """Return the features at the three instants of an interval at which something is decided."""
    is_first = k == 0 or view.begins
    if view.setting == "key":
        before = None if is_first else clip.key(k - 1).gbuffer
        gbuffer = clip.key(k).gbuffer
        assert gbuffer is not None
        return np.array([astuple(observe(with_ids(gbuffer), before, FACTOR))] * 3, np.float64)
    orders = range(FACTOR * k - 1, FACTOR * k + 3)
    instants = [
        None if is_first and order < FACTOR * k else clip.slot(*divmod(order, FACTOR)).gbuffer
        for order in orders
    ]
    rows = []
    for before, gbuffer in pairwise(instants):
        assert gbuffer is not None
        rows.append(astuple(observe(with_ids(gbuffer), before, 1)))
    return np.array(rows, np.float64)


class TrainingTable:
    """What a policy is trained and judged on, of one scene; kept in a file."""

    schema: ClassVar[str]
    kind: ClassVar[str]  # what it is called
    row: ClassVar[str]
    facts: ClassVar[tuple[str, ...]]  # names of the fields that are no arrays
    # By the name of an array: its type in the file and in memory, and the shape of a row.
    arrays: ClassVar[Mapping[str, tuple[type, type, tuple[int, ...]]]]

    scene: str
    network: str  # checksum of the network whose frames were judged

    def __len__(self) -> int:
        return len(getattr(self, next(iter(self.arrays))))

    def save(self, path: Path) -> None:
        """Write the table, whole or not at all; the same table gives the same bytes."""
        about = {"schema": self.schema} | {name: getattr(self, name) for name in self.facts}
        content: dict[str, Array] = {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)}
        for name, (stored, _, _) in self.arrays.items():
            content[name] = getattr(self, name).astype(stored)
        atomic_write_bytes(path, pack_arrays(content, compressed=True))

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a table; raises InputError when there is none, or DamagedFileError."""
        try:
            content = unpack_arrays(path.read_bytes())
            about = json.loads(content["about"].tobytes())
            if about["schema"] != cls.schema:
                raise ValueError(f"its schema is {about['schema']!r}, not {cls.schema}")
            facts = {n: tuple(v) if isinstance(v := about[n], list) else v for n in cls.facts}
            rows: dict[str, Array] = {
                name: content[name].astype(kind) for name, (_, kind, _) in cls.arrays.items()
            }
            table = cls(**facts, **rows)
            if not len(table):
                raise ValueError(f"it has no {cls.row}")
            for name, (_, _, shape) in cls.arrays.items():
                if rows[name].shape != (len(table), *shape):
                    raise ValueError(f"an array is {rows[name].shape}, not {(len(table), *shape)}")
                if not np.isfinite(rows[name]).all():
                    raise ValueError("a number is not finite")
        except FileNotFoundError as error:
            raise InputError(f"there is no {cls.kind} {path}; check the path") from error
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            reason = (str(error) or type(error).__name__).splitlines()[0]
            raise DamagedFileError(
                f"{path} is no {cls.kind} that can be read ({reason}); make it again with --data"
            ) from error
        return table


@dataclass(frozen=True)
class PolicyTable(TrainingTable):
    """The key intervals of one scene, group by group: a group is one view at one size."""

    schema = "exwarp.policy-table/1"
    kind, row = "policy table", "key interval"
    facts = ("scene", "groups", "network")
    arrays: ClassVar = {
        "group": (np.int16, np.int16, ()),
        "features": (np.float64, np.float64, (3, FIELDS)),
        # Some millionths of a decibel are lost.
        "outcomes": (np.float32, np.float64, (len(NODES), 2, 2)),
    }

    scene: str
    # Names, as in "key-phase0-speed1 427x240"; intervals that are measured as beginnings are
    # groups of their own, of one name.
    groups: tuple[str, ...]
    # int16 [N]: which group a row belongs to; rows of a group are together, in order of time.
    group: npt.NDArray[np.int16]
    features: F64  # float64 [N, 3, 8]: the fields of `Features` at t, t + 1/4 and t + 1/2.
    outcomes: F64  # float64 [N, 5, 2, 2], see `exwarp_cli.policy.outcomes`.
    network: str  # Checksum of the network whose frames were judged.

    def __post_init__(self) -> None:
        if ((self.group < 0) | (self.group >= len(self.groups))).any():
            raise ValueError("a group has no name")

    @cached_property
    def states(self) -> F64:
        """The network's inputs at every node of every interval, float64 [N, 5, 44]."""
        states = np.empty((len(self), len(NODES), INPUTS))
        fields = self.features.reshape(-1, FIELDS).tolist()
        features = [
            Features(int(objects), normal, position, x, y, int(width), int(height), distance)
            for objects, normal, position, x, y, width, height, distance in fields
        ]
        for row in range(len(self)):
            older = range(row - 1, max(row - 1 - OLDER_KEYS, -1), -1)
            before = tuple(features[3 * i] for i in older if self.group[i] == self.group[row])
            first, second, third = features[3 * row : 3 * row + 3]
            surroundings = StateHistory((first, second, third), before)
            for column, node in enumerate(NODES):
                states[row, column] = surroundings.inputs(node)
        return states


def join_views(
    scene: str, parts: Sequence[tuple[str, View, Measured]], network: str
) -> PolicyTable:
    """Return a scene's table from the parts: size, as in "427x240", view, and what was measured.

    `network` is the checksum of the network whose frames were judged.
    """
    names: list[str] = []
    counts: list[int] = []
    for size, view, measured in parts:
        count = len(measured.outcomes)
        counts += [1] * count if view.begins else [count]
        names += [f"{view.name} {size}"] * (count if view.begins else 1)
    return PolicyTable(
        scene,
        tuple(names),
        np.repeat(np.arange(len(counts), dtype=np.int16), counts),
        np.concatenate([measured.features for _, _, measured in parts]),
        np.concatenate([measured.outcomes for _, _, measured in parts]),
        network,
    )


def find_tables(
    data: Sequence[Path],
    tables: Path | None,
    output: Path,
    say: Say,
    model: Path | None = None,
    cache: Path | None = None,
    jobs: int | None = None,
) -> list[PolicyTable]:
    """Measure scenes and write their tables to the output, or read tables that are there.

    Without data folders nothing is measured. They hold the same scenes at several sizes. Of a scene
    that is not rendered to the end, its first unbroken run of key frames counts. `tables` is a
    folder, None for those that come with ExWarp. `model` is E's ONNX file, None for the one that
    comes with ExWarp. `cache` is for what is measured, None for a folder beside the first data
    folder. `jobs` views are measured side by side, None for one a core.

    Raises UsageError when data and tables are given, or what is for measuring without data, and
    InputError when there are none.
    """
    if not data:
        options = {"--extrapolator": model, "--cache": cache, "--jobs": jobs}
        if unused := [option for option, value in options.items() if value is not None]:
            raise UsageError(
                f"{unused[0]} is for measuring scenes; give --data too, or leave it out"
            )
        return read_tables(PolicyTable, tables or shipped_folder() / TABLES)
    if tables is not None:
        raise UsageError(GIVE_ONE)
    cache = cache or data[0].resolve().parent / "policy"
    measured = _build_tables(data, model, cache, jobs or processors().usable, say)
    make_folder(output / TABLES)
    paths = [output / TABLES / f"{table.scene}.npz" for table in measured]
    for path, table in zip(paths, measured, strict=True):
        table.save(path)
    # Read back, so that a training from the files gives the same network.
    return [PolicyTable.load(path) for path in paths]


def read_tables(kind: type[Table], folder: Path) -> list[Table]:
    """Read all tables of a folder; raises InputError where it has none."""
    tables = [kind.load(path) for path in sorted(folder.glob("*.npz"))]
    if not tables:
        raise InputError(f"{folder} holds no {kind.kind}; make some with --data")
    return tables


def _build_tables(
    data: Sequence[Path], model: Path | None, cache: Path, jobs: int, say: Say
) -> list[PolicyTable]:
    """Measure the benchmark scenes of some data sets; return a table a scene, by name.

    Raises UsageError when a scene is there twice at one size: it would count double.
    """
    scenes: dict[tuple[str, str], RenderedScene] = {}
    for folder in data:
        for scene in find_scenes(folder, BENCHMARK):
            rendered = scene.as_far_as_rendered()
            size = rendered.manifest.size
            same = scenes.setdefault((rendered.name, size), rendered)
            if same is not rendered:
                raise UsageError(
                    f"{same.folder} and {rendered.folder} are the same scene at {size}; "
                    "give --data one of them"
                )
    checksum = extrapolator(model).checksum
    work = [
        (scene, view, model, cache)
        for view in VIEWS
        for scene in scenes.values()
        # One whole key interval, at least.
        if len(view.variant.order(scene.manifest.instants.count)) > FACTOR
    ]
    measured: dict[tuple[str, str, str], Measured] = {}
    with closing(run_tasks(measure_view, work, jobs)) as results:
        for (scene, view, *_), result in results:
            measured[scene.name, scene.manifest.size, view.name] = result
            count = len(result.outcomes)
            say(f"{scene.name} {scene.manifest.size} {view.name}: {count} key intervals")
    parts: dict[str, list[tuple[str, View, Measured]]] = {}
    for scene, view, *_ in work:
        size = scene.manifest.size
        part = (size, view, measured[scene.name, size, view.name])
        parts.setdefault(scene.name, []).append(part)
    return [join_views(name, parts[name], checksum) for name in sorted(parts)]
