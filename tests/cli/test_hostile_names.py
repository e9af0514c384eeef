"""Shots whose names and headers would be markup, commands or formulas elsewhere: they stay text."""

from __future__ import annotations

import csv
import io
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from exwarp_cli import cli
from exwarp_cli.domain.wording import printable
from tests.cli import shots
from tests.cli.shots import FORWARD, SMALL

MARKUP = "<img src=x onerror=alert(1)>\"'& <script><b>"
TERMINAL = "a\x1b[31mb\x1b]0;c\x07\u202ed\ne\r\x9b2J"
FORMULA = "=cmd|'x'!A1 [red]b[#f00] :heart: $x_1$ `id` {{7*7}}\\"
NAMES = {"markup": MARKUP, "terminal": TERMINAL, "formula": FORMULA}
PLAIN = "plain"

KEYS = (1, 2, 3)


@pytest.fixture(autouse=True)
def unwritten_plots():
    """Write the plots of these pages: names stand in them, too."""


def hostile(folder: Path, name: str) -> Path:
    """Three key frames with a name in file names, headers, and the layer of an artist."""
    for number in KEYS:
        planes = shots.plain_planes(SMALL, number)
        odd = "".join(c for c in name if c not in "\0.")[:60]
        planes[f"{odd}.X"] = planes["Z"] * 0.5
        attributes = shots.header(
            software=f"Blender {name}", comments=name, owner=name, cameraModel=name,
            Camera=name, Scene=name, RenderTime=name,
        )  # fmt: skip
        shots.write(folder / f"{name}.{number:04d}.exr", {"": planes}, attributes)
    return folder


class Elements(HTMLParser):
    """Counts elements with the names of their attributes; in plots, which tell times, kinds."""

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[tuple[str, ...]] = Counter()
        self.drawn: set[tuple[str, ...]] = set()
        self._plots = 0

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self._plots += tag == "svg"
        kind = (tag, *(name for name, _ in attrs))
        if self._plots:
            self.drawn.add(kind)
        else:
            self.found[kind] += 1

    def handle_endtag(self, tag: str) -> None:
        self._plots -= tag == "svg"


def elements(page: Path) -> tuple[object, object]:
    parser = Elements()
    parser.feed(page.read_text(encoding="utf-8"))
    parser.close()
    return parser.found, parser.drawn


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("hostile")


@pytest.fixture(params=NAMES)
def shot(request, folder) -> tuple[Path, str]:
    """The key frames' folder, and the name; read only."""
    name = NAMES[request.param]
    place = folder / name
    return (place if place.exists() else hostile(place, name)), name


def require_plain(*texts: str) -> None:
    """Refuse what a terminal would obey."""
    for text in texts:
        bad = [line for line in text.split("\n") if printable(line) != line]
        assert not bad


class TestTerminal:
    @pytest.mark.parametrize(
        "more", [(), ("--dry-run",), ("--view", TERMINAL), ("--layers", "all")]
    )
    def test_upsample(self, exwarp, shot, tmp_path, more):
        keys, name = shot
        given = (*FORWARD, "-m", "s6", "--threads", 1, "--progress", "plain", *more)
        result = exwarp("upsample", keys, "-o", f"{tmp_path / name}/", *given)
        assert result.code == (3 if "--view" in more else 0), result.err
        require_plain(result.out, result.err)

    def test_inspect(self, exwarp, shot):
        keys, name = shot
        result = exwarp("inspect", keys)
        assert result.code == 0
        require_plain(result.out, result.err)
        if name == FORMULA:
            assert name in result.out  # nothing of it is a colour or a picture
        assert len(result.out.splitlines()) == len(exwarp("inspect", keys).out.split("\n")) - 1

    def test_compare_and_features(self, exwarp, shot):
        keys, _ = shot
        for call in (("compare", keys, keys, "--metrics", "psnr"), ("features", keys, *FORWARD)):
            result = exwarp(*call, "--progress", "none")
            assert result.code == 0, result.err
            require_plain(result.out, result.err)

    def test_what_is_refused(self, exwarp, shot, tmp_path):
        keys, name = shot
        for call in (
            ("upsample", keys / name, "-o", tmp_path / "a"),
            ("upsample", keys, "-o", tmp_path / "a", "--policy", tmp_path / name),
            ("upsample", keys, "-o", tmp_path / "a", "-m", "onnx", "--interpolator", name),
            ("inspect", keys, "--channel-map", tmp_path / name),
            ("policy", "run", tmp_path / name),
            ("merge-reports", tmp_path / name),
        ):
            result = exwarp(*call)
            assert result.code in (2, 3), result.err
            require_plain(result.out, result.err)
            assert len(result.err.splitlines()) == 1


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Path:
    return shots.truth(tmp_path_factory.mktemp("truth") / "truth", street=SMALL)


def elements_of_pages(keys: Path, truth: Path, out: Path) -> list[object]:
    """Write the pages of a run, and of a comparison."""
    scored = (*FORWARD, "-m", "s6", "--ground-truth", truth, "--report", out / "report")
    for command in (
        ("upsample", keys, "-o", f"{out / 'new'}/", *scored, "--threads", 1),
        ("compare", out / "new", out / "new", "--report", out / "compared", "--metrics", "psnr"),
    ):
        assert cli.run([*map(str, command), "--progress", "none"]) == 0
    return [elements(out / part / "report.html") for part in ("report", "compared")]


@pytest.fixture(scope="module")
def plain(truth, tmp_path_factory) -> list[object]:
    """The elements of pages about a plain name."""
    folder = tmp_path_factory.mktemp("plain")
    return elements_of_pages(hostile(folder / "keys", PLAIN), truth, folder / PLAIN)


def test_pages_have_the_elements_of_a_plain_one(exwarp, shot, plain, truth, tmp_path):
    """And tables come back as they were."""
    keys, name = shot
    out = tmp_path / name
    assert elements_of_pages(keys, truth, out) == plain
    merged = exwarp("merge-reports", out / "report", "-o", out / "merged")
    assert merged.code == 0, merged.err
    require_plain(merged.out)
    for part in ("report", "merged"):
        table = (out / part / "frames.csv").read_text(encoding="utf-8")
        rows = list(csv.DictReader(io.StringIO(table, newline="")))
        assert len(rows) == 12
        assert not [cell for row in rows for cell in row.values() if cell[:1] in "=@" and cell]
