"""Sequences that are the passes of one shot, by their names: `shot.####.exr`, `shot.Z.####.exr`.

Movie Render Queue, Redshift, V-Ray and Arnold can write a sequence a pass. The beauty has the
shot's name alone, or a name of its own behind it; each pass has the pass's name behind the shot's.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

from exwarp_cli.io.channels import Role, role_named
from exwarp_cli.io.producers import is_cryptomatte

_SEPARATORS = "._- "
# What programs put before the name of a pass, as V-Ray's VRayVelocity.
_PROGRAM = re.compile(r"(?i)(vray|redshift|arnold|movierenderqueue)[ _]*(?=[A-Za-z])")
_PART = re.compile(r"(?<=[._\- ])(?=[^._\- ])")
# Where a pass's name may begin: after a separator, or at a capital as in shotBeauty.
_BOUNDARY = re.compile(r"(?<=[._\- ])(?=[^._\- ])|(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


@dataclass(frozen=True)
class PassSet:
    """The sequences of one shot, by their places in the list that was asked about.

    Attributes
    ----------
    colour
        The beauty; None where there are G-buffers alone.
    passes
        The others, by the name of their pass, for example "MotionVectors".
    motion
        Name of the pass that leads where there is no beauty.
    more
        Sequences by name that may be further passes, of light or of anything: their names begin as
        the shot's does, and say nothing that is known.
    """

    colour: int | None
    passes: dict[str, int]
    motion: str = ""
    more: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _Name:
    """A sequence's name, with its pass's name apart.

    `stem` is the text before the number without separators at its end. `shot` is what stands before
    the pass's name, and `stem` where none is known.
    """

    stem: str
    shot: str
    name: str
    role: Role | None
    is_matte: bool

    @property
    def is_data(self) -> bool:
        """Whether it is a pass that cannot be a beauty."""
        return self.is_matte or self.role not in (None, Role.COLOUR)


def pass_sets(names: Sequence[tuple[str, str]]) -> list[PassSet]:
    """Find the sequences of a folder that belong together as passes.

    Parameters
    ----------
    names
        Of each sequence, the text before its number and the text after.

    Returns
    -------
    list
        A set for each beauty that has passes, and for each shot without a beauty that has vectors
        and another pass. Where two beauties fit a pass equally well, it is in the sets of both.
    """
    out = []
    for suffix in dict.fromkeys(suffix for _, suffix in names):
        parsed = {i: _parsed(base) for i, (base, end) in enumerate(names) if end == suffix}
        beauties = {i: n for i, n in parsed.items() if not n.is_data}
        passes: dict[int, dict[str, int]] = defaultdict(dict)
        alone: dict[str, list[int]] = defaultdict(list)
        for index, name in parsed.items():
            if not name.is_data:
                continue
            shots = _beauties_of(name, beauties)
            for beauty, pass_name in shots.items():
                passes[beauty][pass_name] = index
            if not shots:
                alone[name.shot].append(index)
        for beauty, found in passes.items():
            others = {i: n for i, n in beauties.items() if i not in passes}
            out.append(PassSet(beauty, found, more=_more(beauties[beauty], others)))
        for members in alone.values():
            leads = [i for i in members if parsed[i].role is Role.MOTION]
            if leads and len(members) > 1:
                by_name = {parsed[i].name: i for i in members}
                out.append(PassSet(None, by_name, parsed[leads[0]].name))
    return out


def pass_role(name: str) -> Role | None:
    """Return the role that a pass's name stands for, with or without its program's name."""
    return _parsed(name).role


def _beauties_of(name: _Name, beauties: dict[int, _Name]) -> dict[int, str]:
    """Return the beauties that a pass belongs to, with its name as a pass of each.

    Several only where they share the longest name of a shot.
    """
    found: dict[int, tuple[int, str]] = {}
    for index, beauty in beauties.items():
        if beauty.role is Role.COLOUR and beauty.shot == name.shot:
            found[index] = (len(beauty.shot), name.name)
        elif _begins(name.stem, beauty.stem):
            # FinalImage and FinalImageMovieRenderQueue_WorldDepth are of one shot too.
            shot = beauty.shot if beauty.role is Role.COLOUR else beauty.stem
            found[index] = (len(shot), name.stem[len(beauty.stem) :].lstrip(_SEPARATORS))
    longest = max((length for length, _ in found.values()), default=0)
    return {index: pass_name for index, (length, pass_name) in found.items() if length == longest}


def _more(beauty: _Name, others: dict[int, _Name]) -> dict[str, int]:
    """Return the sequences without a known name whose names begin as a beauty's shot does."""
    shot = beauty.shot
    return {
        name.stem[len(shot) :].lstrip(_SEPARATORS): index
        for index, name in others.items()
        if name.role is None and _begins(name.stem, shot)
    }


def _begins(stem: str, shot: str) -> bool:
    """Whether a name is a shot's with something behind it, apart from it."""
    if not stem.startswith(shot) or len(stem) == len(shot) or not shot:
        return False
    return stem[len(shot)] in _SEPARATORS or _BOUNDARY.match(stem, len(shot)) is not None


def _parsed(base: str) -> _Name:
    """Part the text before a sequence's number into the shot's name and the pass's."""
    stem = base.rstrip(_SEPARATORS)
    # At separators first: shot.VRayVelocity is no pass of shot.VRay.
    for boundary in (_PART, _BOUNDARY):
        for start in (0, *(match.start() for match in boundary.finditer(stem))):
            tail = stem[start:]
            matte = tail.lower().startswith("crypto") and is_cryptomatte(tail)
            role = role_named(_PROGRAM.sub("", tail, count=1) if _PROGRAM.match(tail) else tail)
            if role is not None or matte:
                return _Name(stem, stem[:start].rstrip(_SEPARATORS), tail, role, matte)
    return _Name(stem, stem, "", None, False)
