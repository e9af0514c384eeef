"""What ``exwarp bench`` is asked, the systems that it compares, and the pictures that they show.

A picture's name says how it was made, so that systems which show the same frame share it: ``F`` is
the key frame again, ``W2`` the key frame warped to slot 2, ``E3`` extrapolated to slot 3, ``W(E2)``
the extrapolated frame of slot 2 warped to slot 3. Those of other systems are ``NAME SLOT``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from exwarp_cli.domain.decision import EXTRAPOLATE, HOLD, INTERPOLATE, LOOKAHEAD, PATHS, WARP
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import UsageError

# G-buffers of every slot, as the paper has them, or of the key frames only.
SETTINGS = ("slot", "key")

# Sizes of frames in the paper's Table III, in pixels.
TABLE_PIXELS = {"480p": 854 * 480, "720p": 1280 * 720, "1080p": 1920 * 1080}

# Where latencies of the real-time clock come from: Table III by the size of the frames,
# or as if they had one of its sizes; or this machine's run times.
TABLE, MEASURED = "table3", "measured"
TABLE_AS = {f"{TABLE}-{size}": size for size in TABLE_PIXELS}
CLOCKS = (TABLE, *TABLE_AS, MEASURED)

# Systems that choose a path for every key interval.
POLICY, BEST_PSNR, BEST_RETURN = "exwarp", "oracle", "oracle-return"
CHOOSERS = (POLICY, BEST_PSNR, BEST_RETURN)

# Systems that take one path throughout; s1 is what ExtraNet does, s6 warps alone.
FIXED = tuple(name.lower() for name in PATHS)

# Systems that wait for the next key frame; networks given by --interpolator are others.
MINTERPOLATE = "minterpolate"
WAITING = (LOOKAHEAD, "softsplat", "blend", MINTERPOLATE)
ONNX = "onnx:"  # before the name of an interpolation network

# What can always be compared, by name.
SYSTEMS = (*CHOOSERS, *FIXED, HOLD, *WAITING)

# Paths S1 and S3 with the network that --extranet names in place of ours.
EXTRANET, EXTRANET_FAST = "extranet", "extranet-s3"

# The path that a system takes in every key interval.
FIXED_PATHS = {name: name.upper() for name in FIXED} | {EXTRANET: "S1", EXTRANET_FAST: "S3"}

SLOTS = range(1, FACTOR)

REPEATED = "F"

# Before the names of pictures that the imported ExtraNet has made, or that come from those.
IMPORTED = "extranet "

# Every picture that a decision path shows, by the first slot at which it can stand.
FIRST_SLOTS = {REPEATED: 1, "W1": 1, "W2": 2, "E2": 2, "W3": 3, "W(E2)": 3, "E3": 3}

ABOUT = {
    POLICY: "ExWarp: the learned policy, in 8-bit integers",
    BEST_PSNR: "best path of every interval by PSNR, by ground truth",
    BEST_RETURN: "best path by the paper's reward, by ground truth",
    **{name: f"path {name.upper()}" for name in FIXED},
    "s1": "path S1, ExtraNet's way with our E",
    "s6": "path S6, warping alone",
    EXTRANET: "imported ExtraNet, path S1",
    EXTRANET_FAST: "imported ExtraNet, path S3",
    LOOKAHEAD: "both key frames splatted as by softsplat, mixed by the weights of a network",
    "softsplat": "both key frames splatted by the renderer's motion, blended by depth",
    "blend": "cross-fade",
    MINTERPOLATE: "ffmpeg's minterpolate, from colour alone",
    HOLD: "the key frame again",
}


@dataclass(frozen=True)
class BenchSettings:
    """What a benchmark measures."""

    inputs: tuple[str, ...]  # data set folders; or one sequence, with its ground truth
    output: Path  # folder for everything
    # Of a sequence, as `upsample` takes them.
    ground_truth: str | None = None
    gbuffers: str | None = None
    motion: str | None = None
    fps: Fraction | None = None
    # Of a data set; empty for all benchmark scenes.
    scenes: tuple[str, ...] = ()
    settings: tuple[str, ...] = SETTINGS[:1]  # of a data set, out of `SETTINGS`
    frames: str | None = None  # range of key frames by number; None for all
    every: int = 1  # only every so-manieth key interval
    systems: tuple[str, ...] = SYSTEMS  # networks that options name come on top
    interpolators: tuple[Path, ...] = ()  # ONNX files with their cards
    extrapolator: Path | None = None  # None for those that come with ExWarp
    policy: Path | None = None
    extranet: Path | None = None  # ONNX file of the imported ExtraNet; None to leave it out
    metrics: tuple[str, ...] = ()  # names as in `Score`
    jobs: int | None = None  # key intervals measured side by side; None for one a core
    device: str = "cpu"
    # Out of `real_time.CLOCKS`, to measure what a display shows in real time as well.
    clock: str | None = None


def is_lookahead(system: str) -> bool:
    """Return whether a system waits for the next key frame."""
    return system in WAITING or system.startswith(ONNX)


def parse_names(text: str | None) -> tuple[str, ...]:
    """Read names with commas between; nothing for None."""
    names = (name.strip() for name in (text or "").split(","))
    return tuple(dict.fromkeys(name for name in names if name))


def parse_systems(text: str | None) -> tuple[str, ...]:
    """Read ``--systems``; all for None. UsageError: a name that is none, or no name."""
    if text is None:
        return SYSTEMS
    names = parse_names(text)
    unknown = [name for name in names if name not in SYSTEMS]
    if unknown or not names:
        wrong = f"names {unknown[0]!r}" if unknown else "is empty"
        raise UsageError(f"--systems {wrong}; choose out of {', '.join(SYSTEMS)}")
    return names


def picture_at(made_by: Sequence[str], slot: int) -> str:
    """Return the name of the picture at a slot, 1 to 3, of a decision path.

    `made_by` is what makes the frames of slots 1 to 3: warp, extrapolate or hold.
    """
    maker = made_by[slot - 1]
    if maker == HOLD:
        return REPEATED if slot == 1 else picture_at(made_by, slot - 1)
    if maker == WARP and slot == FACTOR - 1 and made_by[1] == EXTRAPOLATE:
        return "W(E2)"
    return f"{'E' if maker == EXTRAPOLATE else 'W'}{slot}"


def pictures_of(system: str, path: str | None) -> tuple[str, ...]:
    """Return the names of the pictures that a system shows at slots 1 to 3.

    `path` is the one that it takes in this interval; None for one outside the decision tree.
    """
    if path is not None:
        names = [picture_at(PATHS[path].made_by, slot) for slot in SLOTS]
        foreign = system in (EXTRANET, EXTRANET_FAST)
        return tuple(IMPORTED + name if foreign and "E" in name else name for name in names)
    if system == HOLD:
        return (REPEATED,) * len(SLOTS)
    return tuple(f"{system} {slot}" for slot in SLOTS)


def makers_of(system: str, path: str | None) -> tuple[str, ...]:
    """Return what makes the frames of slots 1 to 3: warp, extrapolate, interpolate or hold."""
    if path is not None:
        return PATHS[path].made_by
    if system.startswith(ONNX):
        return (INTERPOLATE,) * len(SLOTS)
    return (HOLD if system == HOLD else WARP,) * len(SLOTS)
