"""Where the time of `upsample` goes: by method, frame size and compression of the input.

``python -m tests.bench.profile_command --label NAME [--tree DIR]``: a table in PROFILE.md beside
this file, under a heading of that name; other headings stay. Every case is kept in the state file
as soon as it is measured, so a run that was broken off goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.bench.running import cleared, module, run

FLOOR = "codec floor"
METHODS = ("s6", "softsplat", "causal")
KEYS = {480: 5, 1080: 4, 2160: 3}
"""Key frames by lines."""

COMPRESSIONS = ("none", "zip", "piz", "dwaa")
LARGE, ONLY = 2160, "zip"
"""Where the network takes minutes, a method that has one is run on one input: the others
show what decoding takes."""

STEPS = ("read", "geometry", "warp", "features", "decide", "extrapolate", "write")
SECONDS = 300
"""What a case may take."""

BUSY = 2
"""Load average for each thread from which on wall time says nothing; the run itself makes one."""

HERE = Path(__file__).parent
TABLE = HERE / "PROFILE.md"
Case = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.profile_command", description=__doc__)
    parser.add_argument("--label", default="now", help="the table's heading")
    parser.add_argument("--tree", type=Path, default=Path.cwd(), help="whose exwarp is profiled")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--heights", type=int, nargs="+", default=list(KEYS), choices=list(KEYS))
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    parser.add_argument("--state", type=Path, help="default: build/profile-LABEL.json")
    parser.add_argument("--out", type=Path, default=TABLE)
    options = parser.parse_args(arguments)
    state: Path = options.state or Path("build") / f"profile-{options.label}.json"
    state.parent.mkdir(parents=True, exist_ok=True)
    known: dict[str, Case] = json.loads(state.read_text()) if state.is_file() else {}
    for height in options.heights:
        for compression in COMPRESSIONS:
            for name, case in _measured(height, compression, known, options):
                known[name] = case
                state.write_text(json.dumps(known, indent=1) + "\n")
    _write(options, known)
    return 0


def _measured(
    height: int, compression: str, known: dict[str, Case], options: argparse.Namespace
) -> Iterator[tuple[str, Case]]:
    """Measure what is not known yet of one input, which is made for that and removed."""
    methods = [FLOOR, *(m for m in options.methods if _runs(m, height, compression))]
    names = {f"{height} {compression} {method}": method for method in methods}
    wanted = {name: method for name, method in names.items() if name not in known}
    if not wanted:
        return
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        keys, out = Path(folder) / "keys", Path(folder) / "out"
        size = ("--height", str(height), "--count", str(KEYS[height]))
        run(module("tests.bench.big_input", str(keys), *size, "--compression", compression))
        for name, method in wanted.items():
            case = {"load": os.getloadavg()[0], **_case(keys, out, method, options)}
            print(f"{name:28}{case}", flush=True)
            yield name, case
            shutil.rmtree(out, ignore_errors=True)


def _runs(method: str, height: int, compression: str) -> bool:
    return method != "causal" or height < LARGE or compression == ONLY


def _case(keys: Path, out: Path, method: str, options: argparse.Namespace) -> Case:
    threads = str(options.threads)
    out.mkdir(exist_ok=True)
    if method == FLOOR:
        command = module("tests.bench.codec_floor", str(keys), str(out), "--threads", threads)
        measured = run(command)
        return {"wall": measured.wall, "cpu": measured.cpu, "peak": measured.peak_mb}
    tree = options.tree.resolve()
    command = [sys.executable, str(HERE / "profiled.py"), str(keys), str(out), method, threads]
    cleared(out)
    try:
        measured = run(command, {"PYTHONPATH": str(tree)}, tree, SECONDS)
    except subprocess.CalledProcessError as error:
        killed = error.returncode == -signal.SIGKILL
        return {"failed": f"over {SECONDS} s" if killed else "failed"}
    inside = json.loads((out / "profile.json").read_text())
    return {"wall": measured.wall, "cpu": measured.cpu, "peak": measured.peak_mb, "inside": inside}


def _write(options: argparse.Namespace, known: dict[str, Case]) -> None:
    """Write the table under its heading, and keep what stands under others."""
    text = options.out.read_text() if options.out.is_file() else f"{INTRODUCTION}\n"
    head, *sections = text.split("\n## ")
    kept = [s for s in sections if s.split("\n", 1)[0] != options.label]
    version = next((c["inside"]["version"] for c in known.values() if "inside" in c), "unknown")
    command = f"python -m tests.bench.profile_command --label {options.label}"
    ran = f"Version {version}, {os.cpu_count()} cores, `{command} --threads {options.threads}`."
    load = statistics.median(case["load"] for case in known.values())
    if load > BUSY * options.threads:
        ran += f" Load average {load:.0f}: other work took most of the machine; go by cpu alone."
    entry = "\n".join([options.label, "", ran, "", *_rows(known), ""])
    sections = [section.rstrip("\n") + "\n" for section in (head, *kept, entry)]
    options.out.write_text("\n## ".join(sections))


INTRODUCTION = """# Where the time goes

The example, enlarged, in four compressions; 5, 4 and 3 key frames at 480, 1080 and 2160 lines.
`s` and `cpu s` are those of a whole run in a warm cache, and their ratios those to the codec floor
of the same input; ms are those of a new frame in `upsample` itself, without imports: wall and
processor time, then what its steps took by the clock, some of them beside each other and beside
reading and writing. Reading is spread over the new frames of a key frame. `failed`: the run wanted
more than 12 GB of address space.
"""


def _rows(known: dict[str, Case]) -> Iterator[str]:
    named = "lines, input, method, s, ratio, cpu s, ratio, MB, wall ms, cpu ms"
    columns = named.split(", ")
    yield "| " + " | ".join((*columns, *STEPS, "other")) + " |"
    yield "|---|---|---|" + "--:|" * (len(columns) - 3 + len(STEPS) + 1)
    order = [f"{h} {c} {m}" for h in KEYS for c in COMPRESSIONS for m in (FLOOR, *METHODS)]
    for name in (name for name in order if name in known):
        case = known[name]
        height, compression, method = name.split(" ", 2)
        cells = [height, compression, method]
        if "failed" in case:
            yield "| " + " | ".join([*cells, case["failed"]]) + " |"
            continue
        floor = known[f"{height} {compression} {FLOOR}"]
        for kind in ("wall", "cpu"):
            cells += [f"{case[kind]:.2f}", f"{case[kind] / floor[kind]:.2f}"]
        cells.append(f"{case['peak']:.0f}")
        inside = case.get("inside")
        cells += _inside(inside) if inside else [""] * (len(STEPS) + 3)
        yield "| " + " | ".join(cells) + " |"


def _inside(inside: Case) -> list[str]:
    """Return milliseconds of a new frame: wall, processor, by step, and of other steps."""
    new, steps = inside["new"], dict(inside["steps"])
    columns = [1e3 * inside["wall"] / new, 1e3 * inside["cpu"] / new]
    columns += [steps.pop(step, 0.0) / new for step in STEPS]
    return [f"{ms:.0f}" if ms else "" for ms in [*columns, sum(steps.values()) / new]]


if __name__ == "__main__":
    sys.exit(main())
