"""What a run tells: report, scores, hole masks, video, progress."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from exwarp_cli import cli
from tests.cli import shots
from tests.cli.street import Street
from tests.matrix import spread
from tests.unit.tiny_models import convolution, save

EXAMPLE = Path(__file__).parents[2] / "examples" / "market"
FORWARD = ("--motion", "next=u,-v")
SCORE = {"psnr_db", "ssim", "flip", "hdr_flip", "vmaf", "flicker", "pulse", "frames"}


def load(folder: Path) -> dict:
    """Read a report strictly: NaN and infinities are not JSON."""

    def refuse(text: str) -> None:
        raise AssertionError(text)

    return json.loads((folder / "report.json").read_text(), parse_constant=refuse)


def rows(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "frames.csv").read_text().splitlines()))


@pytest.fixture(scope="module")
def example(tmp_path_factory) -> dict[str, dict]:
    """Reports on the committed example by method."""
    root = tmp_path_factory.mktemp("example")
    for method in ("hold", "s6", "softsplat"):
        code = cli.run(
            [
                *("upsample", str(EXAMPLE / "keys"), "-o", str(root / method), "--method", method),
                *("--ground-truth", str(EXAMPLE / "truth"), "--progress", "none"),
                *(
                    "--report",
                    str(root / f"{method}-report"),
                    "--frames",
                    "5",
                    "--metrics",
                    "psnr",
                ),
            ]
        )
        assert code == 0
    return {method: load(root / f"{method}-report") for method in ("hold", "s6", "softsplat")}


@pytest.mark.slow
class TestExample:
    """The render that is committed beside the code, without any flag on conventions."""

    def test_warping_beats_repeating_and_two_frames_beat_one(self, example):
        psnr = {name: report["quality"]["all"]["psnr_db"] for name, report in example.items()}
        assert psnr["s6"] >= psnr["hold"] + 5
        assert psnr["softsplat"] > psnr["s6"]

    def test_what_was_found(self, example):
        source = example["s6"]["input"]
        assert source["producer"] == "Blender" and source["motion"]["source"] == "calibrated"
        assert "previous=X,-Y next=-Z,W" in source["motion"]["evidence"]
        assert example["s6"]["frames"]["key"] == 1 and example["s6"]["frames"]["written"] == 4
        assert example["s6"]["quality"]["all"]["frames"] == 3


class TestReport:
    @pytest.fixture(scope="class")
    @staticmethod
    def run(tmp_path_factory, plain_shot, plain_truth) -> tuple[Path, Path, Path]:
        """Folders of frames, masks and report of an s6 run against the truth."""
        root = tmp_path_factory.mktemp("run")
        out, holes, report = root / "out", root / "holes", root / "report"
        code = cli.run(
            [
                *("upsample", str(plain_shot), "-o", str(out), "-m", "s6", "--progress", "none"),
                *("--write-holes", str(holes), "--report", str(report)),
                *("--ground-truth", str(plain_truth), "--threads", "1"),
            ]
        )
        assert code == 0
        return out, holes, report

    def test_keys_are_the_contract(self, run):
        document = load(run[2])
        assert document["schema"] == "exwarp.report/1"
        top = "method setting lookahead input frames fps holes decisions quality timing_ms"
        assert set(top.split()) <= set(document)
        inner = {
            "input": "pattern first last width height producer motion",
            "frames": "key written generated dropped",
            "fps": "base effective throughput",
            "holes": "mean_fraction p95_fraction histogram",
            "decisions": "nodes paths warp_share",
            "quality": "all holes by_decision dropped",
            "timing_ms": "read features decide warp holes extrapolate write",
        }
        for key, names in inner.items():
            assert set(names.split()) <= set(document[key])
        assert set(document["input"]["motion"]) >= {"source", "evidence"}
        assert set(document["decisions"]["nodes"]) == {"d1", "d2", "d3", "d4", "d5"}
        assert set(document["decisions"]["paths"]) == {"S1", "S2", "S3", "S4", "S5", "S6"}
        assert all(
            set(n) == {"warp", "extrapolate"} for n in document["decisions"]["nodes"].values()
        )
        quality = document["quality"]
        assert set(quality["by_decision"]) == {"warp", "extrapolate"}
        for part in (quality["all"], quality["holes"], quality["dropped"]):
            assert set(part) == SCORE
        assert all(set(part) == SCORE for part in quality["by_decision"].values())

    def test_values(self, run):
        document = load(run[2])
        assert (document["method"], document["setting"], document["lookahead"]) == (
            "s6",
            "key",
            False,
        )
        assert document["frames"] == {
            "key": 3, "written": 12, "generated": 9, "dropped": 0, "rendered": 0, "resumed": 0,
            "made": 12, "replaced": 0,
        }  # fmt: skip
        assert (document["fps"]["base"], document["fps"]["effective"]) == (30, 120)
        assert document["decisions"]["paths"]["S6"] == 3
        assert document["decisions"]["warp_share"] == 1
        # what was not measured is null: nothing was extrapolated, no feature computed
        assert document["timing_ms"]["extrapolate"] is None
        assert document["quality"]["by_decision"]["extrapolate"]["psnr_db"] is None
        assert document["quality"]["all"]["frames"] == 6

    def test_a_row_for_every_frame(self, run):
        out, _, report = run
        table = rows(report)
        assert [row["file"] for row in table] == shots.names(out)
        assert [row["kind"] for row in table] == ["key", "generated", "generated", "generated"] * 3
        scored = [float(row["psnr_db"]) for row in table if row["psnr_db"]]
        assert np.mean(scored) == pytest.approx(load(report)["quality"]["all"]["psnr_db"], abs=1e-9)
        assert all(row["psnr_db"] == "" for row in table if row["kind"] == "key")

    def test_masks(self, run):
        _, holes, report = run
        fractions = {row["file"]: row["hole_fraction"] for row in rows(report)}
        assert shots.names(holes) == [name for name, f in fractions.items() if f]
        for name in shots.names(holes):
            header, planes = shots.read(holes / name)
            assert set(planes) == {"holes"} and set(np.unique(planes["holes"])) <= {0, 1}
            assert planes["holes"].mean() == pytest.approx(float(fractions[name]), abs=1e-3)
            assert header["exwarp:slot"] in (1, 2, 3)

    def test_compare_agrees(self, run, plain_truth, exwarp, tmp_path):
        out, holes, report = run
        # `upsample` scores no rendered frames, so `compare` must see none either
        made, slots = tmp_path / "made", tmp_path / "slots"
        for order in (1, 2, 3, 5, 6, 7):
            name = f"shot.{order + 1:04d}.exr"
            for source, folder in ((out, made), (plain_truth, slots)):
                folder.mkdir(exist_ok=True)
                (folder / name).write_bytes((source / name).read_bytes())
        result = exwarp("compare", slots, made, "--holes", holes, "--json")
        assert result.code == 0 and result.err == ""
        found, expected = json.loads(result.out)["quality"], load(report)["quality"]
        for part in ("all", "holes"):
            assert found[part]["frames"] == expected[part]["frames"] == 6
            for key in ("psnr_db", "ssim", "flip"):
                assert found[part][key] == pytest.approx(expected[part][key], abs=1e-6)

    def test_compare_without_masks_has_no_score_in_holes(self, run, plain_truth, exwarp):
        found = json.loads(exwarp("compare", plain_truth, run[0], "--json").out)
        assert found["quality"]["holes"]["psnr_db"] is None
        assert found["frames"] == 9

    def test_compare_with_itself(self, plain_truth, exwarp, tmp_path):
        result = exwarp("compare", plain_truth, plain_truth, "--report", tmp_path)
        assert result.code == 0 and "100.00" in result.out
        assert load(tmp_path)["quality"]["all"]["psnr_db"] == 100


class TestVideo:
    @pytest.mark.parametrize(("suffix", "fps"), [(".mp4", "30"), (".mov", "23.976")])
    def test_it_plays(self, plain_shot, upsample, tmp_path, suffix, fps):
        video = tmp_path / "new" / f"a b{suffix}"
        options = ("-m", "softsplat", *FORWARD, "--video", video, "--fps", fps)
        upsample(plain_shot, tmp_path / "out", *options)
        count, seconds = imageio_ffmpeg.count_frames_and_secs(str(video))
        assert count == 12
        assert seconds == pytest.approx(12 / (4 * float(fps)), abs=0.02)

    def test_exposure_brightens(self, plain_shot, upsample, tmp_path):
        means = []
        for stops in (-2, 0):
            video = tmp_path / f"{stops}.mp4"
            options = ("-m", "hold", "--frames", "1", "--video", video, "--exposure", stops)
            upsample(plain_shot, tmp_path / f"out{stops}", *options)
            command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(video)]
            raw = ["-f", "rawvideo", "-pix_fmt", "gray", "-"]
            done = subprocess.run(command + raw, capture_output=True, check=True)
            pixels = np.frombuffer(done.stdout, np.uint8)
            assert pixels.size == 4 * 64 * 36
            means.append(pixels.mean())
        assert means[1] > 1.5 * means[0]


class TestProgress:
    @pytest.fixture
    def with_progress(self, exwarp, plain_shot, tmp_path):
        def run(kind: str):
            options = ("-m", "hold", "--progress", kind)
            result = exwarp("upsample", plain_shot, "-o", tmp_path / kind, *options)
            assert result.code == 0
            # the result goes to stdout, whatever the progress
            assert result.out.startswith("12 frames in ") and "exwarp:" not in result.out
            return result

        return run

    def test_json(self, with_progress):
        events = [json.loads(line) for line in with_progress("json").err.splitlines()]
        frames = [event for event in events if event["event"] == "frame"]
        assert [event["frame"] for event in frames] == list(range(1, 13))
        assert [event["done"] for event in frames] == list(range(1, 13))
        assert {event["total"] for event in frames} == {12}
        assert events[-1]["event"] == "finish" and events[-1]["done"] == 12
        assert {e["event"] for e in events} == {"message", "start", "frame", "finish"}

    def test_json_of_a_run_that_breaks_off(self, exwarp, plain_shot, tmp_path):
        (tmp_path / "out" / "shot.0005.exr").mkdir(parents=True)
        options = ("-m", "hold", "--progress", "json", "--overwrite")
        result = exwarp("upsample", plain_shot, "-o", tmp_path / "out", *options)
        *lines, last = result.err.splitlines()
        assert result.code == 5 and last.startswith("exwarp: error: ")
        finish, fail = (json.loads(line) for line in lines[-2:])
        assert (finish["event"], fail["event"], fail["exit_code"]) == ("finish", "fail", 5)
        assert last == f"exwarp: error: {fail['text']}"

    def test_plain(self, with_progress):
        lines = with_progress("plain").err.splitlines()
        assert all(line.startswith("exwarp: ") for line in lines)
        assert any("100% 12/12, frame 12" in line for line in lines)

    def test_auto_is_plain_without_a_terminal(self, with_progress):
        assert "100% 12/12" in with_progress("auto").err

    def test_none_tells_of_no_frame(self, with_progress):
        err = with_progress("none").err
        assert "%" not in err and "frame 12" not in err

    def test_bar(self, with_progress):
        assert "12/12" in with_progress("bar").err


class TestHelp:
    @pytest.mark.parametrize("name", cli.COMMANDS)
    def test_every_option_is_explained(self, name, exwarp):
        result = exwarp(name, "--help")
        assert result.code == 0 and result.err == ""
        assert result.out.startswith(f"Usage: exwarp {name} ")

    def test_as_a_process(self):
        command = [sys.executable, "-m", "exwarp_cli", "upsample", "--help"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert "--skip-existing" in done.stdout and done.stderr == ""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc, as ru_maxrss is the parent's")
class TestMemory:
    @pytest.mark.parametrize("method", spread(["softsplat", "s3", "causal"], 2))
    def test_it_does_not_grow_with_the_sequence(self, tmp_path, method):
        """A frame of 256x144 is 1.2 MiB of passes, so 8 more that were kept would be 10."""
        network = save(tmp_path / "n.onnx", convolution())
        more = ("--factor", 2) if method == "softsplat" else ("--extrapolator", network)
        options = (*FORWARD, *more, "-m", method, "--progress", "none", "--threads", "1")
        street, commands = Street(256, 144), []
        for name, count in (("short", 6), ("long", 14)):
            keys = shots.sequence(tmp_path / name, shots.plain, (1, 2), street, 0.1)
            for number in range(3, count + 1):
                shutil.copy(
                    keys / f"shot.{2 - number % 2:04d}.exr", keys / f"shot.{number:04d}.exr"
                )
            commands.append(("upsample", keys, "-o", tmp_path / f"o-{name}", *options))
        code = (
            "import json, sys; from exwarp_cli import cli\n"
            "for command in json.loads(sys.argv[1]):\n"
            "    assert cli.run(command) == 0\n"
            "    print(next(line for line in open('/proc/self/status') if 'VmHWM' in line))"
        )
        words = [
            sys.executable,
            "-c",
            code,
            json.dumps([[str(word) for word in line] for line in commands]),
        ]
        # What is freed goes back to the system, so that no gaps between what is in use count.
        environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_ARENA_MAX": "1"}
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
        peaks = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("VmHWM")]
        few, many = (int(peak) / 1024 for peak in peaks)
        assert many < few + 7.5
