"""Many spoilt shots, two processes side by side; goes on where it was stopped.

``python -m tests.faults.fuzz [--state FOLDER] [--hypothesis N] [--atheris N] [--command N]``

In process, cases are drawn by hypothesis, and by atheris, which looks for inputs that reach code no
input reached before. Through the command each has a process of its own. Every one has to end in
success, or in one sentence and a documented exit code, in time, without partial files and within
the memory that its frames need. Cases come in batches; a batch that went well is noted in FOLDER
and not run again. What failed is noted there too, and at the end, with what makes it again.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import pkgutil
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

BATCH = {"hypothesis": 250, "atheris": 250, "command": 25}
SECONDS = 1800
"""After which a batch counts as one that hangs: its cases have bounds of their own."""

LONGEST = 8192
"""Bytes that atheris makes a case of."""

MEMORY_MB = 2500
"""What a process of one batch may have had at its peak; a case in a bare process takes 300."""


@dataclass(frozen=True)
class Batch:
    """Cases that are drawn from one seed."""

    kind: str
    seed: int
    cases: int

    @property
    def name(self) -> str:
        """Of the file that says that it is done."""
        return f"{self.kind}-{self.seed:04d}-{self.cases}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("tests.faults.fuzz", description=__doc__)
    parser.add_argument("--state", type=Path, default=Path("build/fuzz"), help="what is done")
    for kind, default in (("hypothesis", 9000), ("atheris", 1500), ("command", 500)):
        parser.add_argument(f"--{kind}", type=int, default=default, help="cases")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--batch", nargs=3, metavar=("KIND", "SEED", "CASES"), help="this alone")
    options = parser.parse_args(arguments)
    if options.batch:
        kind, seed, cases = options.batch
        return _work(Batch(kind, int(seed), int(cases)))
    options.state.mkdir(parents=True, exist_ok=True)
    wanted = [
        Batch(kind, seed, min(size, getattr(options, kind) - seed * size))
        for kind, size in BATCH.items()
        for seed in range(-(-getattr(options, kind) // size))
    ]
    return _run_all(wanted, options.state, options.jobs)


def _run_all(wanted: list[Batch], state: Path, jobs: int) -> int:
    """Run what is not done; tell what failed."""
    begin, lock = time.monotonic(), threading.Lock()

    def one(batch: Batch) -> str:
        done, failed = state / f"{batch.name}.json", state / f"{batch.name}.txt"
        if done.exists():
            return ""
        failure = _started(batch)
        if failure:
            failed.write_text(failure)
        else:
            done.write_text(json.dumps(asdict(batch)))
            failed.unlink(missing_ok=True)
        with lock:
            seconds = time.monotonic() - begin
            print(f"{seconds:6.0f} s  {batch.name}: {(failure and 'FAILED') or 'ok'}", flush=True)
        return failure

    with ThreadPoolExecutor(jobs) as pool:
        failures = [
            (b, text) for b, text in zip(wanted, pool.map(one, wanted), strict=True) if text
        ]
    cases = sum(batch.cases for batch in wanted)
    print(f"{cases} cases in {len(wanted)} batches, {len(failures)} batches with failures")
    for batch, text in failures:
        print(f"\n{batch.name}: python -m tests.faults.fuzz --batch {batch.kind} {batch.seed} "
              f"{batch.cases}\n{text}")  # fmt: skip
    return int(bool(failures))


def _started(batch: Batch) -> str:
    """Run a batch in a process of its own; return what went wrong, or nothing."""
    words = ["--batch", batch.kind, str(batch.seed), str(batch.cases)]
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.faults.fuzz", *words],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
    )  # fmt: skip
    try:
        out, _ = process.communicate(timeout=SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        out, _ = process.communicate()
        return f"longer than {SECONDS} s\n{out[-3000:]}"
    return out[-6000:] or f"ended with {process.returncode}" if process.returncode else ""


def _work(batch: Batch) -> int:
    """Run a batch here."""
    os.environ["EXWARP_CONFIG"] = "none"
    from hypothesis import HealthCheck, given, seed, settings
    from hypothesis import strategies as st

    from tests.faults.fuzz.cases import drawn, in_process
    from tests.faults.running import run

    counted: Counter[str] = Counter()
    run_case = (lambda case: run(*case.arguments)) if batch.kind == "command" else in_process

    @seed(batch.seed)
    @settings(
        max_examples=batch.cases, deadline=None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(st.data())
    def try_one(data: st.DataObject) -> None:
        with drawn(data.draw) as case:
            counted["cases"] += 1
            case.judge(run_case(case))

    if batch.kind == "atheris":
        return _guided(try_one, batch, counted)
    try_one()
    return _within_memory(batch)


def _guided(try_one: Callable[[], None], batch: Batch, counted: Counter[str]) -> int:
    """Have atheris choose the bytes from which cases are drawn, until there were enough of them.

    Bytes from which none can be drawn, as they are too few, are no case; it starts with enough.
    """
    import atheris

    from exwarp_cli import kernels

    # before, as numba wants them without what atheris adds
    for module in pkgutil.iter_modules(kernels.__path__, f"{kernels.__name__}."):
        importlib.import_module(module.name)
    with atheris.instrument_imports(include=["exwarp_cli.io"]):
        import exwarp_cli.io.exr.reader
        import exwarp_cli.io.shot  # noqa: F401
    fuzz: Callable[[bytes], object] = try_one.hypothesis.fuzz_one_input  # type: ignore[attr-defined]

    chance = random.Random(batch.seed)
    corpus = Path(tempfile.mkdtemp(prefix="exwarp-corpus-"))
    for number in range(16):
        (corpus / str(number)).write_bytes(chance.randbytes(LONGEST))

    def one(data: bytes) -> None:
        fuzz(data)
        if counted["cases"] >= batch.cases:
            shutil.rmtree(corpus)
            os._exit(_within_memory(batch))  # it has no other way to stop

    flags = [f"-seed={batch.seed + 1}", f"-max_len={LONGEST}", "-len_control=0"]
    quiet = ["-rss_limit_mb=0", "-verbosity=0", f"-artifact_prefix={corpus}/"]
    atheris.Setup([sys.argv[0], *flags, *quiet, str(corpus)], one)
    atheris.Fuzz()
    return 0


def _within_memory(batch: Batch) -> int:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    if peak > MEMORY_MB:
        print(f"{batch.name} had {peak} MB at its peak, more than {MEMORY_MB}")
    return int(peak > MEMORY_MB)


if __name__ == "__main__":
    sys.exit(main())
