"""What only extrapolation wants of an interval, read once its path calls for it.

Of a run that only warps, older key frames and the surfaces of all took a seventh of the CPU time,
and two fifths of the memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from exwarp_cli.domain.extrapolator import HISTORY
from exwarp_cli.domain.frame import SURFACE_PARTS, GBuffer, KeyFrame
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import GEOMETRY, SURFACE, read_raw
from exwarp_cli.pipeline.loaded import Loaded, Older
from exwarp_cli.pipeline.source import Source


class LateFrames:
    """Completes intervals of the key setting; who reads ahead need not wait for it.

    What one interval had read stays at hand for those that follow at once.

    Parameters
    ----------
    source
        Of the key frames.
    within
        Returns a key frame's geometry, by index, without vectors that lead to another shot.
    repeats
        Returns True if a key frame, by index, shows the same picture as the one before it.
    """

    def __init__(
        self,
        source: Source,
        within: Callable[[int, GBuffer], GBuffer],
        repeats: Callable[[int], bool],
    ) -> None:
        self._source = source
        self._within = within
        self._repeats = repeats
        self._frames: dict[int, KeyFrame] = {}

    def complete(self, loaded: Loaded, history: Sequence[int]) -> Loaded:
        """Return an interval with its key frame's surface, and the key frames before.

        Parameters
        ----------
        loaded
            Without.
        history
            Indices of the key frames that lead back from it, the newest first.

        Raises
        ------
        InputError
            When a file cannot be read.
        """
        assert loaded.frame is not None
        frame = self._source.scratch.store(self._with_surface(loaded.frame))
        past = tuple(Older(self._whole(i), (), self._repeats(i + 1)) for i in history)
        self._frames[loaded.key] = frame
        return replace(loaded, frame=frame, past=past, late=None)

    def forget(self, key: int) -> None:
        """Drop what no interval wants any more when one is read, ahead of the one before it.

        That one may be completed meanwhile, by another thread.
        """
        for index in list(self._frames):
            if index < key - HISTORY:
                self._frames.pop(index, None)

    def _with_surface(self, frame: KeyFrame) -> KeyFrame:
        """Add a key frame's surface, on the window that it lies on."""
        if frame.gbuffer is None:
            return frame
        window = frame.gbuffer.window
        # With colour everything lies on its data window.
        roles = SURFACE if window == self._source.keys.display else (Role.COLOUR, *SURFACE)
        surface = read_raw(self._source.keys, frame.number, roles).gbuffer
        parts = {part: getattr(surface, part) for part in SURFACE_PARTS}
        return replace(frame, gbuffer=replace(frame.gbuffer, **parts))

    def _whole(self, index: int) -> KeyFrame:
        """Read a key frame, unless an interval before had it read."""
        if index not in self._frames:
            keys, finding = self._source.keys, self._source.finding
            roles = (Role.COLOUR, *GEOMETRY, *SURFACE)
            raw = read_raw(keys, self._source.timeline.numbers[index], roles, objects=True)
            frame = raw.key(None if finding is None else finding.convention)
            if frame.gbuffer is not None:
                frame = replace(frame, gbuffer=self._within(index, frame.gbuffer))
            self._frames[index] = self._source.scratch.store(frame)
        return self._frames[index]
