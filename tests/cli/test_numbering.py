"""Which frames are written, and under which names."""

from __future__ import annotations

import csv
import json
from fractions import Fraction
from hashlib import sha256
from pathlib import Path

import OpenEXR
import pytest

from tests.cli import shots
from tests.cli.street import Street

pytestmark = pytest.mark.usefixtures("unpainted_plots")

TINY = Street(16, 9)


@pytest.fixture
def colours(tmp_path):
    """Make a sequence of colour alone, which `hold` and `blend` can do with."""

    def make(numbers, folder: str = "keys") -> Path:
        return shots.sequence(tmp_path / folder, shots.colour_only, numbers, TINY)

    return make


def frames(numbers) -> list[str]:
    return [f"shot.{number:04d}.exr" for number in numbers]


class TestNumbers:
    @pytest.mark.parametrize(
        ("numbers", "options", "expected"),
        [
            ((1, 2, 3), (), range(1, 13)),
            ((1001, 1002, 1003), (), range(1001, 1013)),
            ((0, 1), (), range(8)),
            ((10, 14, 18), (), range(10, 22)),
            ((1001, 1002), ("--start-frame", 500), range(500, 508)),
            ((10, 14), ("--start-frame", 1), range(1, 9)),
            ((1001, 1002, 1003), ("--no-tail",), range(1001, 1010)),
            ((10, 14, 18), ("--no-tail",), range(10, 19)),
            ((7,), (), range(7, 11)),
            ((7,), ("--no-tail",), (7,)),
        ],
    )
    def test_output_follows_the_input(
        self, colours, upsample, tmp_path, numbers, options, expected
    ):
        upsample(colours(numbers), tmp_path / "out", "-m", "hold", *options)
        assert shots.names(tmp_path / "out") == frames(expected)

    @pytest.mark.parametrize(
        ("selection", "expected"),
        [
            ("1001-1003x2", (*range(1001, 1005), *range(1009, 1013))),
            ("1001-1003:2", (*range(1001, 1005), *range(1009, 1013))),
            ("1003,1002,1002-1003", range(1005, 1013)),
            ("1004", range(1013, 1017)),
        ],
    )
    def test_selected_keys_keep_their_places(
        self, colours, upsample, tmp_path, selection, expected
    ):
        keys = colours(range(1001, 1005))
        upsample(keys, tmp_path / "out", "-m", "hold", "--frames", selection)
        assert shots.names(tmp_path / "out") == frames(expected)

    def test_no_tail_stops_at_the_sequence_not_at_the_selection(self, colours, upsample, tmp_path):
        keys = colours((1, 2, 3))
        upsample(keys, tmp_path / "a", "-m", "hold", "--no-tail", "--frames", "1-2")
        upsample(keys, tmp_path / "b", "-m", "hold", "--no-tail", "--frames", "3")
        assert shots.names(tmp_path / "a") == frames(range(1, 9))
        assert shots.names(tmp_path / "b") == frames([9])

    def test_steps_of_four_select_by_input_numbers(self, colours, upsample, tmp_path):
        keys = colours((10, 14, 18))
        upsample(keys, tmp_path / "out", "-m", "hold", "--frames", "14")
        assert shots.names(tmp_path / "out") == frames(range(14, 18))

    def test_key_frames_lie_at_the_slots_of_their_numbers(self, colours, upsample, tmp_path):
        keys = colours((1001, 1002, 1003))
        upsample(keys, tmp_path / "out", "-m", "blend")
        for key, slot in ((1001, 1001), (1002, 1005), (1003, 1009)):
            got = tmp_path / "out" / f"shot.{slot}.exr"
            assert got.read_bytes() == shots.passed_through(keys / f"shot.{key}.exr", 120)

    def test_the_report_counts_what_is_on_disk(self, colours, upsample, tmp_path):
        keys, report = colours((1001, 1002, 1003)), tmp_path / "report"
        upsample(keys, tmp_path / "out", "-m", "blend", "--report", report)
        rows = list(csv.DictReader((report / "frames.csv").read_text().splitlines()))
        assert [row["file"] for row in rows] == shots.names(tmp_path / "out")
        counts = json.loads((report / "report.json").read_text())["frames"]
        # after the last key frame, without motion, three repeats
        assert (counts["key"], counts["written"]) == (3, 12)
        assert (counts["generated"], counts["dropped"]) == (6, 3)


class TestOutputNames:
    @pytest.mark.parametrize(
        ("output", "name"),
        [
            ("out", "shot.0002.exr"),
            ("deep/er/out", "shot.0002.exr"),
            ("out/new.######.exr", "new.000002.exr"),
            ("deep/v2/new_%03d.exr", "new_002.exr"),
            ("out/new.@@.exr", "new.02.exr"),
            ("out/new.$F5.exr", "new.00002.exr"),
            ("out.v2", "shot.0002.exr"),
            ("été 1/out", "shot.0002.exr"),
        ],
    )
    def test_folders_and_patterns(self, colours, upsample, tmp_path, output, name):
        upsample(colours((1, 2)), tmp_path / output, "-m", "hold")
        has_token = Path(output).suffix == ".exr"
        folder = (tmp_path / output).parent if has_token else tmp_path / output
        written = shots.names(folder)
        assert name in written and len(written) == 8

    def test_padding_and_base_are_the_input_s(self, upsample, tmp_path):
        for i in (8, 9, 10):
            shots.colour_only(tmp_path / "keys" / f"a b-{i}.exr", TINY, i)
        upsample(tmp_path / "keys", tmp_path / "out", "-m", "hold", "--no-tail")
        assert set(shots.names(tmp_path / "out")) == {f"a b-{i}.exr" for i in range(8, 17)}

    def test_other_files_of_the_folder_do_not_matter(self, colours, upsample, tmp_path):
        shots.colour_only(tmp_path / "out" / "shot.0099.exr", TINY, 0)
        upsample(colours((1, 2)), tmp_path / "out", "-m", "hold")
        assert len(shots.names(tmp_path / "out")) == 9

    def test_output_beside_the_input_under_another_name(self, colours, upsample, tmp_path):
        keys = colours((1, 2))
        upsample(keys, keys / "fast.####.exr", "-m", "hold")
        assert len(shots.names(keys)) == 10


class TestFrameRate:
    @pytest.mark.parametrize(
        ("options", "base", "source"),
        [
            ((), 30, "header"),
            (("--fps", "24"), 24, "option"),
            (("--fps", "23.976"), 23.976, "option"),
        ],
    )
    def test_base_rate(self, colours, upsample, tmp_path, options, base, source):
        report = tmp_path / "r"
        upsample(
            colours((1, 2)),
            tmp_path / "out",
            "-m",
            "blend",
            "--report",
            report,
            "--no-tail",
            *options,
        )
        fps = json.loads((report / "report.json").read_text())["fps"]
        assert fps["base"] == pytest.approx(base, abs=1e-3) and fps["source"] == source
        header, _ = shots.read(tmp_path / "out" / "shot.0002.exr")
        assert float(header["framesPerSecond"]) == pytest.approx(4 * base, abs=4e-3)
        assert fps["effective"] == pytest.approx(4 * base, abs=4e-3)

    def test_without_any_it_is_assumed_and_said_and_written_nowhere(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.blender5, (1, 2))
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "hold")
        assert result.code == 0 and "30 fps (assumed)" in result.err
        for name in shots.names(tmp_path / "out"):
            assert "framesPerSecond" not in shots.read(tmp_path / "out" / name)[0]
        for key, slot in ((1, 1), (2, 5)):
            source = keys / f"shot.{key:04d}.exr"
            assert (tmp_path / "out" / f"shot.{slot:04d}.exr").read_bytes() == source.read_bytes()
        assert exwarp("compare", keys, keys).code == 0

    def test_a_rate_that_is_said_is_written_into_frames_of_an_earlier_run(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.blender5, (1, 2), TINY)
        command = ("upsample", keys, "-o", tmp_path / "out", "-m", "hold", "--skip-existing")
        exwarp(*command)
        assert exwarp(*command, "--fps", 30).code == 0
        rates = [
            part.header["framesPerSecond"]
            for name in shots.names(tmp_path / "out")
            for part in OpenEXR.File(str(tmp_path / "out" / name), header_only=True).parts
        ]
        assert len(rates) > 8 and set(rates) == {Fraction(120)}

    def test_all_written_frames_have_one(self, colours, exwarp, tmp_path):
        """Whatever is resumed, verified or said in the report."""
        keys, out, report = colours((1, 2, 3)), tmp_path / "out", tmp_path / "report"
        command = ("upsample", keys, "-o", out, "-m", "blend", "--report", report, "--verify")
        assert exwarp(*command).code == 0
        rates = {name: shots.read(out / name)[0]["framesPerSecond"] for name in shots.names(out)}
        assert len(rates) == 12 and set(rates.values()) == {120}
        before = shots.contents(out)
        again = exwarp(*command, "--skip-existing")
        assert again.code == 0, again.err
        assert shots.contents(out) == before
        document = json.loads((report / "report.json").read_text())
        assert document["frames"]["resumed"] == 12
        sums = {one["file"]: one["sha256"] for one in document["files"]}
        assert sums == {name: sha256(data).hexdigest() for name, data in before.items()}
        foreseen = exwarp(*command[:-1], "--skip-existing", "--dry-run")
        assert "12 of them there already and kept" in foreseen.out

    def test_key_frames_can_be_copied_byte_for_byte(self, colours, upsample, tmp_path):
        keys, out = colours((1, 2)), tmp_path / "out"
        upsample(keys, out, "-m", "blend", "--keep-bytes", "--verify")
        kept, made = (shots.read(out / f"shot.{n:04d}.exr")[0] for n in (5, 2))
        assert (kept["framesPerSecond"], made["framesPerSecond"]) == (30, 120)
        source = keys / "shot.0002.exr"
        assert (out / "shot.0005.exr").read_bytes() == source.read_bytes()
        upsample(keys, out, "-m", "blend", "--skip-existing")
        assert (out / "shot.0005.exr").read_bytes() == shots.passed_through(source, 120)

    def test_a_rate_that_is_the_output_s_already_leaves_the_bytes(self, upsample, tmp_path):
        """A header of 30 fps, and every fourth frame of it rendered."""
        keys = shots.sequence(tmp_path / "keys", shots.colour_only, (1, 5, 9), TINY)
        upsample(keys, tmp_path / "out", "-m", "blend")
        for name in shots.names(keys):
            assert (tmp_path / "out" / name).read_bytes() == (keys / name).read_bytes()
        assert shots.read(tmp_path / "out" / "shot.0002.exr")[0]["framesPerSecond"] == 30

    @pytest.mark.parametrize("step", [2, 3, 4, 5])
    def test_numbers_in_steps_have_a_part_of_the_header_s_rate(
        self, exwarp, colours, tmp_path, step
    ):
        keys, out = colours(range(1, 3 * step, step)), tmp_path / "out"
        command = ("upsample", keys, "-m", "blend", "--progress", "plain")
        found = exwarp(*command, "-o", out)
        assert found.code == 0, found.err
        assert f"at {30 / step:g} fps (header)" in found.err
        assert f"numbered in steps of {step}: the header's 30 fps" in found.err
        assert found.err.count("give --fps 30") == 1
        header, _ = shots.read(out / "shot.0002.exr")
        assert header["framesPerSecond"] == Fraction(30, step) * 4

    def test_their_rate_can_be_said(self, exwarp, colours, tmp_path):
        keys, out = colours((1, 5, 9)), tmp_path / "out"
        found = exwarp("upsample", keys, "-o", out, "-m", "blend", "--fps", 30)
        assert found.code == 0 and "in steps" not in found.err
        assert shots.read(out / "shot.0002.exr")[0]["framesPerSecond"] == 120

    def test_inspect_says_so_too(self, exwarp, colours):
        keys = colours((1, 5, 9))
        assert "7.5 fps (header)" in (output := exwarp("inspect", keys).out)
        assert "if the key frames themselves come at 30 fps, give --fps 30" in output
        found = json.loads(exwarp("inspect", keys, "--json").out)["fps"]
        assert (found["base"], found["source"]) == (7.5, "header")

    def test_what_is_assumed_is_the_scene_s_rate_too(self, exwarp, tmp_path):
        shots.sequence(tmp_path / "keys", shots.blender5, (1, 5), TINY)
        result = exwarp("upsample", tmp_path / "keys", "-o", tmp_path / "out", "-m", "hold")
        assert result.code == 0 and "7.5 fps (assumed)" in result.err
        assert "30 fps are assumed" in result.err


class TestInputForms:
    @pytest.mark.parametrize(
        "spec",
        ["", "shot.####.exr", "shot.%04d.exr", "shot.@@@@.exr", "shot.$F4.exr", "shot.0002.exr"],
    )
    @pytest.mark.parametrize("folder", ["keys", "mit Leerzeichen/été ☀"])
    def test_all_name_the_same_frames(self, colours, upsample, tmp_path, spec, folder):
        keys = colours((1, 2), folder)
        upsample(f"{keys}/{spec}", tmp_path / "out", "-m", "hold")
        assert shots.names(tmp_path / "out") == frames(range(1, 9))

    def test_in_the_working_folder(self, colours, upsample, tmp_path, monkeypatch):
        monkeypatch.chdir(colours((1, 2)))
        upsample("shot.####.exr", "../out", "-m", "hold")
        assert shots.names(tmp_path / "out") == frames(range(1, 9))

    def test_inspect_and_compare_take_them_too(self, colours, exwarp):
        keys = colours((1, 2))
        for spec in ("shot.%04d.exr", "shot.0001.exr"):
            assert exwarp("inspect", keys / spec).code == 0
            assert exwarp("compare", keys, keys / spec).code == 0
