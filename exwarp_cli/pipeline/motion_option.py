"""The option ``--motion``: a motion convention by hand, and the names of the channels in it."""

from __future__ import annotations

import re
from dataclasses import dataclass

from exwarp_cli.domain.motion import AxisMap, MotionConvention
from exwarp_cli.errors import UsageError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.producers import PRESETS
from exwarp_cli.io.shot import Shot, channel_label

UNITS = ("width", "height")
"""Words for the frame's size in pixels, as factors."""

MOST = 1e30
"""Factors up to which vectors stay numbers of 32 bits."""

_NUMBER = r"[0-9.]+(?:[eE][+-]?[0-9]+)?"
# Names of channels may have spaces and commas in them, so only these words part the directions.
_CLAUSES = re.compile(r"\s+(?=(?:previous|next)=)")


def motion_names(shot: Shot) -> tuple[str, ...]:
    """Names of the motion channels as --motion takes them, as short as tells them apart.

    Only so much of the layer stands before a component as is needed, and the AOV if that is.
    """
    refs = shot.layout.roles[Role.MOTION]
    for elements in range(1, 1 + max(ref.name.count(".") + 1 for ref in refs)):
        short = tuple(".".join(ref.name.split(".")[-elements:]) for ref in refs)
        if len(set(short)) == len(short):
            return short
    return tuple(channel_label(ref) for ref in refs)


def parse_motion(
    text: str, names: tuple[str, ...], size: tuple[int, int] | None = None
) -> MotionConvention:
    """Read the ``--motion`` option.

    Either a preset's name (blender, unreal, forward …), or the channels that hold the displacement
    to the previous and next frame in pixels, x right and y down, with signs and factors:
    ``previous=X,-Y next=-Z,W``, ``next=0.5*u,-0.5*v``. What else renderers write is said so:

    - ``width`` and ``height`` are factors for vectors that are shares of the frame:
      ``next=0.5*width*R,-0.5*height*G``;
    - a value that stands for no motion is taken off in brackets:
      ``previous=-1920*(R-0.5),1080*(G-0.5)``;
    - a channel with the length, where the others are a direction, is a last factor:
      ``next=R*B,-G*B``, or ``next=2*(R-0.5)*B,-2*(G-0.5)*B`` for a direction mapped to 0 … 1;
    - premultiplied vectors are divided by alpha: ``next=R/A,-G/A``,
      ``next=9*(R/A-0.5),9*(G/A-0.5)``.

    Parameters
    ----------
    text
        What the user wrote.
    names
        The motion channels' names, in order.
    size
        Width and height of the display window. Without it, a convention in shares of the frame
        stays so (see `MotionConvention.of_frame`).

    Raises
    ------
    UsageError
        When the text is neither.
    """
    preset = PRESETS.get(text.strip().lower())
    if preset is not None:
        if preset.count > len(names):
            raise UsageError(
                f"--motion {text} needs {preset.count} motion channels and there are "
                f"{len(names)}: {', '.join(names)}"
            )
        return preset if size is None else preset.sized(*size)
    terms: dict[str, tuple[_Term, _Term]] = {}
    for clause in filter(None, _CLAUSES.split(text.strip())):
        direction, _, axes = clause.partition("=")
        found = _pair(axes, names)
        if direction not in ("previous", "next") or direction in terms or found is None:
            raise _not_understood(text, names)
        terms[direction] = found
    if not terms:
        raise UsageError("--motion is empty; write a preset or a convention, or leave it out")
    of_frame = size is None and all((x.unit, y.unit) == UNITS for x, y in terms.values())
    if size is None and not of_frame and any(t.unit for pair in terms.values() for t in pair):
        raise UsageError(f"--motion {text!r} counts in frame sizes, and that is not known here")
    pixels = (abs(term.pixels(size)) for pair in terms.values() for term in pair)
    if max(pixels) > MOST:
        raise UsageError(f"--motion {text!r} has a factor above {MOST:g}; correct it")
    maps = {direction: _joined(x, y, size) for direction, (x, y) in terms.items()}
    return MotionConvention(maps.get("previous"), maps.get("next"), of_frame)


@dataclass(frozen=True)
class _Term:
    """One axis of a displacement; see AxisMap. `unit` is "", "width" or "height"."""

    channel: int
    scale: float
    unit: str
    still: float
    length: int | None
    alpha: int | None

    @property
    def shared(self) -> tuple[float, int | None, int | None]:
        """What both axes must have in common."""
        return self.still, self.length, self.alpha

    def pixels(self, size: tuple[int, int] | None) -> float:
        """Return the factor in pixels, as far as the frame's size is known."""
        if size is None or not self.unit:
            return self.scale
        return self.scale * size[UNITS.index(self.unit)]


def _joined(x: _Term, y: _Term, size: tuple[int, int] | None) -> AxisMap:
    return AxisMap(x.channel, y.channel, x.pixels(size), y.pixels(size), *x.shared)


def _not_understood(text: str, names: tuple[str, ...]) -> UsageError:
    return UsageError(
        f"--motion {text!r} is not understood; write a preset ({', '.join(PRESETS)}) or "
        f"for example 'previous={names[0]},-{names[1]}', with channels out of {', '.join(names)}"
    )


def _pair(axes: str, names: tuple[str, ...]) -> tuple[_Term, _Term] | None:
    """Read both axes of a displacement, parted by a comma; None when they are not that."""
    for at in (match.start() for match in re.finditer(",", axes)):
        x, y = _term(axes[:at], names), _term(axes[at + 1 :], names)
        if x is not None and y is not None and x.shared == y.shared:
            return x, y
    return None


def _term(term: str, names: tuple[str, ...]) -> _Term | None:
    """Read one axis of a convention; None when it is not one."""
    name = "|".join(re.escape(n) for n in sorted(names, key=len, reverse=True))
    match = re.fullmatch(
        rf"(?P<sign>[+-]?)(?:(?P<factor>{_NUMBER})\*)?(?:(?P<unit>width|height)\*)?"
        rf"(?P<open>\()?(?P<name>{name})(?:/(?P<alpha>{name}))?"
        rf"(?(open)(?P<still>[+-]{_NUMBER})\))(?:\*(?P<length>{name}))?",
        term,
    )
    if match is None:
        return None
    try:
        factor, still = float(match["factor"] or 1.0), 0.0 - float(match["still"] or 0.0)
    except ValueError:
        return None
    length, alpha = (
        None if match[key] is None else names.index(match[key]) for key in ("length", "alpha")
    )
    sign = -1.0 if match["sign"] == "-" else 1.0
    return _Term(
        names.index(match["name"]), sign * factor, match["unit"] or "", still, length, alpha
    )
