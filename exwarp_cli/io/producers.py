"""What programs write: their motion conventions by name, and which layer names give them away.

A convention that is known by a name is a first guess; measuring decides
(:mod:`exwarp_cli.synthesis.calibration`).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, replace

from exwarp_cli.domain.motion import AxisMap, MotionConvention

UNKNOWN = "unknown"


def _both(y: float) -> MotionConvention:
    """Forward vectors in the first two channels, backward ones in the next two, in pixels."""
    return MotionConvention(AxisMap(2, 3, 1.0, y), AxisMap(0, 1, 1.0, y))


_FORWARD = MotionConvention(to_next=AxisMap(0, 1, 1.0, -1.0))

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
    "renderman": _both(1.0),  # raster space: y down
    "karma": _FORWARD,
    # The screen reaches from -1 to 1; premultiplied.
    "moonray": MotionConvention(to_next=AxisMap(0, 1, 0.5, -0.5, alpha=2), of_frame=True),
    "nuke": _both(-1.0),
    "reelsmart": _FORWARD,
    "twixtor": _FORWARD,
    "forward": _FORWARD,
    "backward": MotionConvention(to_previous=AxisMap(0, 1, 1.0, -1.0)),
    "forward+backward": _both(-1.0),
}
"""Conventions by name, for ``--motion``: indices count the motion channels in the order found."""

FORWARD_NAMES = ("forward", "motionfore")
BACKWARD_NAMES = ("backward", "motionback")

_CRYPTOMATTE = re.compile(r"(^|[._:])(crypto[A-Za-z_]*(\d\d)?|\w*HitProxyMask\d\d)$", re.IGNORECASE)


def direction_named(layer: str) -> str:
    """Return "forward" or "backward" where a layer of vectors goes by that name, else ""."""
    name = re.sub(r"[^a-z]", "", layer.lower())
    for direction, names in (("forward", FORWARD_NAMES), ("backward", BACKWARD_NAMES)):
        if name.endswith(names):
            return direction
    return ""


def is_cryptomatte(layer: str) -> bool:
    """Whether a layer goes by a usual name of Cryptomatte: a rank of ids and coverage, or preview.

    Headers may name others; only the file's attributes tell for certain.
    """
    return _CRYPTOMATTE.search(layer) is not None


@dataclass(frozen=True)
class _Signs:
    """What gives a producer away.

    Attributes
    ----------
    name, preset
        The producer, and its convention out of `PRESETS`.
    motion
        Pattern of the motion layer's full name.
    least
        Fewest channels of that layer.
    components
        The channels of that layer begin with these, where it matters.
    beside
        Pattern of another layer's full name that must be there.
    own_file
        Whether the layer must have a file of its own; None where it does not matter.
    """

    name: str
    preset: str
    motion: str
    least: int = 2
    components: str = ""
    beside: str = ""
    own_file: bool | None = None

    def match(self, layer: str, components: str, others: Collection[str], own_file: bool) -> bool:
        """Whether all of them are there."""
        return (
            re.search(self.motion, layer) is not None
            and len(components) >= self.least
            and components.startswith(self.components)
            and self.own_file in (None, own_file)
            and (not self.beside or any(re.search(self.beside, other) for other in others))
        )


_ARNOLD = r"(^|[._])([NP]|ID|crypto_\w+)$"
_KARMA = r"(?i)(^|[._:])(hit(pz|p|n)|objectid)$"
_VRAY = r"(?i)(^|[._])(vray\w+|zdepth|normals|renderid|materialid)$"

_PRODUCERS = (
    _Signs("Unreal Movie Render Queue", "unreal-mrq", r"MovieRenderQueue_?MotionVectors?$"),
    _Signs("Blender", "blender", r"(?i)(^|\.)vector$"),
    _Signs("Unreal (one file per AOV)", "unreal", r"MotionVector$", own_file=True),
    _Signs("RenderMan", "renderman", r"(?i)motion(fore|back)$"),
    _Signs("Nuke convention", "nuke", r"(?i)(forward|backward)$"),
    _Signs("MoonRay", "moonray", r"motion_vectors$"),
    _Signs("Karma", "karma", r"(?i)motionvector$", beside=_KARMA),
    _Signs("Arnold", "arnold", r"(?i)motion_?vector$", least=3),
    _Signs("Arnold", "arnold", r"(?i)motion_?vector$", beside=_ARNOLD),
    _Signs("Redshift", "redshift", r"MotionVectors$", components="RG"),
    _Signs("V-Ray", "vray", r"(?i)velocity$", least=3),
    _Signs("V-Ray", "vray", r"(?i)velocity$", beside=_VRAY),
    _Signs("V-Ray", "vray", r"(?i)(^|[._])(mv|speed)$", beside=_VRAY),
    _Signs("ReelSmart or Twixtor", "reelsmart", r"(?i)(^|[._])(rsmb|reelsmart|twixtor)\w*$|^$"),
)


def recognise(
    layer: str, components: str, others: Collection[str], own_file: bool = False
) -> tuple[MotionConvention | None, str]:
    """Return what names say of motion channels: a convention and the producer.

    Parameters
    ----------
    layer
        Full name of the (first) motion layer, or of its AOV where that has a file of its own.
    components
        The first letter of each motion channel's component, in capitals, in order.
    others
        Full names of all layers.
    own_file
        Whether the motion layer has a file of its own.

    Returns
    -------
    tuple
        None and "unknown" where they say nothing.
    """
    for signs in _PRODUCERS:
        if signs.match(layer, components, others, own_file):
            backward = re.search(r"(?i)(backward|motionback)$", layer) is not None
            return _reduced(PRESETS[signs.preset], len(components), backward), signs.name
    return None, UNKNOWN


def _reduced(convention: MotionConvention, count: int, backward: bool) -> MotionConvention:
    """Leave out of a convention what takes more channels than there are."""
    if convention.count <= count:
        return convention
    before, after = convention.to_previous, convention.to_next
    if before is not None and after is not None:
        if backward:
            return MotionConvention(replace(before, x_channel=0, y_channel=1), None)
        before, after = (axes if max(axes.channels) < count else None for axes in (before, after))
        return MotionConvention(before, after)

    def plain(axes: AxisMap | None) -> AxisMap | None:
        return None if axes is None else replace(axes, length=None, alpha=None)

    return replace(convention, to_previous=plain(before), to_next=plain(after))
