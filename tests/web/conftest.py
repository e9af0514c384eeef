"""A report of a real run, and a browser without a network to look at it."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from exwarp_cli import cli
from tests.cli import shots
from tests.cli.street import Street

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

STREET = Street(160, 90)
NAME = "<img src=x onerror=alert(1)> & 'q' 🎬"
"""Of the sequence: what would run as markup if any of it were taken for markup."""


@dataclass(frozen=True)
class Report:
    """Folders of a run of three key frames with ground truth."""

    keys: Path
    truth: Path
    frames: Path
    folder: Path

    @property
    def page(self) -> Path:
        return self.folder / "report.html"

    def run(self, *options: str) -> None:
        code = cli.run(
            [
                *("upsample", str(self.keys), "-o", str(self.frames), "-m", "s6", *shots.FORWARD),
                *("--ground-truth", str(self.truth), "--report", str(self.folder)),
                *("--progress", "none", "--threads", "1", *options),
            ]
        )
        assert code == 0


@pytest.fixture(scope="session")
def report(tmp_path_factory) -> Report:
    """Made once; read only."""
    root = tmp_path_factory.mktemp("web")
    keys = root / "keys"
    for number in (1, 2, 3):
        shots.plain(keys / f"{NAME}.{number:04d}.exr", STREET, number - 1)
    truth = shots.truth(root / "truth", street=STREET)
    made = Report(keys, truth, root / "frames", root / "report")
    made.run()
    return made


@pytest.fixture(scope="session")
def two_methods(report, tmp_path_factory) -> Path:
    """Folder of the comparison of a blended shot, the baseline, with the warped one."""
    root = tmp_path_factory.mktemp("methods")
    blend = ("upsample", str(report.keys), "-o", str(root / "blend"), "-m", "blend")
    assert cli.run([*blend, "--progress", "none"]) == 0
    both = ("compare", str(root / "blend"), str(report.frames), "--report", str(root / "report"))
    assert cli.run([*both, "--ground-truth", str(report.truth), "--progress", "none"]) == 0
    return root / "report"


def chromium() -> str | None:
    """Find a browser: named by EXWARP_CHROMIUM, else on the path."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return os.environ.get("EXWARP_CHROMIUM") or next(filter(None, map(shutil.which, names)), None)


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """Drive the installed Chromium; skip where there is none."""
    found = chromium()
    if found is None:
        pytest.skip("no Chromium; install one, or name it in EXWARP_CHROMIUM")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        # Containers run as root, where Chromium's sandbox does not start. Without a GPU, a process
        # in its place takes a sixth more of the time.
        made = playwright.chromium.launch(
            executable_path=found, args=["--no-sandbox", "--disable-gpu"]
        )
        yield made
        made.close()


@dataclass
class Visit:
    """An opened page, and everything that it asked for or complained of."""

    page: Page
    requests: list[str]
    complaints: list[str]

    def canvas(self) -> bytes:
        """Pixels of the viewer's canvas, RGBA."""
        return base64.b64decode(self.page.evaluate(_PIXELS))

    def act(self, *keys: str) -> None:
        """Press keys, and wait after each until the viewer has drawn."""
        for key in keys:
            before = self.page.locator(".viewer").get_attribute("data-drawn")
            self.page.keyboard.press(key)
            self.drawn(before)

    def drawn(self, before: str | None = None) -> None:
        """Wait until the viewer has drawn anew."""
        self.page.wait_for_function(
            "before => { const d = document.querySelector('.viewer').dataset.drawn;"
            " return d !== undefined && d !== before; }",
            arg=before,
        )

    @property
    def frame(self) -> int:
        return int(self.page.locator(".viewer").get_attribute("data-frame") or -1)

    def part(self, name: str) -> Any:
        return self.page.locator(f"[data-part={name}]")


_PIXELS = """() => {
  const canvas = document.querySelector('.viewer canvas');
  const found = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  return btoa(Array.from(found, (byte) => String.fromCharCode(byte)).join(''));
}"""


@pytest.fixture
def visit(browser, report) -> Iterator[Any]:
    """Open the page in a fresh window without a network; judge at the end what it asked for."""
    opened: list[tuple[Visit, Any]] = []

    def open_page(width: int = 1100, fragment: str = "", page: Path = report.page, **more: Any):
        context = browser.new_context(
            viewport={"width": width, "height": 800}, offline=True, **more
        )
        made = Visit(context.new_page(), [], [])
        opened.append((made, context))
        made.page.on("request", lambda request: made.requests.append(request.url))
        made.page.on("console", lambda message: made.complaints.append(message.text))
        made.page.on("pageerror", lambda error: made.complaints.append(str(error)))
        made.page.goto(page.as_uri() + fragment)
        if more.get("java_script_enabled", True):
            made.drawn()
        return made

    yield open_page
    for made, context in opened:
        assert made.complaints == []
        asked = {url.split("#")[0] for url in made.requests if not url.startswith("data:")}
        assert len(asked) == 1 and asked.pop().startswith("file://")
        context.close()


@pytest.fixture(scope="session")
def artefacts(tmp_path_factory) -> Path:
    """Where screenshots are kept: EXWARP_ARTEFACTS, else pytest's own folder."""
    named = os.environ.get("EXWARP_ARTEFACTS")
    folder = Path(named) if named else tmp_path_factory.mktemp("screenshots")
    folder.mkdir(parents=True, exist_ok=True)
    return folder
