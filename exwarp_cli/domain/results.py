"""What a run found out: one record a frame, and the summary that becomes the report."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction

from exwarp_cli import __version__
from exwarp_cli.domain.decision import BLEND, HELD, HOLD, Decision, Trial
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.domain.network_api import INTERPOLATE
from exwarp_cli.domain.tiles import Risk, TileMakers
from exwarp_cli.domain.timeline import FACTOR, Cut


class FrameKind(Enum):
    """Where a written frame came from."""

    KEY = "key"
    """A rendered frame, passed through."""

    RENDERED = "rendered"
    """Rendered after all, in the place of a generated one."""

    GENERATED = "generated"
    """Made by a method for this slot."""

    DROPPED = "dropped"
    """A repeat of the frame shown before: no new frame for the eye."""


@dataclass(frozen=True)
class Score:
    """Quality of one frame, or part of one, against ground truth; None is what was not measured.

    Attributes
    ----------
    psnr_db
        Decibels, at most 100.
    ssim
        Mean structural similarity, at most 1.
    flip
        Mean FLIP error, 0 (equal) to 1.
    hdr_flip
        Mean HDR-FLIP error, 0 (equal) to 1.
    vmaf
        0 to 100 (equal, up to its temporal part); of whole frames only.
    flicker
        Change in time that the ground truth does not have, in display levels of 0 to 255; 0 is
        best. See `exwarp_cli.metrics.temporal`.
    pulse
        Per cent by which the frame is sharper (positive) or softer (negative) than ground truth; of
        whole frames only. See `exwarp_cli.metrics.temporal`.
    """

    psnr_db: float | None = None
    ssim: float | None = None
    flip: float | None = None
    hdr_flip: float | None = None
    vmaf: float | None = None
    flicker: float | None = None
    pulse: float | None = None

    @property
    def badness(self) -> float | None:
        """What is larger the worse the frame is, by the first metric that was measured."""
        for metric in METRICS:
            value: float | None = getattr(self, metric.field)
            if value is not None:
                return metric.badness(value)
        return None


@dataclass(frozen=True)
class FrameRecord:
    """One written frame.

    Attributes
    ----------
    number
        Output frame number.
    file
        Name of the written file, without its folder.
    key
        Input number of the key frame that the slot belongs to.
    slot
        0 for the key frame itself, else 1 or more.
    kind
        Rendered, generated or repeated.
    method
        The method that made this very frame (a look-ahead run falls back to a causal method after
        the last key frame); "key" and "rendered" for rendered ones, "held" between key frames that
        show the same picture.
    sources
        Input numbers of the rendered frames that its colour came from; of one that was rendered
        after all its own number.
    hole_fraction
        Share of the frame's pixels, 0 to 1, that the warp from the key frame cannot see; None
        where there is no motion to tell.
    nonfinite_pixels
        Pixels of the source frames with NaN or infinite colour, treated as holes; None where the
        frame was not computed in this run.
    score, hole_score
        Against ground truth, over all pixels and over the hole mask; None where not measured.
    resumed
        Whether an earlier run had written it and this one only checked it.
    replaced
        Whether a file was there whose place it took.
    timing_ms
        Milliseconds by step of the work.
    made_by
        What made the frame: "warp", "extrapolate", "softsplat", "blend", "interpolate" (a network)
        or "hold"; None for a rendered one.
    path
        Decision path of its key interval, S1 to S6; None outside the paper's paths.
    decision
        What was decided of its slot; None where nothing was.
    render
        Seconds that it took to render, and the header's attribute that tells; None for frames that
        were not rendered, and where none tells.
    key_pulse
        Per cent by which a generated frame without ground truth is sharper or softer than the two
        key frames around it; None where not measured. See `exwarp_cli.metrics.temporal`.
    risk
        How wrong a generated frame is expected to be; None where nothing tells.
    trial
        What the gate decided by; None without a gate.
    tiles
        What made each of its tiles; None where one maker made the whole frame by any choice.
    rendered_sources
        Output numbers of frames rendered after all that a generated frame's colour came from.
    """

    number: int
    file: str
    key: int
    slot: int
    kind: FrameKind
    method: str
    sources: tuple[int, ...]
    hole_fraction: float | None = None
    nonfinite_pixels: int | None = None
    score: Score | None = None
    hole_score: Score | None = None
    resumed: bool = False
    timing_ms: dict[str, float] = field(default_factory=dict)
    made_by: str | None = None
    path: str | None = None
    decision: Decision | None = None
    render: tuple[float, str] | None = None
    replaced: bool = False
    key_pulse: float | None = None
    risk: Risk | None = None
    trial: Trial | None = None
    tiles: TileMakers | None = None
    rendered_sources: tuple[int, ...] = ()

    @property
    def pulse(self) -> float | None:
        """Its pulse against ground truth, else against its key frames; None if not measured."""
        return self.key_pulse if self.score is None else self.score.pulse

    @property
    def has_holes(self) -> bool:
        """True if the frame comes by a warp, so that `hole_fraction` tells of its own holes.

        Others have the fraction too: all methods are scored on the same holes.
        """
        if self.hole_fraction is None:
            return False
        return self.path is not None or self.made_by not in (BLEND, INTERPOLATE, HOLD)


@dataclass(frozen=True)
class LeftOut:
    """What was left out of a key interval, as its input or its ground truth cannot be used.

    Attributes
    ----------
    key
        Input number of the key frame.
    frames
        Numbers of the output frames that are missing for it, ascending.
    reason
        What is wrong, in a sentence.
    scores
        Numbers of the frames whose ground truth it is that cannot be used, ascending; they are made
        all the same.
    rendered
        Numbers of the frames whose rendered ones cannot be used, ascending; they are generated.
    """

    key: int
    frames: tuple[int, ...]
    reason: str
    scores: tuple[int, ...] = ()
    rendered: tuple[int, ...] = ()


@dataclass(frozen=True)
class BrokenPixels:
    """Pixels of the input that are NaN or infinite. Nothing is made of them.

    Attributes
    ----------
    key
        Input number of the selected key frame, or of the one before a slot with G-buffers.
    slot
        0 for the key frame itself, else 1 or more.
    view
        That has them; "" where there are none.
    channels
        What they are in: "colour", "motion", "depth" and the like, or the name of a layer.
    pixels
        How many have a value that is not finite; in a depth only NaN counts, as infinity is how
        renderers write the background.
    """

    key: int
    slot: int
    view: str
    channels: str
    pixels: int


@dataclass(frozen=True)
class WrittenFile:
    """A file of a run, and its checksum.

    Attributes
    ----------
    kind
        "frame", "holes" or, where it is written alone, "video".
    frame
        Number of the output frame; None for a video.
    file
        Its name, without its folder.
    sha256
        Of all its bytes as they were made, hexadecimal.
    """

    kind: str
    frame: int | None
    file: str
    sha256: str


@dataclass(frozen=True)
class InputSummary:
    """The input as the report names it.

    Attributes
    ----------
    pattern
        Sequence pattern as a path, with ``#`` for digits.
    first, last
        Input numbers of the first and last key frame of the whole sequence.
    width, height
        Display window, pixels.
    producer
        What wrote the files, as far as they tell.
    motion_source, motion_evidence
        How the motion convention was found; None without motion.
    dynamic
        Names of what moves, as ``--dynamic`` found them; None where nothing was said.
    step
        From each key frame's number to the next one's.
    depth
        Why depth is read otherwise than its name says, or left out; None where it is not.
    """

    pattern: str
    first: int
    last: int
    width: int
    height: int
    producer: str
    motion_source: str | None
    motion_evidence: str | None
    dynamic: tuple[str, ...] | None = None
    step: int = 1
    depth: str | None = None

    @property
    def numbers(self) -> range:
        """Input numbers of all key frames of the sequence."""
        return range(self.first, self.last + 1, self.step)


@dataclass(frozen=True)
class NetworkSummary:
    """The network that extrapolated.

    Attributes
    ----------
    file
        Path of the model.
    sha256
        Of the model's file, hexadecimal.
    device
        "cpu" or "cuda".
    demodulated
        Whether it was given shading that surface colour had been divided out of.
    """

    file: str
    sha256: str
    device: str
    demodulated: bool


@dataclass(frozen=True)
class InterpolatorSummary:
    """The network that interpolated, or that weighed both key frames.

    Attributes
    ----------
    name
        As its card has it; "lookahead" of the one that weighs.
    file
        Path of the model.
    sha256, card_sha256
        Of the model's file and of the card beside it, hexadecimal; None without a card.
    device
        "cpu" or "cuda".
    """

    name: str
    file: str
    sha256: str
    card_sha256: str | None
    device: str

    @property
    def identity(self) -> list[str | None]:
        """What its frames depend on, wherever the files lie."""
        return [self.sha256, self.card_sha256, self.device]


@dataclass(frozen=True)
class PolicySummary:
    """The policy that decided.

    Attributes
    ----------
    file
        Path of its network.
    sha256
        Of the network's file, hexadecimal.
    objects_from
        What identified moving objects: "ids", "cryptomatte" (what moves of it, by name or by
        motion), or "motion" where there are none.
    missing
        Features that are 0 throughout, as the AOVs they come from are missing.
    trained_for
        SHA-256 of the extrapolation networks that it was trained for; () where it does not say.
    note
        Says that another network extrapolates; None where it is one of those.
    """

    file: str
    sha256: str
    objects_from: str | None
    missing: tuple[str, ...]
    trained_for: tuple[str, ...] = ()
    note: str | None = None


@dataclass(frozen=True)
class RunSummary:
    """A whole `upsample` run.

    Attributes
    ----------
    method
        Name of the method asked for.
    setting
        "key" or "slot": whether G-buffers were given for key frames only or for every slot.
    lookahead
        Whether the method uses the next key frame.
    input
        The input sequence.
    base_fps, fps_source
        Frames per second of the input, and where that number came from: "option", "header" or
        "assumed".
    wall_seconds
        Wall time of the streaming part; of several runs that were joined, their sum.
    frames
        One record a written frame, ascending.
    decides
        Whether frames were made by paths of the paper's decision tree.
    extrapolator
        None for methods that do not extrapolate.
    policy
        None where no learned policy decided.
    interpolator
        None for methods that have no network interpolate.
    factor
        Output frames per key frame.
    cuts
        Where shots begin, as far as the run met it; None where cuts were neither looked for nor
        given.
    views
        Views that generated frames hold, the one that was scored and decided by first; () where
        there are none.
    layers
        Names of the layers that generated frames hold beside the beauty.
    keys
        Input numbers of the key frames that were selected, ascending; see `selected`.
    version
        Of the ExWarp that made the frames.
    left_out
        The key intervals that were left out, ascending.
    files
        What was written, with checksums; () where that was not asked.
    verified
        How many files were read back and found as they were made; None where that was not asked.
    nonfinite
        What is not finite in the frames that were read, ascending.
    """

    method: str
    setting: str
    lookahead: bool
    input: InputSummary
    base_fps: float
    fps_source: str
    wall_seconds: float
    frames: tuple[FrameRecord, ...]
    decides: bool = False
    extrapolator: NetworkSummary | None = None
    policy: PolicySummary | None = None
    interpolator: InterpolatorSummary | None = None
    factor: Fraction = Fraction(FACTOR)
    cuts: tuple[Cut, ...] | None = None
    views: tuple[str, ...] = ()
    layers: tuple[str, ...] = ()
    keys: tuple[int, ...] = ()
    version: str = __version__
    left_out: tuple[LeftOut, ...] = ()
    files: tuple[WrittenFile, ...] = ()
    verified: int | None = None
    nonfinite: tuple[BrokenPixels, ...] = ()

    @property
    def selected(self) -> tuple[int, ...]:
        """Input numbers of the selected key frames; where none are stated, those with frames."""
        return self.keys or tuple(sorted({frame.key for frame in self.frames}))

    @property
    def held(self) -> tuple[int, ...]:
        """Input numbers of the key frames that the slots after them repeat, ascending.

        The next key frame shows the same picture; or none follows in the shot, and the key frame
        itself repeats the one before.
        """
        return tuple(sorted({frame.key for frame in self.frames if frame.method == HELD}))

    @property
    def output_fps(self) -> float:
        """Frames per second of the output."""
        return self.base_fps * float(self.factor)
