"""frames.csv, and the folder that the report's files lie in."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from exwarp_cli.domain.decision import Decision, Features
from exwarp_cli.domain.results import Score
from exwarp_cli.errors import OutputError
from exwarp_cli.report.folder import write_report
from exwarp_cli.report.schema import format_cell, format_frames_csv
from tests.unit.sample_runs import interval, no_pictures, path_run, run

COLUMNS = [
    *("frame", "file", "key", "slot", "kind", "method", "sources"),
    *("hole_fraction", "nonfinite_pixels", "psnr_db", "ssim", "flip"),
    *("psnr_db_holes", "ssim_holes", "flip_holes", "resumed"),
    *("made_by", "path", "node", "choice", "output_warp", "output_extrapolate"),
    *("N_d", "EMD_Wn", "EMD_Wp", "Var_x", "Var_y", "R", "inputs"),
    *("hdr_flip", "vmaf", "flicker", "hdr_flip_holes", "flicker_holes"),
    *("render_s", "render_source", "rendered_width", "rendered_height", "distance"),
    *("scored", "scored_holes", "replaced", "pulse", "predicted_error", "risk", "gate"),
    *("tiles", "rendered_sources"),
]
STEPS = ("read", "features", "decide", "warp", "holes", "extrapolate", "write")
TIMES = [f"{step}_ms" for step in STEPS]


SEEN = Features(2, 0.125, 0.1, 4.0, 0.5, 64, 32, 7.0)
DECISION = Decision("d1", "extrapolate", SEEN, (65536, 0, -1), (-3, 12))


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_columns_are_those_of_the_contract() -> None:
    assert format_frames_csv(()).splitlines() == [",".join(COLUMNS + TIMES)]


def test_every_value_has_its_cell() -> None:
    first, second, *_ = interval(1001, "ggg", 1001)
    second = replace(
        second,
        sources=(1001, 1002),
        hole_fraction=0.1,
        nonfinite_pixels=0,
        score=Score(34.5, 0.9, 1 / 3, 0.375, 91.5, 2.75, -12.5),
        hole_score=Score(20.25, 0.5, 0.5, 0.625, None, 7.5),
        resumed=True,
        timing_ms={"warp": 1.5, "score": 7.0},
        made_by="hold",
        path="S2",
        decision=DECISION,
        render=(42.5, "RenderTime"),
    )
    key, row = rows_of(format_frames_csv((first, second)))
    assert list(row) == [*COLUMNS, *TIMES, "score_ms"]
    filled = {name: value for name, value in row.items() if value != ""}
    assert filled == {
        "frame": "1002",
        "file": "shot.1002.exr",
        "key": "1001",
        "slot": "1",
        "kind": "generated",
        "method": "warp",
        "sources": "1001 1002",
        "hole_fraction": "0.1",
        "nonfinite_pixels": "0",
        "psnr_db": "34.5",
        "ssim": "0.9",
        "flip": repr(1 / 3),
        "psnr_db_holes": "20.25",
        "ssim_holes": "0.5",
        "flip_holes": "0.5",
        "resumed": "true",
        "made_by": "hold",
        "path": "S2",
        "node": "d1",
        "choice": "extrapolate",
        "output_warp": "-3",
        "output_extrapolate": "12",
        "N_d": "2",
        "EMD_Wn": "0.125",
        "EMD_Wp": "0.1",
        "Var_x": "4.0",
        "Var_y": "0.5",
        "R": "2048",
        "inputs": "65536 0 -1",
        "hdr_flip": "0.375",
        "vmaf": "91.5",
        "flicker": "2.75",
        "hdr_flip_holes": "0.625",
        "flicker_holes": "7.5",
        "render_s": "42.5",
        "render_source": "RenderTime",
        "rendered_width": "64",
        "rendered_height": "32",
        "distance": "7.0",
        "scored": "true",
        "scored_holes": "true",
        "replaced": "false",
        "pulse": "-12.5",
        "warp_ms": "1.5",
        "score_ms": "7.0",
    }
    assert key["psnr_db"] == key["hole_fraction"] == key["warp_ms"] == ""
    assert (key["kind"], key["resumed"]) == ("key", "false")
    assert key["scored"] == key["scored_holes"] == "false"
    assert all(
        key[name] == "" for name in COLUMNS[COLUMNS.index("made_by") : COLUMNS.index("scored")]
    )


def test_a_decision_without_features_has_no_cells_for_them() -> None:
    frame = interval(1001, "ggg", 1001)[1]
    bare = Decision("d2", "warp", outputs=(34.5, 30.25))
    (row,) = rows_of(format_frames_csv((replace(frame, decision=bare),)))
    filled = {
        name: row[name]
        for name in COLUMNS[COLUMNS.index("made_by") : COLUMNS.index("scored")]
        if row[name]
    }
    assert filled == {
        "node": "d2", "choice": "warp", "output_warp": "34.5", "output_extrapolate": "30.25"
    }  # fmt: skip


def test_rows_keep_their_order() -> None:
    rows = rows_of(format_frames_csv(path_run("S1", 2).frames))
    assert [row["frame"] for row in rows] == [str(n) for n in range(1001, 1009)]
    assert [row["kind"] for row in rows[:4]] == ["key", "dropped", "generated", "dropped"]


@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf])
def test_unmeasured_cells_are_empty(value: float | None) -> None:
    assert format_cell(value) == ""


def test_file_names_that_csv_could_break_on_come_back() -> None:
    frame = replace(interval(1001, "", 1001)[0], file='a, "b"\n\r \udcff.exr')
    text = format_frames_csv((frame,))
    assert rows_of(text)[0]["file"] == 'a, "b"\n\\r \\udcff.exr'


@pytest.mark.parametrize("name", ["=1+1", "+a", "-a", "@a", "'a", "''", "\t=a", "a=1"])
def test_no_spreadsheet_takes_a_file_name_for_a_formula(name: str) -> None:
    frame = replace(interval(1001, "", 1001)[0], file=f"{name}.exr")
    written = rows_of(format_frames_csv((frame,)))[0]["file"]
    assert written[0] not in "=+-@\t" and written.removeprefix("'") == f"{name}.exr"


def test_folder_is_made_and_files_are_whole(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "report"
    write_report(folder, path_run("S6", 2), no_pictures())
    names = [
        *("album.json", "frames.csv", "report.html", "report.json"),
        *("review.csv", "review.txt", "run.json"),
    ]
    assert sorted(p.name for p in folder.iterdir()) == names
    assert json.loads((folder / "report.json").read_text())["frames"]["written"] == 8
    assert len(rows_of((folder / "frames.csv").read_text())) == 8
    write_report(folder, run([]), no_pictures())
    assert json.loads((folder / "report.json").read_text())["frames"]["written"] == 0


def test_folder_that_cannot_be_made_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        write_report(tmp_path / "file", run([]), no_pictures())
