"""ExWarp opens no connection: the libraries that would are silenced before they start."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.matrix import combinations

LOAD = (
    "from exwarp_cli.models.picture_network import load_extrapolator; "
    "load_extrapolator(None, 1, 'cpu')"
)
"""As every method with a network does."""

BARE = "import onnxruntime"
"""As a program without ExWarp does."""

ROOT = Path(__file__).parents[2]

WAIT_S = 3
"""How much longer a process without look-ups is watched than it takes another one to do any."""

LIMIT_S = 30
"""For the other one to do any."""

SILENCED = ("ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS", "CI")
"""Variables that stop the telemetry by themselves."""

SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <netdb.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

/* Seconds that threads did not have to wait. */
static atomic_long skipped;

int getaddrinfo(const char *name, const char *service, const struct addrinfo *hints,
                struct addrinfo **found) {
  FILE *log = fopen(getenv("LOOKUPS"), "a");
  fprintf(log, "%s\\n", name ? name : "");
  fclose(log);
  return EAI_FAIL;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
  int result = syscall(SYS_clock_gettime, clock, now);
  now->tv_sec += skipped;
  return result;
}

int pthread_cond_timedwait(pthread_cond_t *cond, pthread_mutex_t *mutex,
                           const struct timespec *end) {
  int (*wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *) =
      dlsym(RTLD_NEXT, "pthread_cond_timedwait");
  struct timespec now, soon = *end;
  clock_gettime(CLOCK_REALTIME, &now);
  long before = skipped, extra = end->tv_sec - now.tv_sec - 1;
  int is_shortened = 0 < extra && extra < 100;
  soon.tv_sec -= before + (is_shortened ? extra : 0);
  int result = wait(cond, mutex, &soon);
  if (is_shortened && result == ETIMEDOUT)
    atomic_compare_exchange_strong(&skipped, &before, before + extra);
  return result;
}
"""
"""Notes look-ups, and shortens waits: onnxruntime's first look-up comes 20 s after it starts."""


def environment(home: Path, **more: str) -> dict[str, str]:
    """Return what a process in a new home folder sees."""
    kept = {k: v for k, v in os.environ.items() if k not in (*SILENCED, "XDG_CACHE_HOME")}
    return {**kept, "HOME": str(home), **more}


def written(home: Path) -> list[str]:
    return sorted(str(path.relative_to(home)) for path in home.rglob("*") if path.is_file())


CODES = (
    LOAD,
    "import exwarp_cli.farm.dask_worker, onnxruntime",
    "import exwarp_cli.research.training.onnx_export, onnxruntime",
    "import tests.bench, onnxruntime",
)
"""A method, a Dask worker, training and a bench."""


@pytest.mark.parametrize(
    ("code", "wish"), combinations(CODES, [{}, {"ORT_DISABLE_TELEMETRY": "0"}])
)
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


def test_a_network_looks_up_no_host(tmp_path):
    """Beside a process without ExWarp, which shows that look-ups are seen."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("needs a C compiler and Linux")
    source, shim = tmp_path / "shim.c", tmp_path / "shim.so"
    source.write_text(SHIM)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", shim, source, "-ldl"], check=True)
    logs, processes, begin = [], [], time.monotonic()
    for name, code in (("ours", LOAD), ("bare", BARE)):
        home, log = tmp_path / name, tmp_path / f"{name}.log"
        home.mkdir()
        log.touch()
        watched = environment(home, LD_PRELOAD=str(shim), LOOKUPS=str(log))
        waiting = [sys.executable, "-c", f"{code}; input()"]
        processes.append(subprocess.Popen(waiting, env=watched, stdin=subprocess.PIPE, text=True))
        logs.append(log)
    while not logs[1].read_text() and time.monotonic() < begin + LIMIT_S:
        time.sleep(0.05)
    time.sleep(WAIT_S + time.monotonic() - begin)
    for process in processes:
        process.communicate("\n")
    assert [process.returncode for process in processes] == [0, 0]
    ours, bare = (log.read_text() for log in logs)
    if written(tmp_path / "bare"):  # not before onnxruntime 1.29
        assert "microsoft.com" in bare
    assert ours == ""
