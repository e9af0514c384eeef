"""A whole benchmark: parts on disk are taken, the rest is measured side by side and kept."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import UsageError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.exr.reader import read_headers
from exwarp_cli.io.exr.writer import render_seconds
from exwarp_cli.io.files import atomic_write_text, make_folder, remove_leftovers
from exwarp_cli.io.threads import use_threads
from exwarp_cli.pipeline.messages import other_extrapolator
from exwarp_cli.pipeline.progress import NoProgress, Progress
from exwarp_cli.research.bench.measurement import (
    SLOT_SCORES,
    measure,
    measure_slots,
    part_identity,
    time_subject,
    timed_keys,
)
from exwarp_cli.research.bench.subjects import (
    Networks,
    OpenedSubject,
    Subject,
    find_subjects,
    load_networks,
)
from exwarp_cli.research.bench.systems import SLOTS, BenchSettings
from exwarp_cli.runtime.machine import processors
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.runtime.worker_pool import follow_parent, run_tasks, send_message

# Folder of what was measured, a file a key interval.
PARTS = "parts"

# Key intervals that a worker takes at once: neighbours share what they read.
INTERVALS_PER_TASK = 4

# Raised whenever run times come to mean something else.
TIMING_VERSION = 1

GBUFFERS_OF = {"slot": "every slot", "key": "the key frames"}


@dataclass(frozen=True)
class Measured:
    """Everything that was measured of a subject."""

    subject: Subject
    about: dict[str, Any]  # size, rate, producer, policy and render times
    timing: dict[str, Any]  # as `measurement.time_subject` returns it
    parts: tuple[dict[str, Any], ...]  # as `measurement.measure` returns them, by key frame


@dataclass(frozen=True)
class Benchmark:
    """A benchmark that was run."""

    settings: BenchSettings
    networks: dict[str, str]  # SHA-256 by what they are
    systems: tuple[str, ...]  # all that were compared, by name
    measured: tuple[Measured, ...]  # per subject


@dataclass(frozen=True)
class Step:
    """A key interval that is done; `is_new` is false for one that was on disk."""

    subject: Subject
    number: int
    is_new: bool


Report = Callable[[Step], None]

# Arguments and result of `measure_task`.
Task = tuple[BenchSettings, Subject, tuple[int, ...], int]
Parts = list[tuple[int, dict[str, Any]]]


@contextmanager
def run_benchmark(settings: BenchSettings, progress: Progress | None = None) -> Iterator[Benchmark]:
    """Measure what is not measured yet, and keep it in the folder `PARTS` of the output folder.

    Yields the benchmark; the progress ends with the block, in which its files may be written.

    Raises
    ------
    ExwarpError
        For anything that a user can cause; what was measured until then is kept.
    """
    progress = progress or NoProgress()
    subjects = find_subjects(settings, progress.message)
    networks = load_networks(settings, None)
    opened = {subject: OpenedSubject(subject, settings, networks) for subject in subjects}
    _make_folders(opened.values())
    keys = {subject: entry.keys for subject, entry in opened.items()}
    jobs = settings.jobs or processors().usable
    counts = {_kind(subject): len(chosen) for subject, chosen in keys.items()}
    counts |= {_timing_kind(subject): len(timed_keys(entry)) for subject, entry in opened.items()}
    progress.start(sum(counts.values()), counts, jobs)
    try:
        timings = {subject: _measure_times(entry, progress) for subject, entry in opened.items()}
        about = {subject: describe_subject(entry) for subject, entry in opened.items()}
        del opened
        notes = [facts["policy"]["note"] for facts in about.values()]
        for note in dict.fromkeys(note for note in notes if note is not None):
            progress.message(note)

        # Short sequences are shared out as well.
        size = min(INTERVALS_PER_TASK, -(-sum(map(len, keys.values())) // jobs))
        tasks: list[Task] = [
            (settings, subject, chosen[i : i + size], 1)
            for subject, chosen in keys.items()
            for i in range(0, len(chosen), size)
        ]

        def report(step: Step) -> None:
            note = f"{step.subject.name}, {step.subject.setting}"
            progress.advance(step.number, note, _kind(step.subject), step.is_new)

        parts: dict[tuple[Subject, int], dict[str, Any]] = {}
        with closing(_run_tasks(tasks, min(jobs, len(tasks)), report)) as results:
            for subject, measured in results:
                parts |= {(subject, key): part for key, part in measured}
        yield Benchmark(
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
    finally:
        progress.finish()


def _kind(subject: Subject) -> str:
    """Name the kind of a subject's intervals: they take about as long."""
    return f"{subject.source.sequence}, {subject.setting}"


def _timing_kind(subject: Subject) -> str:
    return f"timing {_kind(subject)}"


def _run_tasks(
    tasks: Sequence[Task], jobs: int, report: Report
) -> Generator[tuple[Subject, Parts], None, None]:
    """Yield the parts of each task, as they come."""
    if jobs == 1:
        for settings, subject, keys, _ in tasks:
            yield subject, measure_task(settings, subject, keys, None, report)
        return
    with closing(run_tasks(measure_task, tasks, jobs, _prepare_worker, report)) as results:
        for (_, subject, _, _), parts in results:
            yield subject, parts


def _prepare_worker() -> None:
    follow_parent()
    use_threads(1)


def measure_task(
    settings: BenchSettings,
    subject: Subject,
    keys: Sequence[int],
    threads: int | None,
    report: Report = send_message,
) -> Parts:
    """Measure some key intervals of a subject; what is on disk and still right is taken."""
    opened = _open_cached(settings, subject, threads)
    opened.restart()
    parts = []
    for key in keys:
        part, is_new = _measure_part(opened, key)
        parts.append((key, part))
        report(Step(subject, part["key"], is_new))
        check_stop()
    return parts


@lru_cache(1)
def _load_networks_cached(settings: BenchSettings, threads: int | None) -> Networks:
    return load_networks(settings, threads)


@lru_cache(2)
def _open_cached(settings: BenchSettings, subject: Subject, threads: int | None) -> OpenedSubject:
    return OpenedSubject(subject, settings, _load_networks_cached(settings, threads))


def _measure_part(opened: OpenedSubject, key: int) -> tuple[dict[str, Any], bool]:
    """Return what is measured of a key interval, and whether it was not on disk."""
    path = _folder_of(opened) / f"{opened.number(key)}.json"
    kept: dict[str, Any] | None = None
    identity = ""

    def is_complete(part: dict[str, Any]) -> bool:
        return opened.settings.clock is None or SLOT_SCORES in part

    def needed(recipes: dict[int, str]) -> bool:
        nonlocal kept, identity
        identity = part_identity(opened, key, recipes)
        kept = _read_kept(path, identity)
        return kept is None or not is_complete(kept)

    inputs = opened.load(key, needed)
    if kept is None:
        part = measure(opened, inputs) | {"identity": identity}
    elif is_complete(kept):
        return kept, False
    else:
        part = kept | measure_slots(opened, inputs)
    atomic_write_text(path, json.dumps(part) + "\n")
    return part, True


def _folder_of(opened: OpenedSubject) -> Path:
    """Return where the parts of a subject lie."""
    display, subject = opened.source.keys.display, opened.subject
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in subject.name)
    size = f"{display.width}x{display.height}"
    return opened.settings.output / PARTS / f"{name}-{size}-{subject.setting}"


def _make_folders(subjects: Iterable[OpenedSubject]) -> None:
    """Make a folder for each subject; refuse two that would share one."""
    owners: dict[Path, Subject] = {}
    for opened in subjects:
        folder = _folder_of(opened)
        if folder in owners:
            raise UsageError(
                f"{owners[folder].source.sequence} and {opened.subject.source.sequence} have one "
                "name, size and setting; measure them into two folders"
            )
        owners[folder] = opened.subject
        make_folder(folder)
        remove_leftovers(folder)


def _measure_times(opened: OpenedSubject, progress: Progress) -> dict[str, Any]:
    """Take run times that were measured before with the same networks and systems, or measure."""
    settings = opened.settings
    dependencies = {
        "version": [TIMING_VERSION, __version__],
        "networks": sorted(opened.networks.checksums.items()),
        "systems": opened.systems,
        "device": settings.device,
        "keys": opened.keys,
    }
    identity = hashlib.sha256(json.dumps(dependencies).encode()).hexdigest()
    path = _folder_of(opened) / "timing.json"
    timing, subject = _read_kept(path, identity), opened.subject
    is_new = timing is None

    def report(key: int) -> None:
        note = f"timing {subject.name}, {subject.setting}"
        progress.advance(opened.number(key), note, _timing_kind(subject), is_new)

    if timing is None:
        progress.message(f"timing {subject.name} with G-buffers for {GBUFFERS_OF[subject.setting]}")
        timing = time_subject(opened, report) | {"identity": identity}
        atomic_write_text(path, json.dumps(timing, indent=1) + "\n")
    else:
        for key in timed_keys(opened):
            report(key)
    return timing


def _read_kept(path: Path, identity: str) -> dict[str, Any] | None:
    """Return what an earlier run measured, if it would come out the same."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return kept if isinstance(kept, dict) and kept.get("identity") == identity else None


def describe_subject(opened: OpenedSubject) -> dict[str, Any]:
    """Return size, rate, producer, policy and render times of a subject."""
    source, network = opened.source, opened.networks.own
    display = source.keys.display
    # Of slot G-buffers only where those files hold nothing else: with colour in them, their time is
    # that of the whole frame.
    gbuffer_s = None
    if source.slots is not None and Role.COLOUR not in source.slots.layout:
        files = source.slots.sequence.files
        numbers = [source.slot_number(Slot(key, slot)) for key in opened.keys for slot in SLOTS]
        gbuffer_s = _mean_render_seconds([files[n] for n in numbers if n is not None])
    key_files = [source.keys.sequence.files[opened.number(key)] for key in opened.keys]
    return {
        "width": display.width,
        "height": display.height,
        "fps": float(source.fps),
        "producer": (source.slots or source.keys).layout.producer,
        "policy": {
            "file": opened.policy.path.name,
            "sha256": opened.policy.checksum,
            "trained_without_it": opened.subject.unseen,
            # Says that the policy was trained for another network than the one that extrapolates.
            "note": None if network is None else other_extrapolator(opened.policy, network),
        },
        "render_s": {"key": _mean_render_seconds(key_files), "gbuffer": gbuffer_s},
    }


def _mean_render_seconds(paths: Sequence[Path]) -> float | None:
    """Return the mean of the render times that headers state."""
    times = [time[0] for path in paths if (time := render_seconds(read_headers(path)))]
    return sum(times) / len(times) if times else None
