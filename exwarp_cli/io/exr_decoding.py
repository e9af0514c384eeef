"""Decoding the common kinds of EXR file: flat scan lines, of every compression but the lossy ones.

Chunks are read, inflated and put into place side by side, of wanted parts alone. Whatever is
unusual or broken is left to OpenImageIO, which decides whether it can be read, and says why not.
Pixels are the same, bit for bit.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from threading import Lock, local
from typing import Any

import numpy as np
from isal import isal_zlib

from exwarp_cli.domain import cores
from exwarp_cli.domain.frame import Window
from exwarp_cli.io.exr_chunks import (
    FLOAT,
    I64,
    NONE,
    PXR24,
    RLE,
    U8,
    UINT,
    Stored,
    stored_parts,
)
from exwarp_cli.runtime.frame_pool import pool

RUN = 1 << 21
"""Bytes of pixels that a thread takes at a time, or one chunk."""

SLACK = 64
"""Bytes that a chunk is read with and that may hold anything. Near the end of its input libdeflate
goes bit by bit and copies byte by byte, and of ids or a constant channel so few bytes are left of a
chunk that this was all of it: it took six times as long."""

_IsalError: Any = isal_zlib.error  # an exception's class, which its stubs take for one
_NOTHING = np.empty(0, np.uint8)


@dataclass(frozen=True)
class Wanted:
    """Channels of one part that are decoded into one array.

    Attributes
    ----------
    part
        Index of the part.
    window
        Its data window.
    names
        Of channels that are all whole numbers, or none.
    integer
        Whether they are whole numbers.
    """

    part: int
    window: Window
    names: tuple[str, ...]
    integer: bool


@dataclass(frozen=True)
class _Target:
    """Where the channels of a `Wanted` go.

    Attributes
    ----------
    plain, sorted
        int64 [K, 2] as kernels want it, for lines as they are, and as PXR24 sorts them.
    out
        Bits, uint32 [H, W, C].
    """

    plain: I64
    sorted: I64
    out: np.ndarray


class ScanLines:
    """A file whose scan lines are decoded here; to be closed.

    Raises
    ------
    OSError
        When it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb", buffering=0)
        self._lock, self._own = Lock(), local()
        self._parts: list[Stored | None] = []
        if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
            return  # interpreted, kernels would take minutes for a frame
        with suppress(OSError, ValueError):  # it is not plain
            self._parts = stored_parts(self._bytes, os.fstat(self._file.fileno()).st_size)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read(self, wanted: Sequence[Wanted]) -> list[np.ndarray | None]:
        """Decode channels.

        Returns
        -------
        list
            Of each: float32 or uint32 [H, W, C]; None where OpenImageIO is to decide.
        """
        targets: dict[int, list[_Target]] = {}
        found = [self._target(one) for one in wanted]
        for one, target in zip(wanted, found, strict=True):
            if target is not None:
                targets.setdefault(one.part, []).append(target)
        broken = self._decode(targets)
        return [
            None
            if target is None or one.part in broken
            else target.out.view(np.uint32 if one.integer else np.float32)
            for one, target in zip(wanted, found, strict=True)
        ]

    def _target(self, wanted: Wanted) -> _Target | None:
        """Make room for channels; None where they are not as expected, or too many."""
        stored = self._parts[wanted.part] if wanted.part < len(self._parts) else None
        if stored is None or stored.window != wanted.window:
            return None
        kinds = dict(stored.channels)
        names = [name.encode("utf-8", "surrogateescape") for name in wanted.names]
        if not all(n in kinds and (kinds[n] == UINT) == wanted.integer for n in names):
            return None
        places = [names.index(name) if name in names else -1 for name, _ in stored.channels]
        try:
            out = pool.empty((*stored.window.shape, len(names)), np.uint32)
        except MemoryError:
            return None
        plain = np.array([stored.sizes, places], np.int64).T.copy()
        short = plain.copy()
        short[[kind == FLOAT for _, kind in stored.channels], 0] = 3
        return _Target(plain, short, out)

    def _decode(self, targets: dict[int, list[_Target]]) -> set[int]:
        """Fill targets, by part; return the parts that could not be decoded."""
        tasks = []
        for part, members in targets.items():
            stored = self._parts[part]
            assert stored is not None
            tasks += [(part, _Run(self._followed, stored, members, some)) for some in _runs(stored)]
        broken: set[int] = set()

        def take(task: tuple[int, _Run]) -> None:
            part, run = task
            with cores.working():
                if part not in broken and not run.decode():
                    broken.add(part)

        threads = min(cores.left(), len(tasks))
        if threads > 1:
            # No thread can be started when the interpreter ends, or the system has no more.
            with suppress(RuntimeError), ThreadPoolExecutor(threads, "exr") as pool:
                # A pool of its own: starting one takes a thousandth of a frame's time.
                done = pool.map(take, tasks)
                with cores.waiting():
                    list(done)
                return broken
        for task in tasks:
            take(task)
        return broken

    def _bytes(self, start: int, size: int) -> U8:
        """Read bytes, from any thread; they stay until it reads the next ones."""
        return self._followed(start, size)[:-SLACK]

    def _followed(self, start: int, size: int) -> U8:
        """Read bytes likewise, before `SLACK` others of any value.

        Fresh memory for each run of chunks took as long as half of the reading.
        """
        out: U8 = getattr(self._own, "buffer", _NOTHING)
        if len(out) < size + SLACK:
            out = self._own.buffer = np.zeros(size + SLACK, np.uint8)
        got = 0
        while got < size:
            if hasattr(os, "preadv"):
                more = os.preadv(self._file.fileno(), [out[got:size].data], start + got)
            else:  # Windows
                with self._lock:
                    self._file.seek(start + got)
                    more = self._file.readinto(out[got:size].data) or 0
            if not more:
                break
            got += more
        return out[: got + SLACK]


def _runs(stored: Stored) -> Iterator[I64]:
    """Yield the indices of chunks that are decoded at a time, as they follow each other on disk."""
    order = np.argsort(stored.starts, kind="stable")
    step = max(1, RUN // (stored.lines * stored.window.width * sum(stored.sizes)))
    for first in range(0, len(order), step):
        yield order[first : first + step]


@dataclass(frozen=True)
class _Run:
    """Some chunks of a part, on their way into targets."""

    read: Callable[[int, int], U8]
    stored: Stored
    targets: Sequence[_Target]
    chunks: I64

    def decode(self) -> bool:
        """Decode all; False when one of them is not what it should be."""
        try:
            return all(self._chunk(int(i), data) for i, data in self._read())
        except (OSError, MemoryError):
            return False

    def _read(self) -> Iterator[tuple[int, U8]]:
        """Yield each chunk's number, and its bytes before `SLACK` others.

        Chunks that follow each other are read at once.
        """
        leader = _leader(self.stored).size
        stored, size = self.stored, sum(self.stored.sizes) * self.stored.window.width
        starts = stored.starts[self.chunks]
        # In front of something else there may be a gap of any length.
        ends = np.minimum(stored.ends[self.chunks], starts + leader + stored.lines * size)
        breaks = np.flatnonzero(starts[1:] != ends[:-1]) + 1
        for some in np.split(np.arange(len(starts)), breaks):
            begin = int(starts[some[0]])
            data = self.read(begin, int(ends[some[-1]]) - begin)
            data.flags.writeable = False  # kernels are compiled for arrays of one kind
            for i in some:
                yield self.chunks[i], data[starts[i] - begin : ends[i] - begin + SLACK]

    def _chunk(self, index: int, data: U8) -> bool:
        """Decode one chunk, before `SLACK` other bytes; False when it is not what it should be."""
        stored, leader = self.stored, _leader(self.stored)
        if len(data) < leader.size + SLACK:
            return False
        first = index * stored.lines
        rows = min(stored.lines, stored.window.height - first)
        *number, line, size = leader.unpack_from(data.data)
        full = rows * stored.window.width * sum(stored.sizes)
        packed = data[leader.size : leader.size + size + SLACK]
        named = not number or number[0] == stored.number
        if not named or line != stored.window.y + first or not 0 < size <= full:
            return False
        return len(packed) == size + SLACK and self._placed(packed, first, rows, full)

    def _placed(self, packed: U8, first: int, rows: int, full: int) -> bool:
        """Write a chunk's lines, of which the first and the number are given, to where they go."""
        from exwarp_cli.kernels import exr_rises  # numba: not for what reads no pixels

        stored = self.stored
        if len(packed) == full + SLACK:  # what did not become smaller is stored as it is
            for target in self.targets:
                exr_rises.from_lines(packed[:full], target.plain, target.out[first : first + rows])
        elif stored.compression == NONE:
            return False
        elif stored.compression == PXR24:
            short = self.targets[0].sorted[:, 0].sum()
            data = inflated(packed, int(rows * stored.window.width * short))
            if data is None:
                return False
            for target in self.targets:
                exr_rises.from_planes(data, target.sorted, target.out[first : first + rows])
        else:
            data = (_unrun if stored.compression == RLE else inflated)(packed, full)
            if data is None:
                return False
            for target in self.targets:
                exr_rises.from_halves(data, target.plain, target.out[first : first + rows])
        return True


_LEADERS = {False: struct.Struct("<2i"), True: struct.Struct("<3i")}


def _leader(stored: Stored) -> struct.Struct:
    """Return what stands before each chunk: the part's number, the first line, the bytes."""
    return _LEADERS[stored.number is not None]


def _unrun(packed: U8, size: int) -> U8 | None:
    """Return what run lengths [N + SLACK] stand for; None unless those are so many bytes."""
    from exwarp_cli.kernels.exr_rises import from_runs

    out = np.empty(size, np.uint8)
    if not from_runs(packed[:-SLACK], out):
        return None
    out.flags.writeable = False
    return out


def _by_isal(packed: U8, size: int) -> bytes | None:
    """Inflate with ISA-L, which comes with the writer."""
    stream = isal_zlib.decompressobj()
    try:
        out: bytes = stream.decompress(packed[:-SLACK], size + 1)
    except _IsalError:
        return None
    return out if stream.eof and not stream.unused_data else None


def _by_libdeflate(packed: U8, size: int) -> bytearray | None:
    """Inflate with libdeflate, in 0.6 of the time; it ignores what follows the checksum."""
    try:
        out: bytearray = _libdeflate.zlib_decompress(packed, size)
    except _libdeflate.DeflateError:
        return None
    checksum = packed[-SLACK - 4 : -SLACK]
    return out if _libdeflate.adler32(out) == int.from_bytes(checksum.tobytes(), "big") else None


try:
    _libdeflate = import_module("deflate")
except ImportError:
    FAST = False
else:
    FAST = True
_inflate: Callable[[U8, int], bytes | bytearray | None] = _by_libdeflate if FAST else _by_isal


def inflated(packed: U8, size: int) -> U8 | None:
    """Inflate a zlib stream, uint8 [N + SLACK]; None unless it is whole, and of just `size` bytes.

    The last `SLACK` bytes are no part of it.
    """
    data = _inflate(packed, size)
    if data is None or len(data) != size:
        return None
    out = np.frombuffer(data, np.uint8)
    out.flags.writeable = False
    return out
