"""A job on the workers of a cluster: the same bytes and the same report as in one process."""

from __future__ import annotations

import json
import os
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.farm.dask_cluster import VideoFromFrames
from exwarp_cli.pipeline.job import open_job
from tests.cli import shots
from tests.cli.cluster.results import KEYS, agree
from tests.cli.pictures import clip, frame
from tests.cli.reports import unmeasured
from tests.cli.shots import FORWARD
from tests.stereo_shots import arguments, write_stereo

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


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
    def test_frames_masks_video_and_report(self, both, shot, network, truth):
        sequence, *rest = shot["slot"]
        options = (*rest, "--extrapolator", network, "--ground-truth", truth, "--frames", "1-3")
        one, other = both(sequence, "-m", "oracle", *ALL, *options, size=1)
        assert len(shots.names(one / "frames")) == 12
        agree(one, other)

    def test_decisions(self, both, shot, network):
        sequence, *rest = shot["slot"]
        options = (*rest, "--extrapolator", network, "--frames", "2-4", "--report", "@report")
        one, other = both(sequence, "-m", "causal", *options, size=1)
        assert any(unmeasured(one / "report")["decisions"]["paths"].values())
        agree(one, other)

    def test_a_selection_with_cuts_and_without_tail(self, both, keys):
        options = ("--frames", "2-4", "--cuts", "auto,4", "--no-tail", "--report", "@report")
        one, other = both(keys, "-m", "softsplat", *FORWARD, *options)
        assert unmeasured(other / "report")["cuts"] == [{"frame": 4, "source": "given"}]
        agree(one, other)

    def test_layers_and_views_of_every_kind(self, both, tmp_path_factory):
        folder = write_stereo(tmp_path_factory.mktemp("stereo") / "keys", "parts", (1, 2))
        sequence, options = arguments(folder, "parts")
        everything = ("--view", "all", "--layers", "all", "--video", "@a.mp4")
        agree(*both(sequence, *options, "-m", "softsplat", *everything, size=1))

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
        with VideoFromFrames(job) as film:
            film.append(job.keys)
        assert Path(video).read_bytes() == single.read_bytes()

    def test_what_is_there_is_kept(self, exwarp, farm, keys, whole, tmp_path):
        out = Path(shutil.copytree(whole, tmp_path / "out"))
        (out / "shot.0007.exr").unlink()
        shots.truncate(out / "shot.0011.exr")

        def again() -> None:
            options = ("-m", "s6", *FORWARD, "--skip-existing", "--cluster", farm)
            assert exwarp("upsample", keys, "-o", out, *options).code == 0

        assert shots.changed_by(again, out) == {7, 11}
        assert shots.contents(out) == shots.contents(whole)

    def test_relative_paths_are_the_coordinators(self, exwarp, farm, keys, tmp_path, monkeypatch):
        shutil.copytree(keys, tmp_path / "shot")
        monkeypatch.chdir(tmp_path)
        options = ("-m", "s6", *FORWARD, "--report", "report", "--write-holes", "holes/")
        options += ("--frames", "1-2")
        done = exwarp("upsample", "shot", "-o", "out", *options, "--cluster", farm)
        assert done.code == 0, done.err
        assert [len(shots.names(tmp_path / name)) for name in ("out", "holes")] == [8, 6]
        assert unmeasured(tmp_path / "report")["input"]["pattern"] == "shot/shot.####.exr"
        assert "frames in out:" in done.out and "2 workers of tcp://" in done.err

    def test_progress_tells_each_frame_once(self, exwarp, farm, keys, tmp_path):
        options = ("-m", "s6", *FORWARD, "--progress", "json", "--json", "--cluster", farm)
        done = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        assert json.loads(done.out)["frames"]["written"] == 4 * KEYS
        events = [json.loads(line) for line in done.err.splitlines()]
        frames = [event["frame"] for event in events if event["event"] == "frame"]
        assert sorted(frames) == list(range(1, 4 * KEYS + 1))
        messages = [event["text"] for event in events if event["event"] == "message"]
        assert len(messages) == len(set(messages))

    def test_a_dry_run_counts_the_workers(self, exwarp, farm, keys, tmp_path):
        options = ("-m", "s6", *FORWARD, "--cluster", farm, "--dry-run", "--json")
        found = json.loads(exwarp("upsample", keys, "-o", tmp_path / "out", *options).out)
        assert found["spread"] == f"2 workers of {farm}"
        assert found["chunks"] == ["1", "2", "3", "4"]
        assert shots.names(tmp_path) == []
