"""Files of a job as other processes and machines name and see them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.farm.places import PURPOSES, Flow, Form
from exwarp_cli.pipeline.job import Job


def absolute(settings: UpsampleSettings) -> UpsampleSettings:
    """Return settings whose paths do not depend on the folder in which a process runs."""
    source = replace(settings.source, **_placed_in(settings.source))
    return replace(settings, source=source, **_placed_in(settings))


def inputs_of(job: Job) -> tuple[tuple[str, int], ...]:
    """Return files that a job reads, enough to tell whether a machine sees all, and their sizes.

    Of sequences these are the first and the last frame: mounted is mounted. Networks that come with
    ExWarp are each machine's own.
    """
    return tuple((str(path.absolute()), path.stat().st_size) for path in dict.fromkeys(_files(job)))


def _files(job: Job) -> Iterator[Path]:
    keys, slots = job.source.keys, job.source.slots
    for shot in (keys,) if slots is None else (keys, slots):
        numbers = shot.sequence.numbers
        for number in (numbers[0], numbers[-1]):
            # Where frames may be left out, those that are missing are listed, too.
            paths = shot.files(number).values()
            yield from (path for path in paths if not shot.keep_going or path.exists())
    if job.truth is not None:
        files = job.truth[0].files
        yield from (files[min(files)], files[max(files)])
    for name, purpose in PURPOSES.items():
        if purpose.form is Form.FILE and purpose.flow is Flow.READ:
            owner = job.settings if hasattr(job.settings, name) else job.settings.source
            named = getattr(owner, name)
            if named is not None:
                yield Path(named)


def _placed_in(settings: UpsampleSettings | SourceSettings) -> dict[str, Any]:
    """Return the options of these settings that name files, each beginning at the root."""
    given = {f.name: getattr(settings, f.name) for f in fields(settings) if f.name in PURPOSES}
    return {
        name: tuple(map(_aov, value)) if PURPOSES[name].form is Form.AOV else _placed(value)
        for name, value in given.items()
        if value is not None
    }


def _placed(text: str) -> str:
    """Let a path or pattern begin at the root; a slash at its end stays, as it says something."""
    # Not by `Path`, which drops that slash; and `..` stays, as links could lead elsewhere.
    return text if Path(text).is_absolute() else f"{Path.cwd()}/{text}"


def _aov(text: str) -> str:
    """Place the pattern in ``ROLE=PATTERN[:CHANNELS]``."""
    role, equals, rest = text.partition("=")
    return f"{role}{equals}{_placed(rest)}"
