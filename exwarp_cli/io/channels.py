"""Which channels of a file hold colour, depth, motion and the rest: detection by name.

Renderers name their AOVs differently, and layer names are the artist's; so the last element of a
layer's name is what counts, in any case, without separators; where that says nothing, its last
words. A motion layer only gets a first guess of its convention here, by the program that is
recognised by names; measuring decides (:mod:`exwarp_cli.synthesis.calibration`).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from exwarp_cli.domain.motion import PRESETS, MotionConvention
from exwarp_cli.io.exr.header import Channel

UNKNOWN = "unknown"  # the producer of files whose names do not tell


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
    """A channel of a sequence: its name with the layer, and the AOV if each AOV has its own file.

    `aov` is "" in a sequence's main files.
    """

    aov: str
    name: str

    @property
    def component(self) -> str:
        """The last element of the name: R, X, u and the like."""
        return self.name.rsplit(".", 1)[-1]

    @property
    def label(self) -> str:
        """The name as users see it, and channel maps have it: with its AOV."""
        return f"{self.aov}:{self.name}" if self.aov else self.name


Refs = tuple[ChannelRef, ...]


@dataclass(frozen=True)
class Layout:
    """What was recognised in a sequence's files."""

    roles: Mapping[Role, Refs]  # components in order: R G B A, X Y Z
    guess: MotionConvention | None = None  # the motion convention that names suggest
    producer: str = UNKNOWN
    # Layers that go by a role's name but lack channels: what each has, in words, for example
    # "'forward' has only u".
    incomplete: Mapping[Role, str] = field(default_factory=dict)
    # Channels that may be the colour's alpha; if there are several, none is taken.
    alphas: Refs = ()

    def __contains__(self, role: Role) -> bool:
        return role in self.roles


@dataclass(frozen=True)
class _Rule:
    """Last elements of layers' names, and their components; earlier ones win."""

    leaves: tuple[str, ...]
    components: tuple[str, ...]


FORWARD_NAMES = ("forward", "motionfore")
BACKWARD_NAMES = ("backward", "motionback")

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

# Names that say nothing at the end of a longer one: a diffuse colour is no beauty.
_PLAIN_WORDS = frozenset(
    {"", "c", "ci", "rgba", "rgb", "color", "colour", "finalimage", "image", "vector"}
)

# Roles whose layers are also found by the last words of their names. Not those of materials, where
# each lobe has its own.
_FOUND_BY_ENDING = (
    Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL, Role.POSITION, Role.STENCIL,
)  # fmt: skip

# Words before a role's name that make it another thing: Blender's denoising depth is that of what a
# mirror shows.
_SPOILING_WORDS = frozenset({"shadow", "denoising", "noisy", "variance", "holdout", "bump"})

# Words after a role's name that leave it that, as numbers and versions (`v2`) do.
_SUFFIXES = frozenset(
    {"pass", "layer", "aov", "element", "channel", "channels", "raw", "nofilter", "unfiltered"}
    | {"filtered", "float", "32f", "16f"}
)

# Words before normals and positions of other spaces; only world space counts.
_SPACES = frozenset(
    {"camera", "cam", "view", "eye", "screen", "local", "object", "obj", "rest", "reference", "ref"}
    | {"tangent", "previous", "prev", "light"}
)

_LEAVES = {
    role: frozenset(leaf for rule in rules for leaf in rule.leaves)
    for role, rules in _RULES.items()
}
_PICTURES = _LEAVES[Role.COLOUR]
_DATA = frozenset.union(*_LEAVES.values()) - _PICTURES
_RGB = {"R", "G", "B"}
_LONG_COMPONENTS = {"RED": "R", "GREEN": "G", "BLUE": "B", "ALPHA": "A"}

# `VRayZDepth_v2` has the words V, Ray, Z, Depth, v, 2.
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+[a-z]?")
_NAME_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
# Names of parts that say nothing of what they hold.
_NO_LAYER_NAME = re.compile(r"(part|subimage|image|layer|default|main)?[0-9]*")
# Usual names of a Cryptomatte's ranks and preview. Headers may name others; only they are certain.
CRYPTOMATTE_NAME = re.compile(
    r"(^|[._:])(crypto[A-Za-z_]*(\d\d)?|\w*HitProxyMask\d\d)$", re.IGNORECASE
)


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


@dataclass
class _Layer:
    name: str
    leaf: str  # last element of the name, plain
    endings: dict[str, str]  # its last words, each with the word before
    own_file: bool
    part: int  # of the first channel
    named_by_part: bool
    components: dict[str, ChannelRef] = field(default_factory=dict)

    def pick(self, letters: str) -> Refs:
        """Return the channels of these components, () if one is absent."""
        refs = tuple(self.components[key] for key in letters if key in self.components)
        return refs if len(refs) == len(letters) else ()

    def first_match(self, rule: _Rule) -> Refs:
        """Return the channels that a rule asks for, () if some are absent."""
        if self.leaf == "" and rule.components == ("Z",) and "X" in self.components:
            return ()  # a vector
        if self.leaf == "id" and not self.own_file and set(self.components) >= _RGB:
            return ()  # a picture: ids are one number
        return next(filter(None, (self.pick(letters) for letters in rule.components)), ())


def detect_layout(
    channels: Mapping[str, Iterable[Channel]], excluded: Collection[ChannelRef] = ()
) -> Layout:
    """Recognise the roles of one frame's channels by AOV; "" is the main file's.

    The `excluded` ones have none, as those of Cryptomattes.
    """
    layers = _group_by_layer(channels, excluded)
    # Of several view layers, geometry is looked for in the one whose colour is used.
    near = layers
    roles: dict[Role, Refs] = {}
    for role in _RULES:
        refs = _find_role(near, role) or _find_role(layers, role)
        if not refs:
            continue
        roles[role] = refs
        if role is Role.COLOUR:
            # "A" for "A.Combined.R"
            parent = refs[0].name.rpartition(".")[0].rpartition(".")[0]
            part = next(layer.part for layer in layers if refs[0] in layer.components.values())
            # Without layers that are named by the parts of other pictures.
            near = [
                layer
                for layer in layers
                if layer.name.rpartition(".")[0] == parent
                and (layer.part == part or layer.leaf or not layer.name)
            ]
            near.sort(key=lambda layer: layer.part != part)
            layers = near + [layer for layer in layers if layer not in near]
    if Role.COLOUR not in roles:
        # The only RGB layer without a role, whatever its name. Of several, the one whose channels
        # have no layer in the file, but for its part's name: R, G and B alone are the picture.
        used = {ref for refs in roles.values() for ref in refs}
        pictures = [(layer, layer.pick("RGBA") or layer.pick("RGB")) for layer in layers]
        free = [(layer, refs) for layer, refs in pictures if refs and not used.intersection(refs)]
        if len(free) > 1:
            free = [
                (layer, refs)
                for layer, refs in free
                if layer.named_by_part and not {layer.leaf, *layer.endings} & _DATA
            ]
        if len(free) == 1:
            roles[Role.COLOUR] = free[0][1]
    alphas = _alphas(near, roles) or _alphas(layers, roles)
    if len(alphas) == 1:
        roles[Role.COLOUR] += alphas
    guess, producer = None, UNKNOWN
    if Role.MOTION in roles:
        roles[Role.MOTION], guess, producer = _motion_convention(layers, roles)
    ordered = {role: roles[role] for role in Role if role in roles}
    several = alphas if len(alphas) > 1 else ()
    return Layout(ordered, guess, producer, _incomplete(layers, roles), several)


def role_named(name: str) -> Role | None:
    """Return the role that a whole name stands for, or None.

    One letter stands for a pass only as a capital: `N`, `P`, `Z`.
    """
    leaf = _plain(name)
    if not leaf or (len(leaf) == 1 and not name.strip("._- ").isupper()):
        return None
    return next((role for role, leaves in _LEAVES.items() if leaf in leaves), None)


def split_words(name: str) -> list[str]:
    """Return the words of a name in lower case, split at separators, CamelCase and digits."""
    return [word.lower() for word in _WORD.findall(name)]


def _group_by_layer(
    channels: Mapping[str, Iterable[Channel]], excluded: Collection[ChannelRef]
) -> list[_Layer]:
    """Group channels by layer, in file order, without those of Cryptomattes.

    A channel that is named by a word without a layer, as `hitPz`, is a layer of its own.
    """
    layers: dict[tuple[str, str, int], _Layer] = {}
    for aov, listed in channels.items():
        members = [c for c in listed if ChannelRef(aov, c.name) not in excluded]
        # Channels that carry no layer of their own, and what the names of their parts say of them.
        by_part = {c for c in members if "." not in c.raw_name and c.name != c.raw_name}
        letters: dict[int, set[str]] = {}
        names: dict[str, list[str]] = {}
        for channel in members:
            if channel in by_part:
                layer, _, component = channel.name.rpartition(".")
                letter = _LONG_COMPONENTS.get(component.upper(), component.upper())
                letters.setdefault(channel.part, set()).add(letter)
                names[layer] = _NAME_WORD.findall(layer.rsplit(".", 1)[-1])
        pictures = {part for part, components in letters.items() if components >= _RGB}
        # Words that all these names begin and end with: of `rgba_main` and `depth_main`, 0 and 1.
        leading = _shared_word_count(list(names.values()))
        trailing = _shared_word_count([words[leading:][::-1] for words in names.values()])
        for channel in members:
            if CRYPTOMATTE_NAME.search(channel.name.rpartition(".")[0] or aov):
                continue
            is_by_part = channel in by_part
            layer, last, component, part = _locate(channel, is_by_part, pictures, leading, trailing)
            key = (aov, layer, part)
            if key not in layers:
                own_file = bool(aov) and layer == ""
                if own_file:
                    last = aov.rsplit(".", 1)[-1]
                layers[key] = _Layer(
                    layer or aov,
                    _plain(last),
                    _endings(last),
                    own_file,
                    channel.part,
                    layer != "" and is_by_part,
                )
            layers[key].components.setdefault(component, ChannelRef(aov, channel.name))
    return list(layers.values())


def _locate(
    channel: Channel, by_part: bool, pictures: Collection[int], leading: int, trailing: int
) -> tuple[str, str, str, int]:
    """Return a channel's layer, the last element of its name, the component, and the part.

    The part is -1 where layers of one name are one layer, whatever their parts. `by_part` is True
    if the layer is no more than the part's name. `pictures` are the parts with R, G and B that have
    no layer; `leading` and `trailing` count the shared words of the names of parts.
    """
    layer, _, component = channel.name.rpartition(".")
    component, last = component.upper(), layer.rsplit(".", 1)[-1]
    component = _LONG_COMPONENTS.get(component, component)
    repeats_layer = _plain(component) == _plain(last)
    if len(component) > 1 and (not layer or by_part or repeats_layer):
        return channel.name, channel.name.rsplit(".", 1)[-1], "V", -1
    if not by_part:
        return layer, last, component, -1
    if channel.part in pictures and component not in ("R", "G", "B", "A"):
        # The name is the picture's; Z beside a picture is OpenEXR's own depth.
        return layer, "", component, channel.part
    if _NO_LAYER_NAME.fullmatch(_plain(layer)):
        return "", "", component, channel.part
    if _plain(last) not in _DATA and (leading or trailing):
        words = _NAME_WORD.findall(last)
        last = "_".join(words[leading : len(words) - trailing])
    return layer, last, component, -1


def _shared_word_count(names: list[list[str]]) -> int:
    """Count the words that all names begin with and that change no role; one word stays."""
    if len(names) < 2:
        return 0
    count = 0
    for column in list(zip(*names, strict=False))[: min(map(len, names)) - 1]:
        word = column[0].lower()
        if len(set(column)) > 1 or word in _DATA | _PICTURES | _SPACES | _SPOILING_WORDS:
            break
        count += 1
    return count


def _plain(name: str) -> str:
    """Return a name in lower case, without what separates its words."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _endings(name: str) -> dict[str, str]:
    """Return the last words of a name with the word before, longest first, without the whole name.

    Words are parted by separators, then also by CamelCase; suffixes are left out.
    """
    parted = [word for word in re.split(r"[^A-Za-z0-9]+", name.lower()) if word]
    endings = {"".join(parted[i:]): parted[i - 1] for i in range(1, len(parted))}
    words = split_words(name)
    # A name may end at its last word, and before each of its suffixes, numbers and versions.
    end = len(words)
    while end > 0:
        for i in range(1 if end == len(words) else 0, end):
            endings.setdefault("".join(words[i:end]), words[i - 1] if i else "")
        if end < 2 or not (words[end - 1] in _SUFFIXES or words[end - 1].isdigit()):
            break
        is_version = words[end - 1].isdigit() and words[end - 2] == "v"
        end -= 1 + is_version
    return endings


def _find_role(layers: list[_Layer], role: Role) -> Refs:
    """Return the channels of a role in the best layer, () if there is none."""
    rules = _RULES[role]
    if role is not Role.MOTION:
        return _find_by_rules(layers, rules, role)
    if refs := _find_by_rules(layers, rules[:1], role):
        return refs
    # Forward and backward layers are joined, forward first.
    letters = rules[1].components
    forward = _find_by_rules(layers, (_Rule(FORWARD_NAMES, letters),), role)
    backward = _find_by_rules(layers, (_Rule(BACKWARD_NAMES, letters),), role)
    if refs := forward + backward or _find_by_rules(layers, rules[2:], role):
        return refs
    # A file with red and green alone, as plug-ins write it.
    if len(layers) == 1 and not layers[0].leaf and set(layers[0].components) == {"R", "G"}:
        return layers[0].pick("RG")
    return ()


def _find_by_rules(layers: list[_Layer], rules: tuple[_Rule, ...], role: Role) -> Refs:
    """Find a layer by its whole name, else by the last words of its name."""
    named = [(leaf, rule) for rule in rules for leaf in rule.leaves]
    for leaf, rule in named:
        for layer in layers:
            if layer.leaf == leaf and (refs := layer.first_match(rule)):
                return refs
    spoiling = _SPOILING_WORDS
    if role in (Role.NORMAL, Role.POSITION):
        spoiling |= _SPACES
    for leaf, rule in named if role in _FOUND_BY_ENDING else ():
        # Single letters and "id" end names of anything, "mv" of nothing else.
        if leaf in _PLAIN_WORDS or (len(leaf) <= 3 and leaf != "mv"):
            continue
        for layer in layers:
            # beauty_1, beauty_2 are pictures of one light each.
            is_light = role is Role.COLOUR and not layer.leaf.endswith(leaf)
            if is_light or leaf not in layer.endings or layer.endings[leaf] in spoiling:
                continue
            if refs := layer.first_match(rule):
                return refs
    return ()


def _alphas(layers: list[_Layer], roles: Mapping[Role, Refs]) -> Refs:
    """Return the alphas of other layers that may belong to a colour without alpha."""
    colour = roles.get(Role.COLOUR, ())
    if len(colour) != 3:
        return ()
    alphas = []
    for layer in layers:
        if set(layer.components) >= _RGB:
            continue  # its alpha is its own
        usual: tuple[str, ...] = ("A",) if layer.leaf in _PICTURES else ()
        if layer.leaf in ("a", "alpha"):
            usual = ("A", *_ONE)
        alphas += [layer.components[c] for c in usual if c in layer.components][:1]
    return tuple(ref for ref in alphas if ref.aov == colour[0].aov)


def _motion_convention(
    layers: list[_Layer], roles: Mapping[Role, Refs]
) -> tuple[Refs, MotionConvention | None, str]:
    """Return the motion channels with those that their convention also takes, and what it is.

    A third channel of a layer may hold the length of the vectors, and premultiplied vectors need
    the beauty's alpha.
    """
    motion = roles[Role.MOTION]
    own = next(layer for layer in layers if motion[0] in layer.components.values())
    letters = "".join(ref.component[0].upper() for ref in motion)
    producer = _recognise_producer(own.name, letters, (), own.own_file)[1]
    third = {"XY": "Z", "RG": "B"}.get(letters, "")
    if third in own.components and not producer.startswith(("Unreal", "Blender")):
        motion, letters = (*motion, own.components[third]), letters + third
    colour = roles.get(Role.COLOUR, ())
    if own.name.endswith("motion_vectors") and letters == "RG" and len(colour) == 4:
        motion, letters = (*motion, colour[3]), "RGA"
    names = [layer.name for layer in layers]
    return motion, *_recognise_producer(own.name, letters, names, own.own_file)


def _recognise_producer(
    layer: str, components: str, layers: Collection[str], own_file: bool
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


def _incomplete(layers: list[_Layer], roles: Mapping[Role, Refs]) -> dict[Role, str]:
    """Describe the layers that have a role's name but lack its channels."""
    incomplete: dict[Role, str] = {}
    for role, rules in _RULES.items():
        if role in roles and role is not Role.MOTION:
            continue
        used = set(roles.get(role, ()))
        for rule in rules:
            for layer in layers:
                if not layer.leaf or layer.leaf not in rule.leaves or role in incomplete:
                    continue
                refs = layer.components.values()
                if not used & set(refs) and not layer.first_match(rule):
                    components = ", ".join(ref.component for ref in refs)
                    incomplete[role] = f"{layer.name!r} has only {components}"
    return incomplete
