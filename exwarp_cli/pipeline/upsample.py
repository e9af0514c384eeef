"""The main job: a key sequence in, a sequence at four times its rate out, or at another."""

from __future__ import annotations

import time
from dataclasses import replace

from exwarp_cli.domain.cores import working
from exwarp_cli.domain.frame import Window
from exwarp_cli.domain.outcome import Outcome
from exwarp_cli.domain.results import RunSummary
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.io.threads import use_threads
from exwarp_cli.kernels import _row_bands
from exwarp_cli.pipeline.choosing import Chooser, always, by_policy, by_truth
from exwarp_cli.pipeline.eta import kinds_of
from exwarp_cli.pipeline.finding import is_usual
from exwarp_cli.pipeline.geometry import Staging
from exwarp_cli.pipeline.job import Job, open_job
from exwarp_cli.pipeline.layers import Beside, anything_beside
from exwarp_cli.pipeline.loading import IntervalLoader
from exwarp_cli.pipeline.making import SlotMaker
from exwarp_cli.pipeline.nonfinite import broken_pixels_of
from exwarp_cli.pipeline.progress import NoProgress, Progress
from exwarp_cli.pipeline.run import Run
from exwarp_cli.pipeline.sink import FRAMES_BEHIND, Sink
from exwarp_cli.pipeline.slots_at_once import SlotsAtOnce
from exwarp_cli.pipeline.verifying import Sums, files_of, verify, verify_video
from exwarp_cli.pipeline.views import JointLoader
from exwarp_cli.pipeline.watching import Watcher
from exwarp_cli.pipeline.without_vectors import BY_EXWARP, is_kept, note_of, video_look
from exwarp_cli.runtime.frame_pool import pool

MOST_WAITING = 80 * 10**6
"""Bytes of frames that wait to be written, beside those that are being written."""

PIXEL_BYTES = 16
"""Four channels in float32."""


def upsample(
    settings: UpsampleSettings, progress: Progress | None = None, watcher: Watcher | None = None
) -> RunSummary:
    """Write the slots of the selected key frames.

    Parameters
    ----------
    settings
        What to do.
    progress
        Told of every frame; None for silence.
    watcher
        Shown frames that it wants to see; None for nobody.

    Returns
    -------
    RunSummary
        What was written and how good it is.

    Raises
    ------
    ExwarpError
        For anything that a user can cause; frames written until then are whole.
    """
    return run_job(open_job(settings), progress or NoProgress(), watcher)


def run_job(job: Job, progress: Progress, watcher: Watcher | None = None) -> RunSummary:
    """Do a job that is open; see `upsample`."""
    job.refuse()
    job.targets.make_folders()
    job.announce(progress)
    begin = time.perf_counter()
    progress.start(len(job.slots), kinds_of(job.slots))
    try:
        if watcher is not None:
            watcher.plan(job.groups)
        outcome = write_intervals(job, progress, watcher)
    finally:
        progress.finish()
    return job.summary(outcome, time.perf_counter() - begin)


def write_intervals(job: Job, progress: Progress, watcher: Watcher | None = None) -> Outcome:
    """Do the work of a job whose folders are there, in this thread.

    Parameters
    ----------
    job
        What is done.
    progress
        Told of every frame; started and finished by the caller.
    watcher
        Shown frames; it has heard already which will come.

    Returns
    -------
    Outcome
        Without frames for a video alone that was there as this run would make it.

    Raises
    ------
    OutputError
        When files are not on the disk as they were written, where that is looked after.
    """
    settings = job.settings
    use_threads(settings.threads)
    pool.clear()  # of what vectors were measured in
    loader = make_loader(job)
    note = ""
    if job.targets.frames is None:
        note = note_of(loader.leading_recipes, settings, job.keys)
    try:
        if watcher is None and is_kept(job.targets, settings, note):
            return Outcome(cuts=loader.cuts)
        run = _run_of(job, note, progress, watcher)
        with working():
            frames = run.write_all(loader, job.keys)
        made = Outcome(
            frames,
            loader.cuts,
            tuple(run.left_out),
            nonfinite=broken_pixels_of(job, loader.truth_nonfinite),
        )
        return checked(made, job, run.sink.sums)
    finally:
        job.close()


def checked(made: Outcome, job: Job, sums: Sums) -> Outcome:
    """Add checksums of the files to what was made, and read these back, where that is asked.

    Parameters
    ----------
    made
        By the job.
    job
        Of a run, or of a part of one.
    sums
        What is known of its files.

    Raises
    ------
    OutputError
        When files cannot be read, or are not as they were made.
    """
    settings = job.settings
    if not (job.sums and made.frames):
        return made
    files = files_of(job.targets, made.frames, sums)
    count = None
    if settings.verify:
        count = verify(job.targets, made.frames, files, job.source.keys.view, made.shown)
        if job.targets.frames is not None and job.targets.video is not None:
            verify_video(job.targets.video, made.shown)
    return replace(made, files=files, verified=count)


def _run_of(job: Job, note: str, progress: Progress, watcher: Watcher | None) -> Run:
    """Set up what makes and writes frames."""
    warps = job.source.slots is None and not job.method.extrapolates
    bare = warps and not anything_beside(job.contents)
    staging, *others = (
        Staging(
            source.keys.display,
            job.network,
            job.interpolator,
            source.estimated,
            bare,
            source.scratch,
        )
        for source in job.sources
    )
    beside = Beside(job.contents, tuple(others))
    # Frames with all their layers are large, and few may wait.
    sink = make_sink(job, note, 0 if beside.anything else _behind(job.source.keys.display))
    chooser = make_chooser(job)
    maker = SlotMaker(job.settings, job.source, job.method, sink, beside)
    slots = max((len(job.source.timeline.made_of(key)) for key in job.keys), default=0)
    at_once = SlotsAtOnce(_row_bands.threads(), slots)
    return Run(
        job.settings, job.source, job.method, sink, progress, staging, beside, maker,
        chooser, at_once, watcher,
    )  # fmt: skip


def _behind(display: Window) -> int:
    """Return how many frames may wait to be written: fewer of large ones."""
    return min(FRAMES_BEHIND, MOST_WAITING // (display.pixels * PIXEL_BYTES))


def make_chooser(job: Job) -> Chooser | None:
    """Return who decides the path of each key interval; None outside the decision tree."""
    method, source = job.method, job.source
    if method.path is not None:
        return always(method.path) if is_usual(source) else None
    if job.policy is not None:
        from exwarp_cli.pipeline.observing import Observer
        from exwarp_cli.policy.policies import LearnedPolicy

        observer = Observer(source.keys.display, source.setting)
        return by_policy(LearnedPolicy(job.policy.network), observer)
    return None if method.judge is None else by_truth(method.judge, source.keys.display)


def make_loader(job: Job) -> JointLoader:
    """Return what reads the views that are written; the first decides, and is scored."""
    contents, method, settings, told = job.contents, job.method, job.settings, job.told
    leader = IntervalLoader(contents[0].source, method, settings, job.truth, *told, contents)
    others = (
        IntervalLoader(content.source, method, settings, None, *told, (content,))
        for content in contents[1:]
    )
    return JointLoader(leader, tuple(others))


def make_sink(job: Job, note: str = "", behind: int = FRAMES_BEHIND) -> Sink:
    """Return where frames go; `note` is what a video that is written alone says of itself."""
    keys, rate = job.source.keys, job.source.output_rate
    look = video_look(job.source, job.keys, note or BY_EXWARP)
    return Sink(job.targets, job.settings, keys.display, rate, keys.view, behind, look, job.sums)
