"""Which layers a file has, and what kind of values each of them holds.

A layer is what belongs together in a pixel: a colour with its alpha, the three numbers of a normal,
an id. Kinds go by the roles that were recognised (:mod:`exwarp_cli.io.channels`), then by pixel
type, components and the names that renderers use. Of the layers of a shot without a role, some may
be motion vectors that were not recognised.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from exwarp_cli.errors import UsageError
from exwarp_cli.io.channels import ChannelRef, Layout, Role, split_words
from exwarp_cli.io.cryptomatte import cryptomatte_refs
from exwarp_cli.io.exr.header import Channel
from exwarp_cli.io.sequences import neighbouring_sequences

if TYPE_CHECKING:
    from exwarp_cli.io.shot import Shot

# What --layers takes beside names: the layer that frames are made for, and every one.
BEAUTY, ALL = "beauty", "all"


class LayerKind(Enum):
    """What a layer's values are, hence what may be done with them."""

    COLOUR = "colour"  # may be mixed: light, surface colour, coverage, mist, roughness
    DATA = "data"  # must not be mixed, and is none of the others: texture coordinates, tangents …
    DEPTH = "depth"
    NORMAL = "normal"
    POSITION = "position"  # in any space in which a point's position changes as it moves
    MOTION = "motion"  # the vectors that are used, whose convention is known; others are DATA
    ID = "id"
    CRYPTOMATTE = "cryptomatte"


@dataclass(frozen=True)
class Layer:
    """Channels that belong together, in one part of a file."""

    # What the channels' names have in common ("ViewLayer.Diffuse Color"); of channels without a
    # layer their components ("RGBA", "Z").
    name: str
    kind: LayerKind
    # In the order of the file: in every frame of the sequence, and in the frame that was read.
    refs: tuple[ChannelRef, ...]
    channels: tuple[Channel, ...]

    def rendered_in(self, others: Iterable[Layer]) -> Layer | None:
        """Return the layer of a slot's own file that can be taken unchanged, or None.

        It has the same name and components, and the values must not be mixed. Vectors are never
        taken: those of a slot's own file reach over a slot, the key frames' over a key interval.
        """
        if self.kind in (LayerKind.COLOUR, LayerKind.MOTION):
            return None
        components = {ref.component for ref in self.refs}
        for other in others:
            if other.name == self.name and {ref.component for ref in other.refs} == components:
                return other
        return None


# Every other role is colour: roughness and the like are filtered as colour is.
_KIND_BY_ROLE = {
    Role.DEPTH: LayerKind.DEPTH,
    Role.MOTION: LayerKind.MOTION,
    Role.NORMAL: LayerKind.NORMAL,
    Role.POSITION: LayerKind.POSITION,
    Role.STENCIL: LayerKind.ID,
}

# Components that make a value together; any other is one of its own.
_FAMILIES = {
    "RGBA": frozenset({"R", "G", "B", "RED", "GREEN", "BLUE"}),
    "XYZW": frozenset({"X", "Y", "Z", "W"}),
    "UV": frozenset({"U", "V"}),
    "ST": frozenset({"S", "T"}),
}
_ALPHA = frozenset({"A", "AR", "AG", "AB", "ALPHA"})

# Names of layers as renderers write them, lower case, letters and digits only; the first that fits
# in full counts. Names that end in "id" by chance (grid, fluid) are why things are listed.
_THING = (
    r"(object|obj|material|mat|node|prim|mesh|shape|light|asset|instance|inst|render|entity|face)"
)
_NAMES = (
    (LayerKind.CRYPTOMATTE, re.compile(r"u?crypto.*|actorhitproxymask\d*")),
    (LayerKind.ID, re.compile(rf"(id|ids|.*index|index(ob|ma)|{_THING}ids?|.*stencil|idmask)\d*")),
    (
        LayerKind.DATA,
        re.compile(
            r"(uv|st)\d*|uvs?map\d*|uvcoords?|texcoords?\d*|.*tangents?|.*(ref|rest|local|object)"
            r"(p|n|position|normal)?|(rest|ref|local|object|generated|undisplaced)"
            r"(p|n|position|normal|coords?)|.*(vectors?|velocity|motion.*)|forward|backward"
            r"|deep.*|zback|.*sample(s|count)|raycount|barycentric.*|dpd[uv]|dndu?v?"
        ),
    ),
    (
        LayerKind.NORMAL,
        re.compile(r".*normals?(world|cam|camera|eye)?|n|nn|ng|nworld|ncam|hitn|rayhitn"),
    ),
    (
        LayerKind.POSITION,
        re.compile(r".*position(world)?|p|pos|worldpos|wp|pworld|pcam|(ray)?hitp|pointworld"),
    ),
    (LayerKind.DEPTH, re.compile(r"z|.*depth|z(norm|inv)|(ray)?hitpz|distance")),
)


MAX_LISTED = 12  # layers that a message names

_MOTION_WORDS = frozenset(
    {"move", "movement", "mv", "mb", "vec", "vecs", "vel", "velo", "speed", "optical", "disparity"}
    | {"displacement", "forward", "fwd", "fore", "backward", "bwd", "back", "prev", "previous"}
    | {"next", "blur"}
)
_MOTION_BEGINNINGS = ("motion", "velocit", "vector", "mvec", "flow")
_PAIRS = ("UV", "XY", "RG")


def group_layers(
    files: Mapping[str, Mapping[str, Channel]], layout: Layout, cryptomattes: Collection[str] = ()
) -> tuple[Layer, ...]:
    """Group the channels of a frame's files into layers, in the order of the files.

    `files` are the channels of one view of each file, by AOV ("" for the main one) and by name
    (:func:`exwarp_cli.io.views.view_channels`). There are none of deep parts, whose samples cannot
    be moved as pixels. `layout` has the roles that were recognised in them, `cryptomattes` the
    headers' names of Cryptomatte layers, without the digits of the rank.
    """
    roles = {ref: role for role, refs in layout.roles.items() for ref in refs}
    # Vectors may be premultiplied by the beauty's alpha, which then counts among them.
    roles |= dict.fromkeys(layout.roles.get(Role.COLOUR, ()), Role.COLOUR)
    layers = []
    for aov, channels in files.items():
        for name, members in _group_names(aov, channels):
            refs = tuple(ChannelRef(aov, member) for member in members)
            own = tuple(channels[member] for member in members)
            # Layers of ranks, or the preview, of a Cryptomatte.
            if any(re.fullmatch(rf"{re.escape(base)}\d*", name) for base in cryptomattes):
                kind = LayerKind.CRYPTOMATTE
            elif role := next((roles[ref] for ref in refs if ref in roles), None):
                kind = _KIND_BY_ROLE.get(role, LayerKind.COLOUR)
            else:
                leaf = re.sub(r"[^a-z0-9]", "", name.rsplit(".", 1)[-1].lower())
                named = next((kind for kind, names in _NAMES if names.fullmatch(leaf)), None)
                components = {ref.component.upper() for ref in refs}
                # A vector of unknown meaning: a mixture of two directions may be none of both.
                is_vector = len(components) > 1 and not components & (_FAMILIES["RGBA"] | _ALPHA)
                kind = named or (LayerKind.DATA if is_vector else LayerKind.COLOUR)
                has_integers = any(channel.pixel_type == "uint" for channel in own)
                if has_integers and kind is not LayerKind.CRYPTOMATTE:
                    kind = LayerKind.ID
            layers.append(Layer(name, kind, refs, own))
    return tuple(layers)


def select_layers(layers: tuple[Layer, ...], text: str, layout: Layout) -> tuple[Layer, ...]:
    """Return the layers that ``--layers`` asks for, the beauty always among them.

    `text` is "beauty", "all", or names with wildcards and commas in between, which a layer's whole
    name or its last element has to match: ``*Diffuse*,Depth``. Case counts.

    Raises UsageError if a name matches nothing.
    """
    beauty = set(layout.roles.get(Role.COLOUR, ()))
    patterns = [pattern.strip() for pattern in text.split(",") if pattern.strip()]
    selected = {layer for layer in layers if beauty.intersection(layer.refs)}
    for pattern in patterns:
        if pattern == BEAUTY:
            continue
        matching = {
            layer
            for layer in layers
            if pattern == ALL
            or fnmatchcase(layer.name, pattern)
            # Or the last element, without what the artist put before it.
            or fnmatchcase(layer.name.rsplit(".", 1)[-1], pattern)
        }
        if not matching:
            names = ", ".join(dict.fromkeys(layer.name for layer in layers))
            raise UsageError(f"--layers {pattern!r} matches no layer; there are {names}")
        selected |= matching
    if not patterns:
        raise UsageError("--layers is empty; write beauty, all, or names such as '*Diffuse*'")
    return tuple(layer for layer in layers if layer in selected)


def _group_names(aov: str, channels: Mapping[str, Channel]) -> list[tuple[str, list[str]]]:
    """Group names of channels by part and layer name, and by what makes one value."""
    components: dict[tuple[int, str], set[str]] = defaultdict(set)
    for name, channel in channels.items():
        layer, _, component = name.rpartition(".")
        components[channel.part, layer].add(component.upper())
    groups: dict[tuple[int, str, str], list[str]] = defaultdict(list)
    for name, channel in channels.items():
        layer, _, component = name.rpartition(".")
        letter, present = component.upper(), components[channel.part, layer]
        family = next((f for f, letters in _FAMILIES.items() if letter in letters), component)
        if letter in _ALPHA:
            # Coverage of a colour, or of texture coordinates.
            others = [f for f, letters in _FAMILIES.items() if letters & present]
            family = "RGBA" if "RGBA" in others or not others else others[0]
        elif letter == "Z" and "X" not in present:
            family = component  # a depth beside a colour
        groups[channel.part, layer, family].append(name)
    family_counts = Counter((part, layer) for part, layer, _ in groups)
    named: dict[tuple[int, str], list[str]] = defaultdict(list)
    for (part, layer, family), members in groups.items():
        name = layer
        # Of several values in one layer the colour keeps the name.
        if not layer or (family_counts[part, layer] > 1 and family != "RGBA"):
            letters = "".join(member.rpartition(".")[2] for member in members)
            name = f"{layer}.{letters}" if layer else aov or letters
        named[part, name] += members
    return [(name, members) for (_, name), members in named.items()]


def likely_vectors(refs: Iterable[ChannelRef]) -> tuple[tuple[ChannelRef, ...], ...]:
    """Return the layers that may hold motion vectors, the likeliest first, by name alone.

    Of each layer, its first two components in the order X, Y, or U, V, or R, G. A layer counts if
    its name has a word of motion, or if it has these two components and no third.
    """
    layers: dict[str, dict[str, ChannelRef]] = defaultdict(dict)
    for ref in refs:
        layer = ref.label.rpartition(".")[0] or ref.aov
        layers[layer].setdefault(ref.component[:1].upper(), ref)
    named: list[tuple[ChannelRef, ...]] = []
    unnamed: list[tuple[ChannelRef, ...]] = []
    for layer, components in layers.items():
        pair = next((pair for pair in _PAIRS if set(pair) <= set(components)), None)
        if pair is None:
            continue
        vectors = tuple(components[letter] for letter in pair)
        if _has_motion_word(layer):
            named.append(vectors)
        elif len(components) == 2:
            unnamed.append(vectors)
    return (*named, *unnamed)


def is_colour_alone(shot: Shot) -> bool:
    """Return True if a shot has nothing but its beauty: footage, and no render with passes."""
    has_roles = not set(shot.layout.roles) <= {Role.COLOUR} or shot.layout.incomplete
    if has_roles or shot.aovs or shot.cryptomattes:
        return False
    # Some renderers keep the beauty's alpha in a layer of its own.
    more = [ref for ref in shot.unused if ref.component.lower() not in ("a", "alpha")]
    return not more and not any(map(_has_motion_word, neighbouring_sequences(shot.sequence)))


def _has_motion_word(name: str) -> bool:
    words = split_words(re.sub(r".*:", "", name))
    return any(w in _MOTION_WORDS or w.startswith(_MOTION_BEGINNINGS) for w in words)


def no_vectors_message(shot: Shot, estimable: bool = True) -> str:
    """Return the message that a shot has no usable vectors: its unknown channels, and what to do.

    `estimable` is true if the method could estimate motion.
    """
    incomplete = shot.layout.incomplete.get(Role.MOTION)
    partly = "" if incomplete is None else f" ({incomplete})"
    # Channels of Cryptomattes have a use. Those of the main file come first.
    hashed = cryptomatte_refs(shot.cryptomattes)
    order = ["", *shot.aovs]
    unused = [ref for ref in shot.unused if ref not in hashed]
    unused.sort(key=lambda ref: order.index(ref.aov))
    layers: dict[str, list[str]] = defaultdict(list)
    for ref in unused:
        layer, dot, component = ref.label.rpartition(".")
        layers[layer + dot].append(component)
    listed = [
        f"{layer}{components[0]}" if len(components) == 1 else f"{layer}{{{','.join(components)}}}"
        for layer, components in layers.items()
    ]
    more = f" and {len(listed) - MAX_LISTED} more layers" if len(listed) > MAX_LISTED else ""
    unknown = f"; not recognised: {', '.join(listed[:MAX_LISTED])}{more}" if unused else ""
    likeliest = ""
    if likely := likely_vectors(unused):
        names = ", ".join(ref.name.rpartition(".")[0] or ref.aov for ref, _ in likely[:3])
        aov = likely[0][0].aov
        pattern = (shot.aovs[aov] if aov else shot.sequence).pattern
        channels = ",".join(ref.name for ref in likely[0])
        likeliest = f"; likeliest: {names}, to be named as in --aov motion={pattern}:{channels}"
    else:
        neighbours = {} if shot.aovs else neighbouring_sequences(shot.sequence)
        pattern = next((s.pattern for name, s in neighbours.items() if _has_motion_word(name)), "")
        if pattern:
            likeliest = f"; likeliest: {pattern}, to be named as in --aov motion={pattern}:R,G"
    remedy = ", or allow --estimate-motion" if estimable and not is_colour_alone(shot) else ""
    return (
        f"{shot.sequence.pattern} has no motion vectors that are recognised{partly}{unknown}"
        f"{likeliest}; render the motion pass{remedy}, or use --method hold or blend"
    )
