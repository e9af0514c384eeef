"""`exwarp compare`: what headers tell of where frames came from, and means by it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner

from exwarp_cli.commands.compare import command
from exwarp_cli.domain.metric import parse_threshold
from exwarp_cli.domain.settings import MeasureSettings
from exwarp_cli.errors import QualityError, UsageError
from exwarp_cli.pipeline import evaluation
from exwarp_cli.pipeline.evaluation import Comparison, evaluate
from exwarp_cli.report.comparison import compare_page, comparison_document, require_quality
from exwarp_cli.report.html import render
from tests.unit.sample_runs import no_pictures
from tests.unit.test_compare import picture, sequence

SIZE = (16, 24)
FRAMES = {
    1: (None, None, None),
    2: ("generated", "warp", "S4"),
    3: ("generated", "extrapolate", "S4"),
    4: ("generated", "warp", "S4"),
    5: (None, None, None),
    6: ("dropped", "hold", "S1"),
    7: ("generated", "warp", None),  # a blend of both key frames, which nothing decided for
}
"""Kind, maker and path in the header of each frame; each is a little darker than the one before."""


def save(path: Path, pixels: np.ndarray, *origin: object) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    names = ("exwarp:kind", "exwarp:madeBy", "exwarp:path")
    header |= {name: value for name, value in zip(names, origin, strict=False) if value is not None}
    path.parent.mkdir(exist_ok=True)
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels)}).write(str(path))


@pytest.fixture(scope="module")
def shots(tmp_path_factory) -> tuple[str, str]:
    root = tmp_path_factory.mktemp("origins")
    a = sequence(root / "a", {n: picture(n, SIZE) for n in FRAMES})
    for n, origin in FRAMES.items():
        save(root / "b" / f"shot.{n:04d}.exr", picture(n, SIZE) * np.float32(1 - 0.05 * n), *origin)
    return a, str(root / "b")


@pytest.fixture(scope="module")
def compared(shots: tuple[str, str]) -> Comparison:
    return evaluate(*shots)


def mean(result: Comparison, *numbers: int) -> float:
    return float(np.mean([f.score.psnr_db for f in result.frames if f.test in numbers]))


def test_means_are_taken_apart_by_what_headers_tell(compared: Comparison) -> None:
    quality = comparison_document(compared)["quality"]
    parts = {
        "all": (quality["all"], tuple(FRAMES)),
        "generated": (quality["generated"], (2, 3, 4, 7)),
        "dropped": (quality["dropped"], (6,)),
        "warp": (quality["by_decision"]["warp"], (2, 4)),
        "extrapolate": (quality["by_decision"]["extrapolate"], (3,)),
    }
    for name, (block, numbers) in parts.items():
        assert block["psnr_db"] == pytest.approx(mean(compared, *numbers), abs=1e-12), name
        assert block["frames"] == len(numbers), name
    assert set(quality["by_decision"]) == {"warp", "extrapolate"}


@pytest.mark.parametrize("origin", [(), (7,)])
def test_headers_that_tell_nothing_leave_nulls(
    tmp_path: Path, shots: tuple[str, str], origin: tuple[object, ...]
) -> None:
    save(tmp_path / "b" / "shot.0002.exr", picture(2, SIZE), *origin)
    found = evaluate(shots[0], str(tmp_path / "b"))
    assert found.frames[0].origin == evaluation.Origin()
    quality = comparison_document(found)["quality"]
    parts = (quality["generated"], quality["dropped"], *quality["by_decision"].values())
    for block in parts:
        assert block["frames"] == 0
        assert {value for name, value in block.items() if name != "frames"} == {None}
    assert quality["all"]["frames"] == 1


def test_each_header_is_read_once(shots: tuple[str, str], monkeypatch) -> None:
    read: list[str] = []
    known = evaluation.read_facts
    monkeypatch.setattr(
        evaluation, "read_facts", lambda path: read.append(path.name) or known(path)
    )
    for settings in (MeasureSettings(("psnr_db",)), MeasureSettings(("ssim",), "extranet")):
        read.clear()
        evaluate(*shots, frames="2-4", measuring=settings)
        assert read == [f"shot.{n:04d}.exr" for n in (2, 3, 4)]


def test_table_rows_and_columns(shots: tuple[str, str], tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [*shots, "--report", str(tmp_path / "report")])
    assert result.exit_code == 0, result.output
    found = [line.split("│")[1].strip() for line in result.stdout.splitlines() if "│" in line]
    assert found == [
        *("all pixels", "generated", "repeated", "made by warp", "made by extrapolate"),
        *("holes", "worst: 7"),
    ]
    rows = list(csv.DictReader((tmp_path / "report" / "frames.csv").read_text().splitlines()))
    assert list(rows[0])[-3:] == ["kind", "made_by", "pulse"]
    listed = {int(row["frame"]): (row["kind"], row["made_by"]) for row in rows}
    assert listed == {n: (kind or "", maker or "") for n, (kind, maker, _) in FRAMES.items()}


def test_the_page_has_rows_and_a_number_of_generated_frames(
    compared: Comparison, shots: tuple[str, str]
) -> None:
    text = render(compare_page(compared, comparison_document(compared), no_pictures()))
    for name in ("generated", "repeated", "made by warp", "made by extrapolate"):
        assert text.count(f">{name}<") == 1, name
    assert "PSNR, generated" in text and "of 4 frames alone" in text
    assert "pulse, generated" in text
    assert f"{mean(compared, 2, 3, 4, 7):.2f} dB" in text
    plain = evaluate(shots[0], shots[0])
    page = render(compare_page(plain, comparison_document(plain), no_pictures()))
    assert ", generated" not in page and "made by" not in page and ">repeated<" not in page
    only = evaluate(*shots, frames="2-4")
    page = render(compare_page(only, comparison_document(only), no_pictures()))
    assert "PSNR, generated" not in page


def limited(shots: tuple[str, str], text: str, frames: str | None = None) -> Comparison:
    limit = parse_threshold(text, "--fail-below")
    return evaluate(*shots, frames, measuring=MeasureSettings(thresholds=(limit,)))


def test_a_limit_on_generated_frames(shots: tuple[str, str], compared: Comparison) -> None:
    value = mean(compared, 2, 3, 4, 7)
    passing = limited(shots, f"generated.psnr={value - 1e-6!r}")
    require_quality(passing)
    (verdict,) = comparison_document(passing)["thresholds"]
    assert (verdict["name"], verdict["scope"]) == ("generated.psnr", "generated")
    assert verdict["value"] == pytest.approx(value, abs=1e-12)
    with pytest.raises(QualityError, match=r"generated\.psnr [\d.]+ is below"):
        require_quality(limited(shots, f"generated.psnr={value + 1e-6!r}"))


@pytest.mark.parametrize("frames", ["1,5", "6"])
def test_a_limit_on_generated_frames_that_are_none_is_refused(
    shots: tuple[str, str], frames: str
) -> None:
    with pytest.raises(UsageError, match=r"--fail-below generated\.psnr is on .* write psnr=30 "):
        limited(shots, "generated.psnr=30", frames)
