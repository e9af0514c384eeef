"""The main job: a key sequence in, a sequence at four times its rate out."""

from __future__ import annotations

import time
from pathlib import Path

from exwarp_cli.domain.results import (
    InputSummary,
    InterpolatorSummary,
    NetworkSummary,
    PolicySummary,
    RunSummary,
)
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import LayoutError, UsageError
from exwarp_cli.io import exr
from exwarp_cli.io.channels import Role
from exwarp_cli.io.interpolator import OnnxInterpolator, load_interpolator
from exwarp_cli.io.models import OnnxExtrapolator, load_extrapolator
from exwarp_cli.io.output import compression_of
from exwarp_cli.io.policy_files import PolicyFile, load_policy
from exwarp_cli.io.sequence import Sequence, find_sequence
from exwarp_cli.kernels import jit
from exwarp_cli.pipeline.choosing import Chooser, always, by_policy, by_truth
from exwarp_cli.pipeline.geometry import Staging
from exwarp_cli.pipeline.loading import IntervalLoader
from exwarp_cli.pipeline.observing import Observer
from exwarp_cli.pipeline.progress import NoProgress, Progress
from exwarp_cli.pipeline.run import Run
from exwarp_cli.pipeline.scoring import require_measurable
from exwarp_cli.pipeline.source import FrameOf, Source, align, open_source
from exwarp_cli.pipeline.targets import Targets
from exwarp_cli.pipeline.watching import Watcher
from exwarp_cli.policy.policies import LearnedPolicy
from exwarp_cli.policy.state import INPUTS, STATE_VERSION
from exwarp_cli.synthesis.methods import METHODS, Judge, Method

SURFACE_COLOURS = {Role.ALBEDO: "diffuse", Role.SPECULAR: "glossy"}
"""What `synthesis.modulation` divides by, both together, as the user knows it."""


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
    method = find_method(settings.method)
    compression_of(settings.compression)
    jit.set_threads(settings.threads)
    exr.set_threads(settings.threads)
    network = find_network(settings, method)
    interpolator = find_interpolator(settings, method)
    policy = find_policy(settings, method)
    _require_truth(settings, method)
    source = open_source(settings.source, method.needs_motion)
    require_factor(source, method, interpolator)
    told = None if network is None else _network_summary(network, source)
    between = None if interpolator is None else _interpolator_summary(interpolator)
    keys = source.timeline.select(settings.frames)
    slots = [slot for key in keys for slot in source.timeline.slots_of(key)]
    targets = Targets.of(settings, source.keys.sequence)
    truth = None if settings.ground_truth is None else find_truth(settings.ground_truth, source)
    require_measurable(settings, source.keys.display, source.timeline.steps is not None)
    targets.prepare(settings, source.timeline, slots)
    _announce(progress, settings, source, method, keys)
    if told is not None:
        _announce_network(progress, told, source)
    if between is not None:
        _announce_interpolator(progress, between)
    decided = None if policy is None else _policy_summary(policy, source)
    if decided is not None:
        _announce_policy(progress, decided)
    checksum = None if policy is None else policy.checksum
    loader = IntervalLoader(source, method, settings, truth, told, checksum, between)
    begin = time.perf_counter()
    progress.start(len(slots))
    staging = Staging(source.keys.display, network, interpolator)
    chooser = make_chooser(method, source, policy)
    run = Run(settings, source, method, targets, progress, staging, chooser, watcher)
    try:
        records = run.write_all(loader, keys)
    finally:
        progress.finish()
    return RunSummary(
        method=method.name,
        setting=source.setting,
        lookahead=method.lookahead,
        input=_input_summary(source),
        base_fps=float(source.fps),
        fps_source=source.fps_source,
        wall_seconds=time.perf_counter() - begin,
        frames=records,
        decides=method.decides and is_usual(source),
        extrapolator=told,
        policy=decided,
        interpolator=between,
        factor=source.timeline.factor,
    )


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
    """Whether the output has the paper's factor, for which alone there are decisions."""
    return source.timeline.factor == FACTOR


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


def _policy_summary(policy: PolicyFile, source: Source) -> PolicySummary:
    """Say what the policy sees of the input."""
    layout = (source.slots or source.keys).layout
    objects_from: str | None = "ids" if Role.STENCIL in layout else "motion"
    if objects_from == "motion" and not (Role.POSITION in layout or Role.DEPTH in layout):
        objects_from = None
    needed = {"EMD_Wn": Role.NORMAL, "EMD_Wp": Role.POSITION}
    missing = [name for name, role in needed.items() if role not in layout]
    if objects_from is None:
        missing.insert(0, "N_d")
    return PolicySummary(str(policy.path), policy.checksum, objects_from, tuple(missing))


def _announce_policy(progress: Progress, decided: PolicySummary) -> None:
    progress.message(
        f"decisions by {Path(decided.file).name} (sha256 {decided.sha256[:8]}), 8-bit integers"
    )
    if decided.objects_from == "motion":
        progress.message("no object ids: what moves otherwise than the camera counts as an object")
    if decided.missing:
        progress.message(
            f"the policy sees 0 for {', '.join(decided.missing)}, as the AOVs for it are missing"
        )


def _network_summary(network: OnnxExtrapolator, source: Source) -> NetworkSummary:
    demodulated = not _missing_colours(source)
    return NetworkSummary(str(network.path), network.checksum, network.device, demodulated)


def _interpolator_summary(network: OnnxInterpolator) -> InterpolatorSummary:
    told = (str(network.path), network.checksum, network.card.checksum, network.device)
    return InterpolatorSummary(network.name, *told)


def _announce_interpolator(progress: Progress, told: InterpolatorSummary) -> None:
    progress.message(
        f"interpolation by {told.name}, {Path(told.file).name} (sha256 {told.sha256[:8]}) on "
        f"{told.device}, from colour alone"
    )


def _missing_colours(source: Source) -> list[str]:
    """Name the surface colours that shading would have to be divided by, and that are not there."""
    layout = (source.slots or source.keys).layout
    return [name for role, name in SURFACE_COLOURS.items() if role not in layout]


def _announce_network(progress: Progress, told: NetworkSummary, source: Source) -> None:
    progress.message(
        f"extrapolation by {Path(told.file).name} (sha256 {told.sha256[:8]}) on {told.device}"
    )
    if missing := _missing_colours(source):
        progress.message(
            f"no {' and no '.join(missing)} colour: shading is extrapolated together with surface "
            "colour"
        )


def find_truth(spec: str, source: Source) -> tuple[Sequence, FrameOf]:
    """Find ground truth, and refuse one of another size before any work."""
    sequence = find_sequence(spec)
    frame_of = align(source.timeline, sequence, "--ground-truth")
    with exr.ExrReader(next(iter(sequence.files.values()))) as first:
        window, display = first.parts[0].display_window, source.keys.display
        if window.shape != display.shape:
            raise LayoutError(
                f"--ground-truth {sequence.pattern} is {window.width}x{window.height} and the "
                f"input is {display.width}x{display.height}; give one of the same resolution"
            )
    return sequence, frame_of


def _announce(
    progress: Progress,
    settings: UpsampleSettings,
    source: Source,
    method: Method,
    keys: tuple[int, ...],
) -> None:
    """Say what was found and what is going to happen."""
    count = len(source.timeline.numbers)
    progress.message(
        f"{source.keys.sequence.pattern}: {count} key frame{'' if count == 1 else 's'} at "
        f"{float(source.fps):g} fps ({source.fps_source}), G-buffers for "
        f"{'every slot' if source.slots is not None else 'the key frames'}"
    )
    if settings.source.gbuffers is not None and source.slots is None:
        progress.message(
            "--gbuffers is left out: it has no readable vectors to the previous slot, and "
            f"{method.name} does without"
        )
    if source.finding is not None:
        progress.message(f"motion {source.finding.source}: {source.finding.evidence}")
    last = count - 1
    if method.lookahead and last in keys and len(source.timeline.slots_of(last)) > 1:
        fallback = "s6" if source.finding is not None else "hold"
        progress.message(
            f"after the last key frame there is no next one, so {method.name} falls back to "
            f"{fallback} there; --no-tail leaves those frames out"
        )


def _input_summary(source: Source) -> InputSummary:
    finding = source.finding
    return InputSummary(
        pattern=source.keys.sequence.pattern,
        first=source.timeline.numbers[0],
        last=source.timeline.numbers[-1],
        width=source.keys.display.width,
        height=source.keys.display.height,
        producer=(source.slots or source.keys).layout.producer,
        motion_source=None if finding is None else finding.source,
        motion_evidence=None if finding is None else finding.evidence,
    )
