"""Which layers a file has, and what kind of values each of them holds.

A layer is what belongs together in a pixel: a colour with its alpha, the three numbers of a normal,
an id. Kinds go by the roles that were recognised (:mod:`exwarp_cli.io.channels`), then by pixel
type, components and the names that renderers use.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase

from exwarp_cli.errors import UsageError
from exwarp_cli.io.channels import ChannelRef, Layout, Role
from exwarp_cli.io.exr.header import Channel

BEAUTY, ALL = "beauty", "all"
"""What ``--layers`` takes beside names: the layer that frames are made for, and every one."""


class Kind(Enum):
    """What a layer's values are, hence what may be done with them."""

    COLOUR = "colour"
    """May be mixed: light, surface colour, coverage, mist, roughness."""

    DATA = "data"
    """Must not be mixed, and is nothing of the below: texture coordinates, tangents …"""

    DEPTH = "depth"
    NORMAL = "normal"
    POSITION = "position"
    """In the world, or any space in which a point's position changes as it moves."""

    MOTION = "motion"
    """The vectors that are used, whose convention is known; others are DATA."""

    ID = "id"
    CRYPTOMATTE = "cryptomatte"


@dataclass(frozen=True)
class Layer:
    """Channels that belong together, in one part of a file.

    Attributes
    ----------
    name
        What the channels' names have in common ("ViewLayer.Diffuse Color"); of channels without a
        layer their components ("RGBA", "Z").
    kind
        Of its values.
    refs
        Where the channels are found in every frame of the sequence, in the order of the file.
    channels
        The same in the frame that was looked at.
    """

    name: str
    kind: Kind
    refs: tuple[ChannelRef, ...]
    channels: tuple[Channel, ...]

    @property
    def aov(self) -> str:
        """Name of the AOV's own sequence where each AOV has a file of its own, else ""."""
        return self.refs[0].aov

    @property
    def leaf(self) -> str:
        """Last element of the name, without what the artist put before it."""
        return self.name.rsplit(".", 1)[-1]

    def rendered_in(self, others: Iterable[Layer]) -> Layer | None:
        """Return the layer of a slot's own file that can be taken as it is, None without one.

        It has the same name and components, and the values must not be mixed. Vectors are never
        taken: those of a slot's own file reach over a slot, the key frames' over a key interval.
        """
        if self.kind in (Kind.COLOUR, Kind.MOTION):
            return None
        wanted = {ref.component for ref in self.refs}
        for other in others:
            if other.name == self.name and {ref.component for ref in other.refs} == wanted:
                return other
        return None


_BY_ROLE = {
    Role.DEPTH: Kind.DEPTH,
    Role.MOTION: Kind.MOTION,
    Role.NORMAL: Kind.NORMAL,
    Role.POSITION: Kind.POSITION,
    Role.STENCIL: Kind.ID,
}
"""Every other role is colour: roughness and the like are filtered as colour is."""

_FAMILIES = {
    "RGBA": frozenset({"R", "G", "B", "RED", "GREEN", "BLUE"}),
    "XYZW": frozenset({"X", "Y", "Z", "W"}),
    "UV": frozenset({"U", "V"}),
    "ST": frozenset({"S", "T"}),
}
"""Components that make a value together; any other is one of its own."""

_ALPHA = frozenset({"A", "AR", "AG", "AB", "ALPHA"})

_THING = (
    r"(object|obj|material|mat|node|prim|mesh|shape|light|asset|instance|inst|render|entity|face)"
)
_NAMES = (
    (Kind.CRYPTOMATTE, re.compile(r"u?crypto.*|actorhitproxymask\d*")),
    (Kind.ID, re.compile(rf"(id|ids|.*index|index(ob|ma)|{_THING}ids?|.*stencil|idmask)\d*")),
    (
        Kind.DATA,
        re.compile(
            r"(uv|st)\d*|uvs?map\d*|uvcoords?|texcoords?\d*|.*tangents?|.*(ref|rest|local|object)"
            r"(p|n|position|normal)?|(rest|ref|local|object|generated|undisplaced)"
            r"(p|n|position|normal|coords?)|.*(vectors?|velocity|motion.*)|forward|backward"
            r"|deep.*|zback|.*sample(s|count)|raycount|barycentric.*|dpd[uv]|dndu?v?"
        ),
    ),
    (
        Kind.NORMAL,
        re.compile(r".*normals?(world|cam|camera|eye)?|n|nn|ng|nworld|ncam|hitn|rayhitn"),
    ),
    (
        Kind.POSITION,
        re.compile(r".*position(world)?|p|pos|worldpos|wp|pworld|pcam|(ray)?hitp|pointworld"),
    ),
    (Kind.DEPTH, re.compile(r"z|.*depth|z(norm|inv)|(ray)?hitpz|distance")),
)
"""Names of layers as renderers write them, lower case, letters and digits only; the first that fits
in full counts. Names that end in "id" by chance (grid, fluid) are why things are listed."""


def layers_of(
    files: Mapping[str, Mapping[str, Channel]], layout: Layout, cryptomattes: Collection[str] = ()
) -> tuple[Layer, ...]:
    """Group the channels of a frame's files into layers.

    Parameters
    ----------
    files
        The channels of one view of each of its files, by AOV (key "" for the main one) and by
        their name without view (:func:`exwarp_cli.io.views.channels_of`); none of deep parts, whose
        samples cannot be moved as pixels.
    layout
        The roles that were recognised in these files.
    cryptomattes
        Names that the header gives as those of Cryptomatte layers, without the digits of the rank.

    Returns
    -------
    tuple
        In the order of the files. Every channel is in one of them.
    """
    roles = {ref: role for role, refs in layout.roles.items() for ref in refs}
    # Vectors may be premultiplied by the beauty's alpha, which then counts among them.
    roles |= dict.fromkeys(layout.roles.get(Role.COLOUR, ()), Role.COLOUR)
    found = []
    for aov, channels in files.items():
        for (_, name), members in _grouped(aov, channels).items():
            refs = tuple(ChannelRef(aov, member) for member in members)
            known = tuple(channels[member] for member in members)
            kind = _kind(name, refs, known, [roles.get(ref) for ref in refs])
            if _is_crypto(name, cryptomattes):
                kind = Kind.CRYPTOMATTE
            found.append(Layer(name, kind, refs, known))
    return tuple(found)


def chosen(layers: tuple[Layer, ...], text: str, layout: Layout) -> tuple[Layer, ...]:
    """Return the layers that ``--layers`` asks for, the beauty always among them.

    Parameters
    ----------
    layers
        All that there are.
    text
        "beauty", "all", or names with wildcards and commas in between, which a layer's whole name
        or its last element has to match: ``*Diffuse*,Depth``. Case counts.
    layout
        Which of the layers is the beauty.

    Raises
    ------
    UsageError
        When a name matches nothing.
    """
    beauty = set(layout.roles.get(Role.COLOUR, ()))
    wanted = [pattern.strip() for pattern in text.split(",") if pattern.strip()]
    picked = {layer for layer in layers if beauty.intersection(layer.refs)}
    for pattern in wanted:
        if pattern == BEAUTY:
            continue
        matching = {layer for layer in layers if pattern == ALL or _matches(layer, pattern)}
        if not matching:
            names = ", ".join(dict.fromkeys(layer.name for layer in layers))
            raise UsageError(f"--layers {pattern!r} matches no layer; there are {names}")
        picked |= matching
    if not wanted:
        raise UsageError("--layers is empty; write beauty, all, or names such as '*Diffuse*'")
    return tuple(layer for layer in layers if layer in picked)


def _matches(layer: Layer, pattern: str) -> bool:
    return fnmatchcase(layer.name, pattern) or fnmatchcase(layer.leaf, pattern)


def _grouped(aov: str, channels: Mapping[str, Channel]) -> dict[tuple[int, str], list[str]]:
    """Group names of channels by part and layer name, and by what makes one value."""
    groups: dict[tuple[int, str, str], list[str]] = {}
    beside: dict[tuple[int, str], set[str]] = {}
    for name, channel in channels.items():
        layer, component = _split(name)
        beside.setdefault((channel.part, layer), set()).add(component.upper())
    for name, channel in channels.items():
        layer, component = _split(name)
        family = _family(component, beside[channel.part, layer])
        groups.setdefault((channel.part, layer, family), []).append(name)
    split = [(part, layer) for part, layer, _ in groups]
    named: dict[tuple[int, str], list[str]] = {}
    for (part, layer, family), members in groups.items():
        # Of several values in one layer the colour keeps the name.
        whole = layer if split.count((part, layer)) == 1 or family == "RGBA" else ""
        components = "".join(_split(member)[1] for member in members)
        full = whole or (f"{layer}.{components}" if layer else aov or components)
        named.setdefault((part, full), []).extend(members)
    return named


def _split(name: str) -> tuple[str, str]:
    """Return a channel's layer and component."""
    layer, _, component = name.rpartition(".")
    return layer, component


def _family(component: str, beside: set[str]) -> str:
    """Return what a component makes a value with, out of those `beside` it; else itself."""
    letter = component.upper()
    present = [name for name, letters in _FAMILIES.items() if letters & beside]
    if letter in _ALPHA and "RGBA" not in present and present:
        return present[0]  # coverage of texture coordinates
    if letter == "Z" and "X" not in beside:
        return component  # a depth beside a colour
    if letter in _ALPHA:
        return "RGBA"
    return next((name for name, letters in _FAMILIES.items() if letter in letters), component)


def _kind(
    name: str,
    refs: tuple[ChannelRef, ...],
    channels: tuple[Channel, ...],
    roles: list[Role | None],
) -> Kind:
    """Tell a layer's kind by its role, else by type, name and components."""
    role = next((role for role in roles if role is not None), None)
    if role is not None:
        return _BY_ROLE.get(role, Kind.COLOUR)
    leaf = re.sub(r"[^a-z0-9]", "", name.rsplit(".", 1)[-1].lower())
    named = next((kind for kind, names in _NAMES if names.fullmatch(leaf)), None)
    if any(channel.pixel_type == "uint" for channel in channels):
        return named if named is Kind.CRYPTOMATTE else Kind.ID
    if named is not None:
        return named
    components = {ref.component.upper() for ref in refs}
    # A vector of unknown meaning: a mixture of two directions may be none of both.
    vector = len(components) > 1 and not components & (_FAMILIES["RGBA"] | _ALPHA)
    return Kind.DATA if vector else Kind.COLOUR


def _is_crypto(name: str, cryptomattes: Collection[str]) -> bool:
    """Whether a layer holds ranks, or the preview, of one of these Cryptomattes."""
    return any(re.fullmatch(rf"{re.escape(base)}\d*", name) for base in cryptomattes)
