"""Every bench that has goals, one after the other, and what became of the goals.

``python -m tests.bench [NAME …] [--check] [--json FILE]``. Each runs in a process of its own, as
memory and start-up are measured too.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.bench import goals
from tests.bench.running import environment, module

PREFIX = "bench_"
BENCHES = tuple(sorted(p.stem.removeprefix(PREFIX) for p in Path(__file__).parent.glob("bench_*")))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench", __doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(BENCHES))
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(BENCHES):
        parser.error(f"there is no bench {', '.join(sorted(unknown))}; name {', '.join(BENCHES)}")
    figures: list[goals.Figure] = []
    broken = []
    for name in options.names or BENCHES:
        found = _run(name)
        broken += [name] if found is None else []
        figures += found or []
    print("\ngoals; a fifth above is a miss")
    for figure in figures:
        if figure.goal is not None:
            print(f"{'missed' if figure.missed else 'ok':8}{figure}")
    status = goals.finish(figures, options)
    for name in broken:
        print(f"failed: {name}", file=sys.stderr)
    return 1 if broken else status


def _run(name: str) -> list[goals.Figure] | None:
    """Run one bench; return its figures, None where it fails."""
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        found = Path(folder) / "figures.json"
        command = module(f"tests.bench.{PREFIX}{name}", "--json", str(found))
        done = subprocess.run(command, env=environment(), check=False)
        if done.returncode or not found.is_file():
            return None
        return goals.read(found)


if __name__ == "__main__":
    sys.exit(main())
