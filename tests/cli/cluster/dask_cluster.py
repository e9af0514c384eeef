"""A Dask scheduler and its workers as they run on a farm: processes of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from exwarp_cli.io.files import ResourceOwner


class DaskCluster(ResourceOwner):
    """A scheduler without workers, until they are started; a context manager."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.workers: list[subprocess.Popen[bytes]] = []

    def _open(self, stack: ExitStack) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        address_file = self._folder / "scheduler.json"
        where = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", address_file)
        self._scheduler = self._start(stack, "scheduler", *where)
        deadline = time.monotonic() + 60
        while not address_file.exists() or not address_file.read_text():
            assert time.monotonic() < deadline, (self._folder / "log").read_text()
            time.sleep(0.05)
        self.address: str = json.loads(address_file.read_text())["address"]

    def start_worker(
        self, *options: object, cwd: Path | None = None, preload: str = ""
    ) -> subprocess.Popen[bytes]:
        """Start a worker with one thread, and code of its own that runs before all."""
        arguments: list[object] = ["--nthreads", "1", "--no-nanny", "--death-timeout", "30"]
        if preload:
            script = self._folder / f"preload_{len(self.workers)}.py"
            script.write_text(preload)
            arguments += ["--preload", script]
        arguments += ["--local-directory", self._folder, *options, self.address]
        self.workers.append(self._start(self._stack, "worker", *arguments, cwd=cwd))
        return self.workers[-1]

    def kill_scheduler(self) -> None:
        """Kill the scheduler, without a word to anybody."""
        _end(self._scheduler)

    def _start(
        self, stack: ExitStack, kind: str, *options: object, **more: Any
    ) -> subprocess.Popen[bytes]:
        module = f"distributed.cli.dask_{kind}"
        command = [sys.executable, "-m", module, "--no-dashboard", *map(str, options)]
        log = stack.enter_context((self._folder / "log").open("ab"))
        environment = os.environ | {"PYTHONWARNINGS": "ignore"}
        process = subprocess.Popen(command, stdout=log, stderr=log, env=environment, **more)
        stack.callback(_end, process)
        return process


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
