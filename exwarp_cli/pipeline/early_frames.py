"""Frames that opening an input reads anyway, kept for the run that begins with them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from exwarp_cli.domain.timeline import Timeline
from exwarp_cli.errors import ExwarpError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import GEOMETRY, SURFACE, RawFrame, Shot

if TYPE_CHECKING:
    from exwarp_cli.synthesis.methods import Method


@dataclass(frozen=True)
class Beginning:
    """How the run begins that an input is opened for.

    Attributes
    ----------
    frames
        Range of key frames by input number; None for all.
    method
        What makes them.
    """

    frames: str | None
    method: Method


@dataclass
class EarlyFrames:
    """Frames as a run reads them, to be read when vectors are measured; each is handed out once.

    Nobody has to come for them, so they are dropped when the first interval was read.

    Attributes
    ----------
    numbers
        Of the frames that the run reads first.
    roles
        What it reads of them, whatever their ids say.
    """

    numbers: Collection[int] = ()
    roles: tuple[Role, ...] = ()
    _frames: dict[int, RawFrame] = field(default_factory=dict)

    @classmethod
    def of(cls, run: Beginning, shot: Shot, timeline: Timeline, detects: bool) -> EarlyFrames:
        """Foresee what a run reads first in the key setting: a key frame and its neighbours."""
        try:
            first = min(timeline.select(run.frames))
        except ExwarpError:  # it is said when its turn comes
            return cls()
        numbers = timeline.numbers[max(0, first - 1) : first + 2]
        late = reads_late(shot, run.method)
        return cls(numbers, run_roles(shot, run.method, detects, late))

    def keep(self, frame: RawFrame) -> None:
        """Keep a frame for the run."""
        self._frames[frame.number] = frame

    def seen(self, number: int) -> RawFrame | None:
        """Return a frame that is kept, and go on keeping it; None where it is not."""
        return self._frames.get(number)

    def take(self, number: int, roles: tuple[Role, ...]) -> RawFrame | None:
        """Hand a frame out, if it was read with just these roles."""
        return self._frames.pop(number, None) if roles == self.roles else None

    def drop(self) -> None:
        """Let all frames go."""
        self._frames.clear()


def run_roles(shot: Shot, method: Method, detects: bool, late: bool) -> tuple[Role, ...]:
    """Return what a run reads of a key frame that has vectors, in the key setting.

    Parameters
    ----------
    shot
        The key frames.
    method
        What makes frames.
    detects
        Whether cuts are looked for.
    late
        Whether the surface, which its network wants, is read late; see `reads_late`.
    """
    if method.extrapolates and not late:
        return (Role.COLOUR, *GEOMETRY, *SURFACE)
    if wants_normals(shot, method.extrapolates) or normals_tell(shot, detects):
        return (Role.COLOUR, *GEOMETRY)
    return (Role.COLOUR, *(role for role in GEOMETRY if role is not Role.NORMAL))


def reads_late(shot: Shot, method: Method) -> bool:
    """Whether what only extrapolation wants can be read once an interval's path calls for it.

    A policy decides without. Not where ids of whatever is shown are all there is: what moves is
    found by all frames that an interval reads.
    """
    decides = method.judge is not None and not method.needs_truth and not method.lookahead
    return decides and (shot.ids is None or shot.ids.dynamic is not None)


def wants_normals(shot: Shot, extrapolates: bool) -> bool:
    """Whether frames are made by key frames' normals.

    To warps they tell nothing but Unreal's background, in sets of one file per AOV.
    """
    return extrapolates or bool(shot.aovs)


def normals_tell(shot: Shot, detects: bool) -> bool:
    """Whether cuts are found by key frames' normals: the same for every method."""
    return bool(shot.aovs) or (detects and Role.POSITION not in shot.layout)


def serves(frame: RawFrame, shot: Shot, roles: Iterable[Role]) -> bool:
    """Whether of a frame as a run reads it, some roles are what they are when read by themselves.

    With colour, all lies on its data window, and not on the display window; with normals, they mark
    background.
    """
    asked, ids = set(roles), shot.ids
    if ids is not None and ids.dynamic is None:
        return False  # a run reads the ids of whatever is shown
    if Role.COLOUR not in asked and frame.gbuffer.window != shot.display:
        return False
    normal = frame.gbuffer.normal
    if Role.NORMAL in asked or normal is None or frame.gbuffer.depth is None:
        return True
    # All three of every pixel took 30 ms at 1920x1080.
    marked = normal[normal[..., 0] == -1]
    return not (marked == -1).all(axis=-1).any()
