"""`--json` of every command: one document on stdout and nothing else."""

from __future__ import annotations

import csv
import importlib
import io
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from exwarp_cli import cli
from exwarp_cli.accelerator.mac_array import COMPARE_CYCLES, MacArray, schedule
from exwarp_cli.accelerator.mlp import PAPER_SIZES, infer_reference
from exwarp_cli.commands.options import print_json
from exwarp_cli.domain.decision import CHOICES
from exwarp_cli.models.policy_files import save_network
from exwarp_cli.research.training import extranet_import
from tests.cli import shots
from tests.cli.documents import document_of, strict
from tests.unit.mlp_cases import network, states
from tests.unit.tiny_interpolators import rife
from tests.unit.tiny_models import save

PRINTS_A_SCRIPT = {"completion"}
"""Commands whose stdout a shell reads."""

STATES = states(3, 4)


def leaves(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
    if isinstance(command, click.Group):
        for below, found in command.commands.items():
            yield from leaves(found, f"{name} {below}")
    else:
        yield name, command


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_has_it(name):
    module = importlib.import_module(f"exwarp_cli.commands.{name.replace('-', '_')}")
    found = dict(leaves(module.command, name))
    assert found
    for each, command in found.items():
        options = [param for param in command.params if "--json" in param.opts]
        if each in PRINTS_A_SCRIPT:
            continue
        assert [option.name for option in options] == ["as_json"], each
        assert isinstance(options[0], click.Option) and options[0].is_flag, each


def test_what_is_no_number_is_null(capsys):
    print_json({"a": float("nan"), "b": [float("inf"), 1.5], "c": {"d": None}})
    assert strict(capsys.readouterr().out) == {"a": None, "b": [None, 1.5], "c": {"d": None}}


def test_names_that_are_no_unicode(capsys):
    """As file systems have them; the document is ASCII, and parses to the same name."""
    print_json({"pattern": "caf\udce9\n.exr"})
    text = capsys.readouterr().out
    assert text.isascii() and strict(text)["pattern"] == "caf\udce9\n.exr"


class TestFeatures:
    OPTIONS = (*shots.FORWARD, "--threads", 1)

    def test_rows_are_those_of_the_table(self, exwarp, plain_shot):
        line = ("features", plain_shot, *self.OPTIONS, "--progress", "none")
        found = document_of(exwarp(*line, "--json"), "exwarp.features/1")
        table = list(csv.DictReader(io.StringIO(exwarp(*line).out)))
        assert len(found["rows"]) == len(table) == 15
        for row, cells in zip(found["rows"], table, strict=True):
            assert list(row) == list(cells)
            text = {name: "" if value is None else str(value) for name, value in row.items()}
            text["inputs"] = " ".join(map(str, row["inputs"]))
            assert text == cells

    @pytest.mark.parametrize("json", [(), ("--json",)])
    def test_a_farm_s_lines_keep_off_the_results(self, exwarp, plain_shot, json):
        line = ("features", plain_shot, *self.OPTIONS, *json)
        quiet = exwarp(*line, "--progress", "none")
        openjd = exwarp(*line, "--progress", "openjd")
        assert openjd.out == quiet.out
        assert openjd.err.splitlines()[0] == "openjd_progress: 0.0"
        assert "openjd_status: 3 frames done" in openjd.err.splitlines()

    def test_a_failure_prints_no_part_of_it(self, exwarp, tmp_path):
        keys = shots.sequence(tmp_path / "keys", shots.plain, (1, 2, 3), shots.SMALL)
        last = keys / "shot.0003.exr"
        last.write_bytes(last.read_bytes()[:-900])
        line = ("features", keys, *self.OPTIONS, "--progress", "none", "--json")
        exwarp(*line).refused(3, "shot.0003.exr")


class TestCompare:
    def test_scores(self, exwarp, plain_truth, plain_shot):
        line = ("compare", plain_truth, plain_truth, "--json", "--progress", "openjd")
        result = exwarp(*line)
        found = document_of(result, "exwarp.compare/1")
        assert found["quality"]["all"]["psnr_db"] == 100
        assert "openjd_progress: 100.0" in result.err.splitlines()

    def test_a_farm_hears_of_a_limit(self, exwarp, tmp_path):
        """The failure stands behind the table, as the sentence on stderr does."""
        one = shots.sequence(tmp_path / "a", shots.plain, (1,), shots.SMALL)
        other = tmp_path / "b"
        shots.plain(other / "shot.0001.exr", shots.SMALL, 1.0)
        result = exwarp("compare", one, other, "--fail-below", "psnr=99", "--progress", "openjd")
        assert result.code == 8
        *_, fail = result.out.splitlines()
        sentence = result.err.removeprefix("exwarp: error: ").strip()
        assert fail == f"openjd_fail: {sentence}" and "psnr" in sentence.lower()


class TestInspect:
    def test_what_a_sequence_holds(self, exwarp, plain_shot):
        found = document_of(exwarp("inspect", plain_shot, *shots.FORWARD, "--json"))
        assert (found["count"], found["motion"]["source"]) == (3, "given")


@pytest.fixture
def policy(tmp_path) -> Path:
    path = tmp_path / "p.npz"
    save_network(path, network(9), {})
    return path


class TestPolicy:
    @pytest.fixture
    def table(self, tmp_path) -> Path:
        """Rows 1, 3 and 4 have states."""
        cells = [" ".join(map(str, state.tolist())) for state in STATES]
        rows = [f"{7 + k},d{k + 1},{cell}\n" for k, cell in enumerate([cells[0], "", *cells[1:]])]
        path = tmp_path / "t.csv"
        path.write_text("frame,node,inputs\n" + "".join(rows))
        return path

    def test_cycles(self, exwarp):
        found = document_of(exwarp("policy", "cycles", "--json"), "exwarp.cycles/1")
        assert found["cycles"] == schedule(MacArray(), PAPER_SIZES).cycles

    def test_decisions_are_those_of_the_table(self, exwarp, policy, table):
        line = ("policy", "run", table, "--policy", policy)
        found = document_of(exwarp(*line, "--json"), "exwarp.policy-decisions/1")
        cells = list(csv.DictReader(io.StringIO(exwarp(*line).out)))
        assert [row["row"] for row in found["rows"]] == [1, 3, 4]
        assert [{k: str(v) for k, v in row.items()} for row in found["rows"]] == cells
        one = document_of(exwarp(*line, "--row", 3, "--json"))
        assert one["rows"] == found["rows"][1:2]

    def test_a_trace_has_every_number(self, exwarp, policy, table):
        line = ("policy", "run", table, "--policy", policy, "--trace", "--row", 4, "--json")
        found = document_of(exwarp(*line), "exwarp.policy-trace/1")
        expected = infer_reference(network(9), STATES[2])
        assert (found["row"], found["frame"], found["node"]) == (4, "10", "d4")
        assert found["state"] == STATES[2].tolist()
        assert found["inputs"] == expected.inputs.tolist()
        layers = found["layers"]
        sizes = [(la["fan_in"], la["neurons"]) for la in layers]
        assert sizes == list(itertools.pairwise(PAPER_SIZES))
        sums = [la["accumulators"] for la in layers]
        assert sums == [each.tolist() for each in expected.accumulators]
        values = [la["activations"] for la in layers]
        assert values == [*(each.tolist() for each in expected.activations), None]
        assert [found["output_warp"], found["output_extrapolate"]] == expected.outputs.tolist()
        assert found["decision"] == CHOICES[int(expected.choices)]
        parts = [found["input_cycles"], *(la["cycles"] for la in layers), COMPARE_CYCLES]
        assert found["cycles"] == sum(parts) == schedule(MacArray(), PAPER_SIZES).cycles

    def test_an_export(self, exwarp, policy, tmp_path):
        out = tmp_path / "hex"
        options = ("--policy", policy, "--vectors", 3, "--seed", 5, "--json")
        found = document_of(exwarp("policy", "export", out, *options), "exwarp.policy-export/1")
        assert (found["folder"], found["vectors"], found["seed"]) == (str(out), 3, 5)
        assert sorted(found["files"]) == shots.names(out)
        assert found["manifest"] == "manifest.json" and found["manifest"] in found["files"]


class TestModels:
    def test_an_import(self, exwarp, tmp_path, monkeypatch):
        asked = []
        monkeypatch.setattr(
            extranet_import, "import_extranet", lambda *given, **_: asked.append(given)
        )
        given, out = tmp_path / "given.pth.tar", tmp_path / "e.onnx"
        found = document_of(exwarp("models", "import-extranet", given, out, "--json"))
        assert found == {"schema": "exwarp.model/1", "kind": "extrapolator", "model": str(out)}
        assert asked == [(given, out)]

    def test_a_card(self, exwarp, tmp_path):
        path = save(tmp_path / "net.onnx", rife("plane"))
        line = ("models", "interpolator-card", path, "--shape", "rife", "--json")
        found = document_of(exwarp(*line))
        card = tmp_path / "net.json"
        assert found == {
            "schema": "exwarp.model/1", "kind": "interpolator", "model": str(path),
            "card": str(card),
        }  # fmt: skip
        assert card.exists()

    @pytest.mark.parametrize("kind", ["extrapolator", "interpolator"])
    def test_the_kind_is_an_option_of_upsample(self, exwarp, kind):
        assert re.search(rf"--{kind}\b", exwarp("upsample", "--help").out)
