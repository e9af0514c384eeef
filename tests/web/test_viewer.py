"""The viewer of report.html in a real browser, without a network."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest

from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.frames import read_image
from exwarp_cli.io.view_transform import DisplayLook
from exwarp_cli.report.gallery import KEY, TRUTH
from tests.matrix import spread
from tests.web.conftest import NAME, STREET

SIZE = (STREET.height, STREET.width)


def image(pixels: bytes, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.frombuffer(pixels, np.uint8).reshape(*size, 4)[..., :3].astype(int)


def test_the_divider_moves_by_mouse_and_shows_two_pictures(visit):
    seen = visit()
    before = image(seen.canvas())
    box = seen.part("divider").bounding_box()
    stage = seen.part("stage").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    seen.page.mouse.move(*middle)
    seen.page.mouse.down()
    seen.page.mouse.move(stage["x"] + 0.2 * stage["width"], middle[1], steps=4)
    seen.page.mouse.up()
    assert abs(int(seen.part("divider").get_attribute("aria-valuenow")) - 20) <= 1
    after = image(seen.canvas())
    changed = np.flatnonzero((before != after).any(axis=(0, 2)))
    assert changed.min() >= 0.19 * SIZE[1] and changed.max() <= 0.5 * SIZE[1]


def test_the_divider_moves_by_keyboard(visit):
    seen = visit()
    divider = seen.part("divider")
    frame = seen.frame
    divider.focus()
    for key, at in (("ArrowLeft", 48), ("Shift+ArrowRight", 58), ("Home", 0)):
        seen.page.keyboard.press(key)
        assert divider.get_attribute("aria-valuenow") == str(at)
    right = seen.canvas()
    seen.page.keyboard.press("End")
    left = seen.canvas()
    assert left != right and seen.frame == frame, "the arrows move the divider alone"
    seen.act("4")
    assert seen.canvas() == left, "single shows the left one"
    seen.act("x")
    assert seen.canvas() == right


def test_keys_step_through_the_frames(visit):
    seen = visit()
    numbers, pictures = [], []
    for key in ("Home", "ArrowRight", "k", "ArrowLeft", "j", "ArrowLeft", "End"):
        seen.act(key)
        numbers.append(seen.frame)
        pictures.append(seen.canvas())
    assert numbers == [1, 2, 3, 2, 1, 1, 12]
    assert pictures[0] == pictures[4] != pictures[1] == pictures[3] != pictures[2]
    assert seen.page.url.endswith("#viewer:12")
    assert "slot 3 after key frame 3" in seen.part("facts").inner_text().replace("\n", " ")


def test_the_address_keeps_the_frame_and_links_lead_to_it(visit):
    seen = visit(fragment="#viewer:7")
    assert seen.frame == 7
    link = seen.page.locator("a[href^='#viewer:']").first
    before = seen.page.locator(".viewer").get_attribute("data-drawn")
    link.click()
    seen.drawn(before)
    assert seen.frame == int(link.inner_text()) != 7


def test_other_addresses_start_as_usual(visit):
    usual = visit().frame
    for fragment in spread(["#%", "#viewer", "#viewer:999", "#viewer:", "#else:2"], 3):
        assert visit(fragment=fragment).frame == usual


def test_it_starts_with_the_worst_frame(visit):
    seen = visit()
    worst = seen.page.locator("#quality a[href^='#viewer:']").first
    assert seen.frame == int(worst.inner_text())


def test_modes(visit):
    seen = visit(fragment="#viewer:4")
    shown = {}
    for key, mode in (("1", "slider"), ("2", "side"), ("3", "error"), ("4", "single")):
        seen.act(key)
        assert seen.page.locator(".viewer").get_attribute("data-mode") == mode
        assert seen.part("divider").is_visible() == (mode == "slider")
        assert seen.part("legend").is_visible() == (mode == "error")
        shown[mode] = seen.canvas()
    assert len(set(shown.values())) == 4
    side = image(shown["side"], (SIZE[0], 2 * SIZE[1] + 4))
    assert (side[:, : SIZE[1]] == image(shown["single"])).all()


def test_the_error_is_dark_where_frames_are_equal(visit):
    seen = visit(fragment="#viewer:4")
    seen.act("3")
    wrong = image(seen.canvas())
    seen.act("Home")
    equal = image(seen.canvas())
    assert equal.max() < 20 and wrong.max() > 100
    seen.part("before").select_option(TRUTH)
    seen.act("End")
    assert seen.part("left-tag").inner_text() == "error (not in this frame)"


@pytest.mark.parametrize("stops", [0, 1, -2])
def test_colours_are_those_of_the_file_at_each_exposure(visit, report, stops):
    seen = visit(fragment="#viewer:6")
    seen.part("before").select_option(TRUTH)
    seen.act("4", *(("E",) if stops > 0 else ("e",)) * abs(2 * stops))
    assert seen.part("stops").inner_text() == f"{stops:+d}".replace("+0", "0")
    truth = read_image(report.truth / "shot.0006.exr").pixels
    apart = np.abs(image(seen.canvas()) - to_display(DisplayLook().apply(truth, stops)))
    assert apart.mean() < 5, "WebP at this size"


def test_holes_are_laid_over(visit):
    seen = visit(fragment="#viewer:4")
    seen.act("4")
    plain = image(seen.canvas())
    seen.act("h")
    marked = image(seen.canvas())
    changed = (plain != marked).any(axis=-1)
    assert 0 < changed.mean() < 0.5
    assert marked[changed].mean(axis=0)[1] < 130, "towards magenta"
    seen.act("h")
    assert (image(seen.canvas()) == plain).all()


def test_it_plays_and_stops(visit):
    seen = visit(fragment="#viewer:1")
    seen.part("speed").select_option("6")
    seen.part("stage").focus()
    seen.page.keyboard.press("Space")
    seen.page.wait_for_function("() => document.querySelector('.viewer').dataset.frame === '3'")
    assert seen.part("play").get_attribute("aria-pressed") == "true"
    seen.page.keyboard.press("Space")
    assert seen.part("play").get_attribute("aria-pressed") == "false"
    number = seen.frame
    assert seen.page.url.endswith(f"#viewer:{number}")
    seen.page.wait_for_timeout(600)
    assert seen.frame == number
    seen.page.keyboard.press("Space")
    seen.act("Home")
    assert seen.part("play").inner_text() == "Play" and seen.frame == 1, "a step stops it"


@pytest.mark.parametrize("width", spread([390, 820, 1400], 1))
def test_playing_keeps_step_with_the_clock(visit, artefacts, width):
    """Frames are left out where the screen is slower than 120 fps; the page says at what rate."""
    seen = visit(width=width, fragment="#viewer:4")
    speed = seen.part("speed")
    assert speed.locator("option").first.inner_text() == "120 fps, real time"
    assert speed.input_value() == "120"
    assert seen.part("rate").inner_text() == "Plays frames 1 to 9.", "those with ground truth"
    height = seen.page.evaluate("document.documentElement.scrollHeight")
    seen.page.evaluate(WATCH)
    seen.part("play").click()
    seen.page.wait_for_function(RATE)
    seen.page.screenshot(path=artefacts / f"playing-{width}.png")
    assert seen.page.evaluate("document.documentElement.scrollHeight") == height
    shown = seen.page.evaluate("window.shown")
    assert {number for _, number in shown} <= set(range(1, 10)) and len(shown) > 10
    seen.part("play").click()
    speed.select_option("12")
    seen.page.evaluate(WATCH)
    seen.part("play").click()
    seen.page.wait_for_function("() => window.shown.length > 12")
    shown = seen.page.evaluate("window.shown")
    passed = sum((b - a) % 9 for (_, a), (_, b) in pairwise(shown))
    seconds = (shown[-1][0] - shown[0][0]) / 1000
    assert 8 < passed / seconds < 16
    seen.part("play").click()
    assert seen.part("facts").is_visible()


# Notes when each frame was drawn.
WATCH = """() => {
  const viewer = document.querySelector('.viewer');
  window.shown = [];
  window.watching?.disconnect();
  window.watching = new MutationObserver(() =>
    window.shown.push([performance.now(), Number(viewer.dataset.frame)]));
  window.watching.observe(viewer, { attributeFilter: ['data-drawn'] });
}"""

RATE = """() => /^Plays frames 1 to 9, \\d+( of 120| )? ?fps\\.$/.test(
  document.querySelector('[data-part=rate]').textContent)"""


@pytest.mark.parametrize("width", spread([820, 390, 1400], 1))
def test_two_methods_are_exchanged_in_place(visit, two_methods, artefacts, width):
    """In the view Single, x shows the same frame of the other one, and c each source in turn."""
    seen = visit(width=width, fragment="#viewer:3", page=two_methods / "report.html")
    assert seen.part("rate").inner_text() == "Plays frames 1 to 9."
    seen.act("4")
    shown = {seen.part("left-tag").inner_text(): seen.canvas()}
    seen.act("x")
    shown[seen.part("left-tag").inner_text()] = seen.canvas()
    assert set(shown) == {"baseline", "test"} and len(set(shown.values())) == 2
    seen.act("x")
    assert seen.canvas() == shown["baseline"] and seen.frame == 3
    for name in ("test", "reference", "baseline"):
        seen.act("c")
        assert seen.part("left-tag").inner_text() == name
        assert seen.canvas() == shown.setdefault(name, seen.canvas())
    assert len(set(shown.values())) == 3
    seen.act("1")
    assert seen.part("right-tag").inner_text() == "test", "the divider wipes between the two"
    assert seen.page.evaluate("document.documentElement.scrollWidth") == width
    seen.page.screenshot(path=artefacts / f"two-methods-{width}.png", full_page=True)


def test_reduced_motion_starts_slowly(visit):
    assert visit(reduced_motion="reduce").part("speed").input_value() == "2"


def test_without_truth_in_view_all_frames_play(visit):
    seen = visit(fragment="#viewer:4")
    seen.part("after").select_option(KEY)
    seen.act("2")
    assert seen.part("rate").inner_text() == "Plays frames 1 to 12."
    seen.act("4", "c")
    assert seen.part("left-tag").inner_text() == TRUTH
    assert seen.part("rate").inner_text() == "Plays frames 1 to 9."


def test_controls_keep_their_own_keys(visit):
    seen = visit(fragment="#viewer:4")
    seen.part("before").focus()
    seen.page.keyboard.press("ArrowDown")
    seen.page.keyboard.press("Escape")
    seen.part("exposure").focus()
    seen.act("ArrowRight")
    assert seen.frame == 4 and seen.part("stops").inner_text() == "+0.5"
    seen.page.keyboard.press("?")
    assert seen.part("keys").is_visible()


def test_names_are_text(visit):
    seen = visit()
    assert NAME in seen.page.locator("h1").inner_text()
    assert seen.page.locator("img").count() == 0
    assert NAME in seen.page.title()


def test_light_dark_and_narrow(visit, artefacts):
    grounds = {}
    for scheme in ("light", "dark"):
        seen = visit(color_scheme=scheme)
        grounds[scheme] = seen.page.evaluate("getComputedStyle(document.body).backgroundColor")
        seen.page.screenshot(path=artefacts / f"report-{scheme}.png", full_page=True)
    assert grounds == {"light": "rgb(255, 255, 255)", "dark": "rgb(19, 21, 24)"}
    seen = visit(color_scheme="dark")
    seen.page.locator("#theme").click()
    assert seen.page.evaluate("getComputedStyle(document.body).backgroundColor") == grounds["light"]
    for width in spread([360, 400], 1):
        seen = visit(width)
        assert seen.page.evaluate("document.documentElement.scrollWidth") == width
    seen.page.screenshot(path=artefacts / "report-narrow.png", full_page=True)
    for name in ("light", "dark", "narrow"):
        assert (artefacts / f"report-{name}.png").stat().st_size > 10_000


def test_without_scripts_numbers_tables_and_plots_are_there(visit):
    seen = visit(java_script_enabled=False)
    assert not seen.page.locator(".viewer").is_visible()
    assert not seen.page.locator("#theme").is_visible()
    assert seen.page.locator("noscript p").is_visible()
    assert seen.page.locator("svg.plot").count() >= 5
    assert seen.page.locator(".table table").first.is_visible()


def test_the_forecast_lies_over_the_grey_frame(visit):
    seen = visit(fragment="#viewer:4")
    seen.act("4")
    plain = image(seen.canvas())
    seen.act("5")
    assert seen.page.locator(".viewer").get_attribute("data-mode") == "forecast"
    assert seen.part("legend").is_visible()
    assert "of 255 levels" in seen.part("scale").inner_text()
    assert seen.part("left-tag").inner_text() == "predicted error"
    album = json.loads(seen.page.locator(".viewer script").text_content())
    risk = next(frame for frame in album["frames"] if frame["number"] == 4)["risk"]
    columns = np.arange(SIZE[1]) * risk["columns"] // SIZE[1]
    rows = np.arange(SIZE[0]) * risk["rows"] // SIZE[0]
    levels = np.array(risk["levels"]).reshape(risk["rows"], -1)[rows][:, columns]
    tint = image(seen.canvas()) - 0.3 * plain.mean(axis=-1, keepdims=True)
    worst, best = (tint[levels == level].mean() for level in (levels.max(), levels.min()))
    assert worst > best


@pytest.mark.parametrize("width", spread([390, 820, 1400], 2))
def test_frames_are_enlarged_pixel_by_pixel_within_the_page(visit, artefacts, width):
    """At 1:1 a pixel of the frame is one of the screen; what does not fit scrolls in its box."""
    seen = visit(width=width)
    canvas, stage = seen.part("canvas"), seen.part("stage")
    own = canvas.evaluate("canvas => canvas.width")
    fitting = canvas.bounding_box()["width"]
    seen.page.keyboard.press("z")
    assert canvas.bounding_box()["width"] == own
    for _ in range(3):
        seen.page.keyboard.press("z")
    assert canvas.bounding_box()["width"] == 8 * own
    sizes = stage.evaluate("box => [box.scrollWidth, box.clientWidth]")
    assert (sizes[0] > sizes[1]) == (8 * own > sizes[1])
    if width == 390:
        assert sizes[0] == 8 * own > sizes[1], "it scrolls"
    seen.page.screenshot(path=artefacts / f"enlarged-{width}.png")
    assert seen.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    divider = seen.part("divider")
    divider.focus()
    seen.page.keyboard.press("Home")
    assert divider.get_attribute("aria-valuenow") == "0"
    seen.part("zoom").select_option("0")
    assert canvas.bounding_box()["width"] == fitting
