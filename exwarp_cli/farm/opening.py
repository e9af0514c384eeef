"""Opening a job before it goes to a farm: what would fail there is refused here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.errors import UsageError
from exwarp_cli.farm.calls import FarmJob, Given
from exwarp_cli.farm.places import PURPOSES, locate
from exwarp_cli.io.aov_files import parse_aovs
from exwarp_cli.io.channel_map import read_channel_map
from exwarp_cli.io.clip import is_clip
from exwarp_cli.pipeline.job import Job, open_job


def open_farm_job(
    settings: UpsampleSettings,
    options: Sequence[tuple[str, str, str | None]],
    size: int,
    title: str | None,
) -> FarmJob:
    """Look at what a job would read and write, and put down what its chunks are called with.

    Parameters
    ----------
    settings
        Of the whole run.
    options
        Argument and options, each as its name in the command, its flag ("" for the argument) and
        its value (None without).
    size
        Key frames of a chunk.
    title
        Of the job; None for the sequence's name.

    Raises
    ------
    ExwarpError
        For anything that `upsample` would refuse.
    """
    if is_clip(settings.output):
        raise UsageError(
            f"-o {settings.output} is a video, which no chunk can write alone; name a folder for "
            "the frames in -o, and the video with --video"
        )
    # With the device of a worker, not of here.
    job = open_job(replace(settings, device=UpsampleSettings.device))
    try:
        _require_network(settings, job)
        job.refuse()
        return FarmJob(
            tuple(_given((*options, *_mapped(settings)))),
            job.key_numbers,
            size,
            title or f"exwarp {Path(job.source.keys.sequence.pattern).name}",
            settings.overwrite,
            job.method.needs_truth,
        )
    finally:
        job.close()


def _given(options: Iterable[tuple[str, str, str | None]]) -> Iterable[Given]:
    for parameter, flag, text in options:
        if text is None or parameter not in PURPOSES:
            yield Given(parameter, flag, text)
        else:
            yield Given(parameter, flag, locate(parameter, text))


def _mapped(settings: UpsampleSettings) -> Iterable[tuple[str, str, str]]:
    """Return the AOVs of a channel map as options: its paths hold in this folder alone."""
    path = settings.source.channel_map
    if path is None:
        return
    given = {aov.role for aov in parse_aovs(settings.source.aovs)}
    for aov in read_channel_map(Path(path)).aovs:
        if aov.role not in given:
            yield "aovs", "--aov", f"{aov.role.value}={aov.pattern}{aov.chosen}"


def _require_network(settings: UpsampleSettings, job: Job) -> None:
    """Refuse a device for a method that runs nothing on it."""
    runs = job.method.extrapolates or job.method.interpolates
    if settings.device != UpsampleSettings.device and not runs:
        raise UsageError(
            f"--device {settings.device} is for methods that run a network, and --method "
            f"{job.method.name} does not; leave it out"
        )
