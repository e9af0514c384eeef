"""What made a frame has one name wherever it is read, and only warped frames have hole shares."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import OpenEXR
import pytest

from exwarp_cli import cli
from exwarp_cli.domain.decision import infer_maker
from tests.cli.shots import FORWARD
from tests.unit import tiny_interpolators

pytestmark = pytest.mark.usefixtures("unpainted_plots")

BETWEEN = 6
"""Frames between the three key frames."""


class Run:
    """A run with its report: what it printed, and what it wrote."""

    def __init__(self, root: Path, out: str) -> None:
        self.out, self.printed = root / "out", out
        self.report = json.loads((root / "report" / "report.json").read_text())
        self.page = (root / "report" / "report.html").read_text()
        table = (root / "report" / "frames.csv").read_text().splitlines()
        self.rows = [row for row in csv.DictReader(table) if row["slot"] != "0"]

    @property
    def made_by(self) -> list[str]:
        return [row["made_by"] for row in self.rows]


@pytest.fixture
def run(tmp_path, plain_shot, capsys):
    def make(method: str, *options: object, tail: bool = False) -> Run:
        line = ("upsample", plain_shot, "-o", tmp_path / "out", "-m", method, *FORWARD, *options)
        more = ("--report", tmp_path / "report", "--progress", "none")
        ends = () if tail else ("--no-tail",)
        assert cli.run([str(word) for word in (*line, *more, *ends)]) == 0
        return Run(tmp_path, capsys.readouterr().out)

    return make


class TestMakers:
    @pytest.mark.parametrize("method", ["softsplat", "blend"])
    def test_table_page_and_header_name_the_method(self, run, method):
        made = run(method)
        assert made.made_by == [method] * BETWEEN
        hints = re.findall(r"frame \d+: (\w+)", made.page)
        assert hints == [method] * BETWEEN
        with OpenEXR.File(str(made.out / made.rows[0]["file"]), header_only=True) as file:
            assert file.header()["exwarp:madeBy"] == method
        # The keys of the contract: its time is that of warping, and nothing was decided.
        assert made.report["timing_ms"]["warp"] > 0 and "softsplat" not in made.report["timing_ms"]
        assert made.report["quality"]["by_decision"]["warp"]["frames"] == 0

    def test_after_the_last_key_frame_it_is_a_warp(self, run):
        assert run("softsplat", tail=True).made_by == [*["softsplat"] * BETWEEN, *["warp"] * 3]

    def test_frames_of_an_earlier_version_have_the_same_name(self):
        """ExWarp 0.1 wrote "warp" for both."""
        methods = ("softsplat", "blend", "s6", "causal", None)
        makers = [infer_maker("warp", method) for method in methods]
        assert makers == ["softsplat", "blend", "warp", "warp", "warp"]
        assert infer_maker(None, "key") is None and infer_maker("hold", "blend") == "hold"


class TestHoles:
    @pytest.mark.parametrize("method", ["s6", "softsplat"])
    def test_a_method_that_warps_has_them(self, run, method):
        made = run(method)
        assert made.report["holes"]["mean_fraction"] > 0
        assert re.search(r"^holes \d+\.\d% of the pixels on average$", made.printed, re.MULTILINE)
        assert "Hole share per frame" in made.page

    @pytest.mark.parametrize("method", ["blend", "hold", "onnx"])
    def test_others_have_none(self, run, method, tmp_path):
        more: tuple[object, ...] = ()
        if method == "onnx":
            model, card = tiny_interpolators.CARDS["untimed"]
            more = ("--interpolator", tiny_interpolators.put(tmp_path / "net.onnx", model, card))
        made = run(method, *more)
        assert made.report["holes"] == dict.fromkeys(made.report["holes"])
        assert "holes" not in made.printed
        assert "Hole share" not in made.page and "of the pixels of" not in made.page
        # The mask of W is the same for all methods: it is what scores in holes are taken of.
        assert all(float(row["hole_fraction"]) >= 0 for row in made.rows)

    def test_of_a_fallback_the_warped_frames_alone_are_counted(self, run):
        made = run("blend", tail=True)
        assert sum(made.report["holes"]["histogram"]["counts"]) == 3
        assert re.search(r"^holes .* on average, of 3 warped frames$", made.printed, re.MULTILINE)
