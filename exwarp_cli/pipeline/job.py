"""A job: settings with everything opened that they name, before any frame is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from exwarp_cli.domain.results import InputSummary, RunSummary
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.tiles import LOOK_AHEAD_STATE, TILE_STATE
from exwarp_cli.domain.timeline import FACTOR, Slot, number_step
from exwarp_cli.errors import LayoutError, UsageError
from exwarp_cli.io.footage import close_sequences, is_plain
from exwarp_cli.io.generated_frames import parse_compression
from exwarp_cli.io.layers import BEAUTY
from exwarp_cli.pipeline.decide import make_chooser
from exwarp_cli.pipeline.extra_layers import Content, contents_of
from exwarp_cli.pipeline.ground_truth import find_truth, truth_of_another_size
from exwarp_cli.pipeline.messages import Models, input_messages, model_messages, output_messages
from exwarp_cli.pipeline.output_plan import OutputPlan, require_own
from exwarp_cli.pipeline.rendered_frames import RenderedFrames, find_rendered
from exwarp_cli.pipeline.scheduling import use_threads
from exwarp_cli.pipeline.scoring import require_measurable
from exwarp_cli.pipeline.source import (
    FrameOf,
    Source,
    find_other_windows,
    open_sources,
    require_one_size,
)
from exwarp_cli.runtime.frame_pool import LARGE_PIXELS, ScratchFrames
from exwarp_cli.synthesis import methods

if TYPE_CHECKING:
    from exwarp_cli.domain.results import RunOutcome
    from exwarp_cli.io.sequences import Sequence
    from exwarp_cli.models.interpolator import OnnxInterpolator
    from exwarp_cli.models.picture_network import OnnxExtrapolator, OnnxLookAhead
    from exwarp_cli.models.policy_files import PolicyFile
    from exwarp_cli.pipeline.interval_inputs import Dependencies
    from exwarp_cli.pipeline.progress import Progress
    from exwarp_cli.synthesis.interval import TileChooser


@dataclass(frozen=True)
class Job:
    """What a run works with."""

    settings: UpsampleSettings
    method: methods.Method
    sources: tuple[Source, ...]  # one a view; the first decides, and is scored
    # What the method needs of these three; None for what it does without.
    network: OnnxExtrapolator | None
    interpolator: OnnxInterpolator | OnnxLookAhead | None
    policy: PolicyFile | None
    chooser: TileChooser | None  # of the tiles that the interpolator makes; None for all
    models: Models  # the same as the report names them
    contents: tuple[Content, ...]  # what is written of each view
    keys: tuple[int, ...]  # indices of the key frames to do
    targets: OutputPlan
    truth: tuple[Sequence, FrameOf] | None  # ground truth and its frame for a slot
    rendered: RenderedFrames | None = None
    reported: bool = False  # whether there is a report, which has checksums of all files

    @property
    def sums(self) -> bool:
        """True if checksums of files are wanted."""
        return self.reported or self.settings.verify

    @property
    def source(self) -> Source:
        """The view that decides."""
        return self.sources[0]

    @property
    def key_numbers(self) -> tuple[int, ...]:
        """Input numbers of the key frames to do."""
        return tuple(self.source.timeline.numbers[key] for key in self.keys)

    @property
    def slots(self) -> list[Slot]:
        """The output instants that are written, in order."""
        return [slot for key in self.keys for slot in self.source.timeline.slots_of(key)]

    @property
    def groups(self) -> list[list[int]]:
        """The output numbers of each key interval, as a `FrameListener` plans by them."""
        timeline = self.source.timeline
        return [[timeline.number(slot) for slot in timeline.slots_of(key)] for key in self.keys]

    @property
    def depends_on(self) -> Dependencies:
        """What networks and policy frames depend on, as `IntervalReader` takes it."""
        policy = None
        if self.policy is not None:
            effort = f" effort {self.settings.spent:g}" if self.policy.of_tiles else ""
            policy = f"{self.policy.checksum}{effort}"
        return self.models.extrapolator, self.models.interpolator, policy

    def refuse(self) -> None:
        """Refuse frames and ground truth of another size, and to overwrite; touch nothing.

        See `require_one_size`, `OutputPlan.check_conflicts` and `require_own`.
        """
        for source in self.sources:
            timeline, last = source.timeline, len(source.timeline.numbers) - 1
            # A cut before the next key frame is looked for in both, whatever the method.
            reads_next = self.method.lookahead or source.cuts.detect
            ends = {min(key + 1, last) for key in self.keys} if reads_next else set()
            keys = sorted(ends.union(self.keys))
            require_one_size(source.keys, [timeline.numbers[key] for key in keys])
            if source.slots is not None:
                slots = [s for key in self.keys for s in (Slot(key, 0), *timeline.between(key))]
                numbers = map(source.slot_number, slots)
                require_one_size(source.slots, [n for n in numbers if n is not None])
        if self.truth is not None and (
            self.method.needs_truth or not self.settings.source.keep_going
        ):
            sequence, frame_of = self.truth
            timeline, display = self.source.timeline, self.source.keys.display
            made = [slot for key in self.keys for slot in timeline.made_of(key)]
            truth = {slot: (sequence, n) for slot in made if (n := frame_of(slot)) is not None}
            for slot, window in find_other_windows(truth, display).items():
                if window.shape != display.shape:
                    raise truth_of_another_size(timeline.number(slot), window, display)
        if self.rendered is not None:
            self.rendered.require_usable(self.targets.frames, self.source, self.keys)
        self.targets.check_conflicts(self.source.timeline, self.slots)
        if self.settings.skip_existing and not self.settings.replaces_foreign:
            rendered = None if self.rendered is None else self.rendered.sequence
            require_own(self.targets, self.source, self.method, self.slots, rendered)

    def announce(self, progress: Progress) -> None:
        """Say what was found, and what is going to happen."""
        for text in chain(input_messages(self), output_messages(self), model_messages(self)):
            progress.message(text)

    def close(self) -> None:
        """Close what reading left open; a later read opens it again."""
        close_sequences(self.source.keys.sequence, *(() if self.truth is None else self.truth[:1]))
        if self.rendered is not None:
            close_sequences(self.rendered.sequence)

    def summary(self, outcome: RunOutcome, seconds: float) -> RunSummary:
        """Put together what a run of this job did, in `seconds` of wall time of streaming."""
        source, geometry = self.source, self.source.geometry
        numbers, motion = source.timeline.numbers, source.motion_origin
        by_name = None if geometry.ids is None else geometry.ids.dynamic
        return RunSummary(
            method=self.method.name,
            setting=source.setting,
            lookahead=self.method.lookahead,
            input=InputSummary(
                pattern=source.keys.sequence.pattern,
                first=numbers[0],
                last=numbers[-1],
                width=source.keys.display.width,
                height=source.keys.display.height,
                producer=geometry.layout.producer,
                motion_source=None if motion is None else motion[0],
                motion_evidence=None if motion is None else motion[1],
                dynamic=None if by_name is None else by_name.names,
                step=number_step(numbers),
                depth=geometry.depth.evidence or None,
            ),
            base_fps=float(source.fps),
            fps_source=source.fps_source,
            wall_seconds=seconds,
            frames=outcome.frames,
            decides=self.method.decides and source.allows_decisions,
            extrapolator=self.models.extrapolator,
            policy=self.models.policy,
            interpolator=self.models.interpolator,
            factor=source.timeline.factor,
            cuts=outcome.cuts,
            views=tuple(s.keys.view for s in self.sources if s.keys.view),
            layers=self.contents[0].names,
            keys=self.key_numbers,
            left_out=outcome.left_out,
            files=outcome.files,
            verified=outcome.verified,
            nonfinite=outcome.nonfinite,
            view_transform=self.settings.view_transform,
        )


def open_job(settings: UpsampleSettings) -> Job:
    """Open all that settings name; nothing is written.

    Raises ExwarpError for anything that a user can cause, but for what is in the way of the output.
    """
    compression = parse_compression(settings.compression)
    use_threads(settings.threads)
    method = _find_method(settings)
    sources = open_sources(settings.source, method.needs_motion)
    source = sources[0]
    # The default makes what has no next key frame as `causal` does, where it can.
    is_alone = len(sources) == 1 and settings.layers == BEAUTY
    has_vectors = source.finding is not None and source.slots is None
    if method.weighs and method.gated and is_alone and has_vectors and source.allows_decisions:
        method = replace(method, tail=methods.METHODS[methods.CAUSAL])
    if method.last.extrapolates:
        scratch = ScratchFrames(LARGE_PIXELS)
        sources = tuple(replace(each, scratch=scratch) for each in sources)
        source = sources[0]
    network, interpolator = find_networks(settings, method)
    policy, look_ahead_policy = _find_policies(settings, method)
    if policy is not None and not policy.of_tiles:
        method = methods.FRAMEWISE
    _require_usable(settings, method, source, interpolator)
    contents = contents_of(sources, settings.layers)
    models = Models.of(source, network, interpolator, policy, look_ahead_policy, settings.spent)
    keys = source.timeline.select(settings.frames)
    targets = OutputPlan.from_settings(settings, source.keys.sequence, compression)
    truth = None
    if settings.ground_truth is not None:
        tolerant = settings.source.keep_going and not method.needs_truth
        truth = find_truth(settings.ground_truth, source, tolerant, settings.source.scan)
    require_measurable(settings, source.keys.display, source.timeline.steps is not None)
    rendered = None
    if settings.rendered is not None:
        rendered = find_rendered(settings.rendered, source, settings.source.scan)
    return Job(
        settings,
        method,
        sources,
        network,
        interpolator,
        policy,
        make_chooser(look_ahead_policy, settings.spent),
        models,
        contents,
        keys,
        targets,
        truth,
        rendered,
    )


def _find_method(settings: UpsampleSettings) -> methods.Method:
    """Return the method that settings name: with `causal` one of no later key frame."""
    name, causal = settings.method, settings.causal
    if name in (None, methods.EXWARP):
        if causal:
            return methods.METHODS[methods.CAUSAL]
        return methods.EFFORTLESS if settings.effort == 0 else methods.METHODS[methods.EXWARP]
    if name not in methods.METHODS:
        raise UsageError(f"--method {name} is not one of {', '.join(methods.METHODS)}")
    if causal and methods.METHODS[name].lookahead:
        raise UsageError(
            f"--causal keeps to past key frames, and --method {name} uses the next one, too; leave "
            "out one of the two"
        )
    return methods.METHODS[name]


def find_networks(
    settings: UpsampleSettings, method: methods.Method
) -> tuple[OnnxExtrapolator | None, OnnxInterpolator | OnnxLookAhead | None]:
    """Load the network that a method extrapolates with, and the one that it interpolates with.

    The second may weigh both key frames. None for those that the method does without. Raises
    UsageError when options ask for a network that the method would not use, or name none that it
    needs; InputError or MissingExtraError when a network cannot be used.
    """
    rules: tuple[tuple[str, str, Callable[[methods.Method], bool]], ...] = (
        ("extrapolator", "extrapolate", lambda m: m.last.extrapolates),
        ("interpolator", "interpolate so", lambda m: m.interpolates or m.weighs),
        ("device", "run a network", lambda m: m.runs_network),
    )
    for option, what, uses in rules:
        is_set = getattr(settings, option) != getattr(UpsampleSettings, option)
        # At an effort of 0 the default takes options of the networks that it would run.
        if is_set and not (uses(method) or uses(methods.METHODS[method.name])):
            users = [user for user in methods.METHODS.values() if uses(user)]
            names = ", ".join(user.name for user in users)
            raise UsageError(
                f"--{option} is for methods that {what}, and --method {method.name} does not; "
                f"leave it out, or use {'one of ' if len(users) > 1 else ''}{names}"
            )
    network: OnnxExtrapolator | None = None
    interpolator: OnnxInterpolator | OnnxLookAhead | None = None
    if method.last.extrapolates:
        from exwarp_cli.models.picture_network import load_extrapolator

        path = None if settings.extrapolator is None else Path(settings.extrapolator)
        network = load_extrapolator(path, settings.threads, settings.device)
    path = None if settings.interpolator is None else Path(settings.interpolator)
    if method.weighs:
        from exwarp_cli.models.picture_network import load_lookahead

        interpolator = load_lookahead(path, settings.threads, settings.device)
    elif method.interpolates:
        if path is None:
            raise UsageError(
                f"--method {method.name} has no network of its own; name an ONNX file with "
                "--interpolator, or use --method softsplat"
            )
        from exwarp_cli.models.interpolator import load_interpolator

        interpolator = load_interpolator(path, settings.threads, settings.device)
    return network, interpolator


def _find_policies(
    settings: UpsampleSettings, method: methods.Method
) -> tuple[PolicyFile | None, PolicyFile | None]:
    """Load the policy that a method asks, and what chooses tiles between key frames.

    None for a method that asks no policy, and where a network makes all tiles.
    """
    from exwarp_cli.models import policy_files

    if settings.policy is not None and method.judge is not methods.DecisionSource.TILES:
        raise UsageError(
            f"--policy is for --causal, and --method {method.name} asks no policy; leave it out"
        )
    policy = look_ahead_policy = None
    if method.last.judge is methods.DecisionSource.TILES:
        path, shipped = None, policy_files.SHIPPED_TILE_POLICY
        if settings.policy == policy_files.PAPER:
            shipped = policy_files.SHIPPED_POLICY
        elif settings.policy is not None:
            path = Path(settings.policy)
        policy = require_state(policy_files.load_policy(path, shipped))
    if method.weighs and method.gated and settings.spent != 1:
        look_ahead_policy = policy_files.load_policy(None, policy_files.SHIPPED_LOOK_AHEAD_POLICY)
        require_state(look_ahead_policy, LOOK_AHEAD_STATE)
    by_tiles = policy is not None and policy.of_tiles
    if settings.effort is not None and not (by_tiles or method.name == methods.EXWARP):
        chooser = (
            "--policy chooses for whole frames" if policy else f"{method.name} chooses nothing"
        )
        raise UsageError(
            f"--effort is for exwarp, and for --causal with a policy of tiles, and {chooser}; "
            "leave it out"
        )
    return policy, look_ahead_policy


def require_state(policy: PolicyFile, *versions: str | int) -> PolicyFile:
    """Refuse a policy that was trained on other inputs than a state has.

    `versions` are those that it may have; usually the ones of `causal`.
    """
    from exwarp_cli.policy.state import INPUTS, STATE_VERSION

    inputs, version = policy.network.sizes[0], policy.metadata.get("state")
    if inputs != INPUTS or version not in (versions or (STATE_VERSION, TILE_STATE)):
        raise LayoutError(
            f"{policy.path} takes {inputs} inputs of version {version!r}, and a state has {INPUTS} "
            f"of version {STATE_VERSION}, or of {TILE_STATE!r} for tiles; train the policy again"
        )
    return policy


def _require_usable(
    settings: UpsampleSettings,
    method: methods.Method,
    source: Source,
    interpolator: OnnxInterpolator | OnnxLookAhead | None,
) -> None:
    """Refuse what a method cannot do with these options, with this input, or at its factor."""
    if method.needs_truth and settings.ground_truth is None:
        raise UsageError(
            f"--method {method.name} decides by ground truth; give it with --ground-truth, or use "
            "--causal"
        )
    if not (settings.gate or method.gated or method is methods.EFFORTLESS):
        raise UsageError(
            f"--no-gate is for exwarp and --causal, and --method {method.name} has no gate; leave "
            "it out"
        )
    pattern, plain = source.keys.sequence.pattern, is_plain(source.keys.sequence)
    if plain and settings.layers != BEAUTY:
        raise UsageError(f"--layers is for EXR, and {pattern} has colour alone; leave it out")
    if source.estimated and method.extrapolates and not plain:
        raise LayoutError(
            f"{pattern} has no motion vectors that are recognised; render the motion pass, or use "
            "--method softsplat, for which it is estimated"
        )
    if source.estimated and method.extrapolates:
        raise LayoutError(
            f"--method {method.name} goes by depth, normals and materials, and {pattern} has "
            "colour alone; use --method softsplat or s6"
        )
    timeline = source.timeline
    # The paper's decisions are for slots of 4x alone.
    if method.extrapolates and not source.allows_decisions:
        names = ", ".join(m.name for m in methods.METHODS.values() if not m.extrapolates)
        raise UsageError(
            f"--method {method.name} decides between slots of {FACTOR} times the rate, and "
            f"{float(timeline.factor):g} times are asked for; use one of {names}"
        )
    if interpolator is None:
        return
    times = {timeline.time(slot) for key in range(3) for slot in timeline.between(key)}
    if beyond := sorted(t for t in times if not interpolator.reaches(t)):
        raise UsageError(
            f"--interpolator {interpolator.name} has no input for the time and makes the middle "
            f"frame only, so it does not reach {beyond[0]} of a key interval; give "
            "--factor 2, 4 or 8, or a network with an input for the time"
        )
