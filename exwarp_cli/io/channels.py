"""Which channels of a file hold colour, depth, motion and the rest: detection by name.

Renderers name their AOVs differently, and layer names are the artist's; so the last element of a
layer's name is what counts, in any case, without separators; where that says nothing, its last
words. A motion layer only gets a first guess of its convention here, by what
:mod:`exwarp_cli.io.producers` knows; measuring decides (:mod:`exwarp_cli.synthesis.calibration`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import partial

from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.errors import LayoutError
from exwarp_cli.io.exr.header import Channel
from exwarp_cli.io.producers import (
    BACKWARD_NAMES,
    FORWARD_NAMES,
    UNKNOWN,
    is_cryptomatte,
    recognise,
)


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
    incomplete
        Layers that go by a role's name but lack channels, and so are not taken: what each has, in
        words, for example "'forward' has only u".
    alphas
        Channels that may be the alpha of a colour without, where there are several: none is taken.
    """

    roles: Mapping[Role, tuple[ChannelRef, ...]]
    guess: MotionConvention | None = None
    producer: str = UNKNOWN
    incomplete: Mapping[Role, str] = field(default_factory=dict)
    alphas: tuple[ChannelRef, ...] = ()

    def __contains__(self, role: Role) -> bool:
        return role in self.roles


@dataclass(frozen=True)
class _Rule:
    """Names of layers and components that a role goes by; earlier ones win."""

    leaves: tuple[str, ...]
    components: tuple[str, ...]


_ONE = ("X", "R", "Y", "V")
_RULES: dict[Role, tuple[_Rule, ...]] = {
    Role.COLOUR: (
        _Rule(("", "combined", "beauty", "rgba", "rgb", "color", "colour"), ("RGBA", "RGB")),
        _Rule(("pretonemaphdrcolor", "scenecolor", "finalimage", "c", "ci"), ("RGBA", "RGB")),
        # What Blender's File Output calls its first input.
        _Rule(("image",), ("RGBA", "RGB")),
        _Rule(("rgbcolor", "rgbcolour"), ("RGBA", "RGB")),
    ),
    Role.DEPTH: (
        # OpenEXR's own name for it; what lies beside it as zdepth may be a picture from 0 to 1.
        _Rule(("",), ("Z",)),
        _Rule(("depth", "scenedepth", "zdepth", "worlddepth", "hitpz", "z"), ("Z", *_ONE)),
        _Rule(("disparity", "inversedepth", "depthinverse", "invdepth"), ("Z", *_ONE)),
    ),
    Role.MOTION: (
        _Rule(("vector",), ("XYZW", "RGBA")),
        _Rule((*FORWARD_NAMES, *BACKWARD_NAMES), ("UV", "XY", "RG")),
        _Rule(("motionvector", "motionvectors", "velocity", "motion"), ("XY", "UV", "RG")),
        # Blender's File Output may leave out the fourth; the third alone is half a displacement.
        _Rule(("vector",), ("XY", "RG")),
        _Rule(("mv", "mvec", "motionvec", "speed"), ("XY", "UV", "RG")),
        _Rule(("rsmb", "reelsmart", "twixtor"), ("RG", "XY", "UV")),
    ),
    Role.NORMAL: (
        _Rule(("normal", "worldnormal", "normals", "nworld", "hitn", "n"), ("XYZ", "RGB")),
    ),
    Role.POSITION: (
        _Rule(("position", "worldposition", "pworld", "wp", "hitp", "p"), ("XYZ", "RGB")),
    ),
    Role.STENCIL: (
        _Rule(("objectindex", "indexob", "mystencil", "stencil", "objectid", "id"), _ONE),
        _Rule(("renderid",), _ONE),
    ),
    Role.ALBEDO: (
        _Rule(("diffusecolor", "diffcol", "basecolor", "albedo", "diffusealbedo"), ("RGB",)),
    ),
    Role.SPECULAR: (_Rule(("glossycolor", "glosscol"), ("RGB",)),),
    Role.ROUGHNESS: (_Rule(("roughness",), _ONE),),
    Role.METALLIC: (_Rule(("metallic", "metalness", "metal"), _ONE),),
}

_PLAIN_WORDS = frozenset(
    {"", "c", "ci", "rgba", "rgb", "color", "colour", "finalimage", "image", "vector"}
)
"""Names that say nothing at the end of a longer one: a diffuse colour is no beauty."""

_BY_LAST_WORDS = (
    Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.POSITION, Role.STENCIL,
)  # fmt: skip
"""Roles whose layers are also found by the last words of their names. Not those of materials,
where each lobe has its own."""

_NEVER_BEFORE = frozenset({"shadow", "denoising", "noisy", "variance", "holdout", "bump"})
"""Words before a role's name that make it another thing: Blender's denoising depth is that of what
a mirror shows."""

_SHORT_WORDS = frozenset({"mv"})
"""Roles' names of three letters or fewer that end longer names of nothing else."""

_SUFFIXES = frozenset(
    {"pass", "layer", "aov", "element", "channel", "channels", "raw", "nofilter", "unfiltered"}
    | {"filtered", "float", "32f", "16f"}
)
"""Words after a role's name that leave it that, as numbers and versions (`v2`) do."""

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+[a-z]?")
"""A word of a name: `VRayZDepth_v2` has V, Ray, Z, Depth, v, 2."""

_SPACES = frozenset(
    {"camera", "cam", "view", "eye", "screen", "local", "object", "obj", "rest", "reference", "ref"}
    | {"tangent", "previous", "prev", "light"}
)
"""Such words before normals and positions, which count in world space alone."""

_LEAVES = {
    role: frozenset(e for rule in rules for e in rule.leaves) for role, rules in _RULES.items()
}
_PICTURES = _LEAVES[Role.COLOUR]
_DATA = frozenset.union(*_LEAVES.values()) - _PICTURES
_ALPHAS = frozenset({"a", "alpha"})

_LONG_COMPONENTS = {"RED": "R", "GREEN": "G", "BLUE": "B", "ALPHA": "A"}


def _letter(component: str) -> str:
    """Return a component in capitals; a colour's name as its letter."""
    return _LONG_COMPONENTS.get(component.upper(), component.upper())


@dataclass
class _Layer:
    """The channels of one layer.

    `leaf` is its name's last element; `endings` are its last words, each with the word before.
    `part` holds its first channel. A `bare` layer has its name from the part alone.
    """

    name: str
    leaf: str
    endings: dict[str, str]
    own_file: bool
    part: int = 0
    bare: bool = False
    components: dict[str, ChannelRef] = field(default_factory=dict)

    def pick(self, letters: str) -> tuple[ChannelRef, ...] | None:
        """Return the channels of these components, or None when one is absent."""
        if any(key not in self.components for key in letters):
            return None
        return tuple(self.components[key] for key in letters)

    def has(self, ref: ChannelRef) -> bool:
        """Whether a channel is one of this layer's."""
        return ref in self.components.values()

    @property
    def alpha(self) -> ChannelRef | None:
        """The alpha of a picture that lies elsewhere; None where there is none."""
        if {"R", "G", "B"} <= set(self.components):
            return None  # this layer's own
        if self.leaf in _ALPHAS:
            return next((self.components[c] for c in ("A", *_ONE) if c in self.components), None)
        return self.components.get("A") if self.leaf in _PICTURES else None

    def first(self, rule: _Rule) -> tuple[ChannelRef, ...]:
        """Return the channels that a rule asks for, () where some are absent."""
        if self.leaf == "" and rule.components == ("Z",) and "X" in self.components:
            return ()  # a vector
        if self.leaf == "id" and not self.own_file and {"R", "G", "B"} <= set(self.components):
            return ()  # a picture: ids are one number
        return next(filter(None, (self.pick(letters) for letters in rule.components)), ())


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
    near = layers
    roles: dict[Role, tuple[ChannelRef, ...]] = {}
    for role, rules in _RULES.items():
        search = _motion if role is Role.MOTION else partial(_first, rules=rules, role=role)
        found = search(near) or search(layers)
        if found:
            roles[role] = found
        if role is Role.COLOUR and found:
            # Of several view layers, geometry is looked for in the one whose colour is used.
            parent = _parent(found[0].name)
            near = [layer for layer in layers if _parent(f"{layer.name}.") == parent]
            near = _of_part(near, next(layer.part for layer in layers if layer.has(found[0])))
            layers = near + [layer for layer in layers if layer not in near]
    if Role.COLOUR not in roles:
        roles.update(_only_colour(layers, roles))
    alphas = _alphas(near, layers, roles.get(Role.COLOUR, ()))
    if len(alphas) == 1:
        roles[Role.COLOUR] += alphas
    motion, guess, producer = _convention(layers, roles)
    if motion:
        roles[Role.MOTION] = motion
    ordered = {role: roles[role] for role in Role if role in roles}
    several = alphas if len(alphas) > 1 else ()
    return Layout(ordered, guess, producer, _incomplete(layers, roles), several)


def _alphas(
    near: list[_Layer], layers: list[_Layer], colour: tuple[ChannelRef, ...]
) -> tuple[ChannelRef, ...]:
    """Return the alphas of other layers that may be a colour's: those that lie near, if any."""
    if len(colour) != 3:
        return ()
    for candidates in (near, layers):
        alphas = (layer.alpha for layer in candidates)
        refs = tuple(ref for ref in alphas if ref is not None and ref.aov == colour[0].aov)
        if refs:
            return refs
    return ()


def _of_part(layers: list[_Layer], part: int) -> list[_Layer]:
    """Return layers, those of a part first, without what lies beside other parts' pictures."""
    kept = [layer for layer in layers if layer.part == part or layer.leaf or not layer.name]
    return sorted(kept, key=lambda layer: layer.part != part)


def require(
    layout: Layout, role: Role, where: str, channels: Iterable[str]
) -> tuple[ChannelRef, ...]:
    """Return a role's channels.

    Parameters
    ----------
    layout, role
        What is recognised, and what is wanted of it.
    where, channels
        The file, and the names of all its channels, for the message.

    Raises
    ------
    LayoutError
        When the files do not have it.
    """
    if role not in layout:
        partly = f" ({layout.incomplete[role]})" if role in layout.incomplete else ""
        raise LayoutError(
            f"{where} has no {role.value} channels that are recognised{partly}, only "
            f"{', '.join(channels)}; name them in a channel map, or render the missing pass"
        )
    return layout.roles[role]


def role_named(name: str) -> Role | None:
    """Return the role that a name stands for as a whole, None where it stands for none.

    One letter stands for a pass as a capital alone: `N`, `P`, `Z`.
    """
    leaf = _plain(name)
    if not leaf or (len(leaf) == 1 and not name.strip("._- ").isupper()):
        return None
    return next((r for r, rules in _RULES.items() if any(leaf in x.leaves for x in rules)), None)


def _parent(name: str) -> str:
    """Return what stands before a channel's layer: "A" for "A.Combined.R"."""
    return name.rpartition(".")[0].rpartition(".")[0]


def _layers(channels: Mapping[str, Iterable[Channel]]) -> list[_Layer]:
    """Group channels by layer, in file order; Cryptomatte's are left out.

    A channel that is named by a word without a layer, as `hitPz`, is a layer of its own.
    """
    layers: dict[tuple[str, str, int], _Layer] = {}
    for aov, listed in channels.items():
        members = tuple(listed)
        parts = _PartNames.of(members)
        for channel in members:
            if is_cryptomatte(channel.name.rpartition(".")[0] or aov):
                continue
            layer, last, component, part = parts.place(channel)
            key = (aov, layer, part)
            if key not in layers:
                own = bool(aov) and layer == ""
                last = aov.rsplit(".", 1)[-1] if own else last
                bare = layer != "" and parts.names(channel)
                leaf, ends = _plain(last), _endings(last)
                layers[key] = _Layer(layer or aov, leaf, ends, own, channel.part, bare)
            layers[key].components.setdefault(component, ChannelRef(aov, channel.name))
    return list(layers.values())


@dataclass(frozen=True)
class _PartNames:
    """What the names of a file's parts say of the channels that carry no layer of their own.

    `pictures` are the parts that hold R, G and B so. `leading` and `trailing` count the words that
    the names of all such parts begin and end with: of `rgba_main` and `depth_main`, none and one.
    """

    pictures: frozenset[int] = frozenset()
    leading: int = 0
    trailing: int = 0

    @classmethod
    def of(cls, channels: Iterable[Channel]) -> _PartNames:
        """Look through the channels of a file."""
        letters: dict[int, set[str]] = {}
        names: dict[str, list[str]] = {}
        for channel in channels:
            if cls.names(channel):
                layer, _, component = channel.name.rpartition(".")
                letters.setdefault(channel.part, set()).add(_letter(component))
                names[layer] = _words(layer.rsplit(".", 1)[-1])
        pictures = frozenset(part for part, held in letters.items() if {"R", "G", "B"} <= held)
        leading = _shared(list(names.values()))
        rest = [words[leading:][::-1] for words in names.values()]
        return cls(pictures, leading, _shared(rest))

    @staticmethod
    def names(channel: Channel) -> bool:
        """Whether a channel has its layer's name from its part."""
        return "." not in channel.raw_name and channel.name != channel.raw_name

    def place(self, channel: Channel) -> tuple[str, str, str, int]:
        """Return a channel's layer, the last element of its name, the component, and the part.

        The part is -1 where layers of one name are one layer, whatever their parts.
        """
        layer, _, component = channel.name.rpartition(".")
        component, last, bare = _letter(component), layer.rsplit(".", 1)[-1], self.names(channel)
        repeats = _plain(component) == _plain(last)
        if len(component) > 1 and (not layer or bare or repeats):
            return channel.name, channel.name.rsplit(".", 1)[-1], "V", -1
        if bare and channel.part in self.pictures and component not in ("R", "G", "B", "A"):
            # The name is the picture's; Z beside a picture is OpenEXR's own depth.
            return layer, "", component, channel.part
        if bare and _SAYS_NOTHING.fullmatch(_plain(layer)):
            return "", "", component, channel.part
        return layer, self.without_shared_words(last) if bare else last, component, -1

    def without_shared_words(self, name: str) -> str:
        """Return a part's name without the words that all parts' names have."""
        if _plain(name) in _DATA or not (self.leading or self.trailing):
            return name
        words = _words(name)
        return "_".join(words[self.leading : len(words) - self.trailing])


_SAYS_NOTHING = re.compile(r"(part|subimage|image|layer|default|main)?[0-9]*")
"""Names of parts that say nothing of what they hold."""


def _words(name: str) -> list[str]:
    """Split a name into words: at what is no letter or digit, and where capitals begin one."""
    return re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+", name)


def _shared(names: list[list[str]]) -> int:
    """Count the words that all of several names begin with and that change no role; one stays."""
    if len(names) < 2:
        return 0
    count = 0
    for column in list(zip(*names, strict=False))[: min(map(len, names)) - 1]:
        word = column[0].lower()
        if len(set(column)) > 1 or word in _DATA | _PICTURES | _SPACES | _NEVER_BEFORE:
            break
        count += 1
    return count


def _plain(name: str) -> str:
    """Return a name in lower case, without what separates its words."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case, split at separators, CamelCase and digits."""
    return [word.lower() for word in _WORD.findall(name)]


def _endings(name: str) -> dict[str, str]:
    """Return the last words of a name with the word before, most first, without the whole of it.

    Words are what separators part, then also what CamelCase does; suffixes are left out.
    """
    parted = [word for word in re.split(r"[^A-Za-z0-9]+", name.lower()) if word]
    out = {"".join(parted[i:]): parted[i - 1] for i in range(1, len(parted))}
    words = words_of(name)
    for end in _ends(words):
        for i in range(1 if end == len(words) else 0, end):
            out.setdefault("".join(words[i:end]), words[i - 1] if i else "")
    return out


def _ends(words: list[str]) -> list[int]:
    """Return where a name may end: at its last word, and before each of its suffixes."""
    ends = [len(words)]
    while ends[-1] > 1 and (words[ends[-1] - 1] in _SUFFIXES or words[ends[-1] - 1].isdigit()):
        # The "v" of a version.
        version = words[ends[-1] - 1].isdigit() and words[ends[-1] - 2] == "v"
        if ends[-1] - 1 - version < 1:
            break
        ends.append(ends[-1] - 1 - version)
    return ends


def _first(layers: list[_Layer], rules: Iterable[_Rule], role: Role) -> tuple[ChannelRef, ...]:
    """Return the channels of the best layer for these rules, () when there is none."""
    rules = tuple(rules)
    for by_ending in (False, True) if role in _BY_LAST_WORDS else (False,):
        for rule in rules:
            for leaf in rule.leaves:
                for layer in layers:
                    mine = layer.leaf == leaf if not by_ending else _ends_in(layer, leaf, role)
                    found = layer.first(rule) if mine else ()
                    if found:
                        return found
    return ()


def _ends_in(layer: _Layer, leaf: str, role: Role) -> bool:
    """Whether a layer's name ends in a role's, and the word before leaves it that."""
    # Single letters and "id" end names of anything.
    short = len(leaf) <= 3 and leaf not in _SHORT_WORDS
    if short or leaf in _PLAIN_WORDS or leaf not in layer.endings:
        return False
    if role is Role.COLOUR and not layer.leaf.endswith(leaf):
        return False  # beauty_1, beauty_2: pictures of one light each
    before = layer.endings[leaf]
    spoilt = before in _SPACES and role in (Role.NORMAL, Role.POSITION)
    return before not in _NEVER_BEFORE and not spoilt


def _motion(layers: list[_Layer]) -> tuple[ChannelRef, ...]:
    """Return the motion channels; forward and backward layers are joined, forward first."""
    rules = _RULES[Role.MOTION]
    whole = _first(layers, rules[:1], Role.MOTION)
    if whole:
        return whole
    letters = rules[1].components
    forward = _first(layers, [_Rule(FORWARD_NAMES, letters)], Role.MOTION)
    backward = _first(layers, [_Rule(BACKWARD_NAMES, letters)], Role.MOTION)
    return forward + backward or _first(layers, rules[2:], Role.MOTION) or _bare(layers)


def _bare(layers: list[_Layer]) -> tuple[ChannelRef, ...]:
    """Take a file that holds red and green alone for motion, as plug-ins write it."""
    if len(layers) != 1 or layers[0].leaf or set(layers[0].components) != {"R", "G"}:
        return ()
    return layers[0].pick("RG") or ()


def _convention(
    layers: list[_Layer], roles: Mapping[Role, tuple[ChannelRef, ...]]
) -> tuple[tuple[ChannelRef, ...], MotionConvention | None, str]:
    """Return the motion channels with those that their convention also takes, and what it is.

    A third channel of a layer may hold the length of the vectors, and premultiplied vectors need
    the beauty's alpha.
    """
    motion = roles.get(Role.MOTION, ())
    if not motion:
        return (), None, UNKNOWN
    mine = next(layer for layer in layers if motion[0] in layer.components.values())
    letters = "".join(ref.component[0].upper() for ref in motion)
    producer = recognise(mine.name, letters, (), mine.own_file)[1]
    third = {"XY": "Z", "RG": "B"}.get(letters, "")
    if third in mine.components and not producer.startswith(("Unreal", "Blender")):
        motion, letters = (*motion, mine.components[third]), letters + third
    colour = roles.get(Role.COLOUR, ())
    if mine.name.endswith("motion_vectors") and letters == "RG" and len(colour) == 4:
        motion, letters = (*motion, colour[3]), "RGA"
    names = [layer.name for layer in layers]
    return motion, *recognise(mine.name, letters, names, mine.own_file)


def _incomplete(
    layers: list[_Layer], roles: Mapping[Role, tuple[ChannelRef, ...]]
) -> dict[Role, str]:
    """Tell of layers with a role's name and without its channels."""
    out: dict[Role, str] = {}
    for role, rules in _RULES.items():
        if role in roles and role is not Role.MOTION:
            continue
        for rule in rules:
            named = (layer for layer in layers if layer.leaf and layer.leaf in rule.leaves)
            used = set(roles.get(role, ()))
            left = (layer for layer in named if not used & set(layer.components.values()))
            lame = next((layer for layer in left if not layer.first(rule)), None)
            if lame is not None and role not in out:
                has = ", ".join(ref.component for ref in lame.components.values())
                out[role] = f"{lame.name!r} has only {has}"
    return out


def _only_colour(
    layers: list[_Layer], taken: Mapping[Role, tuple[ChannelRef, ...]]
) -> dict[Role, tuple[ChannelRef, ...]]:
    """Take a single unclaimed RGB layer for colour, whatever its name.

    Of several, that whose channels have no layer in the file, but for its part's name: R, G and B
    alone are the picture.
    """
    used = {ref for refs in taken.values() for ref in refs}
    free = []
    for layer in layers:
        found = layer.pick("RGBA") or layer.pick("RGB")
        if found and not used.intersection(found):
            data = {layer.leaf, *layer.endings} & _DATA
            free.append((layer.bare and not data, found))
    bare = [picture for bare, picture in free if bare]
    only = bare if len(free) > 1 else [picture for _, picture in free]
    return {Role.COLOUR: only[0]} if len(only) == 1 else {}
