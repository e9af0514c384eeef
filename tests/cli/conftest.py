"""The command in this process, and the shots that tests share."""

from __future__ import annotations

import builtins
import hashlib
import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from exwarp_cli import cli
from exwarp_cli.domain.motion import MotionFinding
from exwarp_cli.pipeline import motion_convention
from exwarp_cli.runtime.compilation import COMPILED, COMPILING
from tests.cli import shots
from tests.cli.shots import FORWARD, KEYS, SMALL, VECTORS
from tests.plots import leave_lines_out, leave_plots_out
from tests.unit.tiny_models import convolution, save


@dataclass(frozen=True)
class Result:
    """What a user sees of a command."""

    code: int
    out: str
    err: str

    def refused(self, code: int, *words: str) -> None:
        """Judge a failure: its exit code, and one sentence that holds these words."""
        assert self.code == code, self.err
        errors = [line for line in self.err.splitlines() if line.startswith("exwarp: error: ")]
        assert len(errors) == 1, self.err
        rest = [line for line in self.err.splitlines() if not line.startswith("exwarp: ")]
        assert rest == [] and self.out == "", self.err + self.out
        assert "Traceback" not in self.err and "unexpected" not in errors[0]
        for word in words:
            assert word in errors[0]


Command = Callable[..., Result]


def without_compilation(text: str) -> str:
    """Drop the lines about compilation, which depend on what the disk cache holds."""
    starts = (f"exwarp: {COMPILING}", f"exwarp: {COMPILED}")
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith(starts))


@pytest.fixture(scope="module", autouse=True)
def unwritten_plots() -> Iterator[None]:
    """Leave plots out; `tests/web` and `test_hostile_names` look at what is written."""
    with pytest.MonkeyPatch.context() as patch:
        leave_plots_out(patch)
        yield


def run_quietly(*words: object) -> None:
    """Run a command that has to succeed, for fixtures that outlive a test; leave plots out.

    One thread: more only wait for each other on small frames.
    """
    quiet = ("--progress", "none", *(("--threads", 1) if words[0] == "upsample" else ()))
    with pytest.MonkeyPatch.context() as patch:
        leave_plots_out(patch)
        leave_lines_out(patch)
        assert cli.run([str(word) for word in (*words, *quiet)]) == 0


@pytest.fixture(scope="module")
def unpainted_plots() -> Iterator[None]:
    """Leave out the lines and axes of plots, too, which take a third of a second a report."""
    with pytest.MonkeyPatch.context() as patch:
        leave_lines_out(patch)
        yield


@pytest.fixture(scope="session", autouse=True)
def conventions_measured_once() -> Iterator[None]:
    """Measure what vectors mean once for each set of frames: most of the time of a short run."""
    findings: dict[bytes, MotionFinding] = {}
    measure = motion_convention.calibrate

    def calibrate(*arguments: Any) -> MotionFinding:
        key = hashlib.sha256(pickle.dumps(arguments)).digest()
        if key not in findings:
            findings[key] = measure(*arguments)
        return findings[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion_convention, "calibrate", calibrate)
        yield


@pytest.fixture
def exwarp(capfd, monkeypatch) -> Command:
    """Run a command line; what libraries print past Python counts as well."""
    monkeypatch.delenv("EXWARP_DEBUG", raising=False)

    def run(*arguments: object) -> Result:
        capfd.readouterr()
        code = cli.run([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return Result(code, out, without_compilation(err))

    return run


@pytest.fixture
def upsample(exwarp) -> Command:
    """Run ``exwarp upsample`` on a sequence into a folder, in silence, and expect success.

    One thread, unless an option says otherwise: more only wait for each other on small frames.
    """

    def run(sequence: object, output: object, *options: object) -> Result:
        quiet = ("--progress", "none", "--threads", 1)
        result = exwarp("upsample", sequence, "-o", output, *quiet, *options)
        assert result.code == 0, result.err
        return result

    return run


@pytest.fixture(scope="session")
def plain_shot(tmp_path_factory) -> Path:
    """Three plain frames, 1 to 3; read only."""
    return shots.sequence(tmp_path_factory.mktemp("plain") / "keys")


@pytest.fixture(scope="session")
def plain_truth(tmp_path_factory) -> Path:
    """The truth of `plain_shot`, frames 1 to 9; read only."""
    return shots.truth(tmp_path_factory.mktemp("truth") / "truth")


@pytest.fixture(scope="session")
def network(tmp_path_factory) -> Path:
    """An ONNX file, read only."""
    return save(tmp_path_factory.mktemp("network") / "tiny.onnx", convolution())


@pytest.fixture(scope="session")
def shot(tmp_path_factory) -> dict[str, tuple[object, ...]]:
    """Arguments that name the input, by setting: five key frames, and slots up to the last."""
    root = tmp_path_factory.mktemp("shot")
    keys = shots.sequence(root / "keys", shots.plain, range(1, KEYS + 1), SMALL)
    colour = shots.sequence(root / "colour", shots.colour_only, range(1, KEYS + 1), SMALL)
    slots = shots.sequence(
        root / "slots", shots.slot_gbuffer, range(1, 4 * KEYS - 2), SMALL, step=0.25
    )
    return {"key": (keys, *FORWARD), "slot": (colour, "--gbuffers", slots, *VECTORS)}


@pytest.fixture
def make(upsample, shot, network, tmp_path) -> Callable[..., Path]:
    """Run a method on the shot into a folder of its own; return the folder."""

    def run(name: str, method: str, *options: object, setting: str = "key", **more: Any) -> Path:
        keys, *rest = more.get("shot", shot[setting])
        out = tmp_path / name
        model = ("--extrapolator", more.get("network", network))
        upsample(keys, out, "-m", method, *rest, *model, *options)
        return out

    return run


@pytest.fixture
def without_torch(monkeypatch) -> None:
    """Fail whatever imports torch or onnx."""
    real = builtins.__import__

    def guarded(name: str, *args: Any, **kwargs: Any) -> Any:
        assert not name.startswith(("torch", "onnx")), name
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", guarded)
