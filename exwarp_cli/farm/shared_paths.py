"""Files of a job as other processes and machines name and see them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.pipeline.job import Job


def absolute(settings: UpsampleSettings) -> UpsampleSettings:
    """Return settings whose paths do not depend on the folder in which a process runs."""
    source = settings.source
    return replace(
        settings,
        source=replace(
            source,
            sequence=_placed(source.sequence),
            gbuffers=_maybe(source.gbuffers),
            aovs=tuple(_aov(text) for text in source.aovs),
            channel_map=_maybe(source.channel_map),
        ),
        output=_placed(settings.output),
        ground_truth=_maybe(settings.ground_truth),
        write_holes=_maybe(settings.write_holes),
        video=_maybe(settings.video),
        extrapolator=_maybe(settings.extrapolator),
        interpolator=_maybe(settings.interpolator),
        policy=_maybe(settings.policy),
    )


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
            yield from shot.files(number).values()
    if job.truth is not None:
        files = job.truth[0].files
        yield from (files[min(files)], files[max(files)])
    settings = job.settings
    named = (
        settings.source.channel_map,
        settings.extrapolator,
        settings.interpolator,
        settings.policy,
    )
    yield from (Path(path) for path in named if path is not None)


def _placed(text: str) -> str:
    """Let a path or pattern begin at the root; a slash at its end stays, as it says something."""
    # Not by `Path`, which drops that slash; and `..` stays, as links could lead elsewhere.
    return text if Path(text).is_absolute() else f"{Path.cwd()}/{text}"


def _maybe(text: str | None) -> str | None:
    return None if text is None else _placed(text)


def _aov(text: str) -> str:
    """Place the pattern in ``ROLE=PATTERN[:CHANNELS]``."""
    role, equals, rest = text.partition("=")
    return f"{role}{equals}{_placed(rest)}"
