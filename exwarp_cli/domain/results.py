"""What a run found out: one record a frame, and the summary that becomes the report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction

from exwarp_cli import __version__
from exwarp_cli.domain.decision import BLEND, HOLD, INTERPOLATE, Decision, Trial
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.domain.settings import SRGB_VIEW
from exwarp_cli.domain.tiles import Risk, TileMakers
from exwarp_cli.domain.timeline import FACTOR, Cut


class FrameKind(Enum):
    """Where a written frame came from."""

    KEY = "key"  # a rendered frame, passed through
    RENDERED = "rendered"  # rendered after all, in the place of a generated one
    GENERATED = "generated"  # made by a method for this slot
    DROPPED = "dropped"  # a repeat of the frame shown before


@dataclass(frozen=True)
class Score:
    """Quality of one frame, or part of one, against ground truth; None is not measured."""

    psnr_db: float | None = None  # decibels, at most 100
    ssim: float | None = None  # mean structural similarity, at most 1
    flip: float | None = None  # mean FLIP error, 0 (equal) to 1
    hdr_flip: float | None = None  # mean HDR-FLIP error, 0 (equal) to 1
    vmaf: float | None = None  # 0 to 100 (equal, up to its temporal part); whole frames only
    # Change in time that the ground truth does not have, display levels of 0 to 255; 0 is best.
    flicker: float | None = None
    # Per cent by which the frame is sharper (positive) or softer than ground truth; whole frames.
    pulse: float | None = None

    @property
    def badness(self) -> float | None:
        """The first metric that was measured, larger for worse frames."""
        for metric in METRICS:
            value: float | None = getattr(self, metric.field)
            if value is not None:
                return metric.badness(value)
        return None


@dataclass(frozen=True)
class FrameRecord:
    """One written frame."""

    number: int  # output frame number
    file: str  # name of the written file, without its folder
    key: int  # input number of the key frame that the slot belongs to
    slot: int  # 0 for the key frame itself
    kind: FrameKind
    # What made this very frame: a look-ahead run falls back to a causal method after the last key
    # frame. "key" and "rendered" for rendered ones, "held" between key frames with equal pictures.
    method: str
    # Input numbers of the rendered frames that its colour came from.
    sources: tuple[int, ...]
    # Share of the pixels, 0 to 1, that the warp from the key frame cannot see; None without motion.
    hole_fraction: float | None = None
    # Pixels of the source frames with NaN or infinite colour; None if not computed in this run.
    nonfinite_pixels: int | None = None
    score: Score | None = None  # over all pixels
    hole_score: Score | None = None  # over the hole mask
    resumed: bool = False  # written by an earlier run, and only checked by this one
    timing_ms: dict[str, float] = field(default_factory=dict)  # by step of the work
    # "warp", "extrapolate", "softsplat", "blend", "interpolate", "lookahead" or "hold"; None for
    # rendered frames.
    made_by: str | None = None
    path: str | None = None  # S1 to S6; None outside the paper's paths
    decision: Decision | None = None  # of its slot
    # Seconds that it took to render, and the header attribute that says so.
    render: tuple[float, str] | None = None
    replaced: bool = False  # took the place of a file
    # Pulse against the two key frames around it, where there is no ground truth, per cent.
    key_pulse: float | None = None
    risk: Risk | None = None
    trial: Trial | None = None  # what the gate decided by
    tiles: TileMakers | None = None  # None where one maker made the whole frame by any choice
    # Output numbers of frames rendered after all that a generated frame's colour came from.
    rendered_sources: tuple[int, ...] = ()

    @property
    def pulse(self) -> float | None:
        """Pulse against ground truth, else against the key frames; None if not measured."""
        return self.key_pulse if self.score is None else self.score.pulse

    @property
    def has_holes(self) -> bool:
        """True if the frame was warped, so that `hole_fraction` describes its own holes.

        Others have the fraction too: all methods are scored on the same holes.
        """
        if self.hole_fraction is None:
            return False
        return self.path is not None or self.made_by not in (BLEND, INTERPOLATE, HOLD)


@dataclass(frozen=True)
class LeftOut:
    """What a key interval lacks, as its input or its ground truth cannot be used."""

    key: int  # input number of the key frame
    frames: tuple[int, ...]  # output frames that are missing, ascending
    reason: str  # a sentence
    scores: tuple[int, ...] = ()  # frames that are made, but whose ground truth cannot be used
    rendered: tuple[int, ...] = ()  # generated, as their rendered frames cannot be used


@dataclass(frozen=True)
class BrokenPixels:
    """Pixels of the input that are NaN or infinite; nothing is made of them."""

    key: int  # input number of the key frame, or of the one before a slot with G-buffers
    slot: int  # 0 for the key frame itself
    view: str  # "" where there are no views
    channels: str  # "colour", "motion", "depth" and the like, or the name of a layer
    pixels: int  # of a depth only NaN counts: infinity is how renderers write the background


@dataclass(frozen=True)
class WrittenFile:
    """A file of a run, and its checksum."""

    kind: str  # "frame", "holes" or, where it is written alone, "video"
    frame: int | None  # output number; None for a video
    file: str  # its name, without its folder
    sha256: str  # of all its bytes as they were made, hexadecimal


@dataclass(frozen=True)
class InputSummary:
    """The input as the report names it."""

    pattern: str  # sequence pattern as a path, with # for digits
    first: int  # input number of the first key frame of the whole sequence
    last: int
    width: int  # display window, pixels
    height: int
    producer: str  # what wrote the files, as far as they say
    motion_source: str | None  # how the motion convention was determined; None without motion
    motion_evidence: str | None
    dynamic: tuple[str, ...] | None = None  # what --dynamic matched; None without the option
    step: int = 1  # from each key frame's number to the next one's
    depth: str | None = None  # why depth is read otherwise than its name says, or left out

    @property
    def numbers(self) -> range:
        """Input numbers of all key frames of the sequence."""
        return range(self.first, self.last + 1, self.step)


@dataclass(frozen=True)
class NetworkSummary:
    """The network that extrapolated."""

    file: str
    sha256: str  # of the model's file, hexadecimal
    device: str  # "cpu" or "cuda"
    demodulated: bool  # True if it was given shading without surface colour


@dataclass(frozen=True)
class InterpolatorSummary:
    """The network that interpolated, or that weighed both key frames."""

    name: str  # as its card has it; "lookahead" for the one that weighs
    file: str
    sha256: str
    card_sha256: str | None  # None without a card
    device: str
    # Of the policy of tiles that it makes, and the share of their area; None where it makes all.
    policy_sha256: str | None = None
    effort: float | None = None


@dataclass(frozen=True)
class PolicySummary:
    """The policy that decided."""

    file: str
    sha256: str
    # What identified moving objects: "ids", "cryptomatte" or "motion".
    objects_from: str | None
    missing: tuple[str, ...]  # features that are 0 throughout, as their AOVs are missing
    trained_for: tuple[str, ...] = ()  # SHA-256 of the extrapolation networks; () if unknown
    note: str | None = None  # says that another network extrapolates


@dataclass(frozen=True)
class RunSummary:
    """A whole `upsample` run."""

    method: str
    setting: str  # "key" or "slot": G-buffers of key frames only, or of every slot
    lookahead: bool  # True if the method uses the next key frame
    input: InputSummary
    base_fps: float
    fps_source: str  # "option", "header" or "assumed"
    wall_seconds: float  # of the streaming part; of joined runs, their sum
    frames: tuple[FrameRecord, ...]  # ascending
    decides: bool = False  # True if frames were made by paths of the paper's decision tree
    extrapolator: NetworkSummary | None = None
    policy: PolicySummary | None = None
    interpolator: InterpolatorSummary | None = None
    factor: Fraction = Fraction(FACTOR)  # output frames per key frame
    cuts: tuple[Cut, ...] | None = None  # None where cuts were neither searched nor given
    views: tuple[str, ...] = ()  # the one that was scored and decided by first
    layers: tuple[str, ...] = ()  # that generated frames hold beside the beauty
    keys: tuple[int, ...] = ()  # input numbers of the selected key frames, see `selected`
    version: str = __version__  # of the ExWarp that made the frames
    left_out: tuple[LeftOut, ...] = ()  # ascending
    files: tuple[WrittenFile, ...] = ()  # () where checksums were not asked
    verified: int | None = None  # files that were read back and are as written; None: not asked
    nonfinite: tuple[BrokenPixels, ...] = ()  # ascending
    view_transform: str = SRGB_VIEW  # of the video and the report's pictures

    @property
    def selected(self) -> tuple[int, ...]:
        """Input numbers of the selected key frames; where none are stated, those with frames."""
        return self.keys or tuple(sorted({frame.key for frame in self.frames}))

    @property
    def output_fps(self) -> float:
        """Frames per second of the output."""
        return self.base_fps * float(self.factor)


@dataclass(frozen=True)
class RunOutcome:
    """What was made; attributes as in `RunSummary`."""

    frames: tuple[FrameRecord, ...] = ()
    cuts: tuple[Cut, ...] | None = None
    left_out: tuple[LeftOut, ...] = ()
    files: tuple[WrittenFile, ...] = ()
    verified: int | None = None
    nonfinite: tuple[BrokenPixels, ...] = ()

    @property
    def shown(self) -> int:
        """Number of frames of a video of them."""
        return len(self.frames) + sum(len(interval.frames) for interval in self.left_out)

    @classmethod
    def joined(cls, parts: Sequence[RunOutcome]) -> RunOutcome:
        """Join those of chunks, in their order."""
        counts = [part.verified for part in parts if part.verified is not None]
        return cls(
            tuple(frame for part in parts for frame in part.frames),
            join_cuts(part.cuts for part in parts),
            tuple(interval for part in parts for interval in part.left_out),
            tuple(file for part in parts for file in part.files),
            sum(counts) if counts else None,
            tuple(pixels for part in parts for pixels in part.nonfinite),
        )


def join_cuts(parts: Iterable[tuple[Cut, ...] | None]) -> tuple[Cut, ...] | None:
    """Unite the cuts of all parts of a run; None where cuts were neither searched nor given."""
    cuts: set[Cut] = set()
    for part in parts:
        if part is None:
            return None
        cuts.update(part)
    # Neighbours both meet the cut between them. One that is "given" in any part is given: that
    # word comes after "detected".
    by_number = {cut.number: cut for cut in sorted(cuts, key=lambda c: (c.number, c.source))}
    return tuple(by_number.values())
