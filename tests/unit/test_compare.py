"""`exwarp compare`: pairing, masks, windows, what it prints and what it refuses."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner

from exwarp_cli.commands.compare import command
from exwarp_cli.errors import (
    DamagedFileError,
    ExwarpError,
    InputError,
    LayoutError,
    MissingFrameError,
    OutputError,
    UsageError,
)
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.pipeline.evaluation import Comparison, evaluate
from exwarp_cli.report.comparison import comparison_document
from exwarp_cli.report.schema import to_json

SIZE = (16, 24)


def picture(seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).random((*size, 3), dtype=np.float32)


def save(
    path: Path,
    channels: dict[str, np.ndarray],
    data: tuple[int, int] = (0, 0),
    display: tuple[int, int, int, int] | None = None,
) -> None:
    """Write an EXR whose data window begins at `data`; `display` is x0, y0, x1, y1."""
    height, width = next(iter(channels.values())).shape[:2]
    corner = np.array([data[0] + width - 1, data[1] + height - 1], np.int32)
    window = (np.array(data, np.int32), corner)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": window,
        "displayWindow": window
        if display is None
        else (np.array(display[:2], np.int32), np.array(display[2:], np.int32)),
    }
    path.parent.mkdir(exist_ok=True)
    OpenEXR.File(header, channels).write(str(path))


def sequence(folder: Path, pictures: dict[int, np.ndarray], channel: str = "RGB") -> str:
    for number, pixels in pictures.items():
        save(folder / f"shot.{number:04d}.exr", {channel: np.ascontiguousarray(pixels)})
    return str(folder)


@pytest.fixture
def truth(tmp_path: Path) -> str:
    return sequence(tmp_path / "a", {n: picture(n) for n in range(1, 5)})


def shifted(tmp_path: Path, first: int, count: int = 4, name: str = "b") -> str:
    """Frames that differ from the truth's by a little more each time."""
    return sequence(
        tmp_path / name, {first + i: picture(1 + i) * (1 - 0.1 * i) for i in range(count)}
    )


def pairs(result: Comparison) -> list[tuple[int, int]]:
    return [(frame.reference, frame.test) for frame in result.frames]


def test_frames_are_matched_by_number_where_one_has_all_of_the_other(
    tmp_path: Path, truth: str
) -> None:
    part = sequence(tmp_path / "b", {2: picture(2), 3: picture(3) * 0.5})
    result = evaluate(truth, part)
    assert (result.matched_by, pairs(result)) == ("number", [(2, 2), (3, 3)])
    assert pairs(evaluate(part, truth)) == [(2, 2), (3, 3)]
    assert result.frames[0].score.psnr_db == 100
    assert result.worst.test == 3
    assert (result.width, result.height) == (24, 16)


@pytest.mark.parametrize("first", [3, 101])
def test_frames_are_matched_by_order_otherwise(tmp_path: Path, truth: str, first: int) -> None:
    result = evaluate(truth, shifted(tmp_path, first))
    assert result.matched_by == "order"
    assert pairs(result) == [(1 + i, first + i) for i in range(4)]
    assert result.frames[0].score.psnr_db == 100


def test_scores_are_those_of_the_metrics(tmp_path: Path, truth: str) -> None:
    result = evaluate(truth, shifted(tmp_path, 1))
    for i, frame in enumerate(result.frames):
        original = picture(1 + i)
        assert frame.score == score_frame(original, original * np.float32(1 - 0.1 * i), None)[0]
        assert (frame.hole_score, frame.hole_fraction) == (None, None)


@pytest.mark.parametrize("frames", ["2-3", "3,2"])
def test_frames_selects_by_the_numbers_of_the_reference(
    tmp_path: Path, truth: str, frames: str
) -> None:
    assert pairs(evaluate(truth, shifted(tmp_path, 101), frames)) == [(2, 102), (3, 103)]


def test_one_frame_or_a_pattern_names_the_sequence(tmp_path: Path, truth: str) -> None:
    test = shifted(tmp_path, 1)
    named = evaluate(f"{truth}/shot.####.exr", f"{test}/shot.0003.exr")
    assert named.frames == evaluate(truth, test).frames


@pytest.mark.parametrize("numbered_as", ["test", "reference"])
def test_masks_give_the_score_in_holes(tmp_path: Path, truth: str, numbered_as: str) -> None:
    test = shifted(tmp_path, 101)
    first = 101 if numbered_as == "test" else 1
    hole = np.zeros(SIZE, np.float32)
    hole[2:5, 3:10] = 1.0
    hole[0, 0] = 0.5  # not above the threshold
    masks = sequence(tmp_path / "m", {first + 1: hole, first + 3: hole * 0}, channel="holes")
    result = evaluate(truth, test, holes=masks)
    assert [frame.hole_fraction for frame in result.frames] == [None, 21 / (16 * 24), None, 0]
    original = picture(2)
    expected = score_frame(original, original * np.float32(0.9), hole > 0.5)[1]
    assert [frame.hole_score for frame in result.frames] == [None, expected, None, None]
    assert comparison_document(result)["quality"]["holes"]["frames"] == 1


def test_the_display_window_is_compared(tmp_path: Path) -> None:
    """Overscan is cut off, missing borders are black, and origins may differ."""
    whole = picture(1, (20, 30))
    display = (0, 0, 29, 19)
    save(tmp_path / "a" / "x.1.exr", {"RGB": whole}, display=display)
    over = np.zeros((24, 34, 3), np.float32)
    over[2:22, 2:32] = whole
    save(tmp_path / "b" / "x.1.exr", {"RGB": over}, data=(-2, -2), display=display)
    assert evaluate(str(tmp_path / "a"), str(tmp_path / "b")).frames[0].score.psnr_db == 100
    save(
        tmp_path / "c" / "x.1.exr", {"RGB": whole[5:15, 4:10].copy()}, (104, 55), (100, 50, 129, 69)
    )
    black = np.zeros_like(whole)
    black[5:15, 4:10] = whole[5:15, 4:10]
    found = evaluate(str(tmp_path / "a"), str(tmp_path / "c")).frames[0].score
    assert found == score_frame(whole, black, None)[0]


REFUSALS: dict[str, tuple[list[str], type[ExwarpError]]] = {
    "count": (["{b}"], MissingFrameError),  # three frames against four, of other numbers
    "sizes": (["{b}"], LayoutError),
    "damaged": (["{b}"], DamagedFileError),
    "absent": (["{b}/none"], InputError),
    "frames": (["{b}", "--frames", "2-9"], MissingFrameError),
    "range": (["{b}", "--frames", "two"], UsageError),
    "report": (["{b}", "--report", "{b}/shot.0101.exr/x"], OutputError),
    "mask numbers": (["{b}", "--holes", "{masks}/numbers"], MissingFrameError),
    "mask size": (["{b}", "--holes", "{masks}/size"], LayoutError),
    "mask channel": (["{b}", "--holes", "{masks}/channel"], LayoutError),
}


@pytest.mark.parametrize("case", list(REFUSALS))
def test_what_cannot_be_compared_is_one_sentence(tmp_path: Path, truth: str, case: str) -> None:
    test = shifted(tmp_path, 101, 3 if case == "count" else 4)
    if case == "sizes":
        sequence(Path(test), {103: picture(1, (16, 25))})
    if case == "damaged":
        file = Path(test) / "shot.0102.exr"
        file.write_bytes(file.read_bytes()[:300])
    hole = np.zeros(SIZE, np.float32)
    masks = tmp_path / "masks"
    masks.mkdir()
    sequence(masks / "numbers", {900: hole}, "holes")
    sequence(masks / "size", {101: hole[:8]}, "holes")
    sequence(masks / "channel", {101: hole}, "Y")
    arguments, kind = REFUSALS[case]
    filled = [argument.format(b=test, masks=masks) for argument in arguments]
    result = CliRunner().invoke(command, [truth, *filled])
    assert isinstance(result.exception, kind), result.exception
    assert "\n" not in str(result.exception)
    assert result.stdout == ""


def test_table(tmp_path: Path, truth: str) -> None:
    test = shifted(tmp_path, 101)
    result = CliRunner().invoke(command, [truth, test])
    assert result.exit_code == 0, result.output
    assert "4 frames, matched by order" in result.stdout
    lines = {line.split("│")[1].strip(): line for line in result.stdout.splitlines() if "│" in line}
    found = comparison_document(evaluate(truth, test))
    assert f"{found['quality']['all']['psnr_db']:.2f}" in lines["all pixels"]
    assert f"{found['worst']['psnr_db']:.2f}" in lines["worst: 104"]
    assert [cell.strip() for cell in lines["holes"].split("│")[2:7]] == [*"----", "0"]


def test_json_and_report(tmp_path: Path, truth: str) -> None:
    test = shifted(tmp_path, 101)
    folder = tmp_path / "new" / "report"
    result = CliRunner().invoke(command, [truth, test, "--json", "--report", str(folder)])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert (folder / "report.json").read_text() == result.stdout
    assert document["schema"] == "exwarp.compare/1"
    assert document["frames"] == 4
    assert document["matched_by"] == "order"
    assert document["test"] == {"pattern": f"{test}/shot.####.exr", "first": 101, "last": 104}
    assert document["masks"] is None
    unknown = dict.fromkeys(("psnr_db", "ssim", "flip", "hdr_flip", "vmaf", "flicker", "pulse"))
    unknown["frames"] = 0
    assert document["quality"]["holes"] == unknown
    compared = evaluate(truth, test)
    mean = np.mean([frame.score.psnr_db for frame in compared.frames])
    assert document["quality"]["all"]["psnr_db"] == pytest.approx(mean, abs=1e-12)
    assert document["worst"]["frame"] == 104
    assert document["worst"]["psnr_db"] == compared.frames[3].score.psnr_db
    rows = list(csv.DictReader(io.StringIO((folder / "frames.csv").read_text())))
    assert [row["frame"] for row in rows] == ["101", "102", "103", "104"]
    assert [float(row["ssim"]) for row in rows] == [f.score.ssim for f in compared.frames]
    assert rows[0]["psnr_db_holes"] == ""


def test_broken_pixels_are_scored_as_black_and_white(tmp_path: Path, truth: str) -> None:
    broken = picture(1)
    broken[0, 0] = np.nan
    broken[1, 1] = np.inf
    result = evaluate(truth, sequence(tmp_path / "b", {1: broken}))
    assert "NaN" not in to_json(comparison_document(result))
    assert 0 < result.frames[0].score.psnr_db < 100


class Recorder:
    """A progress that remembers its calls."""

    def __init__(self) -> None:
        self.calls: list[object] = []

    def start(self, total: int, kinds: object = None, at_once: int = 1) -> None:
        self.calls.append(("start", total))

    def advance(
        self, frame: int, note: str | None = None, kind: str = "", made: bool = True
    ) -> None:
        self.calls.append(frame)

    def message(self, text: str) -> None:
        self.calls.append(text)

    def finish(self) -> None:
        self.calls.append("finish")


def test_progress_receives_every_frame_and_the_end(tmp_path: Path, truth: str) -> None:
    progress = Recorder()
    test = shifted(tmp_path, 101)
    evaluate(truth, test, progress=progress)
    assert progress.calls == [("start", 4), 101, 102, 103, 104, "finish"]
    damaged = Path(test) / "shot.0102.exr"
    damaged.write_bytes(damaged.read_bytes()[:-100])
    progress = Recorder()
    with pytest.raises(ExwarpError):
        evaluate(truth, test, progress=progress)
    assert progress.calls == [("start", 4), 101, "finish"]
