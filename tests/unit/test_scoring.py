"""Scores of a key interval: what takes several frames, on the display window."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from exwarp_cli.domain.frame import Window
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.ffmpeg import compute_vmaf
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.metrics.temporal import display_error
from exwarp_cli.pipeline.scoring import IntervalScores, flicker_of, steps_of, vmaf_of
from exwarp_cli.synthesis.motion_fields import SlotField
from tests.reference import flicker as naive

DISPLAY = Window(0, 0, 40, 24)
CANVAS = Window(-3, -2, 48, 30)
NAMES = ("psnr_db", "vmaf", "flicker")


def picture(seed: int) -> np.ndarray:
    rough = np.random.default_rng(seed).random((6, 10, 3), dtype=np.float32)
    return rough.repeat(4, axis=0).repeat(4, axis=1)


def field(seed: int) -> SlotField:
    """Motion over the canvas, with holes where it is unknown and elsewhere."""
    rng = np.random.default_rng(seed)
    motion = rng.normal(0, 2, (*CANVAS.shape, 2)).astype(np.float32)
    motion[rng.random(CANVAS.shape) < 0.1] = np.nan
    hole = np.isnan(motion[..., 0]) | (rng.random(CANVAS.shape) < 0.1)
    return SlotField(motion, np.ones(CANVAS.shape, np.float32), hole)


def interval(has_motion: bool = True) -> Any:
    image = SimpleNamespace(data_window=CANVAS)
    return SimpleNamespace(
        has_motion=has_motion,
        times=(0.25, 0.5, 0.75),
        key=SimpleNamespace(image=image),
        back=lambda slot: field(slot),
        step_back=lambda slot: field(10 + slot),
    )


TRUTH = {slot: picture(slot) for slot in range(4)}
TRUTH[4] = TRUTH[3]  # so that it matters to slot 3 whether a frame follows
TEST = {slot: picture(20 + slot) for slot in (1, 2, 3)}
MASKS = {slot: np.random.default_rng(slot).random(DISPLAY.shape) < 0.3 for slot in (1, 2, 3)}
ENDS = {0: TRUTH[0], 4: TRUTH[4]}


def scored(
    names: tuple[str, ...] = NAMES, slots: tuple[int, ...] = (1, 2, 3), **more: Any
) -> dict[int, Any]:
    made = IntervalScores(more.get("interval", interval()), DISPLAY, names, more.get("end", True))
    for slot in slots:
        made.frame(slot, TRUTH[slot], TEST[slot], MASKS[slot])
    return made.complete(more.get("ends", ENDS))


def expected_transition(slot: int) -> tuple[np.ndarray, np.ndarray]:
    """By the naive twin, from pixels that stand in the middle of the canvas."""
    motion = field(1 if slot == 1 else 10 + slot)
    inside = np.s_[2:26, 3:43]
    before = TRUTH[0] if slot == 1 else TEST[slot - 1]
    return naive.transition(
        (before, TEST[slot]),
        (TRUTH[slot - 1], TRUTH[slot]),
        motion.field[inside],
        motion.hole[inside],
    )


def test_flicker_follows_the_interval_between_two_rendered_frames() -> None:
    found = scored()
    steps = {slot: expected_transition(slot) for slot in (1, 2, 3)}
    means = {slot: per_pixel[counted].mean() for slot, (per_pixel, counted) in steps.items()}
    means[4] = np.abs(naive.displayed(TEST[3]) - naive.displayed(TRUTH[3])).mean()
    for slot in (1, 2, 3):
        overall, inside = found[slot]
        assert overall.flicker == pytest.approx((means[slot] + means[slot + 1]) / 2, abs=1e-3)
        per_pixel, counted = steps[slot]
        within = per_pixel[counted & MASKS[slot]].mean()
        assert inside.flicker == pytest.approx(within, abs=1e-3)
        assert (inside.vmaf, overall.ssim) == (None, None)
        assert overall.psnr_db == score_frame(TRUTH[slot], TEST[slot], None)[0].psnr_db
    last = scored(end=False)[3][0].flicker
    assert last == pytest.approx(means[3], abs=1e-3), "no rendered frame follows"


def test_slots_without_truth_are_left_out() -> None:
    found = scored(slots=(1, 2))
    whole = scored()
    assert set(found) == {1, 2}
    assert found[1][0].flicker == whole[1][0].flicker
    assert found[2][0].flicker != whole[2][0].flicker, "nothing comes after it"
    reference = [to_display(TRUTH[i]) for i in range(3)]
    test = [reference[0], to_display(TEST[1]), to_display(TEST[2])]
    assert [found[i][0].vmaf for i in (1, 2)] == compute_vmaf(reference, test)[1:]


def test_vmaf_is_of_the_interval_as_a_video() -> None:
    reference = [to_display(TRUTH[i]) for i in range(5)]
    test = [reference[0], *(to_display(TEST[i]) for i in (1, 2, 3)), reference[4]]
    values = compute_vmaf(reference, test)[1:4]
    assert [scored()[i][0].vmaf for i in (1, 2, 3)] == values
    rows = [[TEST[1], TEST[2], TEST[3]], [TEST[3], TEST[1], TRUTH[3]]]
    assert vmaf_of(TRUTH, rows)[0] == values
    assert vmaf_of(TRUTH, rows)[1] == vmaf_of(TRUTH, rows[1:])[0]


def test_vmaf_of_an_interval_that_nothing_follows() -> None:
    """Versions must not follow each other then: the next one's first frame would be seen."""
    rows = [[TEST[1], TEST[2], TEST[3]], [TEST[3], TEST[1], TRUTH[3]]]
    open_end = {0: TRUTH[3]} | {slot: TRUTH[slot] for slot in (1, 2, 3)}
    found = vmaf_of(open_end, rows)
    assert found[0] == [scored(ends={0: TRUTH[3]})[i][0].vmaf for i in (1, 2, 3)]
    assert found[0] == vmaf_of(open_end, rows[:1])[0]
    assert found[0][2] != vmaf_of(open_end | {4: TRUTH[3]}, rows)[0][2]


def test_without_motion_there_is_no_flicker() -> None:
    assert steps_of(interval(has_motion=False), DISPLAY) is None
    assert scored(interval=interval(has_motion=False))[2][0].flicker is None


def test_what_is_not_chosen_is_not_measured() -> None:
    (overall, inside) = scored(names=("ssim",))[1]
    known = score_frame(TRUTH[1], TEST[1], MASKS[1], ("ssim",))
    assert (overall, inside) == known
    assert [name for name, value in vars(overall).items() if value is not None] == ["ssim"]


def test_flicker_of_agrees_with_the_scores_of_a_run() -> None:
    steps = steps_of(interval(), DISPLAY)
    assert steps is not None
    errors = {slot: display_error(TRUTH[slot], TEST[slot]) for slot in TEST}
    found = scored()
    expected = [(found[i][0].flicker, found[i][1].flicker) for i in (1, 2, 3)]
    assert flicker_of(errors, MASKS, steps) == expected
