"""Clusters that cannot be reached or cannot do a job, and jobs that no cluster does."""

from __future__ import annotations

import errno
import os
import shutil
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from distributed import Client

from exwarp_cli import __version__
from exwarp_cli.errors import ClusterError
from exwarp_cli.farm import dask_cluster, dask_worker
from exwarp_cli.pipeline.progress import Progress
from tests.cli import shots
from tests.cli.shots import FORWARD

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


class TestRefusals:
    def run(self, exwarp, keys: Path, out: object, *options: object) -> Any:
        return exwarp("upsample", keys, "-o", out, "-m", "s6", *FORWARD, *options)

    def test_no_server_listens(self, exwarp, keys, tmp_path, monkeypatch):
        monkeypatch.setattr(dask_cluster, "CONNECT_S", 0.3)
        begin = time.monotonic()
        result = self.run(exwarp, keys, tmp_path / "out", "--cluster", "tcp://127.0.0.1:9")
        result.refused(9, "tcp://127.0.0.1:9", "dask scheduler")
        assert time.monotonic() - begin < 20
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize(
        "address",
        ["nonsense://x:1", "tcp://127.0.0.1:notaport", "127.0.0.1", "tls://127.0.0.1:9", "inproc:"],
    )
    def test_what_is_no_address(self, exwarp, keys, tmp_path, address, monkeypatch):
        monkeypatch.setattr(dask_cluster, "CONNECT_S", 0.3)
        self.run(exwarp, keys, tmp_path / "out", "--cluster", address).refused(9, address)

    @pytest.mark.parametrize("greeting", [b"HTTP/1.0 400 Bad Request\r\n\r\n" + 80 * b"x", b""])
    def test_another_server_listens(self, exwarp, keys, tmp_path, monkeypatch, greeting):
        monkeypatch.setattr(dask_cluster, "CONNECT_S", 0.3)
        with socket.create_server(("127.0.0.1", 0)) as server:
            threading.Thread(target=greet, args=(server, greeting), daemon=True).start()
            address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
            self.run(exwarp, keys, tmp_path / "out", "--cluster", address).refused(9, address)

    def test_a_worker_is_no_scheduler(self, exwarp, farm, keys, tmp_path):
        with Client(farm, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=60)
            worker = min(client.nthreads())
        result = self.run(exwarp, keys, tmp_path / "out", "--cluster", worker)
        result.refused(9, worker, "a worker of a cluster listens there")

    def test_a_client_that_gave_up(self, farm):
        with Client(farm, set_as_default=False) as client:
            pass
        requirements = dask_worker.WorkerRequirements((), version="0")
        dispatcher = dask_cluster.ChunkDispatcher(client, requirements, Progress())
        with pytest.raises(ClusterError, match="scheduler went away"):
            dispatcher.await_workers()

    def test_without_dask(self, exwarp, keys, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "distributed", None)
        for options in (
            ("--workers", 2),
            ("--cluster", "tcp://a:1"),
            ("--workers", 2, "--dry-run"),
        ):
            result = self.run(exwarp, keys, tmp_path / "out", *options)
            result.refused(7, 'pip install "exwarp[cluster]"')

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--workers", 2, "--cluster", "tcp://a:1"), ("--workers", "--cluster")),
            (("--chunk-size", 2), ("--chunk-size", "--workers")),
            (("--as-chunk",), ("--as-chunk", "--report")),
        ],
    )
    def test_options_that_do_not_go_together(self, exwarp, keys, tmp_path, options, words):
        self.run(exwarp, keys, tmp_path / "out", *options).refused(2, *words)
        assert not (tmp_path / "out").exists()

    def test_a_video_alone(self, exwarp, keys, tmp_path):
        result = self.run(exwarp, keys, tmp_path / "a.mp4", "--workers", 2)
        result.refused(2, "a.mp4", "--video")

    def test_frames_in_the_way(self, exwarp, farm, keys, tmp_path):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "shot.0003.exr").touch()
        self.run(exwarp, keys, tmp_path / "out", "--cluster", farm).refused(6, "frame 3")
        assert shots.names(tmp_path / "out") == ["shot.0003.exr"]

    def test_a_chunk_that_fails(self, exwarp, farm, keys, whole, tmp_path):
        broken = Path(shutil.copytree(keys, tmp_path / "keys"))
        data = (broken / "shot.0003.exr").read_bytes()
        (broken / "shot.0003.exr").write_bytes(data[: len(data) - 200])
        result = self.run(exwarp, broken, tmp_path / "out", "--cluster", farm, "--chunk-size", 1)
        result.refused(3, "shot.0003.exr")
        good, there = shots.contents(whole), shots.contents(tmp_path / "out")
        assert there and all(good[name] == data for name, data in there.items())

    def test_workers_of_another_version(self, exwarp, farm, keys, tmp_path):
        def change(version: str) -> None:
            from exwarp_cli.farm import dask_worker

            dask_worker.__version__ = version

        with changed(farm, partial(change, "0.0.1"), partial(change, __version__)):
            result = self.run(exwarp, keys, tmp_path / "out", "--cluster", farm)
        result.refused(9, "runs ExWarp 0.0.1", "install the same")

    def test_workers_that_see_other_files(self, exwarp, farm, keys, tmp_path):
        def hide() -> None:
            from exwarp_cli.farm import dask_worker

            dask_worker.is_visible = lambda path: False

        def show() -> None:
            from exwarp_cli.farm import dask_worker
            from exwarp_cli.io.files import is_visible

            dask_worker.is_visible = is_visible

        with changed(farm, hide, show):
            result = self.run(exwarp, keys, tmp_path / "out", "--cluster", farm)
        result.refused(9, str(tmp_path / "out"), "machines share")
        assert shots.names(tmp_path / "out") == []

    def test_workers_without_exwarp(self, exwarp, farm, keys, tmp_path):
        name = "exwarp_cli.farm.dask_worker"

        def hide() -> None:
            sys.modules["hidden"] = sys.modules.get(name)
            sys.modules[name] = None

        def show() -> None:
            module = sys.modules.pop("hidden")
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module

        with changed(farm, hide, show):
            result = self.run(exwarp, keys, tmp_path / "out", "--cluster", farm)
        result.refused(9, "cannot run ExWarp", "install the same on all")

    def test_a_worker_that_may_not_write_is_left_out(self, exwarp, farm, keys, tmp_path):
        def forbid() -> None:
            def touch(path: Path, *_: Any, **__: Any) -> None:
                raise OSError(errno.EROFS, "read-only", str(path))

            Path.allowed_touch, Path.touch = Path.touch, touch

        def allow() -> None:
            Path.touch = Path.allowed_touch

        options = ("--cluster", farm, "--chunk-size", 1)
        with changed(farm, forbid, allow, count=1):
            done = self.run(exwarp, keys, tmp_path / "out", *options)
        assert done.code == 0, done.err
        assert "is left out: it cannot write" in done.err and "read-only" in done.err

    def test_busy_workers_are_waited_for(self, exwarp, farm, keys, tmp_path, monkeypatch):
        free = tmp_path / "free"
        real = dask_cluster.chunks_of

        def free_soon(*arguments: Any) -> Any:
            """Free the workers a while after they were counted."""
            threading.Timer(1.0, free.touch).start()
            return real(*arguments)

        def wait(path: Path) -> None:
            while not path.exists():
                time.sleep(0.05)

        monkeypatch.setattr(dask_cluster, "ANSWER_S", 0.0)
        monkeypatch.setattr(dask_cluster, "POLL_S", 0.05)
        monkeypatch.setattr(dask_cluster, "chunks_of", free_soon)
        with Client(farm, set_as_default=False) as client:
            others = [
                client.submit(wait, free, workers=[worker], pure=False)
                for worker in client.nthreads()
            ]
            done = self.run(exwarp, keys, tmp_path / "out", "--cluster", farm)
            client.gather(others)
        assert done.code == 0, done.err
        assert done.err.count("waiting for a worker to be free") == 1


@contextmanager
def changed(
    farm: str, change: Callable[[], None], restore: Callable[[], None], count: int | None = None
) -> Iterator[None]:
    """Change some of the running workers for a while."""
    with Client(farm, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        workers = sorted(client.nthreads())[:count]
        client.run(change, workers=workers)
        try:
            yield
        finally:
            client.run(restore, workers=workers)


def greet(server: socket.socket, greeting: bytes) -> None:
    """Answer every client, or never; ends with the server."""
    silent = []
    with suppress(OSError):
        while True:
            client, _ = server.accept()
            client.sendall(greeting)
            if greeting:
                client.close()
            else:
                silent.append(client)
