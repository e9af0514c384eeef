"""A whole benchmark: parts on disk are taken, the rest is measured side by side and kept."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
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
from exwarp_cli.pipeline.messages import other_extrapolator
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.pipeline.scheduling import use_threads
from exwarp_cli.report.schema import mean
from exwarp_cli.research.bench.measurement import measure, part_identity, time_subject, timed_keys
from exwarp_cli.research.bench.subjects import OpenedSubject, Subject, find_subjects, load_networks
from exwarp_cli.research.bench.systems import SLOTS, BenchSettings
from exwarp_cli.runtime.machine import processors
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.runtime.worker_pool import run_tasks, send_message

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
    opened: tuple[OpenedSubject, ...] = ()  # the same subjects, to make frames of once more


# Takes, of a key interval that is done, the arguments of `Progress.advance`.
Report = Callable[[tuple[int, str, str, bool]], None]
Parts = dict[tuple[Subject, int], dict[str, Any]]  # by subject and key frame


@contextmanager
def run_benchmark(settings: BenchSettings, progress: Progress | None = None) -> Iterator[Benchmark]:
    """Measure what is not measured yet, and keep it in the folder `PARTS` of the output folder.

    Yields the benchmark; the progress ends with the block, in which its files may be written.
    ExwarpError: anything that a user can cause; what was measured until then is kept.
    """
    progress = progress or Progress()
    subjects = find_subjects(settings, progress.message)
    networks = load_networks(settings, None)
    opened = tuple(OpenedSubject(subject, settings, networks) for subject in subjects)
    owners: dict[Path, Subject] = {}
    for each in opened:
        if each.parts in owners:
            raise UsageError(
                f"{owners[each.parts].source.sequence} and {each.subject.source.sequence} have "
                "one name, size and setting; measure them into two folders"
            )
        owners[each.parts] = each.subject
        make_folder(each.parts)
        remove_leftovers(each.parts)
    jobs = settings.jobs or processors().usable
    counts = {_kind(each.subject): len(each.keys) for each in opened}
    counts |= {f"timing {_kind(each.subject)}": len(timed_keys(each)) for each in opened}
    progress.start(sum(counts.values()), counts, jobs)
    try:
        timings = [_measure_times(each, progress) for each in opened]
        about = [describe_subject(each) for each in opened]
        notes = [facts["policy"]["note"] for facts in about]
        for note in dict.fromkeys(note for note in notes if note is not None):
            progress.message(note)
        parts = _measure_all(opened, jobs, lambda step: progress.advance(*step))
        measured = tuple(
            Measured(
                each.subject, facts, timing, tuple(parts[each.subject, key] for key in each.keys)
            )
            for each, facts, timing in zip(opened, about, timings, strict=True)
        )
        yield Benchmark(settings, networks.checksums, opened[0].systems, measured, opened)
    finally:
        progress.finish()


def _kind(subject: Subject) -> str:
    """Name the kind of a subject's intervals: they take about as long."""
    return f"{subject.source.sequence}, {subject.setting}"


def _measure_times(opened: OpenedSubject, progress: Progress) -> dict[str, Any]:
    """Take run times that were measured before with the same networks and systems, or measure."""
    settings, subject = opened.settings, opened.subject
    dependencies = {
        "version": [TIMING_VERSION, __version__],
        "networks": sorted(opened.networks.checksums.items()),
        "systems": opened.systems,
        "device": settings.device,
        "keys": opened.keys,
    }
    identity = hashlib.sha256(json.dumps(dependencies).encode()).hexdigest()
    path = opened.parts / "timing.json"
    timing = _read_kept(path, identity)
    note, kind = f"timing {subject.name}, {subject.setting}", f"timing {_kind(subject)}"
    if timing is not None:
        for key in timed_keys(opened):
            progress.advance(opened.numbers[key], note, kind, made=False)
        return timing
    progress.message(f"timing {subject.name} with G-buffers for {GBUFFERS_OF[subject.setting]}")
    timing = time_subject(opened, lambda key: progress.advance(opened.numbers[key], note, kind))
    timing["identity"] = identity
    atomic_write_text(path, json.dumps(timing, indent=1) + "\n")
    return timing


def _measure_all(subjects: Sequence[OpenedSubject], jobs: int, report: Report) -> Parts:
    """Measure all key intervals, in this process or side by side in others."""
    parts: Parts = {}
    # Short sequences are shared out as well.
    size = min(INTERVALS_PER_TASK, -(-sum(len(opened.keys) for opened in subjects) // jobs))
    tasks = [
        (opened.settings, opened.subject, opened.keys[i : i + size])
        for opened in subjects
        for i in range(0, len(opened.keys), size)
    ]
    jobs = min(jobs, len(tasks))
    if jobs == 1:
        for opened in subjects:
            parts |= _measure_parts(opened, opened.keys, report)
        return parts
    with closing(run_tasks(_measure_task, tasks, jobs, report)) as results:
        for _, measured in results:
            parts |= measured
    return parts


def _measure_task(settings: BenchSettings, subject: Subject, keys: Sequence[int]) -> Parts:
    """Measure some key intervals of a subject in a worker."""
    return _measure_parts(_open_in_worker(settings, subject), keys, send_message)


@lru_cache(2)
def _open_in_worker(settings: BenchSettings, subject: Subject) -> OpenedSubject:
    use_threads(1)
    return OpenedSubject(subject, settings, _load_in_worker(settings, 1))


_load_in_worker = lru_cache(1)(load_networks)


def _measure_parts(opened: OpenedSubject, keys: Sequence[int], report: Report) -> Parts:
    """Measure some key intervals of a subject; what is on disk and still right is taken."""
    parts: Parts = {}
    subject = opened.subject
    note = f"{subject.name}, {subject.setting}"
    for key in keys:
        path = opened.parts / f"{opened.numbers[key]}.json"
        identity = part_identity(opened, key, opened.reader.fingerprints(key))
        part = _read_kept(path, identity)
        is_new = part is None
        if part is None:
            part = measure(opened, opened.reader.read(key)) | {"identity": identity}
            atomic_write_text(path, json.dumps(part) + "\n")
        else:
            opened.reader.release(key)
        parts[subject, key] = part
        report((opened.numbers[key], note, _kind(subject), is_new))
        check_stop()
    opened.restart()
    return parts


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
    keys = source.keys.sequence.files
    timed = {"key": [keys[opened.numbers[key]] for key in opened.keys], "gbuffer": []}
    # Of slot G-buffers only where those files hold nothing else: with colour in them, their time is
    # that of the whole frame.
    if source.slots is not None and Role.COLOUR not in source.slots.layout:
        files = source.slots.sequence.files
        numbers = [source.slot_number(Slot(key, slot)) for key in opened.keys for slot in SLOTS]
        timed["gbuffer"] = [files[n] for n in numbers if n is not None]
    render_s = {}
    for kind, paths in timed.items():
        stated = (render_seconds(read_headers(path)) for path in paths)
        render_s[kind] = mean(seconds[0] for seconds in stated if seconds)
    return {
        "width": display.width,
        "height": display.height,
        "fps": float(source.fps),
        "producer": source.geometry.layout.producer,
        "policy": {
            "file": opened.policy.path.name,
            "sha256": opened.policy.checksum,
            "trained_without_it": opened.subject.unseen,
            # Says that the policy was trained for another network than the one that extrapolates.
            "note": None if network is None else other_extrapolator(opened.policy, network),
        },
        "render_s": render_s,
    }
