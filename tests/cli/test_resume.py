"""Chunks, threads, and runs that go on from an earlier one: always the same bytes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import imageio_ffmpeg
import pytest

from exwarp_cli.io import generated_frames
from exwarp_cli.io.files import TEMPORARY_SUFFIX, host_name
from tests.blender_layers import layer
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.street import Street

pytestmark = pytest.mark.usefixtures("unpainted_plots")

SMALL = Street(48, 27)
FORWARD = ("--motion", "next=u,-v")
OPTIONS = ("-m", "s6", *FORWARD)


@pytest.fixture(scope="module")
def five(tmp_path_factory) -> Path:
    """Five key frames."""
    return shots.sequence(tmp_path_factory.mktemp("five") / "keys", shots.plain, range(1, 6), SMALL)


@pytest.fixture(scope="module")
def finished(plain_shot, tmp_path_factory) -> Path:
    """The frames of a whole run; read only."""
    out = tmp_path_factory.mktemp("finished") / "out"
    run_quietly("upsample", plain_shot, "-o", out, *OPTIONS)
    return out


@pytest.fixture
def done(finished, tmp_path) -> Path:
    """The frames of a whole run, which a test may change."""
    return Path(shutil.copytree(finished, tmp_path / "out"))


class TestChunks:
    @pytest.mark.parametrize("method", ["s6", "softsplat", "blend", "hold"])
    def test_any_split_gives_the_whole(self, five, upsample, tmp_path, method):
        whole, parts = tmp_path / "whole", tmp_path / "parts"
        upsample(five, whole, "-m", method, "--write-holes", tmp_path / "whole-holes")
        for chunk in ("1-2", "3-3", "4-5"):
            masks = ("--write-holes", tmp_path / "parts-holes")
            upsample(five, parts, "-m", method, *masks, "--frames", chunk)
        assert len(shots.names(whole)) == 20
        assert shots.contents(parts) == shots.contents(whole)
        assert shots.contents(tmp_path / "parts-holes") == shots.contents(tmp_path / "whole-holes")

    @pytest.mark.parametrize("method", ["s6", "softsplat"])
    def test_threads_change_nothing(self, five, upsample, tmp_path, method):
        for count in (1, 2):
            upsample(five, tmp_path / str(count), "-m", method, "--threads", count)
        assert shots.contents(tmp_path / "1") == shots.contents(tmp_path / "2")

    def test_slot_g_buffers_too(self, upsample, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.colour_only, (1, 2, 3), SMALL)
        slots = shots.sequence(tmp_path / "slots", shots.slot_gbuffer, range(1, 10), SMALL, 0.25)
        options = ("-m", "softsplat", "--gbuffers", slots)
        upsample(keys, tmp_path / "whole", *options)
        for chunk in ("3", "1", "2"):
            upsample(keys, tmp_path / "parts", *options, "--frames", chunk)
        assert shots.contents(tmp_path / "parts") == shots.contents(tmp_path / "whole")

    def test_windows_that_change_too(self, upsample, tmp_path):
        """A frame that both its neighbours share is placed on two different windows."""

        def frame(path: Path, street: Street, time: float) -> None:
            x, y = 2 * int(time) % 5, int(time) % 3
            planes = {k: v[y:25, x:44].copy() for k, v in shots.plain_planes(street, time).items()}
            place = shots.window(x - 4, y - 2, 44 - x, 25 - y)
            head = shots.header(dataWindow=place, displayWindow=shots.window(0, 0, 36, 20))
            shots.write(path, {"": planes}, head)

        keys = shots.sequence(tmp_path / "keys", frame, range(1, 5), SMALL)
        upsample(keys, tmp_path / "whole", "-m", "softsplat", *FORWARD)
        for chunk in ("1-2", "3", "4"):
            upsample(keys, tmp_path / "parts", "-m", "softsplat", *FORWARD, "--frames", chunk)
        assert shots.contents(tmp_path / "parts") == shots.contents(tmp_path / "whole")


class TestSkipExisting:
    def resume(self, upsample, keys: Path, out: Path, *options: object) -> set[str]:
        """Run again, and return the names of the frames that were written anew."""
        before = {name: (out / name).stat().st_mtime_ns for name in shots.names(out)}
        upsample(keys, out, "--skip-existing", *(options or OPTIONS))
        now = {name: (out / name).stat().st_mtime_ns for name in shots.names(out)}
        return {name for name, time in now.items() if before.get(name) != time}

    def test_good_frames_stay(self, plain_shot, upsample, done):
        assert self.resume(upsample, plain_shot, done) == set()

    def test_spoilt_frames_are_made_again(self, plain_shot, upsample, done):
        good = shots.contents(done)
        for i, (name, data) in enumerate(list(good.items())[:7]):
            spoilt = bytearray(data)
            if i % 2:
                spoilt[-(len(data) // 3 + i)] ^= 1  # of the compressed pixels
            else:
                spoilt = spoilt[: len(data) // 2]
            (done / name).write_bytes(spoilt)
        (done / "shot.0012.exr").unlink()
        assert self.resume(upsample, plain_shot, done) == {*list(good)[:7], "shot.0012.exr"}
        assert shots.contents(done) == good

    def test_frames_of_another_run_are_made_again(self, plain_shot, upsample, done, tmp_path):
        options = (*OPTIONS, "--compression", "piz")
        changed = self.resume(upsample, plain_shot, done, *options)
        upsample(plain_shot, tmp_path / "fresh", *options)
        assert shots.contents(done) == shots.contents(tmp_path / "fresh")
        assert not changed & {"shot.0001.exr", "shot.0005.exr", "shot.0009.exr"}

    @pytest.mark.parametrize(
        ("other", "replaced"),
        [
            (("--compression", "piz"), 9),
            (("--motion", "next=-u,v"), 9),
            (("--fps", "25"), 12),  # key frames have it in their headers, too
        ],
    )
    def test_other_settings_count(self, plain_shot, upsample, done, other, replaced):
        assert len(self.resume(upsample, plain_shot, done, *OPTIONS, *other)) == replaced

    def test_another_channel_map_counts(self, upsample, tmp_path):
        def lit(path: Path, street: Street, time: float) -> None:
            light = street.colour(time)[..., :3]
            planes = shots.plain_planes(street, time)
            planes |= layer("warm", "RGB", light) | layer("cold", "RGB", light / 2)
            shots.write(path, {"": planes})

        keys = shots.sequence(tmp_path / "keys", lit, (1, 2), SMALL)
        out, channel_map = tmp_path / "out", tmp_path / "map.toml"
        options = ("-m", "s6", *FORWARD, "--channel-map", channel_map)
        for name, made in (("warm", set()), ("cold", {2, 3, 4, 6, 7, 8}), ("cold", set())):
            channels = ", ".join(f'"{name}.{c}"' for c in "RGB")
            channel_map.write_text(
                f'schema = "exwarp.channel-map/1"\n[channels]\ncolour = [{channels}]\n'
            )
            if not out.exists():
                upsample(keys, out, *options)
            renewed = self.resume(upsample, keys, out, *options)
            assert renewed == {f"shot.{n:04d}.exr" for n in made}

    def test_a_changed_source_counts_for_its_frames_alone(
        self, plain_shot, upsample, done, tmp_path
    ):
        keys = Path(shutil.copytree(plain_shot, tmp_path / "keys"))
        shots.plain(keys / "shot.0002.exr", Street(), 1.25)
        changed = self.resume(upsample, keys, done)
        # The key frame itself, the slots after it, and those after the next, whose light it tells.
        assert changed == {f"shot.{n:04d}.exr" for n in (5, 6, 7, 8, 10, 11, 12)}

    def test_a_missing_mask_counts(self, plain_shot, upsample, done, tmp_path):
        holes = tmp_path / "holes"
        options = (*OPTIONS, "--write-holes", holes)
        upsample(plain_shot, done, "--skip-existing", *options)
        good = shots.contents(holes)
        assert len(good) == 9
        (holes / "shot.0003.exr").unlink()
        upsample(plain_shot, done, "--skip-existing", *options)
        assert shots.contents(holes) == good

    def test_leftovers_of_dead_runs_go(self, plain_shot, upsample, done, tmp_path):
        report = tmp_path / "report"
        report.mkdir()
        leftovers = [
            f / f".a.{host_name()}-{2**22 + 1}-0{TEMPORARY_SUFFIX}" for f in (done, report)
        ]
        for leftover in leftovers:
            leftover.write_bytes(b"half")
        options = ("--skip-existing", *OPTIONS, "--report", report)
        upsample(plain_shot, done, *options)
        assert not [leftover for leftover in leftovers if leftover.exists()]

    def test_the_report_of_a_resumed_run(self, plain_shot, plain_truth, upsample, tmp_path):
        reports = {}
        for name in ("whole", "resumed"):
            out, report = tmp_path / name, tmp_path / f"{name}-report"
            options = (*OPTIONS, "--ground-truth", plain_truth, "--report", report)
            if name == "resumed":
                upsample(plain_shot, out, *OPTIONS, "--frames", "1-2")
                shots.truncate(out / "shot.0007.exr")
                options = (*options, "--skip-existing")
            upsample(plain_shot, out, *options)
            reports[name] = json.loads((report / "report.json").read_text())
        assert shots.contents(tmp_path / "whole") == shots.contents(tmp_path / "resumed")
        whole, resumed = reports["whole"], reports["resumed"]
        for key in ("quality", "holes", "decisions", "method", "setting", "input"):
            assert resumed[key] == whole[key]
        assert (whole["frames"]["resumed"], resumed["frames"]["resumed"]) == (0, 7)
        assert resumed["frames"]["written"] == whole["frames"]["written"] == 12

    def test_a_video_of_a_resumed_run_is_whole(self, plain_shot, upsample, done, tmp_path):
        video = tmp_path / "a.mp4"
        upsample(plain_shot, done, "--skip-existing", *OPTIONS, "--video", video)
        assert imageio_ffmpeg.count_frames_and_secs(str(video))[0] == 12


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "nothing"},
        {"sources": "first"},
        {"decision": "[]"},
        {"decision": "{"},
        {"decision": '{"node":1}'},
        {"decision": "[" * 100_000},
        {"holeFraction": "many"},
    ],
)
def test_what_frames_say_of_themselves_may_be_forged(plain_shot, exwarp, done, monkeypatch, change):
    """Their checksum is no signature."""
    read_facts = generated_frames.read_facts
    monkeypatch.setattr(generated_frames, "read_facts", lambda path: read_facts(path) | change)
    options = ("--skip-existing", "--progress", "none")
    result = exwarp("upsample", plain_shot, "-o", done, *OPTIONS, *options)
    result.refused(5, "shot.0002.exr says of itself")
