"""Frames of the input that cannot be used, where what does not depend on them is made all the same.

A lost key frame is like a hole between two shots: nothing is taken across it. What is lost has to
be the same for every chunk of a sequence, whatever else that chunk reads. So a key frame is always
read in the same way, and who asks where shots begin has the key frames on both sides read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import InputError


class _NotedError(Exception):
    """The cause of an error of a frame that is noted as lost."""


class Losses:
    """Frames that are lost, by their slot, whose index is 0 for key frames.

    Parameters
    ----------
    bearable
        Whether to go on without them; else errors pass, and nothing is noted.
    """

    def __init__(self, bearable: bool = False) -> None:
        self.bearable = bearable
        self._reasons: dict[Slot, str] = {}

    def __len__(self) -> int:
        return len(self._reasons)

    @contextmanager
    def at(self, slot: Slot) -> Iterator[None]:
        """Read a frame in a block, which is lost when the block fails.

        Raises
        ------
        InputError
            What the block raises; and at once for a frame that is known to be lost.
        """
        if not self.bearable:
            yield
            return
        if slot in self._reasons:
            raise InputError(self._reasons[slot]) from _NotedError()
        try:
            yield
        except InputError as error:
            if isinstance(error.__cause__, _NotedError):  # another frame, read for this one
                raise
            self._reasons[slot] = str(error)  # without what its traceback holds
            raise InputError(self._reasons[slot]) from _NotedError()

    def has(self, key: int) -> bool:
        """Whether a key frame is known to be lost, by its index."""
        return Slot(key, 0) in self._reasons

    def part(self, key: int) -> bool:
        """Whether a key frame or the one before is known to be lost."""
        return self.has(key) or self.has(key - 1)

    def spare(self, slots: Iterable[Slot]) -> bool:
        """Whether none of some slots' frames is known to be lost."""
        return not any(slot in self._reasons for slot in slots)
