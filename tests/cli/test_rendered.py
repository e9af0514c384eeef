"""Frames that were rendered after all take the place of generated ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from exwarp_cli import cli
from exwarp_cli.io.display_colour import to_display
from tests.cli import shots
from tests.cli.documents import document_of
from tests.cli.pictures import frame, stills
from tests.cli.reports import album, rows, unmeasured
from tests.cli.shots import FORWARD, SMALL, VECTORS
from tests.stereo_layouts import single, write_single
from tests.stereo_shots import eyes_at, write_stereo

pytestmark = pytest.mark.usefixtures("unpainted_plots")

HOW = ("-m", "softsplat", *FORWARD, "--cuts", "none")
GIVEN = range(1, 6)
"""Numbers of the rendered sequence, of which 1 and 5 are key frames."""

USED = (2, 3, 4)
GENERATED = {6, 7, 8, 10, 11, 12}


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Three key frames; read only."""
    return shots.sequence(tmp_path_factory.mktemp("shot") / "keys", street=SMALL)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    """Rendered output frames, whose vectors lead over a key interval; read only."""
    folder = tmp_path_factory.mktemp("rendered") / "frames"
    return shots.sequence(folder, numbers=GIVEN, street=SMALL, step=0.25)


@pytest.fixture(scope="module")
def pan(tmp_path_factory) -> Path:
    """Two stills; read only."""
    return stills(tmp_path_factory.mktemp("pan") / "keys", map(frame, range(2)))


@pytest.fixture(scope="module")
def done(keys, rendered, tmp_path_factory) -> Path:
    """A folder of a run that writes everything there is; read only."""
    root = tmp_path_factory.mktemp("done")
    truth = shots.truth(root / "truth", street=SMALL)
    words = ["upsample", keys, "-o", root / "out", *HOW, "--rendered", rendered]
    words += ["--report", root / "report", "--ground-truth", truth, "--video", root / "a.mp4"]
    words += ["--write-holes", root / "holes", "--verify", "--threads", 1, "--progress", "none"]
    assert cli.run([str(word) for word in words]) == 0
    return root


@pytest.fixture
def one_frame(rendered, tmp_path) -> Path:
    """A folder of the rendered frame 3 alone."""
    return copied(rendered, tmp_path / "one", 3)


def copied(folder: Path, to: Path, *numbers: int) -> Path:
    """Copy some frames into another folder."""
    to.mkdir()
    for number in numbers:
        name = f"shot.{number:04d}.exr"
        (to / name).write_bytes((folder / name).read_bytes())
    return to


def facts(path: Path) -> dict[str, object]:
    """Return what a frame says of itself."""
    header, _ = shots.read(path)
    return {k.removeprefix("exwarp:"): v for k, v in header.items() if k.startswith("exwarp:")}


def error(folder: Path, number: int) -> float:
    """Return the RMS error of an output frame."""
    made = shots.colour_of(folder / f"shot.{number:04d}.exr")
    return float(np.sqrt(np.mean((made - SMALL.colour((number - 1) / 4)) ** 2)))


def kinds(folder: Path) -> list[str]:
    return [row["kind"] for row in rows(folder)]


class TestOneRun:
    def test_the_pixels_and_the_layers_are_the_rendered_ones(self, done, rendered):
        for number in USED:
            name = f"shot.{number:04d}.exr"
            _, planes = shots.read(done / "out" / name)
            _, source = shots.read(rendered / name)
            assert planes.keys() == source.keys()
            for channel, plane in source.items():
                np.testing.assert_array_equal(planes[channel], plane)

    def test_the_header_tells(self, done):
        header, _ = shots.read(done / "out" / "shot.0003.exr")
        assert header["framesPerSecond"] == 120 and header["owner"] == "Ada"
        found = facts(done / "out" / "shot.0003.exr")
        assert (found["kind"], found["sources"], found["slot"]) == ("rendered", "shot.0003.exr", 2)

    def test_they_are_counted_apart(self, done):
        document = unmeasured(done / "report")
        counts = document["frames"]
        assert [counts[n] for n in ("key", "rendered", "generated", "written")] == [3, 3, 6, 12]
        assert document["fps"]["effective"] == 120
        assert document["quality"]["all"]["frames"] == 3, "of 6, 7 and 8, which have ground truth"
        assert kinds(done / "report")[:5] == ["key", "rendered", "rendered", "rendered", "key"]
        assert [row["sources"] for row in rows(done / "report")][1:4] == ["2", "3", "4"]
        shown = {frame["number"]: frame["kind"] for frame in album(done / "report")["frames"]}
        assert shown[3] == "rendered" and shown[6] == "softsplat"

    def test_they_are_in_no_list_of_doubtful_frames(self, done):
        assert all(not row["risk"] for row in rows(done / "report") if row["kind"] == "rendered")
        assert unmeasured(done / "report")["review"]["predicted_error"]["frames"] < 9

    def test_they_have_no_hole_masks(self, done):
        assert {int(name[5:9]) for name in shots.names(done / "holes")} == GENERATED

    def test_other_intervals_are_as_without(self, done, upsample, keys, tmp_path):
        upsample(keys, tmp_path / "out", *HOW, "--frames", "2-3")
        for name, data in shots.contents(tmp_path / "out").items():
            assert data == (done / "out" / name).read_bytes()

    def test_chunks_have_the_same_bytes_and_report(
        self, done, exwarp, upsample, keys, rendered, tmp_path
    ):
        truth = ("--ground-truth", done / "truth", "--report", tmp_path / "report", "--as-chunk")
        for chunk in ("1", "2-3"):
            options = (*HOW, "--rendered", rendered, *truth, "--frames", chunk)
            upsample(keys, tmp_path / "out", *options)
        assert shots.contents(tmp_path / "out") == shots.contents(done / "out")
        assert exwarp("merge-reports", tmp_path / "report").code == 0
        joined, whole = (unmeasured(f / "report") for f in (tmp_path, done))
        for name in ("frames", "quality", "review", "fps"):
            assert joined[name] == whole[name]

    def test_going_on_keeps_everything(self, done, upsample, keys, rendered):
        def again() -> None:
            upsample(keys, done / "out", *HOW, "--rendered", rendered, "--skip-existing")

        assert shots.changed_by(again, done / "out") == set()

    def test_a_dry_run_tells_them_apart(self, done, exwarp, keys, rendered):
        words = (*HOW, "--rendered", rendered, "--skip-existing", "--dry-run", "--json")
        found = document_of(exwarp("upsample", keys, "-o", done / "out", *words))["frames"]
        assert (found["rendered"]["numbers"], found["keep"]["numbers"]) == ("2-4", "1-12")

    def test_compare_takes_them_for_rendered(self, done, exwarp):
        result = exwarp("compare", done / "truth", done / "out", "--json", "--progress", "none")
        assert document_of(result)["quality"]["generated"]["frames"] == 3


class TestGoingOn:
    @pytest.fixture
    def run(self, upsample, keys, tmp_path) -> Callable[..., set[int]]:
        """Upsample with --skip-existing; return the numbers of the frames that changed."""
        out = tmp_path / "out"

        def do(*options: object) -> set[int]:
            words = (*HOW, "--frames", "1", "--skip-existing", *options)
            return shots.changed_by(lambda: upsample(keys, out, *words), out)

        return do

    def test_a_frame_that_comes_later_is_used_and_so_is_a_newer_one(self, run, one_frame, tmp_path):
        run()
        generated = shots.contents(tmp_path / "out")
        before = {n: error(tmp_path / "out", n) for n in (2, 4)}
        assert run("--rendered", one_frame) == {2, 3, 4}, "and those beside it"
        for number in (2, 4):
            assert error(tmp_path / "out", number) < before[number]
            assert facts(tmp_path / "out" / f"shot.{number:04d}.exr")["renderedSources"] == "3"
        report = tmp_path / "report"
        assert run("--rendered", one_frame, "--report", report) == set()
        assert [row["rendered_sources"] for row in rows(report)] == ["", "3", "", "3"]
        shots.plain(one_frame / "shot.0003.exr", SMALL, 0.55)
        assert run("--rendered", one_frame) == {2, 3, 4}
        assert run() == {2, 3, 4}, "they are generated again"
        assert shots.contents(tmp_path / "out") == generated

    def test_a_frame_without_vectors_leaves_those_beside_it(
        self, run, exwarp, keys, one_frame, tmp_path
    ):
        run()
        shots.colour_only(one_frame / "shot.0003.exr", SMALL, 0.5)
        words = (*HOW, "--frames", 1, "--rendered", one_frame)
        assert run(*words) == {3}
        messages = exwarp("upsample", keys, "-o", tmp_path / "other", *words).err
        assert "--rendered has no vectors like the key frames' in 3" in messages

    def test_copies_byte_for_byte_are_kept(self, run, one_frame, tmp_path):
        kept = ("--rendered", one_frame, "--keep-bytes")
        assert 3 in run(*kept)
        source = one_frame / "shot.0003.exr"
        assert (tmp_path / "out" / source.name).read_bytes() == source.read_bytes()
        assert run(*kept, "--verify") == set()


class TestRefusals:
    @pytest.fixture
    def run(self, exwarp, keys, tmp_path):
        def do(folder: object, *options: object):
            words = (*HOW, "--frames", "1", "--rendered", folder, *options)
            return exwarp("upsample", keys, "-o", tmp_path / "out", *words, "--progress", "none")

        return do

    def test_numbers_that_are_not_used_are_said_once(self, exwarp, keys, rendered, tmp_path):
        words = (*HOW, "--rendered", rendered, "--dry-run")
        messages = exwarp("upsample", keys, "-o", tmp_path / "out", *words).err
        lines = [line for line in messages.splitlines() if "not used" in line]
        assert len(lines) == 1 and "not used are 1,5" in lines[0] and ": 2-4;" in lines[0]

    def test_a_sequence_without_a_new_frame(self, run, rendered, tmp_path):
        run(copied(rendered, tmp_path / "keys", 1, 5)).refused(3, "1,5", "1-12", "review.txt")

    def test_a_damaged_frame(self, run, one_frame):
        shots.truncate(one_frame / "shot.0003.exr")
        run(one_frame).refused(3, "frame 3 of --rendered", "shot.0003.exr")

    def test_a_frame_of_another_size(self, run, one_frame, tmp_path):
        shots.plain(one_frame / "shot.0003.exr", shots.Street(32, 27), 0.5)
        run(one_frame).refused(3, "frame 3 of --rendered", "32x27")
        assert shots.names(tmp_path / "out") == []

    def test_a_frame_without_the_channels(self, run, one_frame):
        planes = {name: np.zeros((27, 48), np.float16) for name in ("R", "G", "Z")}
        OpenEXR.File(shots.header(), planes).write(str(one_frame / "shot.0003.exr"))
        run(one_frame).refused(3, "frame 3 of --rendered", "'B'")

    def test_a_frame_without_a_layer_that_new_frames_hold(self, run, one_frame):
        shots.colour_only(one_frame / "shot.0003.exr", SMALL, 0.5)
        run(one_frame, "--layers", "all").refused(3, "frame 3 of --rendered", "no channel")

    def test_a_frame_that_was_generated(self, run, done):
        run(done / "out", "--frames", "2").refused(3, "frame 6 of --rendered", "made by ExWarp")

    def test_frames_in_the_folder_of_the_output(self, run, one_frame, tmp_path):
        one_frame.rename(tmp_path / "out")
        run(tmp_path / "out", "--overwrite").refused(5, "--rendered", "shot.0003.exr", "-o")

    def test_keep_going_generates_what_is_damaged(self, run, one_frame, tmp_path):
        shots.truncate(one_frame / "shot.0003.exr")
        result = run(one_frame, "--keep-going", "--report", tmp_path / "report")
        assert result.code == 12 and "generated frame 3" in result.err
        assert facts(tmp_path / "out" / "shot.0003.exr")["kind"] == "generated"
        (left,) = unmeasured(tmp_path / "report")["left_out"]
        assert (left["frames"], left["rendered"]) == ([], [3])


class TestOtherInput:
    def test_stills_are_copied(self, upsample, pan, tmp_path):
        (still,) = stills(tmp_path / "more", [frame(0.5)], first=3).iterdir()
        words = ("--no-tail", "--rendered", tmp_path / "more", "--skip-existing", "--verify")
        upsample(pan, tmp_path / "out", *words)
        assert (tmp_path / "out" / "pan.0003.png").read_bytes() == still.read_bytes()

        def again() -> None:
            upsample(pan, tmp_path / "out", *words)

        assert shots.changed_by(again, tmp_path / "out") == set()

    def test_stills_become_exr(self, upsample, pan, tmp_path):
        stills(tmp_path / "more", [frame(0.5)], first=3)
        words = ("--no-tail", "--rendered", tmp_path / "more", "--skip-existing")
        out = tmp_path / "out.####.exr"
        upsample(pan, out, *words)
        assert facts(tmp_path / "out.0003.exr")["kind"] == "rendered"
        shown = to_display(shots.colour_of(tmp_path / "out.0003.exr").astype(np.float32))
        assert np.abs(shown.astype(int) - frame(0.5)).max() <= 1
        before = (tmp_path / "out.0003.exr").stat().st_mtime_ns
        upsample(pan, out, *words)
        assert (tmp_path / "out.0003.exr").stat().st_mtime_ns == before

    def test_a_video_alone_is_made_again_for_another_frame(self, upsample, pan, tmp_path):
        stills(tmp_path / "more", [frame(0.5)], first=3)
        video, words = tmp_path / "a.mp4", ("--skip-existing", "--no-tail")
        upsample(pan, video, *words)
        plain = video.read_bytes()
        upsample(pan, video, *words, "--rendered", tmp_path / "more")
        assert video.read_bytes() != plain

    def test_both_eyes_are_needed_where_both_are_written(self, exwarp, tmp_path):
        keys = write_stereo(tmp_path / "keys", "single", (1, 2))
        more = tmp_path / "more" / "shot.0002.exr"
        more.parent.mkdir()
        single(more, eyes_at(0.25), 2)
        words = ("upsample", keys, *HOW[:2], *VECTORS, "--view", "all", "--frames", 1)
        words += ("--rendered", more, "--progress", "none")
        assert exwarp(*words, "-o", tmp_path / "out").code == 0
        _, planes = shots.read(more)
        _, written = shots.read(tmp_path / "out" / more.name)
        assert all((written[name] == plane).all() for name, plane in planes.items())
        write_single(more, eyes_at(0.25), named_hero=False, views=("left",))
        exwarp(*words, "-o", tmp_path / "other").refused(3, "frame 2 of --rendered", "no channel")


def test_a_farm_passes_the_frames_on(exwarp, keys, one_frame, tmp_path):
    words = (keys, "-o", tmp_path / "out", *HOW, "--rendered", one_frame, "--video", "a.mp4")
    result = exwarp("farm", "commands", *words, "--chunk-size", 2, "--json")
    document = document_of(result)
    calls = [chunk["command"] for chunk in document["chunks"]] + document["afterwards"]
    assert len(calls) == 3
    for call in calls:
        assert call[call.index("--rendered") + 1] == str(one_frame)
