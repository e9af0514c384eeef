"""What a user asks of a run."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from exwarp_cli.domain.metric import DEFAULT_METRICS, METRICS, Threshold
from exwarp_cli.domain.timeline import AUTO_CUTS
from exwarp_cli.errors import UsageError

# Pixels of a frame that are read unless more is allowed: 16384x16384.
MOST_PIXELS = 2**28

# How interlaced video is read: refused, as if it were progressive, or deinterlaced.
SCANS = ("auto", "progressive", "deinterlace")

# Codecs of videos; the first is the default.
VIDEO_CODECS = ("h264", "hevc", "prores")

# The view transform that is the sRGB curve alone.
SRGB_VIEW = "srgb"

# What networks run on.
DEVICES = ("cpu", "cuda")

# Base rate where neither the user nor the header tells one.
DEFAULT_FPS = Fraction(30)

# At half of the area nearly all is gained that the network gains everywhere.
USUAL_EFFORT = 0.5

# The preset that measures as ExtraNet's authors published, and what each preset measures.
EXTRANET = "extranet"
PRESETS = {EXTRANET: ("psnr_db", "ssim", "vmaf")}


@dataclass(frozen=True)
class SourceSettings:
    """How the input is read; optional values are None where nothing is said."""

    sequence: str  # folder, pattern or any frame of the key frames
    gbuffers: str | None = None  # the same for G-buffers at the output rate
    # A motion convention by hand: a preset's name, or for example ``previous=X,-Y next=-Z,W``.
    motion: str | None = None
    # Of the key frames; None: the header's, else `DEFAULT_FPS`, divided by the frame numbers' step.
    fps: Fraction | None = None
    start_frame: int | None = None  # number of the first output frame; None: the first key frame's
    tail: bool = True  # whether to predict past the last key frame
    factor: int | None = None  # output frames per key frame; None: `timeline.FACTOR`
    to_fps: Fraction | None = None  # frames per second of the output, in place of `factor`
    view: str | None = None  # a view's name, or "all"; None: the channel map's, else the hero
    aovs: tuple[str, ...] = ()  # roles in files of their own: ``motion=vec/a.####.exr:R,G``
    channel_map: str | None = None  # TOML file that says which channels hold what
    cuts: str = AUTO_CUTS  # where shots begin: "auto", "none", or frames such as "1045,1101"
    dynamic: str | None = None  # what moves, by names in a Cryptomatte's manifest
    max_pixels: int = MOST_PIXELS
    keep_going: bool = False  # whether to skip key intervals whose files are damaged or missing
    # Whether motion may be estimated from colour for a render with passes but without usable
    # vectors. Plain footage needs no leave.
    estimate_motion: bool = False
    scan: str = "auto"  # out of `SCANS`


@dataclass(frozen=True)
class UpsampleSettings:
    """What `upsample` writes, and how."""

    source: SourceSettings
    output: str  # folder or pattern for the frames, or a video's path
    method: str | None = None  # name in the registry of methods; None: exwarp
    causal: bool = False  # whether no frame may be made of a later key frame
    frames: str | None = None  # range of key frames by input number; None: all
    rendered: str | None = None  # sequence of output frames that were rendered after all
    ground_truth: str | None = None  # sequence at the output rate to score against
    compression: str | None = None  # of generated frames; None: the key frame's
    # Keep frames that an earlier run wrote, if they are undamaged and would come out the same; make
    # its other frames again, and refuse to replace any other file.
    skip_existing: bool = False
    overwrite: bool = False  # replace frames that exist
    video: str | None = None  # path of a video to write too
    video_codec: str = VIDEO_CODECS[0]  # out of `VIDEO_CODECS`
    exposure: float = 0.0  # of the video, in stops
    # Of the video and the report's pictures; see `io.display_colour`
    view_transform: str = SRGB_VIEW
    write_holes: str | None = None  # folder or pattern for hole masks
    threads: int | None = None  # cores for all that works at a time; None: all that there are
    extrapolator: str | None = None  # ONNX file; None: the one that comes with ExWarp
    device: str = "cpu"  # out of `DEVICES`
    policy: str | None = None  # file of the policy; None: the one that comes with ExWarp
    interpolator: str | None = None  # ONNX file, with its card beside it
    # Whether networks of the default and of `causal` make frames only where this makes the shot's
    # own key frames better.
    gate: bool = True
    # Share of the frames' area that the network may compute, 0 to 1, on average over the scenes
    # that the policy was trained on; None: `USUAL_EFFORT`.
    effort: float | None = None
    metrics: tuple[str, ...] | None = None  # as in `Score`; None: `DEFAULT_METRICS`
    layers: str = "beauty"  # of generated frames: "beauty", "all", or names with wildcards
    verify: bool = False  # whether to read everything back and compare it
    keep_bytes: bool = False  # copy key frames byte for byte, also at another rate
    # With `skip_existing`: replace even what ExWarp did not write. It is set for a process that
    # goes on after one with `overwrite`.
    replaces_foreign: bool = False

    @property
    def spent(self) -> float:
        """`effort`, or the usual one."""
        return USUAL_EFFORT if self.effort is None else self.effort

    @property
    def measured(self) -> tuple[str, ...]:
        """What is measured against ground truth; without, only what key frames stand in for."""
        return DEFAULT_METRICS if self.metrics is None else self.metrics


DEFAULT_CHUNK_SIZE = 10  # key frames: starting ExWarp takes about as long as one of 2K


@dataclass(frozen=True)
class ClusterSettings:
    """Where the chunks of a run are done, if not in the process itself."""

    workers: int | None = None  # processes on this machine
    address: str | None = None  # of a running Dask scheduler
    chunk_size: int | None = None  # key frames that a worker takes at a time; None: what suits

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
        """True if the work is spread at all."""
        return self.workers is not None or self.address is not None


@dataclass(frozen=True)
class MeasureSettings:
    """What `compare` measures, and what it fails by."""

    metrics: tuple[str, ...] | None = None  # as in `Score`; None: the preset's, else the default
    preset: str | None = None  # out of `PRESETS`; None: measure as everywhere
    thresholds: tuple[Threshold, ...] = ()  # limits; what they are on is measured too
    view: str = ""  # name of the stereo view that is compared; "" for the hero of each frame
    scan: str = SourceSettings.scan
    view_transform: str = SRGB_VIEW  # of the report's pictures; scores do not depend on it

    @property
    def measured(self) -> tuple[str, ...]:
        """What is measured, in the order of `METRICS`."""
        usual = DEFAULT_METRICS if self.preset is None else PRESETS[self.preset]
        chosen = usual if self.metrics is None else self.metrics
        limited = {threshold.metric.field for threshold in self.thresholds}
        return tuple(m.field for m in METRICS if m.field in chosen or m.field in limited)
