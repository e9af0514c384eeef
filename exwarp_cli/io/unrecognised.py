"""Channels of a shot that have no role, and which of them are likely to be motion vectors."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable

from exwarp_cli.io.channels import ChannelRef, Role, split_words
from exwarp_cli.io.cryptomatte import find_cryptomattes
from exwarp_cli.io.sequences import neighbouring_sequences
from exwarp_cli.io.shot import Shot, channel_label, without_cryptomattes

MAX_LISTED = 12  # layers that a message names

_MOTION_WORDS = frozenset(
    {"motion", "move", "movement", "mv", "mvec", "mvecs", "mb", "vec", "vecs", "vector", "vectors"}
    | {"vel", "velo", "velocity", "speed", "flow", "optical", "disparity", "displacement"}
    | {"forward", "fwd", "fore", "backward", "bwd", "back", "prev", "previous", "next", "blur"}
)
_MOTION_BEGINNINGS = ("motion", "velocit", "vector", "mvec", "flow")
_PAIRS = ("UV", "XY", "RG")


def unrecognised(shot: Shot) -> tuple[ChannelRef, ...]:
    """Return the channels of a shot's view in its first frame that have no role, in file order.

    Channels of Cryptomattes have a use, and are not among them.

    Raises InputError if a file of the first frame cannot be read.
    """
    used = {ref for refs in shot.layout.roles.values() for ref in refs}
    unused: list[ChannelRef] = []
    for aov, path in shot.files(shot.first).items():
        header = shot.headers.read(path)
        channels = shot.channels(header.parts, aov)
        mattes = find_cryptomattes({aov: channels.values()}, {aov: header.texts})
        for channel in without_cryptomattes(channels, mattes, aov):
            ref = ChannelRef(aov, channel.name)
            if ref not in used:
                unused.append(ref)
    return tuple(unused)


def likely_vectors(refs: Iterable[ChannelRef]) -> tuple[tuple[ChannelRef, ...], ...]:
    """Return the layers that may hold motion vectors, the likeliest first, by name alone.

    Of each layer, its first two components in the order X, Y, or U, V, or R, G. A layer counts if
    its name has a word of motion, or if it has these two components and no third.
    """
    layers: dict[str, dict[str, ChannelRef]] = defaultdict(dict)
    for ref in refs:
        layer = channel_label(ref).rpartition(".")[0] or ref.aov
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
    """Return True if a shot has nothing but its beauty: plain footage, and no render with passes.

    Raises InputError if a file of the first frame cannot be read.
    """
    has_roles = not set(shot.layout.roles) <= {Role.COLOUR} or shot.layout.incomplete
    if has_roles or shot.aovs or shot.cryptomattes:
        return False
    # Some renderers keep the beauty's alpha in a layer of its own.
    more = [ref for ref in unrecognised(shot) if ref.component.lower() not in ("a", "alpha")]
    return not more and not _neighbouring_vectors(shot)


def _neighbouring_vectors(shot: Shot) -> list[str]:
    """Return the patterns of sequences beside a shot whose names have a word of motion."""
    sequences = {} if shot.aovs else neighbouring_sequences(shot.sequence)
    return [member.pattern for name, member in sequences.items() if _has_motion_word(name)]


def _has_motion_word(name: str) -> bool:
    words = split_words(re.sub(r".*:", "", name))
    return any(w in _MOTION_WORDS or w.startswith(_MOTION_BEGINNINGS) for w in words)


def no_vectors_message(shot: Shot, estimable: bool = True) -> str:
    """Return the message that a shot has no usable vectors: its unknown channels, and what to do.

    `estimable` is true if the method could estimate motion.

    Raises InputError if a file of the first frame cannot be read.
    """
    incomplete = shot.layout.incomplete.get(Role.MOTION)
    partly = "" if incomplete is None else f" ({incomplete})"
    unused = unrecognised(shot)
    layers: dict[str, list[str]] = defaultdict(list)
    for ref in unused:
        layer, dot, component = channel_label(ref).rpartition(".")
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
    elif patterns := _neighbouring_vectors(shot):
        likeliest = f"; likeliest: {patterns[0]}, to be named as in --aov motion={patterns[0]}:R,G"
    remedy = ", or allow --estimate-motion" if estimable and not is_colour_alone(shot) else ""
    return (
        f"{shot.sequence.pattern} has no motion vectors that are recognised{partly}{unknown}"
        f"{likeliest}; render the motion pass{remedy}, or use --method hold or blend"
    )
