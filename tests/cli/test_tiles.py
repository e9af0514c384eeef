"""Networks run in chosen tiles alone, and `--effort` says how much they may compute."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from exwarp_cli.domain.decision import EXTRAPOLATE, LOOKAHEAD
from exwarp_cli.domain.tiles import TileMakers
from tests.cli import shots
from tests.cli.street import Street
from tests.unit import tiny_lookahead

pytestmark = pytest.mark.usefixtures("unpainted_plots")

COUNT = 3
STREET = Street(96, 54, speed=0.5)


@dataclass(frozen=True)
class Done:
    """A run's frames and its report."""

    folder: Path
    report: dict[str, Any]
    rows: list[dict[str, str]]

    @classmethod
    def read(cls, folder: Path, report: Path) -> Done:
        document = json.loads((report / "report.json").read_text(encoding="utf-8"))
        with (report / "frames.csv").open(newline="", encoding="utf-8") as file:
            return cls(folder, document, list(csv.DictReader(file)))

    @property
    def tiles(self) -> list[TileMakers]:
        """Of new frames in order."""
        return [TileMakers.parsed(row["tiles"]) for row in self.rows if row["slot"] != "0"]


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Key frames of a street in motion; read only."""
    folder = tmp_path_factory.mktemp("tiles") / "keys"
    return shots.sequence(folder, shots.blender5, range(1, COUNT + 1), STREET)


@pytest.fixture
def done(upsample, keys, tmp_path) -> Callable[..., Done]:
    """Upsample the street by an option with its network, and others."""

    def run(model: tuple[str, Path], name: str, *options: object) -> Done:
        out, report = tmp_path / name, tmp_path / f"{name}-report"
        upsample(keys, out, *model, "--report", report, *options)
        return Done.read(out, report)

    return run


@pytest.fixture
def take(done, network) -> Callable[..., Done]:
    """Upsample the street by W and a tiny E."""
    return partial(done, ("--extrapolator", network))


def test_tiles_of_one_frame_differ(take):
    """No policy that chooses alike everywhere does this; and all that is said of it agrees."""
    done = take("out", "--causal", "--no-gate")
    assert all({"w", "e"} <= set(tiles.letters) for tiles in done.tiles[1::3])
    assert all(set(tiles.letters) == {"w"} for tiles in done.tiles[::3])
    cost = sum(tiles.share("extrapolate") for tiles in done.tiles) / len(done.tiles)
    decisions = done.report["decisions"]
    assert decisions["cost"] == pytest.approx(cost)
    assert decisions["warp_share"] == pytest.approx(1 - cost)
    count = len(done.tiles[0].letters)
    assert sum(decisions["paths"].values()) == COUNT * count
    second, third = ("".join(t.letters for t in done.tiles[slot::3]) for slot in (1, 2))
    pairs = Counter(zip(second, third, strict=True))
    for name, makers in {"S3": "ee", "S4": "er", "S5": "we", "S6": "ww"}.items():
        assert decisions["paths"][name] == pairs[makers[0], makers[1]]
    assert decisions["nodes"]["d1"] == {"warp": COUNT * count, "extrapolate": 0}
    assert sum(decisions["nodes"]["d2"].values()) == COUNT * count
    with OpenEXR.File(str(done.folder / "shot.0003.exr"), header_only=True) as file:
        assert file.header()["exwarp:tiles"] == done.tiles[1].text


@pytest.mark.parametrize(("effort", "path"), [(0, "s6"), (1, "s3")])
def test_the_ends_of_effort_are_fixed_paths(take, upsample, keys, network, effort, path, tmp_path):
    done = take("out", "--causal", "--no-gate", "--effort", effort)
    model = () if path == "s6" else ("--extrapolator", network)
    upsample(keys, tmp_path / "fixed", "-m", path, *model)
    for name in shots.names(done.folder):
        made, fixed = (shots.colour_of(at / name) for at in (done.folder, tmp_path / "fixed"))
        np.testing.assert_array_equal(made, fixed)
    assert done.report["decisions"]["cost"] == pytest.approx(effort * 2 / 3)


def test_more_effort_computes_more(take):
    costs = [
        take(f"e{share}", "--causal", "--no-gate", "--effort", share).report["decisions"]["cost"]
        for share in (0.05, 0.5, 0.95)
    ]
    assert costs == sorted(costs) and costs[0] < costs[2]


def test_chunks_and_threads_change_nothing(take):
    whole = shots.contents(take("whole", "--causal").folder)
    parts: dict[str, bytes] = {}
    for frames in ("1", "2-3"):
        part = take(frames, "--causal", "--frames", frames, "--threads", 1).folder
        parts |= shots.contents(part)
    assert parts == whole


def test_another_effort_makes_frames_again(take):
    take("out", "--causal", "--no-gate", "--effort", 0.3)
    kept = take("out", "--causal", "--no-gate", "--effort", 0.3, "--skip-existing")
    assert kept.report["frames"]["resumed"] == 4 * COUNT
    assert kept.report["decisions"]["cost"] > 0
    made = take("out", "--causal", "--no-gate", "--effort", 0.9, "--skip-existing")
    assert made.report["frames"]["resumed"] == COUNT  # key frames


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("-m", "s3"), "s3 chooses nothing"),
        (("--causal", "--policy", "paper"), "--policy chooses for whole frames"),
    ],
)
def test_effort_is_refused_where_no_tiles_are_chosen(exwarp, keys, tmp_path, options, why):
    result = exwarp("upsample", keys, "-o", tmp_path / "out", *options, "--effort", 0.5)
    result.refused(2, "--effort is for exwarp, and for --causal with a policy of tiles", why)


def test_the_paper_s_policy_chooses_for_whole_frames(take):
    done = take("out", "--causal", "--policy", "paper", "--no-gate")
    assert done.report["policy"]["file"].endswith("policy.npz")
    assert {row["tiles"] for row in done.rows} == {""}
    assert sum(done.report["decisions"]["paths"].values()) == COUNT
    assert done.report["decisions"]["cost"] is None


@pytest.fixture
def ahead(done, tmp_path) -> Callable[..., Done]:
    """Upsample the street by default, with a tiny network between key frames."""
    model = tiny_lookahead.save(tmp_path / "tiny.onnx", tiny_lookahead.nearer_side())
    return partial(done, ("--interpolator", model))


BETWEEN = 3 * (COUNT - 1)  # new frames that have a next key frame


def test_between_key_frames_tiles_of_one_frame_differ(ahead):
    """No policy that chooses alike everywhere does this; and all that is said of it agrees."""
    done = ahead("out", "--no-gate")
    tiles = done.tiles[:BETWEEN]
    assert all({"s", "l"} == set(each.letters) for each in tiles)
    dear = sum(each.share(LOOKAHEAD) for each in tiles)
    decisions = done.report["decisions"]
    assert decisions["look_ahead"]["dear"] == pytest.approx(dear, abs=1e-3)
    assert sum(decisions["look_ahead"].values()) == pytest.approx(BETWEEN)
    after = sum(each.share(EXTRAPOLATE) for each in done.tiles[BETWEEN:])
    assert decisions["cost"] == pytest.approx((dear + after) / (3 * COUNT))
    assert sum(decisions["paths"].values()) == len(done.tiles[-1].letters)
    assert done.report["interpolator"]["effort"] == 0.5
    page = (done.folder.parent / "out-report" / "report.html").read_text(encoding="utf-8")
    assert "Between key frames" in page and "Paths of the tiles" in page
    assert f">{decisions['look_ahead']['dear']:.1f}</bdi>" in page
    with OpenEXR.File(str(done.folder / "shot.0003.exr"), header_only=True) as file:
        assert file.header()["exwarp:tiles"] == done.tiles[1].text


def test_between_key_frames_the_ends_of_effort_are_methods(ahead, upsample, keys, tmp_path):
    model = ("--interpolator", tmp_path / "tiny.onnx")
    for effort, method, options in ((1, "lookahead", model), (0, "softsplat", ())):
        done = ahead(f"e{effort}", "--no-gate", "--effort", effort)
        upsample(keys, tmp_path / method, "-m", method, *options)
        for number in range(2, BETWEEN + COUNT - 1):
            name = f"shot.{number:04d}.exr"
            made, fixed = (shots.colour_of(at / name) for at in (done.folder, tmp_path / method))
            np.testing.assert_array_equal(made, fixed)


def test_between_key_frames_chunks_and_threads_change_nothing(ahead):
    whole = shots.contents(ahead("whole").folder)
    parts: dict[str, bytes] = {}
    for frames in ("1", "2-3"):
        parts |= shots.contents(ahead(frames, "--frames", frames, "--threads", 1).folder)
    assert parts == whole


def test_another_effort_makes_frames_between_key_frames_again(ahead):
    ahead("out", "--no-gate", "--effort", 0.3)
    kept = ahead("out", "--no-gate", "--effort", 0.3, "--skip-existing")
    assert kept.report["frames"]["resumed"] == 4 * COUNT
    assert kept.report["decisions"]["look_ahead"]["dear"] > 0
    made = ahead("out", "--no-gate", "--effort", 0.9, "--skip-existing")
    assert made.report["frames"]["resumed"] == COUNT  # key frames


def test_tiles_are_chosen_with_layers_too(ahead):
    done = ahead("out", "--no-gate", "--layers", "all")
    assert {"s", "l"} == set(TileMakers.parsed(done.rows[1]["tiles"]).letters)
    whole = ahead("whole", "--no-gate", "--layers", "all", "--effort", 1)
    made, all_tiles = (shots.colour_of(one.folder / "shot.0002.exr") for one in (done, whole))
    assert not np.array_equal(made, all_tiles)
