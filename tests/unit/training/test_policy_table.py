"""Tables of states and outcomes: in memory, and as files."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.decision import NODES, Features
from exwarp_cli.errors import DamagedFileError, InputError, UsageError
from exwarp_cli.policy.state import PRECEDING_NODES, SCALES, StateHistory
from exwarp_cli.research.training.outcome_tables import (
    TABLES,
    VIEWS,
    Measured,
    PolicyTable,
    find_tables,
    join_views,
)
from tests.unit.training.policy_tables import NETWORK, random_table

GROUPS = ("key-phase0-speed1 64x36", "slot-phase0-speed1 64x36", "key-phase2-speed1 64x36")
TABLE = random_table(14, 3, "lab", GROUPS)
STARTS = (0, 4, 8)


def features_of(row: int, instant: int) -> Features:
    """The features of a row as a run would have computed them."""
    n, en, ep, vx, vy, w, h, d = TABLE.features[row, instant].tolist()
    return Features(int(n), en, ep, vx, vy, int(w), int(h), d)


class TestStates:
    def test_groups_are_dealt_as_the_test_thinks(self):
        assert np.flatnonzero(np.diff(TABLE.group, prepend=-1)).tolist() == list(STARTS)

    @pytest.mark.parametrize("row", [0, 1, 3, 4, 6, 7, 8, 12, 13])
    def test_they_are_what_a_run_gives_to_the_policy(self, row):
        start = max(first for first in STARTS if first <= row)
        before = tuple(features_of(k, 0) for k in range(row - 1, max(start, row - 3) - 1, -1))
        around = StateHistory(
            (features_of(row, 0), features_of(row, 1), features_of(row, 2)), before
        )
        passed = {"d1": [], "d2": ["d1"], "d3": ["d1"], "d4": ["d1", "d2"], "d5": ["d1", "d2"]}
        assert {node: list(nodes) for node, nodes in PRECEDING_NODES.items()} == passed
        found = TABLE.states
        assert found.shape == (14, 5, 44) and found.dtype == np.float64
        assert (found >= 0).all() and (found <= 1).all()
        for k, node in enumerate(NODES):
            np.testing.assert_array_equal(found[row, k], around.inputs(node))

    def test_history_never_crosses_groups(self):
        found = TABLE.states
        for first, end in zip(STARTS, (*STARTS[1:], 14), strict=True):
            features = np.random.default_rng(1).permutation(TABLE.features)
            features[first:end] = TABLE.features[first:end]
            other = replace(TABLE, features=features).states
            np.testing.assert_array_equal(other[first:end], found[first:end])
            assert (other[:first] != found[:first]).any(axis=(1, 2)).sum() >= first - 1

    @pytest.mark.parametrize("first", STARTS)
    def test_a_group_s_start_is_padded_with_its_oldest_state(self, first):
        states = TABLE.states[first : first + 4, 0].reshape(4, 4, 11)
        here = states[:, 0]
        for row, oldest in enumerate([[0, 0, 0, 0], [1, 0, 0, 0], [2, 1, 0, 0], [3, 2, 1, 0]]):
            np.testing.assert_array_equal(states[row], here[oldest])
        assert len({tuple(row) for row in here.tolist()}) == 4

    def test_one_number_by_hand(self):
        """Var_y of the second instant of row 5: at d2, the fifth of 44 numbers."""
        value = TABLE.features[5, 1, 4] / 427**2
        assert TABLE.states[5, 1, 4] == SCALES["Var_y"](value) > 0
        assert TABLE.states[5, 1, 6:11].tolist() == [0, 1, 0, 0, 0]
        assert TABLE.states[5, 1, 17:22].tolist() == [1, 0, 0, 0, 0]


def test_a_table_is_joined_from_what_was_measured():
    rng = np.random.default_rng(0)
    parts = [
        (size, view, Measured(rng.random((k, 3, 8)), rng.random((k, 5, 2, 2))))
        for size, view, k in (
            ("64x36", VIEWS[0], 3),
            ("64x36", VIEWS[3], 1),
            ("32x18", VIEWS[0], 2),
        )
    ]
    found = join_views("lab", parts, NETWORK)
    assert (found.scene, found.network, len(found)) == ("lab", NETWORK, 6)
    assert found.group.tolist() == [0, 0, 0, 1, 2, 2] and found.group.dtype == np.int16
    assert found.groups == tuple(f"{view.name} {size}" for size, view, _ in parts)
    np.testing.assert_array_equal(found.features[3:4], parts[1][2].features)
    np.testing.assert_array_equal(found.outcomes[4:], parts[2][2].outcomes)


def test_beginnings_have_no_history():
    """Every one is a group of its own, so that its states are four times one."""
    features = TABLE.features[:5]
    begins = replace(VIEWS[0], begins=True)
    parts = [
        ("64x36", VIEWS[0], Measured(features, TABLE.outcomes[:5])),
        ("64x36", begins, Measured(features, TABLE.outcomes[:5])),
    ]
    found = join_views("lab", parts, NETWORK)
    assert found.group.tolist() == [0] * 5 + [1, 2, 3, 4, 5]
    assert found.groups == tuple(f"{view.name} 64x36" for view in (VIEWS[0], *[begins] * 5))
    states = found.states[:, 0].reshape(10, 4, 11)
    assert (states[5:] == states[5:, :1]).all() and (states[4] != states[4, 0]).any()
    np.testing.assert_array_equal(states[5:, 0], states[:5, 0])


class TestFiles:
    def test_what_is_written_is_what_is_read(self, tmp_path):
        TABLE.save(tmp_path / "lab.npz")
        found = PolicyTable.load(tmp_path / "lab.npz")
        assert (found.scene, found.groups, found.network) == ("lab", GROUPS, NETWORK)
        np.testing.assert_array_equal(found.group, TABLE.group)
        np.testing.assert_array_equal(found.features, TABLE.features)
        np.testing.assert_allclose(found.outcomes, TABLE.outcomes, atol=4e-6)
        assert found.features.dtype == found.outcomes.dtype == np.float64
        assert found.group.dtype == np.int16

    def test_the_same_table_gives_the_same_bytes(self, tmp_path, monkeypatch):
        TABLE.save(tmp_path / "one.npz")
        monkeypatch.setattr("time.localtime", lambda *_: (2031, 5, 5, 5, 5, 5, 0, 0, 0))
        TABLE.save(tmp_path / "two.npz")
        PolicyTable.load(tmp_path / "one.npz").save(tmp_path / "again.npz")
        one = (tmp_path / "one.npz").read_bytes()
        assert one == (tmp_path / "two.npz").read_bytes() == (tmp_path / "again.npz").read_bytes()
        assert len(one) < TABLE.features.nbytes + TABLE.outcomes.nbytes

    def test_one_that_is_not_there(self, tmp_path):
        with pytest.raises(InputError, match=r"there is no policy table .*lab\.npz"):
            PolicyTable.load(tmp_path / "lab.npz")

    @pytest.mark.parametrize("cut", [0, 1, 100, 0.3, 0.9, -1])
    def test_one_that_is_cut_off(self, tmp_path, cut):
        path = tmp_path / "lab.npz"
        TABLE.save(path)
        data = path.read_bytes()
        path.write_bytes(data[: cut if isinstance(cut, int) else int(cut * len(data))])
        refused(path)

    def test_one_with_changed_bytes(self, tmp_path):
        path = tmp_path / "lab.npz"
        TABLE.save(path)
        data = path.read_bytes()
        for at in range(40, len(data) - 200, len(data) // 15):
            path.write_bytes(
                data[:at] + bytes(b ^ 0xFF for b in data[at : at + 40]) + data[at + 40 :]
            )
            refused(path)

    def test_something_else(self, tmp_path):
        path = tmp_path / "lab.npz"
        for content in (b"", b"no archive", b"PK\x03\x04", npy(np.zeros(3))):
            path.write_bytes(content)
            refused(path)
        path.unlink()
        path.mkdir()
        refused(path)

    @pytest.mark.parametrize(
        ("change", "word"),
        [
            ({"about": {"schema": "exwarp.policy-table/2"}}, f"not {PolicyTable.schema}"),
            ({"about": {}}, "schema"),
            ({"about": {"schema": PolicyTable.schema}}, "scene"),
            ({"about": []}, "no policy table"),
            ({"features": np.zeros((14, 3, 6))}, r"\(14, 3, 6\), not \(14, 3, 8\)"),
            ({"outcomes": np.zeros((13, 5, 2, 2))}, r"\(13, 5, 2, 2\), not \(14, 5, 2, 2\)"),
            ({"outcomes": np.full((14, 5, 2, 2), np.nan)}, "not finite"),
            ({"features": np.full((14, 3, 8), np.inf)}, "not finite"),
            ({"features": np.array(["a"])}, "no policy table"),
            ({"group": np.full(14, 3, np.int16)}, "group"),
            ({"group": np.full(14, -1, np.int16)}, "group"),
            ({"group": np.zeros(0, np.int16)}, "no key interval"),
            ({"outcomes": None}, "outcomes"),
        ],
    )
    def test_one_whose_content_does_not_fit(self, tmp_path, change, word):
        path = tmp_path / "lab.npz"
        TABLE.save(path)
        with np.load(path) as kept:
            arrays = dict(kept)
        if "about" in change:
            text = json.dumps(change["about"]).encode()
            change = {"about": np.frombuffer(text, np.uint8)}
        arrays = {name: array for name, array in (arrays | change).items() if array is not None}
        with zipfile.ZipFile(path, "w") as archive:
            for name, array in arrays.items():
                archive.writestr(f"{name}.npy", npy(array))
        refused(path, word)


def npy(array: np.ndarray) -> bytes:
    text = io.BytesIO()
    np.save(text, array)
    return text.getvalue()


def refused(path, word: str = "no policy table") -> None:
    with pytest.raises(DamagedFileError, match=word) as caught:
        PolicyTable.load(path)
    message = str(caught.value)
    assert str(path) in message and "\n" not in message and "make it again" in message


class TestFinding:
    def test_a_folder_s_tables_by_name(self, tmp_path):
        for scene in ("town", "lab"):
            replace(TABLE, scene=scene).save(tmp_path / f"{scene}.npz")
        (tmp_path / "notes.txt").write_text("no table")
        found = find_tables((), tmp_path, tmp_path / "out", print)
        assert [table.scene for table in found] == ["lab", "town"]
        assert not (tmp_path / "out").exists()

    def test_without_a_folder_those_that_come_with_exwarp(self, tmp_path, monkeypatch):
        monkeypatch.setattr(
            "exwarp_cli.research.training.outcome_tables.shipped_folder",
            lambda: tmp_path / "models",
        )
        (tmp_path / "models" / TABLES).mkdir(parents=True)
        TABLE.save(tmp_path / "models" / TABLES / "lab.npz")
        found = find_tables((), None, tmp_path / "out", print)
        assert [table.scene for table in found] == ["lab"]

    def test_an_empty_folder_is_refused(self, tmp_path):
        for folder in (tmp_path, tmp_path / "none"):
            with pytest.raises(InputError, match="holds no policy table; make some with --data"):
                find_tables((), folder, tmp_path / "out", print)

    def test_tables_and_data_are_refused_before_anything_is_measured(self, tmp_path):
        with pytest.raises(UsageError, match="give one"):
            find_tables((tmp_path / "none",), tmp_path, tmp_path / "out", print)

    @pytest.mark.parametrize(
        "option", [{"model": "e.onnx"}, {"cache": "kept"}, {"jobs": 2}], ids=lambda o: next(iter(o))
    )
    def test_options_of_a_survey_are_refused_without_data(self, tmp_path, option):
        with pytest.raises(UsageError, match=r"is for measuring scenes; give --data too"):
            find_tables((), tmp_path, tmp_path / "out", print, **option)
