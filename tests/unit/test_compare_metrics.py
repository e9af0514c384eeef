"""`exwarp compare`: metrics over several frames, the preset, and limits."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from exwarp_cli.domain.metric import METRICS, Threshold, parse_metrics, parse_threshold
from exwarp_cli.domain.settings import MeasureSettings
from exwarp_cli.errors import InputError, QualityError, UsageError
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.ffmpeg import VmafStream, compute_vmaf
from exwarp_cli.metrics.registry import score_like_extranet
from exwarp_cli.metrics.temporal import display_error
from exwarp_cli.pipeline.evaluation import Comparison, evaluate
from exwarp_cli.report.comparison import comparison_document, require_quality
from tests.blender_layers import blender_depth, layer
from tests.cli import shots
from tests.cli.street import Street
from tests.unit.test_compare import picture, sequence

SIZE = (24, 32)
STREET = Street(48, 27)
CHANGES = (4.0, 9.0, 3.0, 3.0, 20.0, 1.0)
"""Display levels that the test is darker by, frame by frame."""


def measure(*names: str, **more: object) -> MeasureSettings:
    return MeasureSettings(names or None, **more)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def moving(tmp_path_factory) -> tuple[str, str]:
    """A street with vectors from frame to frame, and the same darker by `CHANGES`."""
    root = tmp_path_factory.mktemp("moving")
    for i, change in enumerate(CHANGES):
        planes = shots.colour_planes(STREET, i / 4) | shots.slot_planes(STREET, i / 4)
        shots.write(root / "a" / f"x.{i + 1:04d}.exr", {"": planes})
        shown = to_level(shots.colour_of(root / "a" / f"x.{i + 1:04d}.exr")[..., :3])
        made = np.ascontiguousarray(to_linear(shown - change), np.float32)
        save(named(root / "b", i + 1), made)
    return str(root / "a"), str(root / "b")


def named(folder: Path, number: int) -> Path:
    folder.mkdir(exist_ok=True)
    return folder / f"x.{number:04d}.exr"


def save(path: Path, pixels: np.ndarray, kind: str | None = None) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if kind is not None:
        header["exwarp:kind"] = kind
    path.parent.mkdir(exist_ok=True)
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels)}).write(str(path))


def to_level(linear: np.ndarray) -> np.ndarray:
    clipped = np.clip(linear, 0.02, 1)
    return np.asarray(255 * (1.055 * clipped ** (1 / 2.4) - 0.055))


def to_linear(level: np.ndarray) -> np.ndarray:
    return np.asarray(((level / 255 + 0.055) / 1.055) ** 2.4)


def test_flicker_follows_the_vectors_of_the_truth(moving: tuple[str, str]) -> None:
    """Every pixel is off alike, so that only how that changes counts, wherever things move."""
    found = evaluate(*moving, measuring=measure("flicker"))
    steps = np.abs(np.diff(CHANGES))
    expected = [steps[0], *((steps[:-1] + steps[1:]) / 2), steps[-1]]
    assert [frame.score.flicker for frame in found.frames] == pytest.approx(expected, abs=0.3)
    assert found.notes == ()


def only_forward(street: Street, time: float) -> dict[str, np.ndarray]:
    """Depth, and vectors to the next frame alone, y up."""
    g = street.geometry(time)
    depth = layer("", "Z", blender_depth(g["depth"]))
    return depth | layer("forward", "uv", g["slot_following"] * [1, -1])


@pytest.mark.parametrize("vectors", [shots.slot_planes, only_forward])
def test_an_error_that_moves_with_the_surfaces_hardly_flickers(tmp_path: Path, vectors) -> None:
    """The contrast is another one, so that every colour has an error of its own."""
    street = Street(80, 45, speed=4)
    errors = []
    for i in range(3):
        a, b = (named(tmp_path / name, i + 1) for name in "ab")
        shots.write(a, {"": shots.colour_planes(street, i / 4) | vectors(street, i / 4)})
        colour = np.ascontiguousarray(shots.colour_of(a)[..., :3], np.float32)
        save(b, colour**3)
        errors.append(display_error(colour, colour**3))
    found = evaluate(str(tmp_path / "a"), str(tmp_path / "b"), measuring=measure("flicker"))
    unmoved = np.abs(errors[1] - errors[0]).mean()
    assert unmoved > 2, found.frames
    assert found.frames[0].score.flicker < unmoved / 3


def test_flicker_only_joins_neighbours(moving: tuple[str, str]) -> None:
    found = evaluate(*moving, frames="1,2,4", measuring=measure("flicker"))
    values = [frame.score.flicker for frame in found.frames]
    assert values[:2] == pytest.approx([5, 5], abs=0.3)
    assert values[2] is None


def test_flicker_in_holes_is_what_comes_in(moving: tuple[str, str], tmp_path: Path) -> None:
    mask = np.zeros((STREET.height, STREET.width), np.float32)
    mask[10:16, 10:30] = 1
    masks = sequence(tmp_path / "m", {2: mask, 4: mask}, "holes")
    found = evaluate(*moving, holes=masks, measuring=measure("flicker"))
    inside = [f.hole_score.flicker if f.hole_score else None for f in found.frames]
    assert inside[1] == pytest.approx(5, abs=0.3)
    assert inside[3] == pytest.approx(0, abs=0.3)
    assert inside[0] is inside[2] is None


def test_without_vectors_a_note_says_why_there_is_no_flicker(tmp_path: Path) -> None:
    a = sequence(tmp_path / "a", {n: picture(n, SIZE) for n in (1, 2)})
    found = evaluate(a, a, measuring=measure("ssim", "flicker"))
    assert [frame.score.flicker for frame in found.frames] == [None, None]
    assert found.notes == (
        "flicker is not measured, as it follows the motion of the first sequence: "
        f"{a}/shot.####.exr has no motion vectors",
    )
    assert comparison_document(found)["notes"] == list(found.notes)
    with pytest.raises(InputError, match=r"nothing can be measured.*no motion vectors"):
        evaluate(a, a, measuring=measure("flicker"))


def shifted(tmp_path: Path, count: int = 4, size: tuple[int, int] = SIZE) -> tuple[str, str]:
    a = {n: picture(n, size) for n in range(1, count + 1)}
    b = {n: pixels * np.float32(1 - 0.05 * n) for n, pixels in a.items()}
    return sequence(tmp_path / "a", a), sequence(tmp_path / "b", b)


def test_vmaf_is_of_the_frames_in_their_order(tmp_path: Path) -> None:
    found = evaluate(*shifted(tmp_path), measuring=measure("vmaf"))
    original = [picture(n, SIZE) for n in range(1, 5)]
    test = [to_display(p * np.float32(1 - 0.05 * n)) for n, p in enumerate(original, 1)]
    expected = compute_vmaf([to_display(p) for p in original], test)
    assert [frame.score.vmaf for frame in found.frames] == expected
    assert found.worst.score.vmaf == min(expected)


@pytest.mark.parametrize("text", ["all", "vmaf,psnr,psnr", " SSIM , hdr-flip"])
def test_metrics_are_read_in_their_order(text: str) -> None:
    expected = {
        "all": tuple(metric.field for metric in METRICS),
        "vmaf,psnr,psnr": ("psnr_db", "vmaf"),
        " SSIM , hdr-flip": ("ssim", "hdr_flip"),
    }
    assert parse_metrics(text) == expected[text]


KINDS = (None, "generated", "dropped", "generated")


@pytest.mark.parametrize("headers", [True, False])
def test_the_preset_counts_generated_frames(tmp_path: Path, headers: bool) -> None:
    truth = {n: picture(n, SIZE) for n in range(1, 15)}
    made = {n: p if KINDS[n % 4] is None else p * np.float32(0.8) for n, p in truth.items()}
    for n, pixels in made.items():
        save(tmp_path / "b" / f"shot.{n:04d}.exr", pixels, KINDS[n % 4] if headers else None)
    a = sequence(tmp_path / "a", truth)
    found = evaluate(a, str(tmp_path / "b"), measuring=measure(preset="extranet"))
    for frame in found.frames:
        n, kind = frame.test, KINDS[frame.test % 4]
        counts = kind == "generated" or (kind == "dropped" and not headers)
        expected = score_like_extranet(truth[n], made[n]) if counts else None
        assert frame.score.psnr_db == (expected.psnr_db if expected else None)
        assert frame.score.ssim == (expected.ssim if expected else None)
        assert (frame.score.vmaf is None) == (n <= 4 or n > 10)
    with VmafStream(is_encoded=True) as stream:
        for n in range(5, 11):
            stream.write(to_display(truth[n]), to_display(made[n]))
        values = stream.close()
    assert [f.score.vmaf for f in found.frames if f.score.vmaf is not None] == values
    document = comparison_document(found)
    assert document["preset"] == "extranet"
    assert document["metrics"] == ["psnr_db", "ssim", "vmaf"]
    count, by = (7, "by their headers") if headers else (11, "as their pixels are not those")
    assert f"{count} of 14 frames count as generated, {by}" in found.notes[0]
    assert "6 frames in H.264" in found.notes[1]


def test_rendered_frames_in_the_means_are_noted(tmp_path: Path) -> None:
    a = sequence(tmp_path / "a", {n: picture(n, SIZE) for n in (1, 2, 3)})
    for n, kind in ((1, None), (2, "generated"), (3, "dropped")):
        save(named(tmp_path / "b", n), picture(n, SIZE), kind)
    (note,) = evaluate(a, str(tmp_path / "b"), measuring=measure("psnr_db")).notes
    assert "all 3 frames, 1 of which are rendered" in note
    assert evaluate(a, a, measuring=measure("psnr_db")).notes == ()


def test_a_short_video_keeps_its_ends(tmp_path: Path) -> None:
    found = evaluate(*shifted(tmp_path, 12), measuring=measure("vmaf", preset="extranet"))
    assert all(frame.score.vmaf is not None for frame in found.frames)


def test_a_preset_without_generated_frames_is_refused(tmp_path: Path) -> None:
    for n in (1, 2):
        save(tmp_path / "a" / f"shot.{n:04d}.exr", picture(n, SIZE), "dropped")
    a = str(tmp_path / "a")
    with pytest.raises(InputError, match=r"none of the frames .* is generated"):
        evaluate(a, a, measuring=measure(preset="extranet"))


@pytest.mark.parametrize(
    ("measuring", "holes", "words"),
    [
        (measure("flip", preset="extranet"), None, "psnr, ssim, vmaf and not flip;"),
        (measure("hdr_flip", preset="extranet"), None, "and not hdr-flip;"),
        (measure(preset="extranet"), "m", "measures whole frames"),
        (
            measure(thresholds=(parse_threshold("holes.ssim=1", "--fail-below"),)),
            None,
            "give masks with --holes",
        ),
    ],
)
def test_contradictions(tmp_path: Path, measuring, holes: str | None, words: str) -> None:
    a = sequence(tmp_path / "a", {1: picture(1, SIZE)})
    with pytest.raises(UsageError, match=words):
        evaluate(a, a, holes=holes, measuring=measuring)


LIMITS = {
    "psnr=35": ("--fail-below", "psnr_db", "all", 35),
    "worst.psnr=30.5": ("--fail-below", "psnr_db", "worst", 30.5),
    "holes.ssim=0.8": ("--fail-below", "ssim", "holes", 0.8),
    "Hdr-Flip = 1e-1": ("--fail-above", "hdr_flip", "all", 0.1),
    "worst.flicker=3": ("--fail-above", "flicker", "worst", 3),
    "vmaf=90": ("--fail-below", "vmaf", "all", 90),
    "generated.pulse=5": ("--fail-above", "pulse", "generated", 5),
}


@pytest.mark.parametrize("text", list(LIMITS))
def test_limits_are_read(text: str) -> None:
    option, name, scope, limit = LIMITS[text]
    found = parse_threshold(text, option)
    assert (found.metric.field, found.scope, found.limit) == (name, scope, limit)
    assert found.option == option
    assert parse_threshold(f"{found.name}={limit}", option) == found


@pytest.mark.parametrize(
    ("option", "text", "words"),
    [
        ("--fail-below", "flip=0.1", "write --fail-above flip=0.1"),
        ("--fail-above", "worst.psnr=35", "more psnr is better"),
        ("--fail-below", "psnr", "no number behind '='"),
        ("--fail-below", "psnr=nan", "no number"),
        ("--fail-below", "best.psnr=3", "no limit"),
        ("--fail-below", "lpips=3", "no limit"),
        ("--fail-below", "holes.vmaf=3", "whole frames"),
        ("--fail-above", "holes.pulse=3", "whole frames"),
        ("--fail-below", "pulse=5", "write --fail-above pulse=5"),
        ("--fail-above", "worst.pulse=-5", "write worst.pulse=5"),
    ],
)
def test_what_is_no_limit(option: str, text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        parse_threshold(text, option)


def judged(found: Comparison, *limits: Threshold) -> Comparison:
    names = tuple(dict.fromkeys(limit.metric.field for limit in limits))
    return Comparison(
        **(vars(found) | {"measuring": measure(*names, thresholds=limits)})  # type: ignore[arg-type]
    )


def limit(text: str) -> Threshold:
    """Read a limit from either side."""
    try:
        return parse_threshold(text, "--fail-below")
    except UsageError:
        return parse_threshold(text, "--fail-above")


@pytest.fixture(scope="module")
def compared(tmp_path_factory) -> Comparison:
    """Three frames, the last one clearly the worst, with masks."""
    root = tmp_path_factory.mktemp("compared")
    a, b = shifted(root, 3)
    mask = np.zeros(SIZE, np.float32)
    mask[3:9, 3:9] = 1
    masks = sequence(root / "m", {2: mask, 3: mask}, "holes")
    return evaluate(a, b, holes=masks)


@pytest.mark.parametrize("name", ["psnr", "flip", "holes.ssim", "worst.psnr", "worst.flip"])
def test_a_limit_is_the_worst_that_passes(compared: Comparison, name: str) -> None:
    field = limit(f"{name}=1").metric.field
    values = [getattr(frame.score, field) for frame in compared.frames]
    inside = [getattr(f.hole_score, field) for f in compared.frames if f.hole_score is not None]
    worst = {"psnr": min, "flip": max}.get(name.rpartition(".")[2], min)(values)
    mean = sum(inside) / len(inside) if "holes" in name else sum(values) / len(values)
    value = worst if "worst" in name else mean
    step = 1e-9 if limit(f"{name}=1").metric.more_is_better else -1e-9
    require_quality(judged(compared, limit(f"{name}={value - step!r}")))
    exact = judged(compared, limit(f"{name}={value!r}"))
    require_quality(exact)
    (verdict,) = comparison_document(exact)["thresholds"]
    assert (verdict["value"], verdict["passed"], verdict["name"]) == (value, True, name)
    broken = judged(compared, limit(f"{name}={value + step!r}"), limit("ssim=0"))
    with pytest.raises(QualityError, match=rf"{name} [\d.]+ is (below|above)"):
        require_quality(broken)
    assert [v["passed"] for v in comparison_document(broken)["thresholds"]] == [False, True]


def test_nothing_passes_unmeasured(compared: Comparison) -> None:
    unmeasured = judged(compared, limit("hdr-flip=1"))
    assert comparison_document(unmeasured)["thresholds"][0]["passed"] is False
    with pytest.raises(UsageError, match="hdr-flip cannot be judged"):
        require_quality(unmeasured)


def test_a_limit_adds_its_metric() -> None:
    assert measure("ssim", thresholds=(limit("psnr=3"),)).measured == ("psnr_db", "ssim")
    usual = ("psnr_db", "ssim", "flip", "pulse")
    assert measure(thresholds=(limit("vmaf=3"),)).measured == (*usual[:3], "vmaf", "pulse")
    assert measure(thresholds=(limit("generated.pulse=5"),)).measured == usual


def test_a_farm_sees_the_result_and_the_exit_code(exwarp_line, tmp_path: Path) -> None:
    a, b = shifted(tmp_path)
    folder = tmp_path / "report"
    passed = exwarp_line("compare", a, b, "--fail-below", "psnr=10", "--fail-above", "flip=0.9")
    assert (passed.code, passed.err) == (0, "")
    failed = exwarp_line(
        *("compare", a, b, "--json", "--report", folder, "--metrics", "ssim"),
        *("--fail-below", "psnr=10", "--fail-below", "worst.psnr=90"),
    )
    assert failed.code == 8
    document = json.loads(failed.out)
    assert (folder / "report.json").read_text() == failed.out
    assert [verdict["passed"] for verdict in document["thresholds"]] == [True, False]
    assert document["metrics"] == ["psnr_db", "ssim"]
    assert failed.err.count("\n") == 1
    value = document["thresholds"][1]["value"]
    assert f"worst.psnr {value:.6g} is below 90" in failed.err
    assert document["worst"]["frame"] == 4


def test_progress_as_a_farm_reads_it(exwarp_line, tmp_path: Path) -> None:
    a, b = shifted(tmp_path)
    result = exwarp_line("compare", a, b, "--metrics", "psnr", "--progress", "json")
    events = [json.loads(line) for line in result.err.splitlines()]
    assert [event["event"] for event in events] == ["start", *["frame"] * 4, "finish"]
    assert "FLIP" not in result.out and "PSNR dB" in result.out


@pytest.fixture
def exwarp_line(capfd):
    """Run a command line as a process would."""
    from types import SimpleNamespace

    from exwarp_cli import cli

    def run(*arguments: object) -> SimpleNamespace:
        capfd.readouterr()
        code = cli.run([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return SimpleNamespace(code=code, out=out, err=err)

    return run
