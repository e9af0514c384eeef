"""``python -m tests.faults.breaking FILE KEY NTH ARGUMENTS``: exwarp, terminated at one step.

A step is where Python may handle a signal in the main thread: at the beginning of a function, and
after a call. FILE gets all that there were in the modules of `LOOKED_AT`, as JSON: how often, by
key. With ``-`` as KEY nothing is terminated; with a key the command is when it comes there for the
NTH time, and says so on stderr.
"""

from __future__ import annotations

import atexit
import dis
import functools
import json
import signal
import sys
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from exwarp_cli import cli
from exwarp_cli.io.stops import Stoppable

LOOKED_AT = (
    "threading", "queue", "weakref", "contextlib", "concurrent.futures", "importlib._bootstrap",
    "numba.core.compiler_lock", "numba.core.dispatcher", "numba.core.codegen",
    "llvmlite.binding", "exwarp_cli",
)  # fmt: skip
STRUCK = "exwarp: terminated here"
CALLS = {"CALL", "CALL_FUNCTION_EX", "CALL_KW", "JUMP_BACKWARD"}


@functools.cache
def steps(code: CodeType) -> frozenset[int]:
    """Return where a function may be interrupted, as offsets of instructions."""
    found, before = set(), ""
    for instruction in dis.get_instructions(code):
        if before in CALLS:
            found.add(instruction.offset)
        before = instruction.opname
    return frozenset(found)


def named(frame: FrameType | None) -> str:
    if frame is None:
        return ""
    return f"{frame.f_globals.get('__name__')}:{frame.f_code.co_qualname}"


class Breaker:
    """Counts steps, and terminates this process at one of them."""

    def __init__(self, key: str, nth: int) -> None:
        self.counts: Counter[str] = Counter()
        self._key, self._nth = key, nth

    def begin(self, frame: FrameType, event: str, argument: Any) -> Any:
        """Take a function that begins; of `sys.settrace`."""
        name = str(frame.f_globals.get("__name__"))
        if not any(name == looked or name.startswith(f"{looked}.") for looked in LOOKED_AT):
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        self._step(frame, -1)
        return self.go_on

    def go_on(self, frame: FrameType, event: str, argument: Any) -> Any:
        """Take an instruction; of `sys.settrace`."""
        if event == "opcode" and frame.f_lasti in steps(frame.f_code):
            self._step(frame, frame.f_lasti)
        return self.go_on

    def _step(self, frame: FrameType, place: int) -> None:
        key = f"{named(frame)}:{frame.f_lineno}:{place} < {named(frame.f_back)}"
        self.counts[key] += 1
        if key == self._key and self.counts[key] == self._nth:
            sys.settrace(None)
            at: FrameType | None = frame
            while at is not None:
                at.f_trace, at = None, at.f_back
            sys.stderr.write(f"{STRUCK}\n")
            handler = signal.getsignal(signal.SIGTERM)
            assert callable(handler)
            handler(signal.SIGTERM, frame)  # as Python would, which knows this function's frame


def main() -> None:
    file, key, nth = sys.argv[1:4]
    del sys.argv[1:4]
    breaker = Breaker(key, int(nth))

    class Traced(Stoppable):
        def __enter__(self) -> None:
            super().__enter__()
            sys.settrace(breaker.begin)

        def __exit__(self, *raised: object) -> None:
            sys.settrace(None)
            super().__exit__(*raised)

    cli.Stoppable = Traced  # type: ignore[misc]
    if key == "-":
        atexit.register(lambda: Path(file).write_text(json.dumps(breaker.counts)))
    cli.main()


if __name__ == "__main__":
    main()
