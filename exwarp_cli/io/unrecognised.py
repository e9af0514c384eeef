"""Channels of a shot that have no role, and which of them are likely to be motion vectors."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable

from exwarp_cli.io.channels import ChannelRef, Role, words_of
from exwarp_cli.io.cryptomatte import find_cryptomattes
from exwarp_cli.io.sequence import beside
from exwarp_cli.io.shot import Shot, plain, spelled

LISTED = 12
"""Layers that a message names at most."""

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

    Raises
    ------
    InputError
        When a file of the first frame cannot be read.
    """
    used = {ref for refs in shot.layout.roles.values() for ref in refs}
    out: list[ChannelRef] = []
    for aov, path in shot.files(shot.first).items():
        header = shot.headers.read(path)
        channels = shot.channels(header.parts, aov)
        members = tuple(channels)
        every = plain(channels, (), aov)
        rest = plain(channels, find_cryptomattes({aov: every}, {aov: header.texts}), aov)
        names = {channel.name for channel in rest}
        refs = (ChannelRef(aov, name) for name in members if name in names)
        out += (ref for ref in refs if ref not in used)
    return tuple(out)


def likely_vectors(refs: Iterable[ChannelRef]) -> tuple[tuple[ChannelRef, ...], ...]:
    """Return the layers that may hold motion vectors, the likeliest first, by name alone.

    Returns
    -------
    tuple
        Of each layer its first two components in the order X, Y, or U, V, or R, G. A layer counts
        if its name has a word of motion, or if it has these two components and no third.
    """
    layers: dict[str, dict[str, ChannelRef]] = defaultdict(dict)
    for ref in refs:
        name = spelled(ref)
        layers[name.rpartition(".")[0] or ref.aov].setdefault(ref.component[:1].upper(), ref)
    ranked: list[tuple[int, tuple[ChannelRef, ...]]] = []
    for name, parts in layers.items():
        pair = next((p for p in _PAIRS if set(p) <= set(parts)), None)
        if pair is None:
            continue
        words = _has_motion_word(name)
        if words or len(parts) == 2:
            ranked.append((0 if words else 1, tuple(parts[letter] for letter in pair)))
    return tuple(refs for _, refs in sorted(ranked, key=lambda entry: entry[0]))


def listed(refs: Iterable[ChannelRef]) -> str:
    """Return channels as a message names them: layer by layer, with their components."""
    layers: dict[str, list[str]] = defaultdict(list)
    for ref in refs:
        name = spelled(ref)
        layer, dot, component = name.rpartition(".")
        layers[layer + dot].append(component)
    names = [
        f"{layer}{parts[0]}" if len(parts) == 1 else f"{layer}{{{','.join(parts)}}}"
        for layer, parts in layers.items()
    ]
    more = f" and {len(names) - LISTED} more layers" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def is_colour_alone(shot: Shot) -> bool:
    """Return whether a shot has nothing but its beauty: plain footage, and no render with passes.

    Raises
    ------
    InputError
        When a file of the first frame cannot be read.
    """
    bare = set(shot.layout.roles) <= {Role.COLOUR} and not shot.layout.incomplete
    if not bare or shot.aovs or shot.cryptomattes:
        return False
    # Some renderers keep the beauty's alpha in a layer of its own.
    more = [ref for ref in unrecognised(shot) if ref.component.lower() not in ("a", "alpha")]
    return not more and not _vectors_beside(shot)


def _vectors_beside(shot: Shot) -> list[str]:
    """Return the patterns of sequences beside a shot whose names have a word of motion."""
    found = {} if shot.aovs else beside(shot.sequence)
    return [member.pattern for name, member in found.items() if _has_motion_word(name)]


def no_vectors(shot: Shot, estimable: bool = True) -> str:
    """Return the message that a shot has no usable vectors: its unknown channels, and what to do.

    Raises
    ------
    InputError
        When a file of the first frame cannot be read.
    """
    half = shot.layout.incomplete.get(Role.MOTION)
    said = "" if half is None else f" ({half})"
    rest = unrecognised(shot)
    likely = likely_vectors(rest)
    unknown = f"; not recognised: {listed(rest)}" if rest else ""
    name = ""
    if likely:
        names = ", ".join(ref.name.rpartition(".")[0] or ref.aov for ref, _ in likely[:3])
        aov = likely[0][0].aov
        pattern = (shot.aovs[aov] if aov else shot.sequence).pattern
        channels = ",".join(ref.name for ref in likely[0])
        name = f"; likeliest: {names}, to be named as in --aov motion={pattern}:{channels}"
    elif patterns := _vectors_beside(shot):
        name = f"; likeliest: {patterns[0]}, to be named as in --aov motion={patterns[0]}:R,G"
    allowed = estimable and not is_colour_alone(shot)
    passes = ", or allow --estimate-motion" if allowed else ""
    return (
        f"{shot.sequence.pattern} has no motion vectors that are recognised{said}{unknown}{name}; "
        f"render the motion pass{passes}, or use --method hold or blend"
    )


def _has_motion_word(name: str) -> bool:
    words = words_of(re.sub(r".*:", "", name))
    return any(w in _MOTION_WORDS or w.startswith(_MOTION_BEGINNINGS) for w in words)
