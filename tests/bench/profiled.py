"""One run of `upsample` in this process, reported as JSON: what its steps took.

``python profiled.py KEYS OUT METHOD THREADS``, with the tree to be profiled on the path: apart from
that tree's `exwarp_cli` nothing is imported, so an older state can be profiled too.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections import Counter
from pathlib import Path

LIMIT_GB = 12
"""Address space, so that a run which wants more fails alone."""


def main() -> int:
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_GB * 2**30,) * 2)
    keys, out, method, threads = sys.argv[1:]
    from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
    from exwarp_cli.pipeline.run import upsample

    settings = UpsampleSettings(
        SourceSettings(keys), out, method, overwrite=True, threads=int(threads)
    )
    wall, cpu = time.perf_counter(), time.process_time()
    made = upsample(settings)
    steps: Counter[str] = Counter()
    for frame in made.frames:
        steps.update({step: took for step, took in frame.timing_ms.items() if took is not None})
    document = {
        "version": made.version,
        "wall": time.perf_counter() - wall,
        "cpu": time.process_time() - cpu,
        "new": sum(frame.kind.value == "generated" for frame in made.frames),
        "steps": dict(steps),
    }
    Path(out, "profile.json").write_text(json.dumps(document), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
