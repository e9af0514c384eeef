"""Plant known defects in a copy of the repository, one at a time; name the test that catches each.

``python -m tests.faults.planted [NAME …]``

A defect counts as caught if a test of the default suite, in its files, fails with it and passes
without it. Exits with 1 if a defect is not caught, and with 2 if one cannot be planted.
`test_planted.py` keeps the list up to date.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.matrix import DEFAULT_SUITE

ROOT = Path(__file__).parents[2]

# Seconds for one run of pytest. The first one compiles the kernels that it needs.
LIMIT_S = 600

PYTEST = ("-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", DEFAULT_SUITE)


@dataclass(frozen=True)
class Defect:
    """A mistake that a reviewer could miss, and the tests that must catch it."""

    name: str
    file: str  # under exwarp_cli
    old: str  # occurs once in the file
    new: str
    tests: str  # under tests, separated by spaces


DEFECTS = (
    Defect(
        "slot-time",  # right for integer factors alone
        "domain/timeline.py",
        "return self.order(slot) / self.factor - slot.key if slot.index",
        "return slot.index / self.factor if slot.index",
        "unit/test_timeline.py",
    ),
    Defect(
        "output-number",  # frame 0 is no start
        "domain/timeline.py",
        "first = ordered[0] if start is None else start",
        "first = start or ordered[0]",
        "unit/test_timeline.py",
    ),
    Defect(
        "blend-sides",
        "kernels/blend.py",
        "early = np.float32(1) - time if shared[j] else early * (np.float32(1) - time)\n"
        "            late = time if shared[j] else late * time",
        "early = time if shared[j] else early * (np.float32(1) - time)\n"
        "            late = np.float32(1) - time if shared[j] else late * time",
        "unit/test_kernels_blend.py",
    ),
    Defect(
        "motion-sign",
        "synthesis/layer_retiming.py",
        "np.where(self.sources.later, self.time - 1, self.time)",
        "np.where(self.sources.later, 1 - self.time, self.time)",
        "unit/test_layer_retiming.py",
    ),
    Defect(
        "motion-order",
        "synthesis/trajectory.py",
        "enumerate(others, start=2)",
        "enumerate(reversed(others), start=2)",
        "unit/test_gbuffer_values.py",
    ),
    Defect(
        "hole-ids",  # what stands still has id 0
        "kernels/holes.py",
        "if now >= 0 and then >= 0 and now != then:",
        "if now > 0 and then > 0 and now != then:",
        "unit/test_kernels_holes.py",
    ),
    Defect(
        "depth-inverse",
        "io/depth.py",
        "self.scale / (depth - np.float64(self.offset))",
        "self.scale / depth - np.float64(self.offset)",
        "unit/test_depth.py",
    ),
    Defect(
        "half-pixel",
        "kernels/resample.py",
        "row, column = math.floor(y + 0.5) - top, math.floor(x + 0.5) - left",
        "row, column = math.floor(y) - top, math.floor(x) - left",
        "unit/test_kernels_resample.py",
    ),
    Defect(
        "cryptomatte-mixed",  # of those whose name does not say what they are
        "io/layers.py",
        r'rf"{re.escape(base)}\d*"',
        r'rf"{re.escape(base)}\d"',
        "unit/test_layers.py",
    ),
    Defect(
        "data-window",
        "synthesis/cut_detection.py",
        "_cell_pixels(gbuffer.window, display, size, middle)",
        "_cell_pixels(display, display, size, middle)",
        "unit/test_cut_detection.py",
    ),
    Defect(
        "rounding",  # rint rounds half to even
        "accelerator/mlp.py",
        "rounded = whole + (scaled - whole >= 0.5)",
        "rounded = np.rint(scaled)",
        "unit/test_fixed_point.py",
    ),
    Defect(
        "state-order",
        "policy/state.py",
        "nodes = [node, *reversed(PRECEDING_NODES[node])]\n        states",
        "nodes = [node, *PRECEDING_NODES[node]]\n        states",
        "unit/test_state.py",
    ),
    Defect(
        "gate-choice",
        "pipeline/gate.py",
        "values = warped.value(), by_network.value()",
        "values = by_network.value(), warped.value()",
        "cli/test_gate.py",
    ),
    Defect(
        "stale-layers",
        "pipeline/fingerprint.py",
        'facts["layers"] = list(self.layers)',
        'facts["layers"] = len(self.layers)',
        "cli/test_layers.py",
    ),
    Defect(
        "partial-file",
        "io/files.py",
        'with atomic_path(path) as temporary, temporary.open("wb") as file:',
        'with path.open("wb") as file:',
        "unit/test_atomic.py",
    ),
    Defect(
        "exit-code",  # --keep-going goes on, and exits with 12
        "errors.py",
        "class UnreadableError(ExwarpError):",
        "class UnreadableError(InputError):",
        "unit/test_reading_retry.py",
    ),
    Defect(
        "flicker-pixels",
        "metrics/temporal.py",
        "else self.counted & mask",
        "else mask",
        "unit/test_flicker.py",
    ),
    Defect(
        "merged-time",  # of a chunk that was made again in part
        "report/merge.py",
        "wall_seconds=run.wall_seconds * share",
        "wall_seconds=run.wall_seconds",
        "cli/test_merge_reports.py",
    ),
    Defect(
        "video-rate",  # 24000/1001 becomes another fraction
        "io/video_writer.py",
        "limit_denominator(100_000)",
        "limit_denominator(1000)",
        "unit/test_video.py",
    ),
    Defect(
        "srgb-threshold",
        "kernels/resample.py",
        "if size <= np.float32(0.04045) else curved",
        "if size <= np.float32(0.0031308) else curved",
        "unit/test_kernels_resample.py",
    ),
)


def main(names: list[str]) -> int:
    unknown = sorted(set(names) - {defect.name for defect in DEFECTS})
    if unknown:
        print(f"no defect is called {', '.join(unknown)}", file=sys.stderr)
        return 2
    chosen = [defect for defect in DEFECTS if not names or defect.name in names]
    missed = 0
    with tempfile.TemporaryDirectory(prefix="exwarp-planted-") as folder:
        copy = Path(folder)
        copy_tracked_files(copy)
        for defect in chosen:
            try:
                test = find_catching_test(copy, defect)
            except ValueError as error:
                print(f"{defect.name}: {error}", file=sys.stderr)
                return 2
            missed += test is None
            caught = f"caught by {test.removeprefix('tests/')}" if test else "NOT CAUGHT"
            print(f"{defect.name:18} {defect.file:28} {caught}", flush=True)
    print(f"{len(chosen) - missed} of {len(chosen)} defects are caught")
    return 1 if missed else 0


def copy_tracked_files(target: Path) -> None:
    """Copy the files that git tracks, as they are now."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in listed.stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def plant(text: str, defect: Defect) -> str:
    """Return a source text with a defect; raises ValueError where it does not fit exactly once."""
    count = text.count(defect.old)
    if count != 1:
        raise ValueError(f"its text occurs {count} times in {defect.file}; correct the list")
    return text.replace(defect.old, defect.new)


def find_catching_test(copy: Path, defect: Defect) -> str | None:
    """Return the test that fails with a defect and passes without it; None without one.

    ValueError: the defect does not fit, or pytest cannot run its tests.
    """
    source = copy / "exwarp_cli" / defect.file
    sound = source.read_text(encoding="utf-8")
    source.write_text(plant(sound, defect), encoding="utf-8")
    try:
        output = run_tests(copy, [f"tests/{name}" for name in defect.tests.split()])
    finally:
        source.write_text(sound, encoding="utf-8")
    failed = re.search(r"^(?:FAILED|ERROR) (\S+::.+?)(?: - .*)?$", output, re.MULTILINE)
    if failed is None:
        return None
    return failed[1] if not run_tests(copy, [failed[1]]) else None


def run_tests(copy: Path, tests: list[str]) -> str:
    """Run tests up to the first one that fails, and return the output; "" if all pass."""
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.Popen(
        [sys.executable, *PYTEST, *tests], cwd=copy, env=environment, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        output, _ = process.communicate(timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return f"no result within {LIMIT_S} s"
    finally:
        with suppress(ProcessLookupError):  # a test's commands may be left
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    if process.returncode not in (0, 1):
        raise ValueError(f"pytest cannot run its tests:\n{output[-2000:]}")
    return output if process.returncode else ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
