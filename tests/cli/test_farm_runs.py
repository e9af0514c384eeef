"""Jobs run by Open Job Description's own engine: the bytes of a single run, whatever happens."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from exwarp_cli.io.files import TEMPORARY_SUFFIX
from exwarp_cli.io.generated_frames import is_intact
from tests.cli import shots
from tests.cli.farm_engine import EXWARP, HOSTILE, Ended, environment, openjd
from tests.cli.processes import await_files
from tests.cli.reports import rows, unmeasured
from tests.cli.shots import FORWARD, SMALL

pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="signals of POSIX"),
]

HOW = (*FORWARD, "--threads", 1)


@pytest.fixture
def job(exwarp, tmp_path, monkeypatch):
    """Write a job's template into the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EXWARP_CONFIG", "")

    def write(*options: object) -> Path:
        result = exwarp("farm", "openjd", *options, *HOW, "--command", EXWARP)
        assert result.code == 0, result.err
        path = tmp_path / "template.yaml"
        path.write_text(result.out, encoding="utf-8")
        return path

    return write


@pytest.fixture
def ran(job, tmp_path):
    """Write a job and run it."""

    def run(*options: object) -> Ended:
        return openjd("run", job(*options), cwd=tmp_path)

    return run


class TestSameBytes:
    def test_three_chunks_with_report_and_video(self, ran, upsample, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.plain, range(1, 6), SMALL)
        truth = shots.truth(tmp_path / "truth", 5, street=SMALL)
        both = ("-m", "softsplat", "--ground-truth", truth, "--metrics", "psnr")
        last = ("--report", "report", "--video", "a.mp4")
        ended = ran("keys", "-o", "out", "--chunk-size", 2, *both, *last)
        assert ended.code == 0 and ended.log.count("--------- Running Task") == 5, ended.log
        single = ("--report", "single-report", "--video", "single.mp4")
        upsample(keys, tmp_path / "single", *both, *FORWARD, *single)
        assert len(shots.names(tmp_path / "report" / "chunks")) == 3
        assert shots.contents(tmp_path / "out") == shots.contents(tmp_path / "single")
        assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "single.mp4").read_bytes()
        merged, whole = (unmeasured(tmp_path / name) for name in ("report", "single-report"))
        assert merged["input"]["pattern"] == f"{keys}/shot.####.exr"  # jobs name whole paths
        assert merged == whole and whole["quality"]["all"]["frames"] == 12
        assert rows(tmp_path / "report") == rows(tmp_path / "single-report")
        assert "openjd_progress: 100.0" in ended.log and "openjd_status: " in ended.log

    def test_a_plain_template_of_frames_in_steps(self, ran, upsample, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.plain, (-4, 0, 4), SMALL)
        ended = ran("keys", "-o", "out", "--chunk-size", 2, "--plain", "-m", "s6")
        assert ended.code == 0 and ended.log.count("--------- Running Task") == 2, ended.log
        upsample(keys, tmp_path / "single", *FORWARD, "-m", "s6")
        assert shots.contents(tmp_path / "out") == shots.contents(tmp_path / "single")

    def test_chunks_of_frames_in_steps_with_hostile_names(self, ran, upsample, tmp_path):
        folder = tmp_path / HOSTILE
        for i, number in enumerate((-4, 0, 4)):
            shots.plain(folder / f"{HOSTILE}.{number:04d}.exr", SMALL, i)
        out = f"out {HOSTILE}/"
        ended = ran(f"{HOSTILE}/", "-o", out, "--chunk-size", 2, "-m", "s6")
        assert ended.code == 0 and ended.log.count("--------- Running Task") == 2, ended.log
        upsample(folder, tmp_path / "single", *FORWARD, "-m", "s6")
        assert shots.contents(tmp_path / out) == shots.contents(tmp_path / "single")

    def test_a_bundle_elsewhere(self, exwarp, upsample, tmp_path, monkeypatch):
        """What submits a bundle hands its values over, as here by hand."""
        keys = shots.sequence(tmp_path / "keys", shots.plain, (1, 2), SMALL)
        (tmp_path / "jobs").mkdir()
        monkeypatch.chdir(tmp_path)
        options = ("--command", EXWARP, "-m", "s6", *HOW)
        exwarp("farm", "openjd", "keys", "-o", "out", *options, "--bundle", "jobs/one")
        values = (f"-p{name}={tmp_path / place}" for name, place in
                  (("SequenceFolder", "keys"), ("OutputFolder", "new")))  # fmt: skip
        ended = openjd("run", "one/template.yaml", *values, cwd=tmp_path / "jobs")
        assert ended.code == 0, ended.log
        upsample(keys, tmp_path / "single", *FORWARD, "-m", "s6")
        assert shots.contents(tmp_path / "new") == shots.contents(tmp_path / "single")


class TestTrouble:
    @pytest.fixture
    def keys(self, tmp_path) -> Path:
        return shots.sequence(tmp_path / "keys", shots.plain, range(1, 7), SMALL)

    @pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
    def test_a_job_that_broke_off_goes_on(self, job, upsample, tmp_path, number):
        keys = shots.sequence(tmp_path / "keys", shots.plain, range(1, 13), SMALL)
        template = job("keys", "-o", "out", "--chunk-size", 12, "-m", "softsplat")
        words = [sys.executable, "-m", "openjd", "run", str(template)]
        with subprocess.Popen(
            words,
            cwd=tmp_path,
            env=environment(tmp_path),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as engine:
            await_files(engine, tmp_path / "out", 5)
            if number == signal.SIGKILL:
                strike(tmp_path / "out")
            else:
                engine.send_signal(number)
            engine.communicate(timeout=120)
        assert engine.returncode != 0
        before = shots.contents(tmp_path / "out")
        assert len(before) < 48
        rendered = {shots.passed_through(path, 120) for path in keys.iterdir()}
        for name, data in before.items():
            frame = data in rendered or is_intact(data)
            assert frame or (TEMPORARY_SUFFIX in name and number == signal.SIGKILL)
        ended = openjd("run", template, cwd=tmp_path)
        assert ended.code == 0, ended.log
        upsample(keys, tmp_path / "single", *FORWARD, "-m", "softsplat")
        assert shots.contents(tmp_path / "out") == shots.contents(tmp_path / "single")

    def test_a_task_that_fails_says_why_and_the_job_is_submitted_again_when_that_is_mended(
        self, keys, job, upsample, tmp_path, monkeypatch
    ):
        """With other chunks, and to machines that set what the job leaves as it is."""
        more = ("-m", "s6", "--report", "report", "--chunk-size", 3)
        template = job("keys", "-o", "out", *more)
        good = (keys / "shot.0006.exr").read_bytes()
        (keys / "shot.0006.exr").write_bytes(good[:500])
        broken = openjd("run", template, cwd=tmp_path)
        assert broken.code != 0 and broken.chunks == ["1-3", "4-6"], broken.log
        (failure,) = (line for line in broken.log.splitlines() if "openjd_fail: " in line)
        assert "shot.0006.exr" in failure and "openjd_progress" in broken.log
        (keys / "shot.0006.exr").write_bytes(good)
        for name, text in {"LAYERS": "all", "NO_TAIL": "1", "MOTION": "x", "TAIL": "what"}.items():
            monkeypatch.setenv(f"EXWARP_UPSAMPLE_{name}", text)
        ended = openjd("run", template, "-p", "ChunkSize=2", cwd=tmp_path)
        assert ended.code == 0, ended.log
        assert ended.chunks == ["1-2", "3-4", "5-6"]
        assert f"newer ones tell of: {tmp_path / 'report' / 'chunks' / '1-3'}" in ended.log
        for name in ("LAYERS", "NO_TAIL", "MOTION", "TAIL"):
            monkeypatch.delenv(f"EXWARP_UPSAMPLE_{name}")
        upsample(keys, tmp_path / "single", *FORWARD, "-m", "s6", "--report", tmp_path / "whole")
        assert shots.contents(tmp_path / "out") == shots.contents(tmp_path / "single")
        columns = ("frame", "kind", "hole_fraction")  # kept frames tell no times
        merged, whole = (
            [[row[name] for name in columns] for row in rows(tmp_path / folder)]
            for folder in ("report", "whole")
        )
        assert merged == whole and len(whole) == 24

    def test_what_is_left_out_keeps_no_step_from_its_turn(self, keys, job, tmp_path):
        (keys / "shot.0002.exr").unlink()
        last = ("--report", "report", "--video", "a.mp4", "--keep-going")
        template = job("keys", "-o", "out", "--chunk-size", 3, "-m", "s6", *last)
        (keys / "shot.0005.exr").write_bytes(b"damaged")
        ended = openjd("run", template, cwd=tmp_path)
        assert ended.code == 0 and ended.log.count("--------- Running Task") == 4, ended.log
        for frames in ("5-8", "17-20"):
            assert (
                f"openjd_status: 1 of 3 key intervals was left out (frames {frames})" in ended.log
            )
        found = json.loads((tmp_path / "report" / "report.json").read_text())
        assert [one["frames"] for one in found["left_out"]] == [[5, 6, 7, 8], [17, 18, 19, 20]]
        assert "2 key intervals left out: frames 5-8,17-20" in ended.log
        assert len(shots.names(tmp_path / "out")) == 16 and (tmp_path / "a.mp4").stat().st_size


def strike(output: Path) -> None:
    """Kill the process that upsamples into a folder, as a machine that fails would."""
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if b"upsample" in words and f"{output}/".encode() in words:
            os.kill(int(entry.name), signal.SIGKILL)
