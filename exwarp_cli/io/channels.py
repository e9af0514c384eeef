"""Which channels of a file hold colour, depth, motion and the rest: detection by name.

Renderers name their AOVs differently, and layer names are the artist's; so the last element of a
layer's name is what counts, in any case, without separators. A motion layer only gets a first guess
of its convention here; measuring decides (:mod:`exwarp_cli.synthesis.calibration`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from exwarp_cli.domain.motion import AxisMap, MotionConvention
from exwarp_cli.errors import LayoutError
from exwarp_cli.io.exr import Channel


class Role(Enum):
    """What a set of channels is for."""

    COLOUR = "colour"
    DEPTH = "depth"
    MOTION = "motion"
    NORMAL = "normal"
    POSITION = "position"
    STENCIL = "stencil"
    ALBEDO = "albedo"
    SPECULAR = "specular"
    ROUGHNESS = "roughness"
    METALLIC = "metallic"


@dataclass(frozen=True)
class ChannelRef:
    """Where a channel is found in every frame of a sequence.

    Attributes
    ----------
    aov
        Name of the AOV's own sequence where each AOV has a file of its own, else "".
    name
        Channel name with its layer.
    """

    aov: str
    name: str

    @property
    def component(self) -> str:
        """Last element of the name: R, X, u and the like."""
        return self.name.rsplit(".", 1)[-1]


@dataclass(frozen=True)
class Layout:
    """What was recognised in a sequence's files.

    Attributes
    ----------
    roles
        The channels of every role that was found, components in order (R G B A, X Y Z …).
    guess
        What the names say of the motion convention; None where they say nothing.
    producer
        The program that wrote the files, as far as the names tell.
    """

    roles: Mapping[Role, tuple[ChannelRef, ...]]
    guess: MotionConvention | None = None
    producer: str = "unknown"

    def __contains__(self, role: Role) -> bool:
        return role in self.roles


@dataclass(frozen=True)
class _Rule:
    """Names of layers and components that a role goes by; earlier ones win."""

    leaves: tuple[str, ...]
    components: tuple[str, ...]


_RULES: dict[Role, tuple[_Rule, ...]] = {
    Role.COLOUR: (
        _Rule(("", "combined", "beauty", "rgba", "rgb", "color", "colour"), ("RGBA", "RGB")),
        _Rule(("pretonemaphdrcolor", "scenecolor", "finalimage", "c"), ("RGBA", "RGB")),
    ),
    Role.DEPTH: (
        _Rule(("depth", "scenedepth", "zdepth", "worlddepth", "z"), ("Z", "R", "Y", "V")),
        _Rule(("",), ("Z",)),
    ),
    Role.MOTION: (
        _Rule(("vector",), ("XYZW",)),
        _Rule(("forward", "motionfore", "backward", "motionback"), ("UV", "XY", "RG")),
        _Rule(("motionvector", "motionvectors", "velocity", "motion"), ("XY", "UV", "RG")),
    ),
    Role.NORMAL: (_Rule(("normal", "worldnormal", "normals", "nworld", "n"), ("XYZ", "RGB")),),
    Role.POSITION: (_Rule(("position", "worldposition", "pworld", "wp", "p"), ("XYZ", "RGB")),),
    Role.STENCIL: (
        _Rule(
            ("objectindex", "indexob", "mystencil", "stencil", "objectid", "id", "renderid"),
            ("X", "R", "Y", "V"),
        ),
        _Rule(("",), ("ID",)),
    ),
    Role.ALBEDO: (
        _Rule(("diffusecolor", "diffcol", "basecolor", "albedo", "diffusealbedo"), ("RGB",)),
    ),
    Role.SPECULAR: (_Rule(("glossycolor", "glosscol"), ("RGB",)),),
    Role.ROUGHNESS: (_Rule(("roughness",), ("X", "R", "Y", "V")),),
    Role.METALLIC: (_Rule(("metallic", "metalness", "metal"), ("X", "R", "Y", "V")),),
}

# Unreal, as ExtraNet dumps it: current minus previous, y up.
_UNREAL = MotionConvention(to_previous=AxisMap(0, 1, -1.0, 1.0))
# Blender: XY is previous minus current, ZW current minus next, y up.
_BLENDER = MotionConvention(AxisMap(0, 1, 1.0, -1.0), AxisMap(2, 3, -1.0, 1.0))

PRESETS: dict[str, MotionConvention] = {
    "blender": _BLENDER,
    "unreal": _UNREAL,
    "forward": MotionConvention(to_next=AxisMap(0, 1, 1.0, -1.0)),
    "backward": MotionConvention(to_previous=AxisMap(0, 1, 1.0, -1.0)),
    "forward+backward": MotionConvention(
        to_previous=AxisMap(2, 3, 1.0, -1.0), to_next=AxisMap(0, 1, 1.0, -1.0)
    ),
}
"""Conventions by name, for ``--motion``: indices count the motion channels in the order found."""


@dataclass
class _Layer:
    """The channels that share a layer name."""

    name: str
    leaf: str
    order: int
    components: dict[str, ChannelRef] = field(default_factory=dict)

    def pick(self, letters: str) -> tuple[ChannelRef, ...] | None:
        """Return the channels of these components, or None when one is absent."""
        keys = ["ID"] if letters == "ID" else list(letters)
        if any(key not in self.components for key in keys):
            return None
        return tuple(self.components[key] for key in keys)


def detect(channels: Mapping[str, Iterable[Channel]]) -> Layout:
    """Recognise the roles of channels.

    Parameters
    ----------
    channels
        The channels of one frame by AOV: key "" for the main file, the AOV's own name for files
        that hold one AOV each.

    Returns
    -------
    Layout
        Roles that were not found are absent.
    """
    layers = _layers(channels)
    roles: dict[Role, tuple[ChannelRef, ...]] = {}
    for role, rules in _RULES.items():
        found = _motion(layers) if role is Role.MOTION else _first(layers, rules)
        if found:
            roles[role] = found
        if role is Role.COLOUR and found:
            # Of several view layers, geometry is looked for in the one whose colour is used.
            parent = _parent(found[0].name)
            layers.sort(key=lambda layer: _parent(f"{layer.name}.") != parent)
    if Role.COLOUR not in roles:
        roles.update(_only_colour(layers, roles))
    guess, producer = _guess(roles.get(Role.MOTION, ()))
    return Layout(roles, guess, producer)


def require(layout: Layout, role: Role, where: str) -> tuple[ChannelRef, ...]:
    """Return a role's channels.

    Raises
    ------
    LayoutError
        When the files do not have it.
    """
    if role not in layout:
        raise LayoutError(
            f"{where} has no {role.value} channels that are recognised; "
            "list its channels with 'exwarp inspect' and render the missing pass"
        )
    return layout.roles[role]


def _parent(name: str) -> str:
    """Return what stands before a channel's layer: "A" for "A.Combined.R"."""
    return name.rpartition(".")[0].rpartition(".")[0]


def _layers(channels: Mapping[str, Iterable[Channel]]) -> list[_Layer]:
    """Group channels by layer, in file order."""
    layers: dict[tuple[str, str], _Layer] = {}
    for aov, members in channels.items():
        for channel in members:
            layer, _, component = channel.name.rpartition(".")
            leaf = re.sub(r"[^a-z0-9]", "", (layer.rsplit(".", 1)[-1] or aov).lower())
            key = (aov, layer)
            if key not in layers:
                layers[key] = _Layer(layer or aov, leaf, len(layers))
            layers[key].components.setdefault(component.upper(), ChannelRef(aov, channel.name))
    return list(layers.values())


def _first(layers: list[_Layer], rules: Iterable[_Rule]) -> tuple[ChannelRef, ...]:
    """Return the channels of the best layer for these rules, () when there is none."""
    for rule in rules:
        for leaf in rule.leaves:
            for layer in layers:
                if layer.leaf != leaf:
                    continue
                for letters in rule.components:
                    found = layer.pick(letters)
                    if found:
                        return found
    return ()


def _motion(layers: list[_Layer]) -> tuple[ChannelRef, ...]:
    """Return the motion channels; forward and backward layers are joined, forward first."""
    whole = _first(layers, _RULES[Role.MOTION][:1])
    if whole:
        return whole
    letters = _RULES[Role.MOTION][1].components
    forward = _first(layers, [_Rule(("forward", "motionfore"), letters)])
    backward = _first(layers, [_Rule(("backward", "motionback"), letters)])
    return forward + backward or _first(layers, _RULES[Role.MOTION][2:])


def _only_colour(
    layers: list[_Layer], taken: Mapping[Role, tuple[ChannelRef, ...]]
) -> dict[Role, tuple[ChannelRef, ...]]:
    """Take a single unclaimed RGB layer for colour, whatever its name."""
    used = {ref for refs in taken.values() for ref in refs}
    free = []
    for layer in layers:
        found = layer.pick("RGBA") or layer.pick("RGB")
        if found and not used.intersection(found):
            free.append(found)
    return {Role.COLOUR: free[0]} if len(free) == 1 else {}


def _guess(motion: tuple[ChannelRef, ...]) -> tuple[MotionConvention | None, str]:
    """Return what the motion channels' names say: a convention and the producer."""
    if not motion:
        return None, "unknown"
    layer = motion[0].name.rpartition(".")[0] or motion[0].aov
    leaf = re.sub(r"[^a-z]", "", layer.rsplit(".", 1)[-1].lower())
    if leaf == "vector" and len(motion) == 4:
        return PRESETS["blender"], "Blender"
    if motion[0].aov and leaf.endswith("motionvector"):
        return PRESETS["unreal"], "Unreal (one file per AOV)"
    if leaf in ("forward", "motionfore"):
        return PRESETS["forward+backward" if len(motion) == 4 else "forward"], "Nuke convention"
    if leaf in ("backward", "motionback"):
        return PRESETS["backward"], "Nuke convention"
    return None, "unknown"
