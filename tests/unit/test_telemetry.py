"""ExWarp opens no connection: the libraries that would are silenced before they start."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LOAD = (
    "from exwarp_cli.models.picture_network import load_extrapolator; "
    "load_extrapolator(None, 1, 'cpu')"
)
"""As every method with a network does."""

BARE = "import onnxruntime"
"""As a program without ExWarp does."""

ROOT = Path(__file__).parents[2]

WAIT_S = 24
"""onnxruntime's first look-up comes 20 s after it starts."""

SILENCED = ("ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS", "CI")
"""Variables that stop the telemetry by themselves."""

LOOKUPS = """
#include <netdb.h>
#include <stdio.h>
#include <stdlib.h>
int getaddrinfo(const char *name, const char *service, const struct addrinfo *hints,
                struct addrinfo **found) {
  FILE *log = fopen(getenv("LOOKUPS"), "a");
  fprintf(log, "%s\\n", name ? name : "");
  fclose(log);
  return EAI_FAIL;
}
"""


def environment(home: Path, **more: str) -> dict[str, str]:
    """Return what a process in a new home folder sees."""
    kept = {k: v for k, v in os.environ.items() if k not in (*SILENCED, "XDG_CACHE_HOME")}
    return {**kept, "HOME": str(home), **more}


def written(home: Path) -> list[str]:
    return sorted(str(path.relative_to(home)) for path in home.rglob("*") if path.is_file())


@pytest.mark.parametrize(
    "code",
    [
        pytest.param(LOAD, id="method"),
        pytest.param("import exwarp_cli.farm.dask_worker, onnxruntime", id="Dask worker"),
        pytest.param("import exwarp_cli.research.training.onnx_export, onnxruntime", id="training"),
        pytest.param("import tests.bench, onnxruntime", id="bench"),
    ],
)
@pytest.mark.parametrize("wish", [{}, {"ORT_DISABLE_TELEMETRY": "0"}], ids=["unset", "0"])
def test_a_network_leaves_no_device_id_in_the_home_folder(tmp_path, code, wish):
    process = [sys.executable, "-c", code]
    subprocess.run(process, env=environment(tmp_path, **wish), check=True, cwd=ROOT)
    assert not [path for path in written(tmp_path) if "Microsoft" in path]


def test_commands_hand_it_on_to_every_process_that_they_start():
    code = (
        "import subprocess, sys, exwarp_cli; "
        "asked = 'import os; print(os.environ.get(\"ORT_DISABLE_TELEMETRY\"))'; "
        "subprocess.run([sys.executable, '-c', asked], check=True)"
    )
    environ = {k: v for k, v in os.environ.items() if k not in SILENCED}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environ, check=True, capture_output=True, text=True
    )
    assert done.stdout == "1\n"


@pytest.mark.slow
def test_a_network_looks_up_no_host(tmp_path):
    """Beside a process without ExWarp, which shows that look-ups are seen."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("needs a C compiler and Linux")
    source, shim = tmp_path / "lookups.c", tmp_path / "lookups.so"
    source.write_text(LOOKUPS)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", shim, source], check=True)
    logs, processes = [], []
    for name, code in (("ours", LOAD), ("bare", BARE)):
        home, log = tmp_path / name, tmp_path / f"{name}.log"
        home.mkdir()
        log.touch()
        watched = environment(home, LD_PRELOAD=str(shim), LOOKUPS=str(log))
        waiting = f"{code}; import time; time.sleep({WAIT_S})"
        processes.append(subprocess.Popen([sys.executable, "-c", waiting], env=watched))
        logs.append(log)
    assert [process.wait() for process in processes] == [0, 0]
    ours, bare = (log.read_text() for log in logs)
    if written(tmp_path / "bare"):  # not before onnxruntime 1.29
        assert "microsoft.com" in bare
    assert ours == ""
