"""Key frames that an interval looked ahead to, of which the next one gets colour alone.

What is settled of their geometry for the one serves the other. As read, with vectors, positions
and ids, it takes 66 MB more at 1920x1080, which would lie there until its turn comes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from exwarp_cli.domain.frame import GBuffer, KeyFrame
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import read_raw
from exwarp_cli.pipeline.source import Source
from exwarp_cli.synthesis.methods import Method


def looks_ahead_alone(method: Method) -> bool:
    """Whether a method takes the next key frame and no older ones.

    Of these, and of what a policy looks at, geometry is wanted as it was read.
    """
    return method.lookahead and not method.extrapolates


class HandedOver:
    """Lets geometry go, and reads it again where it is needed after all.

    Parameters
    ----------
    source
        Of the key frames.
    roles
        What is read of them.
    left_out
        What of that frames are made without.
    within
        Returns a key frame's geometry, by index, without vectors that lead to another shot.
    """

    def __init__(
        self,
        source: Source,
        roles: tuple[Role, ...],
        left_out: tuple[str, ...],
        within: Callable[[int, GBuffer], GBuffer],
    ) -> None:
        self._source, self._roles, self._left_out, self._within = source, roles, left_out, within
        self._last: int | None = None

    def lean(self, key: int, frame: KeyFrame) -> KeyFrame:
        """Return what is kept of a key frame that an interval gets as its next one.

        All of it, where ids of whatever is shown are all there is: what moves is found by comparing
        both key frames as they were read.
        """
        if frame.gbuffer is None or frame.gbuffer.objects is not None:
            return frame
        self._last = key
        return replace(frame, gbuffer=None)

    def again(self, key: int) -> Callable[[], KeyFrame] | None:
        """Return what reads a key frame again of which only colour was kept; None for others."""
        return partial(self._read, key) if key == self._last else None

    def _read(self, key: int) -> KeyFrame:
        """Read a key frame; not by the thread that loads intervals."""
        source = self._source
        assert source.finding is not None
        raw = read_raw(source.keys, source.timeline.numbers[key], self._roles, objects=True)
        frame = raw.key(source.finding.convention).without(*self._left_out)
        if frame.gbuffer is None:
            return frame
        return replace(frame, gbuffer=self._within(key, frame.gbuffer))
