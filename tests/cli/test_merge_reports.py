"""``exwarp merge-reports``: chunks in any split tell what a single run tells."""

from __future__ import annotations

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from exwarp_cli import cli
from exwarp_cli.domain.timeline import parse_frames, ranges
from exwarp_cli.report.folder import chunk_folder
from exwarp_cli.report.gallery import OUTPUT, TRUTH
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.documents import strict
from tests.cli.reports import album, rows, unmeasured
from tests.cli.shots import VECTORS
from tests.cli.street import Street

pytestmark = pytest.mark.usefixtures("unpainted_plots")

KEYS = 6
CUT = 4
"""First key frame of the second shot."""

STREET = Street(64, 36)


def of_two_shots(frame: shots.FrameWriter) -> shots.FrameWriter:
    """Write frames of two shots that look at other parts of the street, CUT - 1 intervals each."""

    def write(path: Path, street: Street, time: float) -> None:
        frame(path, street, time + (6.0 if time >= CUT - 1 else -20.0))

    return write


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> dict[str, Path]:
    """Six key frames of two shots with all passes, and truth up to the last one; read only."""
    root = tmp_path_factory.mktemp("merging")
    keys, truth = of_two_shots(shots.blender4), of_two_shots(shots.colour_only)
    slots = range(1, 4 * KEYS - 2)
    return {
        "keys": shots.sequence(root / "keys", keys, range(1, KEYS + 1), STREET),
        "truth": shots.sequence(root / "truth", truth, slots, STREET, 0.25),
    }


Run = Callable[..., Path]


@pytest.fixture
def do(upsample, shot, tmp_path) -> Run:
    """Do some key frames of the shot; return the folder of their report."""

    def run(name: str, *options: object, frames: str | None = None) -> Path:
        report = tmp_path / f"{name}-report"
        part = ()
        if frames is not None:
            report = chunk_folder(report, parse_frames(frames))
            part = ("--frames", frames)
        more = ("--report", report, *VECTORS, *options)
        upsample(shot["keys"], tmp_path / name, *part, *more)
        return report

    return run


def wall(folder: Path) -> float:
    """Return a report's seconds of work."""
    return float(json.loads((folder / "report.json").read_text())["wall_s"])


def split(seed: int) -> list[str]:
    """Deal the key frames to two chunks at random; they need not be neighbours."""
    rng = random.Random(seed)
    owners = [0, 1, *(rng.randrange(2) for _ in range(KEYS - 2))]
    rng.shuffle(owners)
    parts = [[k + 1 for k in range(KEYS) if owners[k] == i] for i in range(2)]
    return [ranges(part) for part in parts]


CASES = {
    "causal": (True, "-m", "causal", "--metrics", "all"),
    "s6 without tail": (True, "-m", "s6", "--no-tail"),
    "softsplat, layers": (True, "-m", "softsplat", "--layers", "all", "--metrics", "ssim,flicker"),
    "oracle": (True, "-m", "oracle"),
    "hold": (False, "-m", "hold", "--cuts", "none"),
    "24 to 60": (False, "-m", "s6", "--fps", "24", "--to-fps", "60", "--no-tail"),
    "given cut": (False, "-m", "s3", "--cuts", "auto,3"),
}


@pytest.fixture(scope="module")
def options(shot, network) -> Callable[[str], tuple[object, ...]]:
    """Return the options of a case."""

    def found(name: str) -> tuple[object, ...]:
        scored, *rest = CASES[name]
        if rest[1] in ("causal", "oracle", "s3"):
            rest += ["--extrapolator", network]
        return (*rest, *(("--ground-truth", shot["truth"]) if scored else ()))

    return found


@pytest.fixture(scope="module")
def single(shot, options, tmp_path_factory) -> Callable[[str], Path]:
    """Do a case as one run, once; return the folder of its report, beside "out"; read only."""
    done: dict[str, Path] = {}

    def run(name: str) -> Path:
        if name not in done:
            root = tmp_path_factory.mktemp("single")
            done[name] = root / "report"
            where = (shot["keys"], "-o", root / "out", "--report", done[name], *VECTORS)
            run_quietly("upsample", *where, *options(name))
        return done[name]

    return run


@pytest.mark.parametrize("name", [name for name in CASES if name != "s6 without tail"])
def test_chunks_tell_what_a_single_run_tells(exwarp, do, options, single, tmp_path, name):
    whole = single(name)
    seed = list(CASES).index(name)
    chunks = [do("parts", *options(name), frames=part) for part in split(seed)]
    random.Random(seed).shuffle(chunks)
    merged = tmp_path / "merged"
    result = exwarp("merge-reports", *chunks, "-o", merged)
    assert result.code == 0 and result.err == ""
    assert unmeasured(merged) == unmeasured(whole)
    assert rows(merged) == rows(whole)
    assert album(merged) == album(whole), "the same pictures, byte for byte"
    assert wall(merged) == pytest.approx(sum(map(wall, chunks)))
    assert shots.contents(tmp_path / "parts") == shots.contents(whole.parent / "out")


def test_cases_are_what_they_are_called(single):
    """Cuts are met, frames dropped or scored, and layers written: else equality says little."""
    found = unmeasured(single("causal"))
    assert found["cuts"] == [{"frame": CUT, "source": "detected"}]
    assert found["quality"]["all"]["vmaf"] and found["quality"]["holes"]["ssim"]
    assert found["policy"] and found["extrapolator"] and found["input"]["selected"] == "1-6"
    found = unmeasured(single("softsplat, layers"))
    assert len(found["layers"]) > 3
    found = unmeasured(single("24 to 60"))
    assert found["fps"]["factor"] == "5/2" and found["frames"]["key"] == 3


def test_frames_that_were_kept_are_reported_alike(exwarp, do, options, single, tmp_path):
    chosen = (*options("s6 without tail"), "--skip-existing")
    for name in ("whole", "parts"):
        shutil.copytree(single("s6 without tail").parent / "out", tmp_path / name)
        (tmp_path / name / "shot.0006.exr").unlink()
    whole = do("whole", *chosen)
    for part in ("1", "2-4", "5-6"):
        do("parts", *chosen, frames=part)
    merged = tmp_path / "parts-report"
    assert exwarp("merge-reports", merged, "--overwrite").code == 0
    assert unmeasured(merged) == unmeasured(whole)
    assert rows(merged) == rows(whole)
    assert [row["frame"] for row in rows(merged) if row["resumed"] == "false"] == ["6"]


@pytest.fixture(scope="module")
def done(tmp_path_factory, shot) -> Path:
    """The report's folder of three chunks against the truth; key frame 4 is in none; read only."""
    root = tmp_path_factory.mktemp("chunks")
    for part in ("1-2", "3", "5-6"):
        code = cli.run(
            [
                *("upsample", str(shot["keys"]), "-o", str(root / "out"), "-m", "s6", *VECTORS),
                *("--ground-truth", str(shot["truth"]), "--frames", part),
                *("--report", str(chunk_folder(root / "report", parse_frames(part)))),
                *("--progress", "none", "--threads", "1"),
            ]
        )
        assert code == 0
    return root / "report"


@pytest.fixture
def chunks(done, tmp_path) -> tuple[Path, list[Path]]:
    """A copy of these chunks: the folder of the report, and theirs in it."""
    report = shutil.copytree(done, tmp_path / "chunks-report")
    return report, [chunk_folder(report, keys) for keys in ([1, 2], [3], [5, 6])]


def test_chunks_are_joined_where_they_lie(exwarp, chunks):
    report, folders = chunks
    assert [folder.name for folder in folders] == ["1-2", "3", "5-6"]
    result = exwarp("merge-reports", report)
    assert result.code == 0 and result.err == ""
    lines = result.out.splitlines()
    assert lines[0] == "20 frames: 5 rendered, 15 generated, 0 repeated"
    assert "30 fps in, 120 out, effective 120" in lines
    assert any(line.startswith("against ground truth (12 frames): PSNR ") for line in lines)
    assert any(line.startswith("3 reports joined, ") for line in lines)
    assert "key frames of the sequence that are in no report: 4" in lines
    assert lines[-1] == f"report in {report}"
    again = exwarp("merge-reports", report)
    again.refused(6, str(report), "--overwrite", "-o")
    # A late chunk is joined with the others, and the joined report is none of them.
    assert exwarp("merge-reports", report, "--overwrite").out == result.out


def change_run(folder: Path, name: str, value: object) -> None:
    """Change a field of the run in a report's run.json."""
    document = json.loads((folder / "run.json").read_text())
    document["run"][name] = value
    (folder / "run.json").write_text(json.dumps(document))


@pytest.mark.parametrize("seconds", ["inf", "nan"])
def test_a_time_that_is_not_known_is_named_so(exwarp, chunks, seconds):
    report, folders = chunks
    change_run(folders[1], "wall_seconds", seconds)
    result = exwarp("merge-reports", report)
    assert result.code == 0 and result.err == ""
    assert "3 reports joined, time of the work not known" in result.out.splitlines()


def test_json_is_the_document_and_the_facts_of_the_merging(exwarp, chunks, tmp_path):
    report, folders = chunks
    (folders[1] / "album.json").unlink()
    result = exwarp("merge-reports", report, "--json", "-o", tmp_path / "joined")
    assert result.code == 0 and result.err == ""
    found = strict(result.out)
    assert found.pop("merged") == {
        "reports": 3, "missing": "4", "without_pictures": [str(folders[1])], "superseded": []
    }  # fmt: skip
    assert found == json.loads((tmp_path / "joined" / "report.json").read_text())
    assert parse_frames(found["input"]["selected"]) == [1, 2, 3, 5, 6]


def test_a_joined_report_is_joined_with_others(exwarp, chunks, do, shot, tmp_path):
    report, _ = chunks
    late = do("late", "-m", "s6", "--ground-truth", shot["truth"], frames="4")
    assert exwarp("merge-reports", report).code == 0
    result = exwarp("merge-reports", report, late, late, "-o", tmp_path / "all")
    assert result.code == 0 and "in no report" not in result.out
    single = do("single", "-m", "s6", "--ground-truth", shot["truth"])
    assert unmeasured(tmp_path / "all") == unmeasured(single)
    assert album(tmp_path / "all") == album(single)


@pytest.mark.parametrize("harm", ["absent", "album", "picture", "bytes"])
def test_albums_that_cannot_be_read_leave_out_their_pictures(exwarp, chunks, harm):
    report, folders = chunks
    file = folders[0] / "album.json"
    text = file.read_text()
    if harm == "absent":
        file.unlink()
    elif harm == "bytes":
        file.write_bytes(b"\xff\xfe")
    elif harm == "picture":
        file.write_text(text.replace("data:image/webp;base64,", "data:image/svg+xml;base64,"))
    else:
        file.write_text(text.replace('"frames":', '"f":'))
    result = exwarp("merge-reports", report)
    assert result.code == 0 and result.err == ""
    (line,) = (line for line in result.out.splitlines() if line.startswith("without pictures"))
    assert str(folders[0]) in line
    shown = album(report)
    assert [frame["number"] for frame in shown["frames"]] == [*range(9, 13), *range(17, 25)]
    assert (shown["before"], shown["after"]) == (OUTPUT, TRUTH)
    assert len(rows(report)) == 20


def test_a_run_without_any_album_has_a_report(exwarp, chunks):
    report, folders = chunks
    for folder in folders:
        (folder / "album.json").unlink()
    assert exwarp("merge-reports", report).code == 0
    assert 'id="viewer"' not in (report / "report.html").read_text()


class TestRefusals:
    def test_a_frame_twice(self, exwarp, chunks, do, shot, tmp_path):
        _, folders = chunks
        more = do("more", "-m", "s6", "--ground-truth", shot["truth"], frames="2-3")
        result = exwarp("merge-reports", *folders, more, "-o", tmp_path / "joined")
        result.refused(3, "frame 5 is in", str(folders[0]), str(more), "leave one of them out")
        assert not (tmp_path / "joined").exists()

    def test_another_method(self, exwarp, chunks, do, tmp_path):
        _, folders = chunks
        other = do("other", "-m", "hold", frames="4")
        result = exwarp("merge-reports", *folders, other, "-o", tmp_path / "joined")
        result.refused(3, str(folders[0]), str(other), "the method is s6")

    def test_a_comparison(self, exwarp, chunks, shot, tmp_path):
        _, folders = chunks
        compared = tmp_path / "compared"
        assert exwarp("compare", shot["truth"], shot["truth"], "--report", compared).code == 0
        result = exwarp("merge-reports", folders[0], compared, "-o", tmp_path / "joined")
        result.refused(3, str(compared / "report.json"), "comparison")

    @pytest.mark.parametrize("name", ["run.json", "report.json"])
    def test_a_damaged_file(self, exwarp, chunks, name):
        report, folders = chunks
        file = folders[2] / name
        file.write_text(file.read_text()[:-30])
        exwarp("merge-reports", report).refused(3, str(folders[2]), "do its key frames again")

    @pytest.mark.parametrize("name", ["run.json", "report.json"])
    def test_a_file_that_is_no_text(self, exwarp, chunks, name):
        report, folders = chunks
        (folders[2] / name).write_bytes(b"\xff\xfe")
        result = exwarp("merge-reports", report)
        result.refused(3, f"{folders[2] / name} is damaged", "do its key frames again")

    def test_a_factor_that_is_no_number(self, exwarp, chunks):
        report, folders = chunks
        change_run(folders[2], "factor", "1/0")
        exwarp("merge-reports", report).refused(3, str(folders[2]), "do its key frames again")

    def test_files_of_two_runs(self, exwarp, chunks):
        report, folders = chunks
        shutil.copyfile(folders[0] / "run.json", folders[1] / "run.json")
        result = exwarp("merge-reports", report)
        result.refused(3, f"report.json and run.json in {folders[1]} do not go together", "again")

    def test_a_report_of_a_version_before_run_files(self, exwarp, chunks):
        report, folders = chunks
        (folders[1] / "run.json").unlink()
        result = exwarp("merge-reports", report)
        result.refused(3, f"{folders[1]} holds no run.json", "merge reports with the version that")

    def test_a_report_of_a_version_that_wrote_something_else(self, exwarp, chunks):
        report, folders = chunks
        file = folders[1] / "report.json"
        document = json.loads(file.read_text())
        file.write_text(json.dumps(document | {"version": "99.0"}))
        exwarp("merge-reports", report).refused(3, "was written by ExWarp 99.0")

    def test_nothing_to_join(self, exwarp, tmp_path):
        exwarp("merge-reports", tmp_path).refused(3, str(tmp_path), "chunks")
        named = exwarp("merge-reports", tmp_path, "-o", tmp_path / "joined")
        named.refused(3, f"{tmp_path} holds no report.json")

    def test_farms_receive_the_reason(self, exwarp, tmp_path):
        result = exwarp("merge-reports", tmp_path, "--progress", "openjd")
        assert result.code == 3
        (line,) = result.out.splitlines()
        assert line == f"openjd_fail: {result.err.strip().removeprefix('exwarp: error: ')}"

    def test_no_place_to_write(self, exwarp, chunks):
        _, folders = chunks
        exwarp("merge-reports", *folders).refused(2, "-o")
        assert exwarp("merge-reports").code == 2

    def test_onto_one_of_them(self, exwarp, chunks):
        _, folders = chunks
        before = shots.contents(folders[0])
        result = exwarp("merge-reports", *folders, "-o", folders[0], "--overwrite")
        result.refused(2, f"-o {folders[0]}")
        assert shots.contents(folders[0]) == before

    def test_onto_a_report(self, exwarp, chunks, do, tmp_path):
        _, folders = chunks
        other = do("other", "-m", "hold")
        exwarp("merge-reports", *folders, "-o", other).refused(6, str(other), "another -o")


class TestSubmittedAgain:
    """Jobs whose chunks have another size leave reports of the same key frames: the newer tells."""

    @pytest.fixture
    def again(self, do, options, tmp_path) -> Callable[..., list[Path]]:
        """Do chunks as a job that was submitted so many times before would."""

        def run(time: int, *parts: str, case: str = "s6 without tail") -> list[Path]:
            found = []
            # Else the frames of a single run would be made, and these replaced.
            shutil.rmtree(tmp_path / "parts", ignore_errors=True)
            for part in parts:
                folder = do("parts", *options(case), "--overwrite", frames=part)
                os.utime(folder / "report.json", (time, time))
                found.append(folder)
            return found

        return run

    def test_chunks_of_another_size(self, exwarp, again, single, tmp_path):
        older = again(1, "1-2", "3-6")
        newer = again(2, "1-3", "4-6")
        whole = single("s6 without tail")
        merged = tmp_path / "parts-report"
        result = exwarp("merge-reports", merged)
        assert result.code == 0 and "2 reports joined, " in result.out
        named = ", ".join(map(str, older))
        assert f"older reports, of key frames that newer ones tell of: {named}\n" in result.out
        assert unmeasured(merged) == unmeasured(whole) and rows(merged) == rows(whole)
        assert album(merged) == album(whole)
        assert wall(merged) == pytest.approx(sum(map(wall, newer)))
        assert all((folder / "report.json").exists() for folder in older), "nothing is deleted"

    def test_a_part_of_a_chunk(self, exwarp, again, single, tmp_path):
        (older,) = again(1, "1-6")
        file = older / "run.json"
        file.write_text(file.read_text().replace("shot.0006.exr", "old.0006.exr"))
        (newer,) = again(2, "2-4")
        merged = tmp_path / "parts-report"
        result = exwarp("merge-reports", merged, "--json")
        assert result.code == 0
        facts = strict(result.out)["merged"]
        assert facts["superseded"] == [str(older)] and facts["reports"] == 2
        whole = single("s6 without tail")
        assert unmeasured(merged) == unmeasured(whole) and rows(merged) == rows(whole)
        assert album(merged) == album(whole)
        kept = 21 - 12
        assert wall(merged) == pytest.approx(wall(newer) + wall(older) * kept / 21)

    def test_older_ones_of_another_run_are_in_the_way_only_where_they_tell(self, exwarp, again):
        (older,) = again(1, "1-4", case="hold")
        (newer,) = again(2, "3-6")
        report = older.parent.parent
        exwarp("merge-reports", report).refused(3, str(older), str(newer), "the method is hold")
        again(3, "1-3")
        assert exwarp("merge-reports", report).code == 0

    def test_older_ones_of_earlier_versions_are_in_the_way_only_where_they_tell(
        self, exwarp, again
    ):
        (older,) = again(1, "2")
        again(2, "1-3", "4-6")
        (older / "run.json").unlink()
        result = exwarp("merge-reports", older.parent.parent)
        assert result.code == 0 and "2 reports joined, " in result.out

    def test_of_the_same_moment_none_is_newer(self, exwarp, again):
        one, other = again(1, "1-2", "2-3")
        exwarp("merge-reports", one.parent.parent).refused(3, "frame 5 is in", str(one), str(other))


@pytest.mark.parametrize(
    ("keys", "name"),
    [
        ([1001], "1001"),
        ([1001, 1002, 1003], "1001-1003"),
        ([1001, 1002, 1010], "1001-1002,1010"),
        ([10, 14, 18], "10-18x4"),
        ([-5, -4, -3], "-5--3"),
        ([0], "0"),
    ],
)
def test_folders_of_chunks(keys, name):
    assert chunk_folder(Path("r"), keys) == Path("r") / "chunks" / name


def test_folders_of_other_chunks_have_other_names():
    """Else a report would be lost: they may begin and end alike."""
    many = [key for key in range(2000) if key % 7 in (0, 1, 3)]
    names = {chunk_folder(Path("r"), keys).name for keys in (many, [*many[:-2], many[-1]])}
    assert len(names) == 2 and all(len(name) < 128 for name in names)
