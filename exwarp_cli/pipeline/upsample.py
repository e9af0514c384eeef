"""The main job: a key sequence in, a sequence at four times its rate out, or at another."""

from __future__ import annotations

import time
from pathlib import Path

from exwarp_cli.domain.cuts import Cut
from exwarp_cli.domain.results import (
    FrameRecord,
    InterpolatorSummary,
    NetworkSummary,
    RunSummary,
)
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import LayoutError, UsageError
from exwarp_cli.io import exr
from exwarp_cli.io.footage import close, find_frames, picture_size
from exwarp_cli.io.interpolator import OnnxInterpolator, load_interpolator
from exwarp_cli.io.models import OnnxExtrapolator, load_extrapolator
from exwarp_cli.io.output import compression_of
from exwarp_cli.io.policy_files import PolicyFile, load_policy
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.io.video import VideoLook
from exwarp_cli.io.views import expand
from exwarp_cli.kernels import jit
from exwarp_cli.pipeline.announcing import (
    Models,
    announce,
    announce_contents,
    announce_models,
    announce_truth,
    input_summary,
)
from exwarp_cli.pipeline.choosing import Chooser, always, by_policy, by_truth
from exwarp_cli.pipeline.contents import Content, contents_of
from exwarp_cli.pipeline.geometry import Staging
from exwarp_cli.pipeline.layers import Beside
from exwarp_cli.pipeline.loading import IntervalLoader
from exwarp_cli.pipeline.observing import Observer
from exwarp_cli.pipeline.progress import NoProgress, Progress
from exwarp_cli.pipeline.run import Run
from exwarp_cli.pipeline.scoring import require_measurable
from exwarp_cli.pipeline.sink import FRAMES_BEHIND, Sink
from exwarp_cli.pipeline.source import FrameOf, Source, align
from exwarp_cli.pipeline.targets import Targets
from exwarp_cli.pipeline.views import JointLoader, open_sources
from exwarp_cli.pipeline.watching import Watcher
from exwarp_cli.pipeline.without_vectors import (
    is_kept,
    note_of,
    require_able,
    usual_method,
    video_look,
)
from exwarp_cli.policy.policies import LearnedPolicy
from exwarp_cli.policy.state import INPUTS, STATE_VERSION
from exwarp_cli.synthesis.methods import METHODS, Judge, Method


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
    progress = progress or NoProgress()
    method, sources = _open(settings)
    source = sources[0]
    network = find_network(settings, method)
    interpolator = find_interpolator(settings, method)
    policy = find_policy(settings, method)
    _require_truth(settings, method)
    require_able(source, method, settings)
    require_factor(source, method, interpolator)
    contents = contents_of(sources, settings.layers)
    models = Models.of(source, network, interpolator, policy)
    keys = source.timeline.select(settings.frames)
    slots = [slot for key in keys for slot in source.timeline.slots_of(key)]
    targets = Targets.of(settings, source.keys.sequence)
    truth = None if settings.ground_truth is None else find_truth(settings.ground_truth, source)
    require_measurable(settings, source.keys.display, source.timeline.steps is not None)
    targets.prepare(settings, source.timeline, slots)
    announce(progress, settings, source, method, keys)
    if truth is not None:
        announce_truth(progress, truth[0], source)
    announce_contents(progress, contents)
    announce_models(progress, models, source)
    told = (models.extrapolator, None if policy is None else policy.checksum, models.interpolator)
    loader = make_loader(contents, method, settings, truth, told)
    note = "" if targets.frames else note_of(loader.leading_recipes, settings, keys)
    kept = watcher is None and is_kept(targets, settings, note)
    begin = time.perf_counter()
    progress.start(len(slots))
    staging, *others = (
        Staging(s.keys.display, network, interpolator, s.estimated) for s in sources
    )
    beside = Beside(contents, tuple(others))
    chooser = make_chooser(method, source, policy)
    sink = make_sink(targets, settings, source, beside, video_look(source, keys, note))
    run = Run(settings, source, method, sink, progress, staging, beside, chooser, watcher)
    try:
        records = () if kept else run.write_all(loader, keys)
    finally:
        progress.finish()
        close(source.keys.sequence, *(() if truth is None else truth[:1]))
    return _summary(method, sources, models, contents, loader.cuts, records, begin)


def _summary(
    method: Method,
    sources: tuple[Source, ...],
    models: Models,
    contents: tuple[Content, ...],
    cuts: tuple[Cut, ...] | None,
    records: tuple[FrameRecord, ...],
    begin: float,
) -> RunSummary:
    """Put together what a run that began at some `time.perf_counter` found out."""
    source = sources[0]
    return RunSummary(
        method=method.name,
        setting=source.setting,
        lookahead=method.lookahead,
        input=input_summary(source),
        base_fps=float(source.fps),
        fps_source=source.fps_source,
        wall_seconds=time.perf_counter() - begin,
        frames=records,
        decides=method.decides and is_usual(source),
        extrapolator=models.extrapolator,
        policy=models.policy,
        interpolator=models.interpolator,
        factor=source.timeline.factor,
        cuts=cuts,
        views=tuple(s.keys.view for s in sources if s.keys.view),
        layers=contents[0].names,
    )


def _open(settings: UpsampleSettings) -> tuple[Method, tuple[Source, ...]]:
    """Open the input, and settle the method, which may depend on it."""
    compression_of(settings.compression)
    jit.set_threads(settings.threads)
    exr.set_threads(settings.threads)
    named = None if settings.method is None else find_method(settings.method)
    sources = open_sources(settings.source, named is None or named.needs_motion, pictures=True)
    method = named or find_method(usual_method(sources[0], settings))
    return method, sources


def find_method(name: str) -> Method:
    """Return a method by name; UsageError when there is none."""
    if name not in METHODS:
        raise UsageError(f"--method {name} is not one of {', '.join(METHODS)}")
    return METHODS[name]


def find_network(settings: UpsampleSettings, method: Method) -> OnnxExtrapolator | None:
    """Load the network that a method needs; None for methods that do not extrapolate.

    Raises
    ------
    UsageError
        When options ask for a network that the method would not use.
    InputError, MissingExtraError
        When the network cannot be used.
    """
    _refuse_network_options(settings, method)
    if not method.extrapolates:
        return None
    path = None if settings.extrapolator is None else Path(settings.extrapolator)
    return load_extrapolator(path, settings.threads, settings.device)


def find_interpolator(settings: UpsampleSettings, method: Method) -> OnnxInterpolator | None:
    """Load the network that a method interpolates with; None for methods that do without.

    Raises
    ------
    UsageError
        When none is named.
    InputError, MissingExtraError
        When it or its card cannot be used.
    """
    if not method.interpolates:
        return None
    if settings.interpolator is None:
        raise UsageError(
            f"--method {method.name} has no network of its own; name an ONNX file with "
            "--interpolator, or use --method softsplat"
        )
    return load_interpolator(Path(settings.interpolator), settings.threads, settings.device)


def _refuse_network_options(settings: UpsampleSettings, method: Method) -> None:
    """Refuse options of networks that the method does not run."""
    extrapolating = [m for m in METHODS.values() if m.extrapolates]
    interpolating = [m for m in METHODS.values() if m.interpolates]
    either = [m for m in METHODS.values() if m in extrapolating or m in interpolating]
    other_device = settings.device != UpsampleSettings.device
    rules = (
        ("--extrapolator", settings.extrapolator is not None, "extrapolate", extrapolating),
        ("--interpolator", settings.interpolator is not None, "interpolate so", interpolating),
        ("--device", other_device, "run a network", either),
    )
    for option, given, what, users in rules:
        if given and method not in users:
            names = ", ".join(user.name for user in users)
            raise UsageError(
                f"{option} is for methods that {what}, and --method {method.name} does not; "
                f"leave it out, or use {'one of ' if len(users) > 1 else ''}{names}"
            )


def find_policy(settings: UpsampleSettings, method: Method) -> PolicyFile | None:
    """Load the policy that a method asks; None for methods that ask none.

    Raises
    ------
    UsageError
        When options name a policy that the method would not ask.
    InputError
        When it cannot be used.
    """
    path = None if settings.policy is None else Path(settings.policy)
    if method.judge is Judge.POLICY:
        return require_state(load_policy(path))
    if path is not None:
        raise UsageError(
            f"--policy is for --method exwarp, and --method {method.name} asks no policy; leave "
            "it out"
        )
    return None


def require_state(policy: PolicyFile) -> PolicyFile:
    """Refuse a policy that was trained on other inputs than a state has."""
    inputs, version = policy.network.sizes[0], policy.metadata.get("state")
    if (inputs, version) != (INPUTS, STATE_VERSION):
        raise LayoutError(
            f"{policy.path} takes {inputs} inputs of version {version!r}, and a state has {INPUTS} "
            f"of version {STATE_VERSION}; train the policy again"
        )
    return policy


def _require_truth(settings: UpsampleSettings, method: Method) -> None:
    """Refuse an oracle without ground truth."""
    if method.needs_truth and settings.ground_truth is None:
        raise UsageError(
            f"--method {method.name} decides by ground truth; give it with --ground-truth, or use "
            "--method exwarp"
        )


def make_chooser(method: Method, source: Source, policy: PolicyFile | None) -> Chooser | None:
    """Return who decides the path of each key interval; None outside the decision tree."""
    if method.path is not None:
        return always(method.path) if is_usual(source) else None
    if policy is not None:
        observer = Observer(source.keys.display, source.setting)
        return by_policy(LearnedPolicy(policy.network), observer)
    return None if method.judge is None else by_truth(method.judge, source.keys.display)


def is_usual(source: Source) -> bool:
    """Whether there are decisions: for the paper's factor alone, and along a renderer's motion."""
    return source.timeline.factor == FACTOR and not source.estimated


def require_factor(
    source: Source, method: Method, interpolator: OnnxInterpolator | None = None
) -> None:
    """Refuse a factor at which a method makes no frames; raises UsageError."""
    timeline = source.timeline
    if not (method.any_factor or is_usual(source)):
        names = ", ".join(other.name for other in METHODS.values() if other.any_factor)
        raise UsageError(
            f"--method {method.name} decides between slots of {FACTOR} times the rate, and "
            f"{float(timeline.factor):g} times are asked for; use one of {names}"
        )
    if interpolator is None:
        return
    times = {timeline.time(slot) for key in range(3) for slot in timeline.between(key)}
    if out := sorted(t for t in times if not interpolator.reaches(t)):
        raise UsageError(
            f"--interpolator {interpolator.name} is not told the time and makes the middle frame "
            f"only, so it does not reach {out[0]} of a key interval; give --factor 2, 4 or 8, or a "
            "network with an input for the time"
        )


def make_loader(
    contents: tuple[Content, ...],
    method: Method,
    settings: UpsampleSettings,
    truth: tuple[Sequence, FrameOf] | None,
    told: tuple[NetworkSummary | None, str | None, InterpolatorSummary | None],
) -> JointLoader:
    """Return what reads the views that are written; the first decides, and is scored.

    `told` is what networks and policy frames depend on, as `IntervalLoader` takes it.
    """
    leader = IntervalLoader(contents[0].source, method, settings, truth, *told, contents)
    others = (
        IntervalLoader(content.source, method, settings, None, *told, (content,))
        for content in contents[1:]
    )
    return JointLoader(leader, tuple(others))


def make_sink(
    targets: Targets, settings: UpsampleSettings, source: Source, beside: Beside, look: VideoLook
) -> Sink:
    """Return where frames go; those with all their layers are large, and few may wait."""
    behind = 0 if beside.anything else FRAMES_BEHIND
    view = source.keys.view
    return Sink(targets, settings, source.keys.display, source.output_fps, view, behind, look)


def find_truth(spec: str, source: Source) -> tuple[Sequence, FrameOf]:
    """Find ground truth of any kind, and refuse one of another size before any work."""
    sequence = find_frames(expand(spec, source.keys.view or None)[0])
    frame_of = align(source.timeline, sequence, "--ground-truth")
    window, display = picture_size(sequence), source.keys.display
    if window.shape != display.shape:
        raise LayoutError(
            f"--ground-truth {sequence.pattern} is {window.width}x{window.height} and the "
            f"input is {display.width}x{display.height}; give one of the same resolution"
        )
    return sequence, frame_of
