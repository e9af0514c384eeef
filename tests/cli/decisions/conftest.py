"""A short shot whose motion changes from interval to interval, and runs on it that tests share.

The policy decides alone: `tests/cli/test_gate.py` has the gate before it.
"""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from exwarp_cli import cli
from tests.cli import shots
from tests.cli.shots import VECTORS
from tests.cli.street import Street
from tests.plots import leave_lines_out, leave_plots_out
from tests.reference.decisions import PATHS
from tests.unit import tiny_policies

STREET = Street(32, 18)
TIMES = (0.0, 1.0, 1.1, 2.6, 3.0, 4.2)
"""Of the key frames: what moves on evenly looks the same at every one."""

KEYS = len(TIMES)
SETTINGS = ("key", "slot")


@dataclass(frozen=True)
class Done:
    """What a run left behind."""

    out: Path
    report: dict[str, Any]
    rows: list[dict[str, str]]

    @property
    def frames(self) -> dict[str, bytes]:
        return shots.contents(self.out)

    @property
    def paths(self) -> list[str]:
        """The path of each key interval."""
        return [row["path"] for row in self.rows if row["slot"] == "1"]


def instants() -> list[float]:
    """Times of all slots up to the last key frame."""
    found = [a + i * (b - a) / 4 for a, b in itertools.pairwise(TIMES) for i in range(4)]
    return [*found, TIMES[-1]]


def write(folder: Path, frame: shots.FrameWriter, times: list[float]) -> Path:
    for number, time in enumerate(times, 1):
        frame(folder / f"shot.{number:04d}.exr", STREET, time)
    return folder


def write_shots(
    root: Path, key: shots.FrameWriter, colour: shots.FrameWriter, slot: shots.FrameWriter
) -> dict[str, tuple[object, ...]]:
    """Write the shot in both settings; return the arguments that name it."""
    keys = write(root / "keys", key, list(TIMES))
    bare = write(root / "colour", colour, list(TIMES))
    slots = write(root / "slots", slot, instants())
    return {"key": (keys, *VECTORS), "slot": (bare, "--gbuffers", slots, *VECTORS)}


@pytest.fixture(scope="session")
def uneven(tmp_path_factory) -> dict[str, tuple[object, ...]]:
    """Arguments that name the shot, by setting; read only."""
    root = tmp_path_factory.mktemp("uneven")
    return write_shots(root, shots.blender4, shots.colour_only, shots.slot_gbuffer)


@pytest.fixture(scope="session")
def truth(tmp_path_factory) -> Path:
    """The colour of every slot up to the last key frame; read only."""
    return write(tmp_path_factory.mktemp("truth") / "truth", shots.colour_only, instants())


@pytest.fixture(scope="session")
def policies(tmp_path_factory) -> Callable[[str], Path]:
    """Return the file of a policy: ``watching``, a path, or a choice that is always taken."""
    root = tmp_path_factory.mktemp("policies")

    def find(name: str) -> Path:
        path = root / f"{name}.npz"
        if not path.exists():
            makers = dict.fromkeys(PATHS, tiny_policies.taking)
            makers |= dict.fromkeys(tiny_policies.CHOICES, tiny_policies.always)
            made = makers[name](name) if name in makers else tiny_policies.watching()
            tiny_policies.save(path, made)
        return path

    return find


def take(given: tuple[object, ...], out: Path, *options: object) -> Done:
    """Run ``exwarp upsample`` with a report into a folder, and expect success."""
    keys, *rest = given
    report = out.parent / f"{out.name}-report"
    more = ("--progress", "none", "--threads", 1, "--report", report)
    line = ("upsample", keys, "-o", out, *rest, *more, *options)
    with pytest.MonkeyPatch.context() as patch:
        leave_plots_out(patch)
        leave_lines_out(patch)
        assert cli.run([str(argument) for argument in line]) == 0
    table = (report / "frames.csv").read_text(encoding="utf-8").splitlines()
    document = json.loads((report / "report.json").read_text(encoding="utf-8"))
    return Done(out, document, list(csv.DictReader(table)))


@pytest.fixture(scope="session")
def judged(tmp_path_factory, uneven, truth, network, policies) -> Callable[..., Done]:
    """Run a method, or a policy by its name, on the whole shot against the truth; each once."""
    root = tmp_path_factory.mktemp("judged")
    known: dict[tuple[str, str], Done] = {}

    def run(name: str, setting: str = "key") -> Done:
        if (name, setting) not in known:
            method = ("-m", name)
            if name not in ("oracle", "oracle-return") and not name.startswith("s"):
                method = ("-m", "causal", "--no-gate", "--policy", policies(name))
            if name != "s6":
                method += ("--extrapolator", network)
            out = root / f"{name}-{setting}"
            known[name, setting] = take(uneven[setting], out, *method, "--ground-truth", truth)
        return known[name, setting]

    return run


@pytest.fixture(scope="session")
def moving(tmp_path_factory, network, policies) -> Callable[[str], tuple[tuple[object, ...], Done]]:
    """Return the shot on windows that change, by setting, and a policy's run on it; each once."""
    from tests.cli.decisions.windows import moving_shots

    root = tmp_path_factory.mktemp("moving")
    given, known = moving_shots(root), dict[str, Done]()
    policy = ("--causal", "--no-gate", "--policy", policies("watching"))

    def run(setting: str) -> tuple[tuple[object, ...], Done]:
        if setting not in known:
            out = root / f"out-{setting}"
            known[setting] = take(given[setting], out, *policy, "--extrapolator", network)
        return given[setting], known[setting]

    return run
