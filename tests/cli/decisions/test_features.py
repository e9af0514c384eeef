"""`exwarp features`: what the policy sees, as a run has it, and as it is defined."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.decisions.conftest import KEYS, SETTINGS, STREET, Done, take
from tests.matrix import combinations
from tests.reference import decisions as paper

NODES = ("d1", "d2", "d3", "d4", "d5")
SLOT = {"d1": 1, "d2": 2, "d3": 3, "d4": 3, "d5": 3}
NAMES = ("N_d", "EMD_Wn", "EMD_Wp", "Var_x", "Var_y", "R")
Rows = list[dict[str, str]]


@pytest.fixture
def features(exwarp) -> Callable[..., Rows]:
    """Run the command, and expect a table alone."""

    def run(given: tuple[object, ...], *options: object) -> Rows:
        quiet = ("--progress", "none", "--threads", 1)
        result = exwarp("features", *given, *quiet, *options)
        assert result.code == 0 and result.err == "", result.err
        assert result.out.count("frame") == 1  # one header
        return list(csv.DictReader(io.StringIO(result.out)))

    return run


@pytest.fixture(scope="module")
def tables() -> dict[str, Rows]:
    return {}


@pytest.fixture
def table(features, uneven, tables) -> Callable[[str], Rows]:
    """Return the table of the whole shot, by setting; each made once."""

    def find(setting: str) -> Rows:
        if setting not in tables:
            tables[setting] = features(uneven[setting])
        return tables[setting]

    return find


@pytest.fixture
def by_watching(policies, network, tmp_path) -> Callable[..., Done]:
    """Upsample a shot by a policy that goes by what it sees, without a gate."""
    options = ("--no-gate", "--policy", policies("watching"), "--extrapolator", network)
    return lambda given: take(given, tmp_path / "out", "--causal", *options)


def same_as_in_the_run(rows: Rows, run: Rows) -> None:
    """Judge that what a run's decisions were taken by is in the table, digit by digit."""
    table = {(row["frame"], row["node"]): row for row in rows}
    decided = [row for row in run if row["node"]]
    assert decided
    for row in decided:
        found = table[row["frame"], row["node"]]
        for name in ("key", *NAMES, "inputs"):
            assert found[name] == row[name], (row["frame"], row["node"], name)


@pytest.mark.parametrize("setting", SETTINGS)
class TestTable:
    def test_a_row_for_every_node(self, table, setting):
        rows = table(setting)
        assert list(rows[0]) == ["frame", "key", "node", *NAMES, "distance", "inputs"]
        assert [(row["key"], row["node"], row["frame"]) for row in rows] == [
            (str(key), node, str(4 * key - 3 + SLOT[node]))
            for key in range(1, KEYS + 1)
            for node in NODES
        ]

    def test_it_is_what_a_run_saw(self, table, judged, setting):
        same_as_in_the_run(table(setting), judged("watching", setting).rows)

    def test_inputs_are_those_of_the_definition(self, table, setting):
        rows = table(setting)
        seen = {
            (int(row["key"]), row["node"]): {
                name: float(row[name]) for name in (*NAMES, "distance")
            } | {"width": STREET.width}
            for row in rows
        }  # fmt: skip
        before = {"d1": (), "d2": ("d1",), "d3": ("d1",), "d4": ("d2", "d1"), "d5": ("d2", "d1")}
        for row in rows:
            key, node = int(row["key"]), row["node"]
            history = [(seen[key, at], at) for at in (node, *before[node])]
            history += [(seen[k, "d1"], "d1") for k in range(key - 1, 0, -1)]
            expected = np.array(paper.inputs(history)) * 65536
            found = np.array(row["inputs"].split(), dtype=float)
            np.testing.assert_allclose(found, expected, atol=0.51)

    def test_windows_that_change_too(self, features, moving, setting):
        given, run = moving(setting)
        same_as_in_the_run(features(given), run.rows)

    def test_ids_from_motion_too(self, features, by_watching, tmp_path, setting):
        def frame(planes_of):
            def write(path, street, time):
                planes = planes_of(street, time)
                shots.write(path, {"": {k: v for k, v in planes.items() if "Index" not in k}})

            return write

        def key_planes(street, time):
            passes = shots.blender_passes(street, time)
            return {k: v for group in passes for k, v in group.items()}

        street = shots.SMALL
        if setting == "key":
            given = (shots.sequence(tmp_path / "keys", frame(key_planes), (1, 2), street),)
        else:
            keys = shots.sequence(tmp_path / "keys", shots.colour_only, (1, 2), street)
            slots = tmp_path / "slots"
            shots.sequence(slots, frame(_without_index), range(1, 6), street, 0.25)
            given = (keys, "--gbuffers", slots)
        given = (*given, *shots.VECTORS)
        run = by_watching(given)
        rows = features(given)
        same_as_in_the_run(rows, run.rows)
        assert "1" in {row["N_d"] for row in rows}
        assert run.report["policy"]["objects_from"] == "motion"


def _without_index(street, time):
    return {k: v for k, v in shots.slot_planes(street, time).items() if k != "IndexOB.X"}


@pytest.mark.parametrize(("setting", "frames"), combinations(SETTINGS, ("6", "2-6x2")))
def test_a_chunk_is_a_part_of_the_whole(features, table, uneven, setting, frames):
    part = features(uneven[setting], "--frames", frames)
    chosen = {"6"} if frames == "6" else {"2", "4", "6"}
    assert part == [row for row in table(setting) if row["key"] in chosen]


def test_nodes_see_the_key_frame_or_their_own_instant(table):
    """At d1 the settings differ by the instant before, at d3 to d5 by their own."""
    for setting, own in (("key", False), ("slot", True)):
        rows = table(setting)
        for k in range(KEYS - 1):
            cells = [tuple(row[name] for name in NAMES) for row in rows[5 * k : 5 * k + 5]]
            assert cells[2] == cells[3] == cells[4]
            assert (len(set(cells)) == 3) is own
            assert (len(set(cells)) == 1) is not own
        first = rows[0]
        assert (first["EMD_Wn"], first["EMD_Wp"]) == ("0.0", "0.0")
        # the slots' G-buffers end with the last key frame
        assert len({tuple(row[name] for name in NAMES) for row in rows[-5:]}) == 1


def test_a_policy_runs_on_it(features, exwarp, uneven, judged, policies, tmp_path):
    keys, *rest = uneven["key"]
    table = exwarp("features", keys, *rest, "--progress", "none").out
    (tmp_path / "f.csv").write_text(table)
    found = exwarp("policy", "run", tmp_path / "f.csv", "--policy", policies("watching"))
    rows = {(r["frame"], r["node"]): r for r in csv.DictReader(io.StringIO(found.out))}
    for row in judged("watching").rows:
        if row["node"]:
            decided = rows[row["frame"], row["node"]]
            assert decided["decision"] == row["choice"]
            assert decided["output_extrapolate"] == row["output_extrapolate"]


class TestRefusals:
    def test_a_sequence_that_is_not_there(self, exwarp, tmp_path):
        exwarp("features", tmp_path / "gone", "--progress", "none").refused(3, "gone")

    def test_no_motion(self, exwarp, plain_truth):
        exwarp("features", plain_truth, "--progress", "none").refused(3, "no motion vectors")

    def test_frames_outside_the_sequence(self, exwarp, uneven):
        options = ("--frames", "5-9", "--progress", "none")
        exwarp("features", *uneven["key"], *options).refused(3, "frame 7-9 ", "1-6")

    def test_a_damaged_frame(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.plain, (1, 2), shots.SMALL)
        first = keys / "shot.0001.exr"
        first.write_bytes(first.read_bytes()[:-900])
        exwarp("features", keys, *shots.FORWARD, "--progress", "none").refused(3, "shot.0001.exr")

    @pytest.mark.parametrize("option", [("--threads", "0"), ("--motion", "sideways")])
    def test_options(self, exwarp, uneven, option):
        keys = uneven["key"][0]
        exwarp("features", keys, *option, "--progress", "none").refused(2, *option[:1])
