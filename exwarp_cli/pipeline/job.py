"""A job: settings with everything opened that they name, before any frame is made."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from exwarp_cli.domain.results import InterpolatorSummary, NetworkSummary, RunSummary
from exwarp_cli.io.footage import close_sequences
from exwarp_cli.io.generated_frames import parse_compression
from exwarp_cli.io.threads import use_threads
from exwarp_cli.pipeline.announcing import (
    Models,
    announce,
    announce_contents,
    announce_models,
    announce_truth,
    announce_video,
    input_summary,
)
from exwarp_cli.pipeline.contents import Content, contents_of
from exwarp_cli.pipeline.finding import (
    find_interpolator,
    find_method,
    find_network,
    find_policy,
    find_truth,
    is_usual,
    method_of,
    require_factor,
    require_gate,
    require_truth,
)
from exwarp_cli.pipeline.frame_sizes import (
    require_one_size_of,
    require_rendered_size,
    require_truth_size,
)
from exwarp_cli.pipeline.frame_writer import OutputPlan
from exwarp_cli.pipeline.ownership import require_own
from exwarp_cli.pipeline.rendered_frames import find_rendered
from exwarp_cli.pipeline.scoring import require_measurable
from exwarp_cli.pipeline.source import open_sources
from exwarp_cli.pipeline.without_vectors import require_able
from exwarp_cli.runtime.frame_pool import LARGE_PIXELS, ScratchFrames

if TYPE_CHECKING:
    from exwarp_cli.domain.joining import Outcome
    from exwarp_cli.domain.settings import UpsampleSettings
    from exwarp_cli.domain.timeline import Slot
    from exwarp_cli.io.interpolator import OnnxInterpolator
    from exwarp_cli.io.lookahead_network import OnnxLookAhead
    from exwarp_cli.io.models import OnnxExtrapolator
    from exwarp_cli.io.policy_files import PolicyFile
    from exwarp_cli.io.sequence import Sequence
    from exwarp_cli.pipeline.progress import Progress
    from exwarp_cli.pipeline.rendered_frames import RenderedFrames
    from exwarp_cli.pipeline.source import FrameOf, Source
    from exwarp_cli.synthesis.methods import Method


@dataclass(frozen=True)
class Job:
    """What a run works with.

    Attributes
    ----------
    settings
        What the user asked for.
    method
        Makes the frames.
    sources
        The input, one a view; the first decides, and is scored.
    network, interpolator, policy
        What the method needs of them; None for what it does without.
    models
        The same three as the report names them.
    contents
        What is written of each view.
    keys
        Indices of the key frames to do.
    targets
        The files to write.
    truth
        Ground truth and its frame for a slot; None without.
    rendered
        Frames that were rendered after all; None without.
    reported
        Whether a report tells of it, which has checksums of all files.
    """

    settings: UpsampleSettings
    method: Method
    sources: tuple[Source, ...]
    network: OnnxExtrapolator | None
    interpolator: OnnxInterpolator | OnnxLookAhead | None
    policy: PolicyFile | None
    models: Models
    contents: tuple[Content, ...]
    keys: tuple[int, ...]
    targets: OutputPlan
    truth: tuple[Sequence, FrameOf] | None
    rendered: RenderedFrames | None = None
    reported: bool = False

    @property
    def sums(self) -> bool:
        """Whether checksums of files are wanted."""
        return self.reported or self.settings.verify

    @property
    def is_gated(self) -> bool:
        """Whether the network makes frames only where trials show that it pays."""
        return self.method.gated and self.settings.gate

    @property
    def measures_key_pulse(self) -> bool:
        """Whether new frames without ground truth are compared with their key frames."""
        asked = self.reported or self.settings.metrics is not None
        return asked and "pulse" in self.settings.measured

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
    def depends_on(self) -> tuple[NetworkSummary | None, str | None, InterpolatorSummary | None]:
        """What networks and policy frames depend on, as `IntervalReader` takes it."""
        decided = None
        if self.policy is not None:
            effort = f" effort {self.settings.spent:g}" if self.policy.of_tiles else ""
            decided = f"{self.policy.checksum}{effort}"
        return self.models.extrapolator, decided, self.models.interpolator

    def of(self, keys: tuple[int, ...]) -> Job:
        """Return the same job for other key frames."""
        return replace(self, keys=keys)

    def refuse(self) -> None:
        """Refuse frames of several sizes, and to overwrite; touch nothing.

        See `require_one_size`, `OutputPlan.check_conflicts` and `require_own`.
        """
        for source in self.sources:
            require_one_size_of(source, self.keys, self.method.lookahead)
        if self.truth is not None and (
            self.method.needs_truth or not self.settings.source.keep_going
        ):
            require_truth_size(self.truth, self.source, self.keys)
        if self.rendered is not None:
            self.rendered.require_apart(self.targets.frames)
            require_rendered_size(self.rendered.sequence, self.source, self.keys)
        self.targets.check_conflicts(self.settings, self.source.timeline, self.slots)
        if self.settings.skip_existing and not self.settings.replaces_foreign:
            rendered = None if self.rendered is None else self.rendered.sequence
            require_own(self.targets, self.source, self.method, self.slots, rendered)

    def announce(self, progress: Progress) -> None:
        """Say what was found, and what is going to happen."""
        announce(progress, self.settings, self.source, self.method, self.keys)
        if self.rendered is not None:
            progress.message(self.rendered.note(self.source.timeline))
        if self.truth is not None:
            announce_truth(progress, *self.truth, self.source)
        if self.targets.video is not None:
            announce_video(progress, self.source, self.keys)
        announce_contents(progress, self.contents)
        announce_models(progress, self.models, self.source)

    def close(self) -> None:
        """Close what reading left open; a later read opens it again."""
        close_sequences(self.source.keys.sequence, *(() if self.truth is None else self.truth[:1]))
        if self.rendered is not None:
            close_sequences(self.rendered.sequence)

    def summary(self, outcome: Outcome, seconds: float) -> RunSummary:
        """Put together what a run of this job found out.

        Parameters
        ----------
        outcome
            What became of its key frames.
        seconds
            Wall time of the streaming part.
        """
        source = self.source
        return RunSummary(
            method=self.method.name,
            setting=source.setting,
            lookahead=self.method.lookahead,
            input=input_summary(source),
            base_fps=float(source.fps),
            fps_source=source.fps_source,
            wall_seconds=seconds,
            frames=outcome.frames,
            decides=self.method.decides and is_usual(source),
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
        )


def open_job(settings: UpsampleSettings) -> Job:
    """Open all that settings name; nothing is written.

    Raises
    ------
    ExwarpError
        For anything that a user can cause, but for what is in the way of the output.
    """
    parse_compression(settings.compression)
    use_threads(settings.threads)
    method = find_method(settings.method, settings.causal)
    sources = open_sources(settings.source, method.needs_motion, pictures=True)
    source = sources[0]
    if method.extrapolates:
        scratch = ScratchFrames(LARGE_PIXELS)
        sources = tuple(replace(each, scratch=scratch) for each in sources)
        source = sources[0]
    network = find_network(settings, method)
    interpolator = find_interpolator(settings, method)
    policy = find_policy(settings, method)
    method = method_of(method, policy, settings)
    require_truth(settings, method)
    require_gate(settings, method)
    require_able(source, method, settings)
    require_factor(source, method, interpolator)
    contents = contents_of(sources, settings.layers)
    models = Models.of(source, network, interpolator, policy)
    keys = source.timeline.select(settings.frames)
    targets = OutputPlan.from_settings(settings, source.keys.sequence)
    truth = None
    if settings.ground_truth is not None:
        bearable = settings.source.keep_going and not method.needs_truth
        truth = find_truth(settings.ground_truth, source, bearable, settings.source.scan)
    require_measurable(settings, source.keys.display, source.timeline.steps is not None)
    rendered = None
    if settings.rendered is not None:
        rendered = find_rendered(settings.rendered, source, settings.source.scan)
    return Job(
        settings, method, sources, network, interpolator, policy, models, contents, keys, targets,
        truth, rendered,
    )  # fmt: skip
