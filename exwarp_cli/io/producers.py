"""Motion conventions by name, and the names of layers by which a program is recognised.

A convention that is known by a name is a first guess; measuring decides
(:mod:`exwarp_cli.synthesis.calibration`).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, replace

from exwarp_cli.domain.motion import AxisMap, MotionConvention

UNKNOWN = "unknown"


def _both_directions(y: float) -> MotionConvention:
    """Forward vectors in the first two channels, backward ones in the next two, in pixels."""
    return MotionConvention(AxisMap(2, 3, 1.0, y), AxisMap(0, 1, 1.0, y))


_FORWARD = MotionConvention(to_next=AxisMap(0, 1, 1.0, -1.0))

# For --motion. Indices count the motion channels in the order in which they were found.
PRESETS: dict[str, MotionConvention] = {
    # XY is previous minus current, ZW current minus next, y up.
    "blender": MotionConvention(AxisMap(0, 1, 1.0, -1.0), AxisMap(2, 3, -1.0, 1.0)),
    # As ExtraNet dumps it: current minus previous, y up.
    "unreal": MotionConvention(to_previous=AxisMap(0, 1, -1.0, 1.0)),
    # Movie Render Queue: the same as shares of the frame about 0.5; twice that is reported, too.
    "unreal-mrq": MotionConvention(AxisMap(0, 1, -1.0, 1.0, still=0.5), of_frame=True),
    # Max displace 0: red and green are the direction, blue is the length.
    "arnold": MotionConvention(to_next=AxisMap(0, 1, 1.0, -1.0, length=2)),
    "vray": _FORWARD,
    "redshift": _FORWARD,
    "renderman": _both_directions(1.0),  # raster space: y down
    "karma": _FORWARD,
    # The screen reaches from -1 to 1; premultiplied.
    "moonray": MotionConvention(to_next=AxisMap(0, 1, 0.5, -0.5, alpha=2), of_frame=True),
    "nuke": _both_directions(-1.0),
    "reelsmart": _FORWARD,
    "twixtor": _FORWARD,
    "forward": _FORWARD,
    "backward": MotionConvention(to_previous=AxisMap(0, 1, 1.0, -1.0)),
    "forward+backward": _both_directions(-1.0),
}

FORWARD_NAMES = ("forward", "motionfore")
BACKWARD_NAMES = ("backward", "motionback")

_CRYPTOMATTE = re.compile(r"(^|[._:])(crypto[A-Za-z_]*(\d\d)?|\w*HitProxyMask\d\d)$", re.IGNORECASE)


def vector_direction(layer: str) -> str:
    """Return "forward" or "backward" if the name of a layer of vectors ends so, else ""."""
    name = re.sub(r"[^a-z]", "", layer.lower())
    for direction, names in (("forward", FORWARD_NAMES), ("backward", BACKWARD_NAMES)):
        if name.endswith(names):
            return direction
    return ""


def is_cryptomatte_name(layer: str) -> bool:
    """Return True for a usual name of a Cryptomatte's rank or preview.

    Headers may name others; only the file's attributes are certain.
    """
    return _CRYPTOMATTE.search(layer) is not None


@dataclass(frozen=True)
class _Signature:
    """What the layers of a producer look like; names are patterns of full names."""

    producer: str
    preset: str
    motion: str
    min_channels: int = 2
    components: str = ""  # that the motion layer's begin with
    other_layer: str = ""  # that must exist, too
    own_file: bool | None = None  # None: does not matter


_ARNOLD = r"(^|[._])([NP]|ID|crypto_\w+)$"
_KARMA = r"(?i)(^|[._:])(hit(pz|p|n)|objectid)$"
_VRAY = r"(?i)(^|[._])(vray\w+|zdepth|normals|renderid|materialid)$"

_SIGNATURES = (
    _Signature("Unreal Movie Render Queue", "unreal-mrq", r"MovieRenderQueue_?MotionVectors?$"),
    _Signature("Blender", "blender", r"(?i)(^|\.)vector$"),
    _Signature("Unreal (one file per AOV)", "unreal", r"MotionVector$", own_file=True),
    _Signature("RenderMan", "renderman", r"(?i)motion(fore|back)$"),
    _Signature("Nuke convention", "nuke", r"(?i)(forward|backward)$"),
    _Signature("MoonRay", "moonray", r"motion_vectors$"),
    _Signature("Karma", "karma", r"(?i)motionvector$", other_layer=_KARMA),
    _Signature("Arnold", "arnold", r"(?i)motion_?vector$", min_channels=3),
    _Signature("Arnold", "arnold", r"(?i)motion_?vector$", other_layer=_ARNOLD),
    _Signature("Redshift", "redshift", r"MotionVectors$", components="RG"),
    _Signature("V-Ray", "vray", r"(?i)velocity$", min_channels=3),
    _Signature("V-Ray", "vray", r"(?i)velocity$", other_layer=_VRAY),
    _Signature("V-Ray", "vray", r"(?i)(^|[._])(mv|speed)$", other_layer=_VRAY),
    _Signature("ReelSmart or Twixtor", "reelsmart", r"(?i)(^|[._])(rsmb|reelsmart|twixtor)\w*$|^$"),
)


def recognise_producer(
    layer: str, components: str, layers: Collection[str], own_file: bool = False
) -> tuple[MotionConvention | None, str]:
    """Return the convention and the producer that names suggest, else None and "unknown".

    `layer` is the full name of the first motion layer, or of its AOV if that has a file of its own;
    `components` the first letter of each motion channel, in capitals; `layers` all full names.
    """
    signs = (
        sign
        for sign in _SIGNATURES
        if re.search(sign.motion, layer)
        and len(components) >= sign.min_channels
        and components.startswith(sign.components)
        and sign.own_file in (None, own_file)
        and (not sign.other_layer or any(re.search(sign.other_layer, n) for n in layers))
    )
    sign = next(signs, None)
    if sign is None:
        return None, UNKNOWN
    convention, count = PRESETS[sign.preset], len(components)
    if convention.count <= count:
        return convention, sign.producer
    # Without what takes more channels than there are.
    before, after = convention.to_previous, convention.to_next
    if before is None or after is None:
        before, after = (
            axes and replace(axes, length=None, alpha=None) for axes in (before, after)
        )
    elif re.search(r"(?i)(backward|motionback)$", layer):
        before, after = replace(before, x_channel=0, y_channel=1), None
    else:
        before, after = (axes if max(axes.channels) < count else None for axes in (before, after))
    return replace(convention, to_previous=before, to_next=after), sign.producer
