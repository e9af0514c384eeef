"""Motion between successive frames of a sequence, by vectors of its own."""

from __future__ import annotations

from itertools import pairwise

from exwarp_cli.domain.frame import Bool, Float32, GBuffer
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.errors import InputError, MotionError
from exwarp_cli.io.frames import GEOMETRY, Shot, open_shot, read_raw
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.motion_finding import find_motion
from exwarp_cli.synthesis.geometry import matched, reproject, settle_motion


class Flow:
    """Reads where the pixels of a frame come from; asked frame by frame, ascending.

    Parameters
    ----------
    shot
        Frames with vectors to the neighbouring frames.
    convention
        Of the vectors.
    """

    def __init__(self, shot: Shot, convention: MotionConvention) -> None:
        self._shot = shot
        self._convention = convention
        numbers = shot.sequence.numbers
        self._step = min((b - a for a, b in pairwise(numbers)), default=1)
        self._before: tuple[int, GBuffer] | None = None

    def into(self, number: int) -> tuple[Float32, Bool] | None:
        """Return the motion from a frame to the one before it.

        Returns
        -------
        tuple or None
            On the display window, float32 [H, W, 2] in pixels, x right, y down, NaN where nothing
            is known; and bool [H, W]: the frame before does not show the surface point. None where
            the frame that was asked for last is not its neighbour.
        """
        raw = read_raw(self._shot, number, GEOMETRY)
        now = settle_motion(raw.settle(self._convention).on(self._shot.display))
        before, self._before = self._before, (number, now)
        if before is None or before[0] != number - self._step:
            return None
        found = (
            reproject(before[1], 1.0)
            if now.to_previous is None
            else matched(now, before[1], now.to_previous, 1)
        )
        return found.field, found.hole


def open_flow(spec: str, sequence: Sequence, view: str = "") -> Flow | str:
    """Return the flow of a sequence, or in a few words why it has none.

    Parameters
    ----------
    spec
        What the user named it by.
    sequence
        What was found there.
    view
        Whose vectors; "" for the hero's.
    """
    try:
        shot = open_shot(spec, view or None)
        finding = find_motion(shot, None)
    except (InputError, MotionError) as error:
        return str(error)
    if finding is None:
        return f"{sequence.pattern} has no motion vectors"
    if not set(sequence.files) <= set(shot.sequence.files):
        return f"the vectors beside {sequence.pattern} are of other frames"
    return Flow(shot, finding.convention)
