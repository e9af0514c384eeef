"""A job on the workers of a cluster: the same bytes and the same report as in one process."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from distributed import Client

from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.errors import ClusterError
from exwarp_cli.farm import cluster_client, cluster_dispatch, cluster_work
from exwarp_cli.io.atomic import MARK, _host
from exwarp_cli.pipeline.filming import Film
from exwarp_cli.pipeline.job import open_job
from tests.cli import shots
from tests.cli.dask_cluster import DaskCluster
from tests.cli.pictures import clip, frame
from tests.cli.reports import album, rows, unmeasured
from tests.cli.shots import FORWARD, SMALL
from tests.stereo_shots import arguments, write_stereo

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

KEYS = 6


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("six") / "keys"
    return shots.sequence(folder, shots.plain, range(1, KEYS + 1), SMALL)


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Path:
    return shots.truth(tmp_path_factory.mktemp("six-truth") / "truth", KEYS, 1, SMALL)


@pytest.fixture(scope="module")
def farm(tmp_path_factory) -> Iterator[str]:
    """The address of a scheduler with two workers."""
    with DaskCluster(tmp_path_factory.mktemp("farm")) as cluster:
        for _ in range(2):
            cluster.start_worker()
        yield cluster.address


def agree(one: Path, other: Path) -> None:
    """Judge that two folders hold the same frames, masks, videos and reports."""
    assert shots.names(one) == shots.names(other)
    for name in ("frames", "holes"):
        assert shots.contents(one / name) == shots.contents(other / name)
        assert not [n for n in shots.names(other / name) if MARK in n]
    if (one / "a.mp4").exists():
        assert (one / "a.mp4").read_bytes() == (other / "a.mp4").read_bytes()
    if (one / "report").exists():
        for told in (unmeasured, rows, album):
            assert told(one / "report") == told(other / "report")


Both = Callable[..., tuple[Path, Path]]


@pytest.fixture
def both(upsample, farm, tmp_path) -> Both:
    """Do a job in this process and on the cluster; return where what they wrote lies."""

    def run(sequence: object, *options: object, size: int = 2) -> tuple[Path, Path]:
        one, other = tmp_path / "one", tmp_path / "other"
        for root, more in ((one, ()), (other, ("--cluster", farm, "--chunk-size", size))):
            placed = [root / o[1:] if isinstance(o, str) and o[:1] == "@" else o for o in options]
            upsample(sequence, root / "frames", *placed, *more)
        return one, other

    return run


ALL = ("--write-holes", "@holes", "--video", "@a.mp4", "--report", "@report")


class TestSame:
    @pytest.mark.parametrize("method", ["s6", "softsplat"])
    def test_frames_masks_video_and_report(self, both, keys, truth, method):
        one, other = both(keys, "-m", method, *ALL, "--ground-truth", truth)
        assert len(shots.names(one / "frames")) == 4 * KEYS
        agree(one, other)

    @pytest.mark.parametrize("method", ["exwarp", pytest.param("oracle", marks=pytest.mark.slow)])
    def test_methods_that_decide(self, both, shot, network, tmp_path_factory, method):
        sequence, *rest = shot["slot"]
        truth = shots.truth(tmp_path_factory.mktemp("five") / "truth", shots.KEYS, 1, SMALL)
        told = (*rest, "-m", method, "--extrapolator", network, "--ground-truth", truth)
        one, other = both(sequence, *told, "--report", "@report", size=1)
        assert any(unmeasured(one / "report")["decisions"]["paths"].values())
        agree(one, other)

    def test_a_selection_with_cuts_and_without_tail(self, both, keys):
        options = ("--frames", "2-6", "--cuts", "auto,4", "--no-tail", "--report", "@report")
        one, other = both(keys, "-m", "softsplat", *FORWARD, *options)
        assert unmeasured(other / "report")["cuts"] == [{"frame": 4, "source": "given"}]
        agree(one, other)

    @pytest.mark.slow
    def test_layers_and_views_of_every_kind(self, both, tmp_path_factory):
        folder = write_stereo(tmp_path_factory.mktemp("stereo") / "keys", "parts")
        sequence, told = arguments(folder, "parts")
        everything = ("--view", "all", "--layers", "all", "--video", "@a.mp4")
        agree(*both(sequence, *told, "-m", "softsplat", *everything, size=1))

    @pytest.mark.slow
    def test_a_video_with_sound(self, both, tmp_path_factory):
        pytest.importorskip("cv2")
        film = tmp_path_factory.mktemp("clip") / "film.mp4"
        clip(film, [frame(time) for time in range(5)])
        agree(*both(film, "--video", "@a.mp4", "--frames", "1-3"))
        family = psutil.Process().children(recursive=True)
        assert not [one for one in family if "ffmpeg" in one.name()]

    def test_the_video_waits_for_frames_to_show(self, upsample, keys, tmp_path):
        out, single = tmp_path / "out", tmp_path / "single.mp4"
        upsample(keys, out, "-m", "hold", "--video", single, "--frames", "1-2")
        video = str(tmp_path / "a.mp4")
        source = SourceSettings(str(keys))
        settings = UpsampleSettings(source, str(out), method="hold", frames="1-2", video=video)
        (out / "shot.0003.exr").rename(tmp_path / "hidden")
        shows = threading.Timer(0.5, (tmp_path / "hidden").rename, [out / "shot.0003.exr"])
        shows.start()
        job = open_job(settings)
        with Film(job) as film:
            film.append(job.keys)
        assert Path(video).read_bytes() == single.read_bytes()

    def test_what_is_there_is_kept(self, both, exwarp, farm, keys, tmp_path):
        one, other = both(keys, "-m", "s6", *FORWARD)
        (other / "frames" / "shot.0007.exr").unlink()
        (other / "frames" / "shot.0011.exr").write_bytes(b"damaged")

        def again() -> None:
            options = ("-m", "s6", *FORWARD, "--skip-existing", "--cluster", farm)
            assert exwarp("upsample", keys, "-o", other / "frames", *options).code == 0

        assert shots.changed_by(again, other / "frames") == {7, 11}
        agree(one, other)

    def test_relative_paths_are_the_coordinators(self, exwarp, farm, keys, tmp_path, monkeypatch):
        shutil.copytree(keys, tmp_path / "shot")
        monkeypatch.chdir(tmp_path)
        options = ("-m", "s6", *FORWARD, "--report", "report", "--write-holes", "holes/")
        done = exwarp("upsample", "shot", "-o", "out", *options, "--cluster", farm)
        assert done.code == 0, done.err
        assert len(shots.names(tmp_path / "out")) == 4 * KEYS
        assert unmeasured(tmp_path / "report")["input"]["pattern"] == "shot/shot.####.exr"
        assert "frames in out:" in done.out and "2 workers of tcp://" in done.err

    def test_progress_tells_each_frame_once(self, exwarp, farm, keys, tmp_path):
        options = ("-m", "s6", *FORWARD, "--progress", "json", "--json", "--cluster", farm)
        done = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        assert json.loads(done.out)["frames"]["written"] == 4 * KEYS
        told = [json.loads(line) for line in done.err.splitlines()]
        frames = [event["frame"] for event in told if event["event"] == "frame"]
        assert sorted(frames) == list(range(1, 4 * KEYS + 1))
        messages = [event["text"] for event in told if event["event"] == "message"]
        assert len(messages) == len(set(messages))

    def test_a_dry_run_counts_the_workers(self, exwarp, farm, keys, tmp_path):
        options = ("-m", "s6", *FORWARD, "--cluster", farm, "--dry-run", "--json")
        found = json.loads(exwarp("upsample", keys, "-o", tmp_path / "out", *options).out)
        assert found["spread"] == f"2 workers of {farm}"
        assert found["chunks"] == ["1", "2", "3", "4", "5", "6"]
        assert shots.names(tmp_path) == []


class TestRefusals:
    def run(self, exwarp, keys: Path, out: object, *options: object) -> Any:
        return exwarp("upsample", keys, "-o", out, "-m", "s6", *FORWARD, *options)

    def test_nobody_listens(self, exwarp, keys, tmp_path, monkeypatch):
        monkeypatch.setattr(cluster_client, "CONNECT_S", 1.0)
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
        monkeypatch.setattr(cluster_client, "CONNECT_S", 1.0)
        self.run(exwarp, keys, tmp_path / "out", "--cluster", address).refused(9, address)

    @pytest.mark.parametrize("greeting", [b"HTTP/1.0 400 Bad Request\r\n\r\n" + 80 * b"x", b""])
    def test_somebody_else_listens(self, exwarp, keys, tmp_path, monkeypatch, greeting):
        monkeypatch.setattr(cluster_client, "CONNECT_S", 1.0)
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
        needs = cluster_work.Needs("0", ())
        dispatch = cluster_dispatch.Dispatch(client, needs, *4 * [lambda *_: None])
        with pytest.raises(ClusterError, match="scheduler went away"):
            dispatch.muster()

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

    def test_a_chunk_that_fails(self, exwarp, farm, keys, tmp_path):
        broken = Path(shutil.copytree(keys, tmp_path / "keys"))
        data = (broken / "shot.0005.exr").read_bytes()
        (broken / "shot.0005.exr").write_bytes(data[: len(data) - 200])
        result = self.run(exwarp, broken, tmp_path / "out", "--cluster", farm, "--chunk-size", 1)
        result.refused(3, "shot.0005.exr")
        whole = tmp_path / "whole"
        assert self.run(exwarp, keys, whole).code == 0
        good, there = shots.contents(whole), shots.contents(tmp_path / "out")
        assert there and all(good[name] == data for name, data in there.items())

    def test_workers_that_cannot(self, exwarp, keys, tmp_path, monkeypatch):
        """First one of another version; then one that sees other files; then a good one too."""
        other = "import exwarp_cli; exwarp_cli.__version__ = '0.0.1'"
        blind = (
            "from pathlib import Path; real = Path.exists\n"
            "Path.exists = lambda path, **k: 'exwarp-tmp' not in path.name and real(path, **k)"
        )
        with DaskCluster(tmp_path / "dask") as cluster:
            cluster.start_worker(preload=other)
            result = self.run(exwarp, keys, tmp_path / "out", "--cluster", cluster.address)
            result.refused(9, "runs ExWarp 0.0.1", "install the same")
            cluster.workers[0].kill()
            worker = cluster.start_worker(preload=blind)
            monkeypatch.setattr(cluster_dispatch, "PATIENCE_S", 60.0)
            result = self.run(exwarp, keys, tmp_path / "out", "--cluster", cluster.address)
            result.refused(9, str(tmp_path / "out"), "machines share")
            assert shots.names(tmp_path / "out") == []
            assert worker.poll() is None

    def test_a_worker_that_may_not_write_is_left_out(self, exwarp, keys, tmp_path):
        read_only = (
            "import errno; from pathlib import Path\n"
            "def touch(path, *a, **k): raise OSError(errno.EROFS, 'read-only', str(path))\n"
            "Path.touch = touch"
        )
        with DaskCluster(tmp_path / "dask") as cluster:
            cluster.start_worker(preload=read_only)
            cluster.start_worker()
            with Client(cluster.address, set_as_default=False) as client:
                client.wait_for_workers(2, timeout=60)
            options = ("--cluster", cluster.address, "--chunk-size", 1)
            done = self.run(exwarp, keys, tmp_path / "out", *options)
        assert done.code == 0, done.err
        assert "is left out: it cannot write" in done.err and "read-only" in done.err

    def test_busy_workers_are_waited_for(self, exwarp, keys, tmp_path, monkeypatch):
        monkeypatch.setattr(cluster_dispatch, "PATIENCE_S", 1.0)
        monkeypatch.setattr(cluster_dispatch, "ANSWER_S", 1.0)
        with (
            DaskCluster(tmp_path / "dask") as cluster,
            Client(cluster.address, set_as_default=False) as client,
        ):
            cluster.start_worker()
            client.wait_for_workers(1, timeout=60)
            other = client.submit(time.sleep, 5)
            done = self.run(exwarp, keys, tmp_path / "out", "--cluster", cluster.address)
            assert other.done()
        assert done.code == 0, done.err
        assert done.err.count("waiting for a worker to be free") == 1


class TestLosses:
    def test_a_worker_that_is_killed_on_the_way(self, upsample, keys, tmp_path, monkeypatch):
        one, other = tmp_path / "one", tmp_path / "other"
        beside = [(root / "a.mp4", root / "report") for root in (one, other)]
        how = ("-m", "softsplat", *FORWARD)
        upsample(keys, one / "frames", *how, "--video", beside[0][0], "--report", beside[0][1])
        more = ("--video", beside[1][0], "--report", beside[1][1], "--chunk-size", 3)
        scratch = tmp_path / "scratch"
        scratch.mkdir()
        monkeypatch.setenv("TMPDIR", str(scratch))
        with start(keys, other / "frames", *how, *more, "--workers", 2) as process:
            await_frames(process, other / "frames", 2)
            victim = worker_processes(process)[0]
            victim.kill()
            out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert "was lost; frames" in err and "are done again" in err
        assert f"{4 * KEYS} frames in" in out
        assert [line for line in err.splitlines() if not line.startswith("exwarp: ")] == []
        assert not [name for name in shots.names(scratch) if "exwarp" in name or "dask" in name]
        agree(one, other)

    @pytest.mark.parametrize(
        "stop",
        [
            signal.SIGINT,
            pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
            pytest.param(signal.SIGKILL, marks=pytest.mark.slow),
        ],
    )
    def test_ending_leaves_no_worker(self, exwarp, keys, tmp_path, stop):
        out = tmp_path / "out"
        how = ("-m", "s6", *FORWARD)
        with start(keys, out, *how, "--workers", 2, "--chunk-size", 1) as process:
            await_frames(process, out, 2)
            family = worker_processes(process)
            os.killpg(process.pid, stop) if stop == signal.SIGINT else process.send_signal(stop)
            _, err = process.communicate(timeout=60)
        expected = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -signal.SIGKILL}
        assert process.returncode == expected[stop], err
        assert psutil.wait_procs(family, timeout=10)[1] == []
        if stop != signal.SIGKILL:
            assert "--skip-existing goes on" in err and "Traceback" not in err
            assert not [name for name in shots.names(out) if MARK in name]
        assert exwarp("upsample", keys, "-o", out, *how, "--skip-existing").code == 0
        assert exwarp("upsample", keys, "-o", tmp_path / "whole", *how).code == 0
        assert shots.contents(out) == shots.contents(tmp_path / "whole")

    @pytest.mark.slow
    def test_what_a_hung_worker_leaves_is_removed(self, keys, tmp_path):
        out = tmp_path / "out"
        with start(keys, out, "-m", "s6", *FORWARD, "--workers", 1) as process:
            await_frames(process, out, 1)
            (worker,) = worker_processes(process)
            worker.suspend()
            begun = out / f".shot.0009.exr.{_host()}-{worker.pid}-99{MARK}"
            begun.touch()
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=60)
        assert process.returncode == 130, err
        assert not worker.is_running() and not begun.exists()

    @pytest.mark.slow
    def test_a_scheduler_that_is_killed(self, keys, tmp_path):
        out = tmp_path / "out"
        how = ("-m", "softsplat", *FORWARD)
        with DaskCluster(tmp_path / "dask") as cluster:
            cluster.start_worker()
            options = (*how, "--cluster", cluster.address, "--chunk-size", 2)
            with start(keys, out, *options) as process:
                await_frames(process, out, 1)
                cluster.kill_scheduler()
                _, err = process.communicate(timeout=120)
        assert [line for line in err.splitlines() if not line.startswith("exwarp: ")] == []
        assert process.returncode == 9 and "the Dask scheduler went away" in err


def greet(server: socket.socket, greeting: bytes) -> None:
    """Answer whoever comes, or never; ends with the server."""
    silent = []
    with suppress(OSError):
        while True:
            somebody, _ = server.accept()
            somebody.sendall(greeting)
            if greeting:
                somebody.close()
            else:
                silent.append(somebody)


def start(keys: Path, out: Path, *options: object) -> subprocess.Popen[str]:
    """Start the command in a session of its own, as a terminal would."""
    told = [sys.executable, "-m", "exwarp_cli", "upsample", keys, "-o", out, *options]
    return subprocess.Popen(
        [str(word) for word in told],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def await_frames(process: subprocess.Popen[str], folder: Path, count: int) -> None:
    """Wait until so many frames are there, while more are to come."""
    deadline = time.monotonic() + 120
    while sum(name.endswith(".exr") for name in shots.names(folder)) < count:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.002)


def worker_processes(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Return the processes that do the work."""
    family = psutil.Process(process.pid).children(recursive=True)
    return [one for one in family if "spawn_main" in " ".join(one.cmdline())]
