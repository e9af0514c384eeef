"""What a user asks of a run."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from exwarp_cli.domain.metric import DEFAULT_METRICS, METRICS, Threshold
from exwarp_cli.domain.timeline import AUTO_CUTS
from exwarp_cli.errors import UsageError

MOST_PIXELS = 2**28
"""Pixels of a frame that are read unless more is allowed: 16384x16384."""


@dataclass(frozen=True)
class SourceSettings:
    """How the input is read.

    Attributes
    ----------
    sequence
        Folder, pattern or any frame of the key frames.
    gbuffers
        The same for G-buffers at the output rate; None when only key frames have them.
    motion
        A motion convention by hand: a preset's name or for example ``previous=X,-Y next=-Z,W``;
        None to measure it.
    fps
        Frames per second of the key frames; None to take the header's, else `DEFAULT_FPS`, divided
        by the step of the frame numbers.
    start_frame
        Number of the first output frame; None for the first key frame's.
    tail
        Whether to predict past the last key frame.
    factor
        Output frames per key frame; None for `timeline.FACTOR`.
    to_fps
        Frames per second of the output instead; None without.
    view
        Name of the stereo view that is read, or "all"; None for the channel map's, else the hero.
    aovs
        Roles in sequences of their own, as ``--aov`` takes them: ``motion=vec/a.####.exr:R,G``.
    channel_map
        TOML file that says which channels hold what; None to recognise them.
    cuts
        Where shots begin, as ``--cuts`` takes it: "auto", "none", or frames such as "1045,1101".
    dynamic
        What moves, by names in a Cryptomatte's manifest as ``--dynamic`` takes them; None where
        nothing is said.
    max_pixels
        Pixels that a frame may have.
    keep_going
        Whether key intervals are left out whose files are damaged or missing.
    estimate_motion
        Whether motion may be estimated from colour for a render with passes but without usable
        vectors. Plain footage needs no leave.
    scan
        Out of `SCANS`: how a video is read whose frames say that they are interlaced.
    """

    sequence: str
    gbuffers: str | None = None
    motion: str | None = None
    fps: Fraction | None = None
    start_frame: int | None = None
    tail: bool = True
    factor: int | None = None
    to_fps: Fraction | None = None
    view: str | None = None
    aovs: tuple[str, ...] = ()
    channel_map: str | None = None
    cuts: str = AUTO_CUTS
    dynamic: str | None = None
    max_pixels: int = MOST_PIXELS
    keep_going: bool = False
    estimate_motion: bool = False
    scan: str = "auto"


USUAL_EFFORT = 0.5
"""At half of the area nearly all is gained that the network gains everywhere."""


@dataclass(frozen=True)
class UpsampleSettings:
    """What `upsample` writes, and how.

    Attributes
    ----------
    source
        The input.
    output
        Folder or pattern for the frames.
    method
        Name in the registry of methods; None for exwarp.
    causal
        Whether no frame may be made of a later key frame.
    frames
        Range of key frames by input number; None for all.
    rendered
        Sequence of output frames that were rendered after all, which take the place of generated
        ones; None without.
    ground_truth
        Sequence at the output rate to score against.
    metrics
        What is measured there, as in `Score`; None for `DEFAULT_METRICS`.
    compression
        Of generated frames; None keeps the key frame's.
    skip_existing
        Keep frames that an earlier run wrote, if they are undamaged and would come out the same;
        make its other frames again, and refuse to replace any other file.
    overwrite
        Replace frames that exist.
    replaces_foreign
        With `skip_existing`: replace even what ExWarp did not write. It is set for a process that
        goes on after one with `overwrite`.
    video
        Path of a video to write too.
    exposure
        Of the video, in stops.
    write_holes
        Folder or pattern for hole masks.
    threads
        Cores for all that works at a time; None for all that there are.
    extrapolator
        ONNX file of the network that extrapolates; None for the one that comes with ExWarp.
    device
        Out of `DEVICES`: what the network runs on.
    policy
        File of the policy that decides; None for the one that comes with ExWarp.
    interpolator
        ONNX file of the network that interpolates, with its card beside it.
    gate
        Whether networks of the default and of `causal` make frames only where this makes the shot's
        own key frames better.
    effort
        Share of the frames' area that the network may compute, 0 to 1, on average over the scenes
        that the policy was trained on; None for `USUAL_EFFORT`.
    layers
        Which layers generated frames hold: "beauty", "all", or names with wildcards.
    verify
        Whether to read everything back and compare it.
    keep_bytes
        Whether key frames are copied byte for byte, also where their rate is not the output's.
    """

    source: SourceSettings
    output: str
    method: str | None = None
    causal: bool = False
    frames: str | None = None
    rendered: str | None = None
    ground_truth: str | None = None
    compression: str | None = None
    skip_existing: bool = False
    overwrite: bool = False
    video: str | None = None
    exposure: float = 0.0
    write_holes: str | None = None
    threads: int | None = None
    extrapolator: str | None = None
    device: str = "cpu"
    policy: str | None = None
    interpolator: str | None = None
    gate: bool = True
    effort: float | None = None
    metrics: tuple[str, ...] | None = None
    layers: str = "beauty"
    verify: bool = False
    keep_bytes: bool = False
    replaces_foreign: bool = False

    @property
    def spent(self) -> float:
        """`effort`, or the usual one."""
        return USUAL_EFFORT if self.effort is None else self.effort

    @property
    def measured(self) -> tuple[str, ...]:
        """What is measured against ground truth; without, only what key frames stand in for."""
        return DEFAULT_METRICS if self.metrics is None else self.metrics


@dataclass(frozen=True)
class ClusterSettings:
    """Where the chunks of a run are done, if not in the process itself.

    Attributes
    ----------
    workers
        Processes on this machine; None without.
    address
        Of a running Dask scheduler; None without.
    chunk_size
        Key frames that a worker is given at a time; None for what suits.
    """

    workers: int | None = None
    address: str | None = None
    chunk_size: int | None = None

    def __post_init__(self) -> None:
        """Refuse contradictions; raises UsageError."""
        if self.workers is not None and self.address is not None:
            raise UsageError(
                "--workers is for this machine and --cluster for a running scheduler; give one"
            )
        if self.chunk_size is not None and not self.spread:
            raise UsageError("--chunk-size is for --workers and --cluster; give one of them")

    @property
    def spread(self) -> bool:
        """Whether the work is spread at all."""
        return self.workers is not None or self.address is not None


EXTRANET = "extranet"
"""The preset that measures as ExtraNet's authors published."""

PRESETS = {EXTRANET: ("psnr_db", "ssim", "vmaf")}
"""What each preset of `compare` measures."""


@dataclass(frozen=True)
class MeasureSettings:
    """What `compare` measures, and what it fails by.

    Attributes
    ----------
    metrics
        As in `Score`; None for the preset's, or without one for `DEFAULT_METRICS`.
    preset
        Out of `PRESETS`; None to measure as everywhere.
    thresholds
        Limits; what they are on is measured too.
    view
        Name of the stereo view that is compared; "" for the hero of each frame.
    scan
        As in `SourceSettings`.
    """

    metrics: tuple[str, ...] | None = None
    preset: str | None = None
    thresholds: tuple[Threshold, ...] = ()
    view: str = ""
    scan: str = SourceSettings.scan

    @property
    def measured(self) -> tuple[str, ...]:
        """What is measured, in the order of `METRICS`."""
        usual = DEFAULT_METRICS if self.preset is None else PRESETS[self.preset]
        chosen = usual if self.metrics is None else self.metrics
        limited = {threshold.metric.field for threshold in self.thresholds}
        return tuple(m.field for m in METRICS if m.field in chosen or m.field in limited)


SCANS = ("auto", "progressive", "deinterlace")
"""How interlaced video is read: refused, as if it were progressive, or deinterlaced."""

DEVICES = ("cpu", "cuda")
"""What networks run on."""

DEFAULT_FPS = Fraction(30)
"""Base rate where neither the user nor the header tells one."""
