"""A whole benchmark: what is found on disk is taken, the rest measured side by side and kept."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.bench import BenchSettings
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import UsageError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.exr.reader import read_headers
from exwarp_cli.io.exr.template import render_seconds
from exwarp_cli.io.files import atomic_write_text, make_folder, remove_leftovers
from exwarp_cli.io.threads import use_threads
from exwarp_cli.pipeline.announcing import other_extrapolator
from exwarp_cli.pipeline.bench.measure import SLOT_SCORES, identity, measure, measure_slots
from exwarp_cli.pipeline.bench.opened import Networks, Opened, load_networks
from exwarp_cli.pipeline.bench.plan import Subject, subjects_of
from exwarp_cli.pipeline.bench.side_by_side import follow_parent, side_by_side, tell
from exwarp_cli.pipeline.bench.timing import time_subject
from exwarp_cli.pipeline.progress import NoProgress, Progress
from exwarp_cli.pipeline.scoring import SLOTS
from exwarp_cli.runtime.machine import processors
from exwarp_cli.runtime.stop import check_stop

PARTS = "parts"
"""Folder of what was measured, a file a key interval."""

RUN = 4
"""Key intervals that a worker takes at once: neighbours share what they read."""

TIMING_VERSION = 1
"""Raised whenever run times come to mean something else."""


@dataclass(frozen=True)
class Measured:
    """Everything that was measured of a subject.

    Attributes
    ----------
    subject
        What.
    about
        ``width``, ``height``, ``fps``, ``producer``, ``policy`` and its checksum.
    timing
        As `bench.timing.time_subject` returns it.
    parts
        As `bench.measure.measure` returns them, by key frame.
    """

    subject: Subject
    about: dict[str, Any]
    timing: dict[str, Any]
    parts: tuple[dict[str, Any], ...]


@dataclass(frozen=True)
class Benchmark:
    """A benchmark that was run.

    Attributes
    ----------
    settings
        What was asked.
    networks
        SHA-256 by what they are.
    systems
        All that were compared, by name.
    measured
        Per subject.
    """

    settings: BenchSettings
    networks: dict[str, str]
    systems: tuple[str, ...]
    measured: tuple[Measured, ...]


def run_benchmark(settings: BenchSettings, progress: Progress | None = None) -> Benchmark:
    """Measure what is not measured yet.

    Parameters
    ----------
    settings
        What is asked. Its output folder gets a folder `PARTS`.
    progress
        Receives every key interval.

    Raises
    ------
    ExwarpError
        For anything that a user can cause; what was measured until then is kept.
    """
    progress = progress or NoProgress()
    subjects = subjects_of(settings, progress.message)
    networks = load_networks(settings, None)
    opened = {subject: Opened(subject, settings, networks) for subject in subjects}
    _make_folders(opened.values())
    timings = {subject: _timing(one, progress) for subject, one in opened.items()}
    keys = {subject: one.keys for subject, one in opened.items()}
    about = {subject: about_subject(one) for subject, one in opened.items()}
    del opened
    notes = [one["policy"]["note"] for one in about.values()]
    for note in dict.fromkeys(note for note in notes if note is not None):
        progress.message(note)
    counts = {_kind(subject): len(chosen) for subject, chosen in keys.items()}
    progress.start(sum(counts.values()), counts, _jobs(settings))
    try:
        with closing(_parts(settings, keys, progress)) as found:
            parts = dict(found)
    finally:
        progress.finish()
    return Benchmark(
        settings,
        networks.checksums,
        (*settings.systems, *networks.systems),
        tuple(
            Measured(
                subject,
                about[subject],
                timings[subject],
                tuple(parts[subject, key] for key in keys[subject]),
            )
            for subject in subjects
        ),
    )


def folder_of(opened: Opened) -> Path:
    """Return where the parts of a subject lie."""
    display, subject = opened.source.keys.display, opened.subject
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in subject.name)
    size = f"{display.width}x{display.height}"
    return opened.settings.output / PARTS / f"{name}-{size}-{subject.setting}"


def _make_folders(opened: Iterable[Opened]) -> None:
    """Make a folder for each subject; refuse two that would share one."""
    seen: dict[Path, Subject] = {}
    for one in opened:
        folder = folder_of(one)
        if folder in seen:
            raise UsageError(
                f"{seen[folder].source.sequence} and {one.subject.source.sequence} have one name, "
                "size and setting; measure them into two folders"
            )
        seen[folder] = one.subject
        make_folder(folder)
        remove_leftovers(folder)


def _timing(opened: Opened, progress: Progress) -> dict[str, Any]:
    """Take run times that were measured before with the same networks and systems, or measure."""
    settings = opened.settings
    dependencies = {
        "version": [TIMING_VERSION, __version__],
        "networks": sorted(opened.networks.checksums.items()),
        "systems": [*settings.systems, *opened.networks.systems],
        "device": settings.device,
        "keys": opened.keys,
    }
    token = hashlib.sha256(json.dumps(dependencies).encode()).hexdigest()
    path = folder_of(opened) / "timing.json"
    known = _kept(path, token)
    if known is None:
        subject = opened.subject
        progress.message(f"timing {subject.name} with G-buffers for {_SETTINGS[subject.setting]}")
        known = time_subject(opened) | {"identity": token}
        atomic_write_text(path, json.dumps(known, indent=1) + "\n")
    return known


_SETTINGS = {"slot": "every slot", "key": "the key frames"}


def _kept(path: Path, token: str) -> dict[str, Any] | None:
    """Return what an earlier run measured, if it would come out the same."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    fits = isinstance(found, dict) and found.get("identity") == token
    return found if fits else None


Task = tuple[BenchSettings, Subject, tuple[int, ...], int]
"""Arguments of `work`."""

Part = tuple[tuple[Subject, int], dict[str, Any]]
Run = tuple[Subject, list[tuple[int, dict[str, Any]]]]


@dataclass(frozen=True)
class Step:
    """A key interval that is done; `made` is false for one that was on disk."""

    subject: Subject
    number: int
    made: bool


Hear = Callable[[Step], None]


def _kind(subject: Subject) -> str:
    """Name the kind of a subject's intervals: they take about as long."""
    return f"{subject.source.sequence}, {subject.setting}"


def _jobs(settings: BenchSettings) -> int:
    """Return how many key intervals are measured side by side."""
    return settings.jobs or processors().usable


def _parts(
    settings: BenchSettings, keys: dict[Subject, tuple[int, ...]], progress: Progress
) -> Generator[Part, None, None]:
    """Yield what is measured of every key interval, from disk or anew."""

    def hear(step: Step) -> None:
        note = f"{step.subject.name}, {step.subject.setting}"
        progress.advance(step.number, note, _kind(step.subject), step.made)

    jobs = _jobs(settings)
    # Short sequences are dealt out as well.
    run = min(RUN, -(-sum(map(len, keys.values())) // jobs))
    tasks: list[Task] = [
        (settings, subject, chosen[i : i + run], 1)
        for subject, chosen in keys.items()
        for i in range(0, len(chosen), run)
    ]
    with closing(_done(tasks, min(jobs, len(tasks)), hear)) as runs:
        for subject, found in runs:
            for key, part in found:
                yield (subject, key), part


def _done(tasks: Sequence[Task], jobs: int, hear: Hear) -> Generator[Run, None, None]:
    """Yield the parts of each run of key intervals, as they come."""
    if jobs == 1:
        for settings, subject, keys, _ in tasks:
            yield subject, work(settings, subject, keys, None, hear)
        return
    with closing(side_by_side(work, tasks, jobs, _alone, hear)) as found:
        for (_, subject, _, _), parts in found:
            yield subject, parts


def _alone() -> None:
    """Prepare a worker: one thread each, and it ends with its parent."""
    follow_parent()
    use_threads(1)


def work(
    settings: BenchSettings,
    subject: Subject,
    keys: Sequence[int],
    threads: int | None,
    hear: Hear = tell,
) -> list[tuple[int, dict[str, Any]]]:
    """Measure some key intervals of a subject; what is on disk and still right is taken."""
    opened = _opened(settings, subject, threads)
    opened.restart()
    found = []
    for key in keys:
        part, made = _part(opened, key)
        found.append((key, part))
        hear(Step(subject, part["key"], made))
        check_stop()
    return found


def _part(opened: Opened, key: int) -> tuple[dict[str, Any], bool]:
    """Return what is measured of a key interval, and whether it was not on disk."""
    path = folder_of(opened) / f"{opened.number(key)}.json"
    known: dict[str, Any] | None = None
    token = ""

    def is_complete(part: dict[str, Any]) -> bool:
        return opened.settings.clock is None or SLOT_SCORES in part

    def needed(recipes: dict[int, str]) -> bool:
        nonlocal known, token
        token = identity(opened, key, recipes)
        known = _kept(path, token)
        return known is None or not is_complete(known)

    loaded = opened.load(key, needed)
    if known is None:
        measured = measure(opened, loaded) | {"identity": token}
    elif is_complete(known):
        return known, False
    else:
        measured = known | measure_slots(opened, loaded)
    atomic_write_text(path, json.dumps(measured) + "\n")
    return measured, True


@lru_cache(1)
def _networks(settings: BenchSettings, threads: int | None) -> Networks:
    return load_networks(settings, threads)


@lru_cache(2)
def _opened(settings: BenchSettings, subject: Subject, threads: int | None) -> Opened:
    return Opened(subject, settings, _networks(settings, threads))


def about_subject(opened: Opened) -> dict[str, Any]:
    """Say what the subject is."""
    source = opened.source
    display = source.keys.display
    return {
        "width": display.width,
        "height": display.height,
        "fps": float(source.fps),
        "producer": (source.slots or source.keys).layout.producer,
        "policy": {
            "file": opened.policy.path.name,
            "sha256": opened.policy.checksum,
            "trained_without_it": opened.subject.unseen,
            "note": _policy_note(opened),
        },
        "render_s": _render_times(opened),
    }


def _policy_note(opened: Opened) -> str | None:
    """Say that the policy was trained for another network than the one that extrapolates."""
    network = opened.networks.own
    return None if network is None else other_extrapolator(opened.policy, network)


def _render_times(opened: Opened) -> dict[str, float | None]:
    """Mean render times that the headers tell, in seconds: of key frames, and of slot G-buffers.

    The latter only where those files hold nothing else: with colour in them, their time is that of
    the whole frame.
    """
    source = opened.source
    numbers = [opened.number(key) for key in opened.keys]
    found: dict[str, float | None] = {
        "key": _mean_time([source.keys.sequence.files[number] for number in numbers]),
        "gbuffer": None,
    }
    if source.slots is not None and Role.COLOUR not in source.slots.layout:
        files = source.slots.sequence.files
        wanted = [source.slot_number(Slot(key, i)) for key in opened.keys for i in SLOTS]
        found["gbuffer"] = _mean_time([files[n] for n in wanted if n is not None])
    return found


def _mean_time(paths: Sequence[Path]) -> float | None:
    known = [found[0] for path in paths if (found := render_seconds(read_headers(path)))]
    return sum(known) / len(known) if known else None
