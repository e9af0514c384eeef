"""--keep-going: what cannot be made is left out, and nothing else changes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.shots import FORWARD, KEYS, SMALL, VECTORS, contents, names
from tests.cli.spoiling import remove, scribble, truncate
from tests.matrix import combinations

pytestmark = pytest.mark.usefixtures("unpainted_plots")

FRAMES = 4 * KEYS
BROKEN = 3
"""Number of the key frame that is lost: its interval has the output frames 9 to 12."""

EXTRAPOLATING = ("s3", "causal")


def shrink(path: Path) -> None:
    shots.plain(path, shots.Street(24, 14), 0.0)


DAMAGES = (remove, truncate, scribble, shrink)


def numbered(folder: Path) -> set[int]:
    return {int(name.split(".")[1]) for name in names(folder)}


@pytest.fixture
def keys(shot, tmp_path) -> Path:
    """A copy of the shot's key frames, to be damaged."""
    return Path(shutil.copytree(shot["key"][0], tmp_path / "keys"))


@pytest.fixture
def kept(exwarp, network, tmp_path) -> Callable[..., tuple[Path, str]]:
    """Run with --keep-going; return the folder and what was said. Something is left out."""

    def run(name: str, keys: object, *options: object, method: str = "softsplat") -> tuple:
        out = tmp_path / name
        extra = ("--extrapolator", network) if method in EXTRAPOLATING else ()
        quiet = ("--progress", "none", "--threads", 1)
        result = exwarp(
            "upsample", keys, "-o", out, "-m", method, *extra, *quiet, "--keep-going", *options
        )
        assert result.code == 12, result.err
        return out, result.err

    return run


@pytest.fixture
def made(upsample, network, tmp_path) -> Callable[..., Path]:
    """Run, and expect that all is made."""

    def run(name: str, keys: object, *options: object, method: str = "softsplat") -> Path:
        extra = ("--extrapolator", network) if method in EXTRAPOLATING else ()
        upsample(keys, tmp_path / name, "-m", method, *extra, *options)
        return tmp_path / name

    return run


def damaged_at(keys: Path, number: int) -> Path:
    return keys / f"shot.{number:04d}.exr"


@pytest.mark.parametrize("damage", DAMAGES)
def test_everything_else_is_made(kept, keys, damage):
    damage(damaged_at(keys, BROKEN))
    out, err = kept("out", keys, *FORWARD)
    assert numbered(out) == set(range(1, FRAMES + 1)) - {9, 10, 11, 12}
    first, last = err.splitlines()[-2:]
    assert first.startswith("exwarp: left out frames 9-12: ")
    assert "shot.0003.exr" in first
    assert last == (
        "exwarp: error: 1 of 5 key intervals was left out (frames 9-12), see above or left_out in "
        "report.json; mend the input and run again with --skip-existing"
    )


def test_a_task_of_a_farm_succeeds_and_tells(exwarp, keys, tmp_path):
    """Engines take every other code for a failure, try again, and join no reports."""
    remove(damaged_at(keys, BROKEN))
    options = (*FORWARD, "--progress", "openjd", "--threads", 1)
    result = exwarp("upsample", keys, "-o", tmp_path / "out", "--keep-going", *options)
    assert result.code == 0 and "openjd_fail" not in result.out
    last = [line for line in result.out.splitlines() if line.startswith("openjd_status: ")][-1]
    assert "1 of 5 key intervals was left out (frames 9-12)" in last
    result = exwarp("upsample", keys, "-o", tmp_path / "out", "--skip-existing", *options)
    assert result.code == 3 and "openjd_fail" in result.out


def test_without_it_nothing_goes_on(exwarp, keys, tmp_path):
    remove(damaged_at(keys, BROKEN))
    quiet = ("--progress", "none", "--threads", 1)
    result = exwarp("upsample", keys, "-o", tmp_path / "out", *FORWARD, *quiet)
    result.refused(3, "frame 3 is missing")


@pytest.mark.parametrize("method", ["softsplat", "s3", "causal"])
def test_mended_and_resumed_all_is_as_if_nothing_had_been(kept, made, keys, method):
    sound = damaged_at(keys, BROKEN).read_bytes()
    expected = contents(made("expected", keys, *FORWARD, method=method))
    truncate(damaged_at(keys, BROKEN))
    out, _ = kept("out", keys, *FORWARD, method=method)
    damaged_at(keys, BROKEN).write_bytes(sound)
    made("out", keys, *FORWARD, "--skip-existing", method=method)
    assert contents(out) == expected


def test_resuming_while_it_is_broken_makes_nothing_anew(kept, keys):
    remove(damaged_at(keys, BROKEN))
    out, _ = kept("out", keys, *FORWARD)
    before = {name: (out / name).stat().st_mtime_ns for name in names(out)}
    kept("out", keys, *FORWARD, "--skip-existing")
    assert {name: (out / name).stat().st_mtime_ns for name in names(out)} == before


@pytest.mark.parametrize("method", ["softsplat", "causal"])
def test_a_sound_input_comes_out_as_without_it(made, keys, method):
    expected = contents(made("expected", keys, *FORWARD, method=method))
    assert contents(made("out", keys, *FORWARD, "--keep-going", method=method)) == expected


@pytest.mark.parametrize("lost", [(1,), (5,), (1, 2), (2, 4), (1, 3, 5)])
def test_any_frames_may_be_lost(kept, keys, lost):
    """The first, too, by which channels are recognised and vectors measured."""
    for number in lost:
        scribble(damaged_at(keys, number))
    out, err = kept("out", keys, *FORWARD)
    expected = {n for k in range(1, KEYS + 1) if k not in lost for n in range(4 * k - 3, 4 * k + 1)}
    assert numbered(out) == expected
    assert f"{len(lost)} of 5 key intervals" in err


def test_vectors_are_measured_in_sound_frames(kept, tmp_path):
    keys = shots.sequence(tmp_path / "keys", shots.blender5, range(1, 6), SMALL)
    truncate(damaged_at(keys, 1))
    out, _ = kept("out", keys)
    assert numbered(out) == set(range(5, FRAMES + 1))


def test_where_all_are_lost_the_first_is_named(exwarp, keys, tmp_path):
    for path in keys.iterdir():
        scribble(path)
    quiet = ("--progress", "none", "--threads", 1, "--keep-going")
    exwarp("upsample", keys, "-o", tmp_path / "out", *FORWARD, *quiet).refused(3, "shot.0001.exr")


class TestOtherFiles:
    @pytest.fixture
    def slots(self, shot, tmp_path) -> Path:
        return Path(shutil.copytree(shot["slot"][2], tmp_path / "slots"))

    @pytest.mark.parametrize(
        ("method", "damage"), combinations(["softsplat", "s6", "s3", "causal"], [remove, truncate])
    )
    def test_a_slot_without_g_buffers(self, kept, shot, slots, method, damage):
        """Slot 2 of the second interval, frame 7: the key frame 5 goes through."""
        damage(damaged_at(slots, 7))
        out, err = kept("out", shot["slot"][0], "--gbuffers", slots, *VECTORS, method=method)
        assert numbered(out) == set(range(1, FRAMES + 1)) - {6, 7, 8}
        assert "left out frames 6-8: " in err

    def test_g_buffers_of_a_key_frame(self, kept, shot, slots):
        truncate(damaged_at(slots, 5))
        out, _ = kept("out", shot["slot"][0], "--gbuffers", slots, *VECTORS)
        assert numbered(out) == set(range(1, FRAMES + 1)) - {5, 6, 7, 8}

    @pytest.mark.parametrize("damage", [remove, scribble])
    def test_a_file_of_one_aov(self, kept, tmp_path, damage):
        for i in range(4):
            shots.unreal(tmp_path / "keys", SMALL, i, i + 1)
        damage(tmp_path / "keys" / "P_WorldNormal.0002.exr")
        out, _ = kept("out", tmp_path / "keys")
        assert numbered(out) == set(range(1, 17)) - {5, 6, 7, 8}

    def test_a_sequence_given_as_an_aov(self, kept, shot, keys, tmp_path):
        aov = shutil.copytree(keys, tmp_path / "aov")
        remove(damaged_at(aov, 4))
        colour = shot["slot"][0]
        given = ("--aov", f"motion={aov}/shot.####.exr:forward.u,forward.v")
        depth = ("--aov", f"depth={aov}/shot.####.exr:Z")
        out, _ = kept("out", colour, *given, *depth, "--motion", "next=u,-v")
        assert numbered(out) == set(range(1, FRAMES + 1)) - {13, 14, 15, 16}

    def test_ground_truth(self, kept, keys, tmp_path):
        truth = shots.truth(tmp_path / "truth", KEYS, street=SMALL)
        truncate(damaged_at(truth, 7))
        out, err = kept("out", keys, *FORWARD, "--ground-truth", truth)
        assert numbered(out) == set(range(1, FRAMES + 1)), "it costs scores alone"
        assert "not scored frame 7: " in err

    def test_layers(self, kept, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.blender5, range(1, 5), SMALL)
        truncate(damaged_at(keys, 3))
        out, _ = kept("out", keys, "--layers", "all", *VECTORS)
        assert numbered(out) == set(range(1, 17)) - {9, 10, 11, 12}

    def test_stills(self, kept, upsample, shot, tmp_path):
        pytest.importorskip("cv2")
        upsample(shot["key"][0], tmp_path / "png", "-m", "hold", *FORWARD, "--factor", 2)
        exr = tmp_path / "png"
        keys = tmp_path / "stills"
        keys.mkdir()
        import OpenImageIO as oiio

        for i in range(1, 6):
            image = oiio.ImageBuf(str(exr / f"shot.{i:04d}.exr"))
            oiio.ImageBufAlgo.channels(image, ("R", "G", "B")).write(
                str(keys / f"a.{i:04d}.png"), "uint8"
            )
        remove(keys / "a.0002.png")
        scribble(keys / "a.0001.png")
        out, _ = kept("out", keys)
        assert numbered(out) == set(range(9, FRAMES + 1))


class TestReport:
    def test_it_lists_what_is_missing(self, kept, keys, tmp_path):
        truncate(damaged_at(keys, 2))
        remove(damaged_at(keys, 4))
        report = tmp_path / "report"
        kept("out", keys, *FORWARD, "--report", report)
        left_out = json.loads((report / "report.json").read_text())["left_out"]
        assert [(one["key"], one["frames"]) for one in left_out] == [
            (2, [5, 6, 7, 8]),
            (4, [13, 14, 15, 16]),
        ]
        assert all("shot.000" in one["reason"] for one in left_out)
        assert "Key intervals left out" in (report / "report.html").read_text()

    def test_chunks_are_joined(self, exwarp, kept, keys, tmp_path):
        truncate(damaged_at(keys, 2))
        report = tmp_path / "report"
        as_chunk = ("--report", report, "--as-chunk", *FORWARD)
        kept("out", keys, *as_chunk, "--frames", "1-3")
        quiet = ("--progress", "none", "--threads", 1, "-m", "softsplat", "--keep-going")
        result = exwarp(
            "upsample", keys, "-o", tmp_path / "out", *quiet, *as_chunk, "--frames", "4-5"
        )
        assert result.code == 0, result.err
        assert exwarp("merge-reports", report).code == 0
        document = json.loads((report / "report.json").read_text())
        assert [one["key"] for one in document["left_out"]] == [2]
        assert document["frames"]["written"] == FRAMES - 4

    def test_the_document_is_printed(self, exwarp, keys, tmp_path):
        remove(damaged_at(keys, 2))
        quiet = ("--progress", "none", "--threads", 1, "-m", "softsplat", "--keep-going", "--json")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *FORWARD, *quiet)
        assert result.code == 12
        assert json.loads(result.out)["left_out"][0]["frames"] == [5, 6, 7, 8]

    def test_the_summary_says_it(self, exwarp, keys, tmp_path):
        remove(damaged_at(keys, 2))
        quiet = ("--progress", "none", "--threads", 1, "-m", "softsplat", "--keep-going")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *FORWARD, *quiet)
        assert "1 key interval left out: frames 5-8" in result.out


def test_a_video_stays_in_step(kept, keys, tmp_path):
    from exwarp_cli.io.video_reader import open_clip

    truncate(damaged_at(keys, 1))
    truncate(damaged_at(keys, 3))
    kept("out", keys, *FORWARD, "--video", tmp_path / "out.mp4")
    assert open_clip(tmp_path / "out.mp4").count == FRAMES
    out, _ = kept("alone.mp4", keys, *FORWARD)
    assert open_clip(out).count == FRAMES


def test_a_dry_run_goes_on(exwarp, keys, tmp_path):
    remove(damaged_at(keys, 3))
    options = (*FORWARD, "-m", "softsplat", "--keep-going", "--dry-run", "--skip-existing")
    result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
    assert result.code == 0, result.err


def test_processes_leave_out_the_same(kept, keys, tmp_path):
    pytest.importorskip("distributed")
    truncate(damaged_at(keys, 3))
    one, _ = kept("one", keys, *FORWARD)
    report = ("--report", tmp_path / "report", "--video", tmp_path / "out.mp4")
    spread = ("--workers", 2, "--chunk-size", 2, "--threads", 2)
    many, err = kept("many", keys, *FORWARD, *report, *spread)
    assert contents(many) == contents(one)
    assert err.count("left out frames 9-12") == 1
    document = json.loads((tmp_path / "report" / "report.json").read_text())
    assert [one["key"] for one in document["left_out"]] == [3]
