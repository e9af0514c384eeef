"""The document and the tables of a benchmark, from parts whose means are known."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

from exwarp_cli.accelerator.mac_array import MacArray, schedule
from exwarp_cli.accelerator.mlp import PAPER_SIZES
from exwarp_cli.domain.decision import PATHS
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.html import Page, Table
from exwarp_cli.research.bench import bench_figures, paper
from exwarp_cli.research.bench.bench_document import (
    bench_document,
    describe_benchmark,
    feature_points,
    identify,
    pearson,
    spearman,
)
from exwarp_cli.research.bench.bench_report import bench_page, format_markdown
from exwarp_cli.research.bench.bench_tables import make_tables
from exwarp_cli.research.bench.benchmark import Benchmark, Measured
from exwarp_cli.research.bench.subjects import Subject
from exwarp_cli.research.bench.systems import BenchSettings, makers_of, pictures_of
from tests.plots import leave_plots_out

SYSTEMS = ("exwarp", "s1", "s6", "softsplat")


@pytest.fixture(autouse=True)
def unwritten_plots(monkeypatch):
    leave_plots_out(monkeypatch)


def score(psnr: float) -> dict[str, Any]:
    rest = dict.fromkeys(("flip", "hdr_flip", "vmaf", "flicker", "pulse"))
    return {"psnr_db": psnr, "ssim": psnr / 100, **rest}


def frames(system: str, path: str | None, psnr: float) -> list[dict[str, Any]]:
    makers = makers_of(system, path)
    return [{"made_by": maker, "all": score(psnr + i), "holes": None}
            for i, maker in enumerate(makers)]  # fmt: skip


def part(key: int, path: str, psnr: float) -> dict[str, Any]:
    return {
        "key": key,
        "holes": [0.02, 0.15, 0.25],
        "features": [[float(key + i), 0.1, 0.2, 1.0, 2.0, 16.0, 9.0, 5.0] for i in range(3)],
        "paths": {"exwarp": path, "oracle": "S3", "oracle-return": "S6"},
        "returns": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        "warp_psnr_db": [30.0 - key, 29.0 - key, 28.0 - key],
        "systems": {
            "exwarp": frames("exwarp", path, psnr),
            "s1": frames("s1", "S1", psnr - 5),
            "s6": frames("s6", "S6", psnr - 1),
            "softsplat": frames("softsplat", None, psnr + 2),
        },
        "extranet": {name: {"psnr_db": psnr, "ssim": 0.5} for name in SYSTEMS},
    }


def measured(name: str = "town", **about: Any) -> Measured:
    subject = Subject(name, SourceSettings("keys"), "truth", "slot", None, True)
    facts = {
        "width": 854, "height": 480, "fps": 30.0, "producer": "Blender",
        "policy": {"file": "p.npz", "sha256": "0", "trained_without_it": True},
        "render_s": {"key": 2.0, "gbuffer": 0.25},
    }  # fmt: skip
    timing = {
        "steps_ms": {"read": 1.0, "warp": 2.0, "holes": 3.0, "network": 4.0},
        "systems_ms": {"exwarp": 100.0, "s6": 10.0, "softsplat": 20.0},
        "machine": {"processor": "a processor", "cores": 2},
    }
    parts = (part(1, "S3", 30.0), part(2, "S1", 20.0))
    return Measured(subject, facts | about, timing, parts)


def benchmark_of(*rows: Measured) -> Benchmark:
    settings = BenchSettings(("data",), Path("out"), systems=SYSTEMS)
    return Benchmark(settings, {}, SYSTEMS, rows)


def document_of(benchmark: Benchmark) -> dict[str, Any]:
    return bench_document(benchmark, schedule(MacArray(), PAPER_SIZES), 1e9)


@pytest.fixture
def found() -> dict[str, Any]:
    return document_of(benchmark_of(measured(), measured("pier")))


def test_quality_is_the_mean_over_all_frames_and_split_by_what_made_them(found):
    ours = found["quality"][0]["systems"]["exwarp"]
    assert ours["all"]["psnr_db"] == pytest.approx((30 + 31 + 32 + 20 + 21 + 22) / 6)
    assert ours["all"]["frames"] == 6 and ours["all"]["vmaf"] is None
    # S3 warps slot 1 and extrapolates 2 and 3; S1 extrapolates slot 2 and repeats twice.
    assert ours["by_decision"]["warp"]["psnr_db"] == 30
    assert ours["by_decision"]["extrapolate"]["psnr_db"] == pytest.approx((31 + 32 + 21) / 3)
    assert ours["dropped"]["psnr_db"] == 21 and ours["dropped"]["frames"] == 2
    assert ours["holes"]["frames"] == 0 and ours["holes"]["psnr_db"] is None
    assert found["quality"][0]["best_path"] == "s6"
    assert found["quality"][0]["returns"]["exwarp"] == (3 + 1) / 2
    assert found["quality"][0]["returns"]["oracle-return"] == 6


def test_rates_count_new_frames_and_decisions_the_nodes_that_were_passed(found):
    assert found["fps"][0]["effective"] == {
        "exwarp": 30 * (1 + (3 + 1) / 2), "s1": 60, "s6": 120, "softsplat": 120,
    }  # fmt: skip
    ours = found["decisions"][0]["exwarp"]
    assert ours["paths"]["S1"] == ours["paths"]["S3"] == 1
    assert ours["nodes"]["d1"] == {"warp": 1, "extrapolate": 1}
    assert ours["warp_share"] == 1 / 5  # d1 of S3; d2, d4, and d1, d3 of S1 extrapolate


def test_holes_fall_into_their_bins(found):
    row = found["holes"][0]
    assert row["histogram"]["counts"] == [0, 2, 0, 2, 2, 0, 0]
    assert row["mean"] == pytest.approx(0.14)
    assert (row["below_10"], row["above_20"]) == pytest.approx((1 / 3, 1 / 3))


def test_only_lookahead_waits(found):
    systems = found["comparison"][0]["systems"]
    assert systems["softsplat"]["waits_ms"] == pytest.approx(1000 / 30)
    assert {systems[name]["waits_ms"] for name in ("exwarp", "s1", "s6")} == {0}
    assert systems["s1"]["frame_ms"] is None
    assert found["render_time"][0]["times_faster"]["exwarp"] == 20


def test_the_papers_figures_stand_beside_scenes_of_its_themes(found):
    town, pier = found["runtime"]
    assert town["paper"] == {
        "gbuffer": 0.34, "warping": 0.96, "hole_marking": 1.89, "inference": 3.61,
    }  # fmt: skip
    assert town["gbuffer_ms"] == 250 and pier["paper"] is None
    assert found["quality"][0]["paper"]["exwarp"] == {"psnr_db": 24.10, "ssim": 0.81}
    assert found["comparison"][0]["paper"]["EMA-VFI"] == {"psnr_db": 14.40, "ssim": 0.82}
    assert found["predictor"]["paper"]["latency_ns"] == 6.2
    assert found["predictor"]["cycles"] == 1871
    measured = found["predictor"]["synthesis"]
    assert measured["simulated"]["cycles"] == 1871
    assert all(line.startswith("passed") for line in measured["simulated"]["icarus"])


def test_correlation_is_none_where_a_feature_does_not_vary(found):
    correlation = found["features"][0]["correlation"]
    assert correlation["Var_x"] == {"pearson": None, "spearman": None}
    assert correlation["N_d"]["spearman"] < 0
    assert found["features"][-1]["name"] == "all" and found["features"][-1]["points"] == 12


def test_markdown_leaves_out_what_was_not_measured(found):
    text = format_markdown(found)
    assert "VMAF |" not in text and "FLIP |" not in text
    assert "| town | 854x480 | slot | measured |" in text and "| TN | - | slot | paper |" in text
    assert "trained without it (town, pier)" in text


def test_markdown_escapes_names():
    found = document_of(benchmark_of(measured("a|b_c*<script>")))
    assert "a\\|b\\_c\\*\\<script\\>" in format_markdown(found)


def test_every_row_of_every_table_has_only_known_columns(found):
    for table in make_tables(found):
        assert table.rows, table.name
        keys = [column.key for column in table.columns]
        assert len(set(keys)) == len(keys), table.name


@pytest.mark.parametrize(
    ("scene", "height", "app"),
    [
        ("lab", 240, "LB"), ("lab", 480, "LB"), ("town", 720, "TN2"), ("slum", 1080, "SL3"),
        ("market", 480, None),
    ],
)  # fmt: skip
def test_applications_of_the_paper(scene, height, app):
    assert identify(measured(scene, height=height))["app"] == app


def test_the_papers_tables_have_its_own_statements():
    """Its text says that ExWarp gains 18.02 % PSNR over S1 and 9.24 % over S6."""
    gains = {"s1": [], "s6": []}
    for rows in paper.QUALITY.values():
        for name, found in gains.items():
            found.append(rows["exwarp"]["psnr_db"] / rows[name]["psnr_db"] - 1)
    assert np.mean(gains["s1"]) == pytest.approx(0.1802, abs=0.02)
    assert np.mean(gains["s6"]) == pytest.approx(0.0924, abs=0.02)
    assert set(paper.RUNTIME) == set(paper.QUALITY) == set(paper.INTERPOLATION)


@pytest.mark.parametrize("seed", range(5))
def test_correlations_agree_with_scipy(seed):
    rng = np.random.default_rng(seed)
    x = rng.integers(0, 6, 40).astype(float)
    y = x * rng.normal() + rng.normal(size=40).round(1)
    assert pearson(x, y) == pytest.approx(scipy.stats.pearsonr(x, y).statistic)
    assert spearman(x, y) == pytest.approx(scipy.stats.spearmanr(x, y).statistic)
    assert pearson([1.0, 2.0], [3.0, 4.0]) is None and spearman([1.0] * 5, [*range(5)]) is None


@pytest.mark.parametrize(
    ("path", "names"),
    [
        ("S1", ("F", "E2", "E2")), ("S2", ("F", "E2", "W(E2)")), ("S3", ("W1", "E2", "E3")),
        ("S4", ("W1", "E2", "W(E2)")), ("S5", ("W1", "W2", "E3")), ("S6", ("W1", "W2", "W3")),
    ],
)  # fmt: skip
def test_paths_share_the_pictures_that_are_alike(path, names):
    assert pictures_of(path.lower(), path) == names
    foreign = pictures_of("extranet", path)
    assert foreign == tuple(f"extranet {n}" if "E" in n else n for n in names)
    assert makers_of(path.lower(), path) == PATHS[path].made_by


def test_saved_is_what_new_frames_would_have_cost_less_the_time_of_every_slot(found):
    row = found["render_time"][0]
    # exwarp shows 3 new frames in one interval and 1 in the other, s6 always 3.
    assert row["saved_share"]["exwarp"] == pytest.approx((2 * 2.0 - 3 * 0.1) / (3 * 2.0))
    assert row["saved_share"]["s6"] == pytest.approx((3 * 2.0 - 3 * 0.01) / (4 * 2.0))
    untimed = document_of(benchmark_of(measured(render_s={"key": None, "gbuffer": None})))
    assert untimed["render_time"][0]["saved_share"] is None
    assert untimed["render_time"][0]["times_faster"] is None


def test_points_tell_the_rendered_pixels():
    first = feature_points(measured())[0]
    assert (first["R"], first["distance"]) == (16.0 * 9.0, 5.0)


def test_the_subtitle_tells_all_sizes_and_rates():
    rows = (measured(), measured("pier", width=1280, height=720, fps=24.0))
    text = describe_benchmark(document_of(benchmark_of(*rows)))
    assert "2 sequences of 854x480, 1280x720 pixels, 4 key intervals" in text
    assert "30 to 120 and 24 to 96 frames per second, G-buffers for every slot" in text


def page_of(*rows: Measured) -> Page:
    benchmark = benchmark_of(*rows)
    albums = [Album(("a",), "a", "a") for _ in rows]
    return bench_page(benchmark, document_of(benchmark), albums)


def tables_in(page: Page, section: str) -> list[Table]:
    (found,) = (section_ for section_ in page.sections if section_.name == section)
    return [block for block in found.blocks if isinstance(block, Table)]


def first_cells(tables: Iterable[Table]) -> list[Any]:
    return [row[0] for table in tables for row in table.rows]


def test_the_page_has_a_comparison_for_each_sequence_with_the_papers_rows():
    tables = tables_in(page_of(measured(), measured("pier", height=720)), "quality")
    assert [table.title for table in tables] == ["town 480p", "pier 720p"]
    assert first_cells(tables[:1])[:4] == ["town"] * 4 and first_cells(tables[:1])[4] == "TN"
    # Of the other one the title says all that its rows have in common.
    assert first_cells(tables[1:]) == list(SYSTEMS) and tables[1].columns[0] == "system"


def test_tables_with_figures_have_rows_of_each_sequence():
    for table in make_tables(document_of(benchmark_of(measured(), measured("pier")))):
        if table.name in bench_figures.FIGURES:
            town, pier = table.by_sequence()
            assert {row["scene"] for row in town} <= {"town", "TN"}, table.name
            assert {row["scene"] for row in pier} == {"pier"}, table.name


def test_the_page_leaves_out_columns_that_say_the_same_of_all_sequences():
    (table,) = tables_in(page_of(measured("quay"), measured("pier")), "paths")[:1]
    assert list(table.columns[:2]) == ["scene", "S1"]
    assert first_cells([table]) == ["quay", "pier"]
    (table,) = tables_in(page_of(measured("quay"), measured("quay", height=720)), "paths")[:1]
    assert list(table.columns[:3]) == ["scene", "size", "S1"]


def test_the_headline_begins_with_what_is_saved_where_headers_tell_it():
    labels = [number.label for number in page_of(measured()).numbers]
    assert labels[:3] == ["Render time saved", "Rendered frame", "Generated frame"]
    untimed = page_of(measured(render_s={"key": None, "gbuffer": None}))
    assert [n.label for n in untimed.numbers] == labels[3:]


@pytest.mark.parametrize(
    ("sizes", "labels"),
    [
        (((854, 480), (854, 480)), ["a", "b"]),
        (((854, 480), (1280, 720)), ["a 480p", "b 720p"]),
        (((640, 480), (854, 480)), ["a 640x480", "b 854x480"]),
    ],
)
def test_short_names_of_sequences(sizes, labels):
    rows = (measured(n, width=w, height=h) for n, (w, h) in zip("ab", sizes, strict=True))
    assert bench_figures.sequence_labels(document_of(benchmark_of(*rows))) == labels


def test_figures_draw_what_was_measured_and_the_papers_values_across(found, monkeypatch):
    drawn = {}

    def keep(labels, groups, series, *more):
        drawn[labels.title] = (list(groups), dict(series), *more)

    monkeypatch.setattr(bench_figures, "draw_bars", keep)
    monkeypatch.setattr(bench_figures, "draw_stacked_bars", keep)
    for table in make_tables(found):
        bench_figures.draw_figure(table, ["town", "pier"])
    groups, paths, printed = drawn["PSNR of every decision path"]
    assert groups == ["town", "pier"] and list(paths) == list(printed) == ["s1", "s6", "exwarp"]
    assert paths["exwarp"] == pytest.approx([26, 26]) and printed["exwarp"] == [24.10, None]
    _, systems, references = drawn["Causal and look-ahead systems"]
    assert list(systems) == list(SYSTEMS) and references is None
    assert systems["softsplat"] == pytest.approx([28, 28])
    _, steps, kinds = drawn["Run time of a frame"]
    assert steps == {"warping": [2, 2], "hole marking": [3, 3], "network": [4, 4]} and not kinds
    _, shares, kinds = drawn["Decisions of the policy"]
    assert shares["warp"] == [20, 20] and shares["extrapolate"] == [80, 80] and kinds
    groups, holes = drawn["Holes of warped frames"]
    assert groups[0] == "0-1 %" and sum(holes["town"]) == pytest.approx(100)


def test_figures_without_anything_measured_are_left_out(found):
    def drawn() -> list[bool]:
        tables = {table.name: table for table in make_tables(found)}
        return [
            bench_figures.draw_figure(tables[name], ["town", "pier"]) is not None
            for name in ("holes", "fps")
        ]

    assert drawn() == [True, True]
    for row in found["holes"]:
        row["histogram"] = None
    for row in found["fps"]:
        row["effective"] = {"oracle": 120.0}
    assert drawn() == [False, False]
