"""``python -m tests.faults.crashing HOW AFTER ARGUMENTS``: exwarp with a decoder that fails.

HOW is the name of a signal by which the process ends, or ``hang``; AFTER, how many times it decodes
before, or how the path of the file ends that it fails at.
"""

from __future__ import annotations

import itertools
import os
import signal
import sys
import time
from typing import Any

from exwarp_cli import cli
from exwarp_cli.io.exr.reader import ExrFile


def main() -> None:
    how, after = sys.argv[1:3]
    del sys.argv[1:3]
    decode, counted = ExrFile._decode_by_openimageio, itertools.count()

    def failing(self: ExrFile, wanted: Any) -> Any:
        here = next(counted) >= int(after) if after.isdigit() else str(self.path).endswith(after)
        if here:
            if how != "hang":
                os.kill(os.getpid(), signal.Signals[how])
            sys.stderr.write("exwarp: a decoder hangs\n")
            sys.stderr.flush()
            time.sleep(1000)
        return decode(self, wanted)

    ExrFile._decode_by_openimageio = failing  # type: ignore[method-assign]
    cli.main()


if __name__ == "__main__":
    main()
