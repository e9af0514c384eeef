"""`exwarp policy`: what it prints and writes, and what it refuses."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.accelerator.mac_array import MacArray, schedule
from exwarp_cli.accelerator.mlp import PAPER_SIZES, infer_reference
from exwarp_cli.domain.decision import CHOICES
from exwarp_cli.models.policy_files import save_network
from tests.unit.mlp_cases import network, states

SEED = 9
STATES = states(5, SEED)


@pytest.fixture(scope="module")
def policy(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("policy") / "p.npz"
    save_network(path, network(SEED), {})
    return path


def cell(state: np.ndarray) -> str:
    return " ".join(map(str, state.tolist()))


@pytest.fixture
def features(tmp_path) -> Path:
    """States in rows 1, 2, 4, 5 and 6; row 3 has none."""
    path = tmp_path / "frames.csv"
    rows = [[100 + k, f"f.{k}.exr", k % 4, f"d{k % 5 + 1}", cell(s)] for k, s in enumerate(STATES)]
    rows.insert(2, ["102", "x", "0", "", ""])
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([["frame", "file", "slot", "node", "inputs"], *rows])
    return path


class TestCycles:
    def test_the_paper_s_machine(self, exwarp):
        result = exwarp("policy", "cycles")
        assert result.code == 0 and result.err == ""
        assert "latency: 1,871 cycles, 1,871 ns at 1 GHz" in result.out
        assert "6.2 ns: the 1,837 MAC cycles alone would need 296 GHz" in result.out
        assert "12,436 of all 77,972 bytes are fetched again" in result.out
        rows = [line.split() for line in result.out.splitlines()]
        assert ["128", "to", "256", "832", "3", "2", "837", "97.9%", "8,768", "0"] in rows
        assert ["total", "1,837", "1,871", "95.4%", "19,559", "3,175"] in rows

    def test_another_machine_as_json(self, exwarp, policy):
        options = ("--cores", 8, "--macs", 16, "--cache", "8KiB", "--clock", "500 MHz")
        result = exwarp("policy", "cycles", *options, "--policy", policy, "--json")
        found, plan = json.loads(result.out), schedule(MacArray(8, 16, 4, 8192), PAPER_SIZES)
        assert found["schema"] == "exwarp.cycles/1"
        assert found["machine"] == {
            "cores": 8, "macs": 16, "pipeline_stages": 4, "cache_bytes": 8192, "port_bytes": 0
        }  # fmt: skip
        assert (found["cycles"], found["clock_hz"]) == (plan.cycles, 5e8)
        assert found["latency_ns"] == 2.0 * plan.cycles
        assert [layer["cycles"] for layer in found["layers"]] == [la.cycles for la in plan.layers]
        assert found["core_refill_bytes"] == list(plan.core_refill_bytes)

    def test_the_policy_s_own_size_counts(self, exwarp, tmp_path):
        save_network(tmp_path / "small.npz", network(1, (5, 3, 2)), {})
        out = exwarp("policy", "cycles", "--policy", tmp_path / "small.npz", "--json").out
        assert json.loads(out)["sizes"] == [5, 3, 2]

    def test_a_port_that_brings_what_caches_do_not_hold(self, exwarp):
        out = exwarp("policy", "cycles", "--port", 8).out
        assert "latency: 4,360 cycles" in out
        assert "over a port of 8 for which MAC units wait 2,489 cycles" in out
        fitting = exwarp("policy", "cycles", "--port", 8, "--cache", "20KB")
        assert "latency: 1,871 cycles" in fitting.out

    def test_caches_that_hold_it(self, exwarp):
        assert "; everything fits\n" in exwarp("policy", "cycles", "--cache", "20KB").out

    @pytest.mark.parametrize(
        ("text", "hertz"),
        [("500MHz", 5e8), ("1.5GHz", 1.5e9), ("1e9", 1e9), ("2 ghz", 2e9), ("32.768kHz", 32768.0)],
    )
    def test_clocks(self, exwarp, text, hertz):
        out = exwarp("policy", "cycles", "--clock", text, "--json").out
        assert json.loads(out)["clock_hz"] == pytest.approx(hertz)

    @pytest.mark.parametrize("text", ["fast", "0", "-1GHz", "1.2.3", "1e999", "nan", "", "."])
    def test_no_clocks(self, exwarp, text):
        result = exwarp("policy", "cycles", f"--clock={text}")
        result.refused(2, "is no clock rate; give one as 500MHz")

    @pytest.mark.parametrize("text", ["big", "1.5KB", "-1", "9" * 20])
    def test_no_caches(self, exwarp, text):
        exwarp("policy", "cycles", f"--cache={text}").refused(2, "is no size; give one as 16KB")

    @pytest.mark.parametrize("text", ["0", "400"])
    def test_too_small_caches(self, exwarp, text):
        exwarp("policy", "cycles", "--cache", text).refused(2, f"--cache {text} does not do")

    @pytest.mark.parametrize("option", ["--cores", "--macs"])
    @pytest.mark.parametrize("count", ["0", "5000", "x"])
    def test_no_machines(self, exwarp, option, count):
        exwarp("policy", "cycles", option, count).refused(2, option, "policy cycles --help")


class TestRun:
    def test_every_row_is_decided(self, exwarp, policy, features):
        result = exwarp("policy", "run", features, "--policy", policy)
        assert result.code == 0 and result.err == ""
        rows = list(csv.DictReader(io.StringIO(result.out)))
        expected = infer_reference(network(SEED), STATES)
        assert [row["row"] for row in rows] == ["1", "2", "4", "5", "6"]
        assert [row["frame"] for row in rows] == ["100", "101", "102", "103", "104"]
        assert [row["node"] for row in rows] == ["d1", "d2", "d3", "d4", "d5"]
        assert list(rows[0]) == [
            *("row", "frame", "slot", "node", "output_warp", "output_extrapolate", "decision")
        ]
        for row, outputs, choice in zip(rows, expected.outputs, expected.choices, strict=True):
            assert [int(row["output_warp"]), int(row["output_extrapolate"])] == outputs.tolist()
            assert row["decision"] == CHOICES[choice]
        assert {row["decision"] for row in rows} == set(CHOICES)

    def test_one_row(self, exwarp, policy, features):
        whole = exwarp("policy", "run", features, "--policy", policy).out.splitlines()
        one = exwarp("policy", "run", features, "--policy", policy, "--row", 4).out.splitlines()
        assert one == [whole[0], whole[3]]

    def test_a_table_of_states_alone(self, exwarp, policy, tmp_path):
        (tmp_path / "t.csv").write_text(f"\ufeffinputs\r\n{cell(STATES[0])}\r\n", "utf-8")
        out = exwarp("policy", "run", tmp_path / "t.csv", "--policy", policy).out.splitlines()
        assert out[0] == "row,output_warp,output_extrapolate,decision" and len(out) == 2

    @pytest.mark.parametrize(("row", "index"), [(None, 0), (5, 3)])
    def test_a_trace(self, exwarp, policy, features, row, index):
        more = () if row is None else ("--row", row)
        result = exwarp("policy", "run", features, "--policy", policy, "--trace", *more)
        found = infer_reference(network(SEED), STATES[index])
        lines = [" ".join(line.split()) for line in result.out.splitlines()]
        assert lines[0] == f"row {row or 1} (frame {100 + index}, slot {index % 4}, " + (
            f"node d{index + 1})"
        )
        shown = [STATES[index], found.inputs, *found.activations, *found.accumulators[:-1]]
        for values in shown:
            text = " ".join(map(str, values[:8].tolist()))
            assert any(line.endswith(f" {text} …") for line in lines), text
        for k, sums in enumerate(found.accumulators):
            at = next(i for i, line in enumerate(lines) if line.startswith(f"layer {k}: "))
            assert lines[at + 1] == f"accumulators {sums.min()} to {sums.max()}"
        warp, extrapolate = found.outputs
        assert f"outputs: warp {warp}, extrapolate {extrapolate}" in lines
        assert f"decision: {CHOICES[found.choices]}, 1 cycle" in lines
        assert lines[-1] == "in all 1871 cycles on the paper's machine"


class TestRunRefuses:
    @pytest.fixture
    def refused(self, exwarp, policy, tmp_path):
        def run(text: str | bytes, code: int, *words: str, options: tuple[object, ...] = ()):
            path = tmp_path / "table.csv"
            path.write_bytes(text if isinstance(text, bytes) else text.encode())
            exwarp("policy", "run", path, "--policy", policy, *options).refused(code, *words)

        return run

    def test_no_column(self, refused):
        refused("frame,slot\n1,2\n", 3, "table.csv has no column 'inputs'; give")
        refused("", 3, "has no column 'inputs'")

    def test_no_state(self, refused):
        refused("frame,inputs\n1,\n2, \n3\n", 3, "has no row with 'inputs'")

    @pytest.mark.parametrize("count", [1, 43, 45])
    def test_a_wrong_count(self, refused, count):
        text = f"inputs,node\n\n{cell(STATES[0])},\n{' 1' * count},d1\n"
        refused(text, 3, f"table.csv, line 4: 'inputs' holds {count} numbers, and", "takes 44")

    @pytest.mark.parametrize(
        "word", ["0.5", "1e3", "x", "2147483648", "-2147483649", "1_0", "٣", "--1", "-", "9" * 5000]
    )
    def test_no_integers(self, refused, word):
        refused(f"inputs\n{'1 ' * 43}{word}\n", 3, "line 2: ", "is no 32-bit integer")

    def test_no_text(self, refused):
        refused(b"inputs\n\xff\xfe\n", 3, "is no CSV file in UTF-8")
        refused("inputs\n" + "1 " * 200_000 + "\n", 3, "is no CSV file in UTF-8")

    @pytest.mark.parametrize("options", [(), ("--trace",)])
    def test_no_such_row(self, refused, options):
        text = f"inputs\n{cell(STATES[0])}\n\n"
        refused(text, 2, "--row 3: ", "rows 1 to 1", options=(*options, "--row", 3))

    def test_no_files(self, exwarp, policy, features, tmp_path):
        missing = tmp_path / "none.csv"
        exwarp("policy", "run", missing, "--policy", policy).refused(3, "cannot read", "none.csv")
        exwarp("policy", "run", tmp_path, "--policy", policy).refused(3, "cannot read")
        exwarp("policy", "run", features, "--policy", missing).refused(3, "there is no model")
        exwarp("policy", "run", features, "--policy", features).refused(3, "no policy file")


def words(path: Path, bits: int) -> np.ndarray:
    """Read a file as $readmemh and a signed register would."""
    values = [int(line, 16) for line in path.read_text().split()]
    assert all(len(line) == bits // 4 for line in path.read_text().split())
    return np.array([v - (1 << bits) if v >> (bits - 1) else v for v in values])


class TestExport:
    @pytest.fixture(scope="class")
    @classmethod
    def made(cls):
        return network(SEED)

    @pytest.fixture
    def folder(self, exwarp, policy, tmp_path) -> Path:
        out = tmp_path / "a" / "hex"
        result = exwarp("policy", "export", out, "--policy", policy, "--vectors", 7)
        assert result.code == 0 and result.err == ""
        assert result.out == f"{out}: {len(list(out.iterdir()))} files, 7 test vectors; see " + (
            "README.txt\n"
        )
        return out

    def test_cores_hold_the_network(self, folder, made):
        manifest = json.loads((folder / "manifest.json").read_text())
        assert manifest["sizes"] == list(PAPER_SIZES)
        assert sorted([*manifest["files"], "manifest.json"]) == sorted(
            path.name for path in folder.iterdir()
        )
        for core, places in enumerate(manifest["addresses"]):
            lines = (folder / f"core{core}_weights.hex").read_text().split()
            biases = words(folder / f"core{core}_bias.hex", 32)
            multipliers = words(folder / f"core{core}_multiplier.hex", 32)
            shifts = words(folder / f"core{core}_shift.hex", 8)
            for layer, place in zip(made.layers, places, strict=True):
                for t, neuron in enumerate(range(core, layer.neurons, 4)):
                    at = place["weights_at"] + t * place["words"]
                    read = b"".join(
                        bytes.fromhex(line)[::-1] for line in lines[at : at + place["words"]]
                    )
                    row = np.frombuffer(read, np.int8)
                    assert (row[layer.fan_in :] == 0).all() and len(row) < layer.fan_in + 10
                    np.testing.assert_array_equal(row[: layer.fan_in], layer.weights[neuron])
                    assert biases[place["bias_at"] + t] == layer.biases[neuron]
                    if layer.requantisation is not None:
                        scale = place["scale_at"] + t
                        assert multipliers[scale] == layer.requantisation.multipliers[neuron]
                        assert shifts[scale] == layer.requantisation.shifts[neuron]
            assert len(lines) == 1837 - (13 if core > 1 else 0)

    def test_vectors(self, folder, made):
        states = words(folder / "vectors_input.hex", 32).reshape(7, 44).astype(np.int32)
        found = infer_reference(made, states)
        assert len({*map(tuple, states.tolist())}) == 7
        files = {
            "vectors_input_q": (8, found.inputs),
            **{f"vectors_layer{k}_accumulator": (32, a) for k, a in enumerate(found.accumulators)},
            **{f"vectors_layer{k}_activation": (8, a) for k, a in enumerate(found.activations)},
        }
        for name, (bits, values) in files.items():
            np.testing.assert_array_equal(words(folder / f"{name}.hex", bits), values.ravel())
        outputs = words(folder / "vectors_output.hex", 32).reshape(7, 3)
        np.testing.assert_array_equal(outputs[:, :2], found.outputs)
        np.testing.assert_array_equal(outputs[:, 2], found.choices)

    def test_inputs(self, folder, made):
        multipliers = words(folder / "input_multiplier.hex", 32)
        np.testing.assert_array_equal(multipliers, made.inputs.multipliers)
        shifts = words(folder / "input_shift.hex", 8)
        np.testing.assert_array_equal(shifts, made.inputs.shifts)

    def test_the_seed_counts(self, exwarp, policy, folder, tmp_path):
        def vectors(name: str, seed: int) -> str:
            out = tmp_path / name
            exwarp("policy", "export", out, "--policy", policy, "--vectors", 7, "--seed", seed)
            return (out / "vectors_input.hex").read_text()

        assert vectors("again", 0) == (folder / "vectors_input.hex").read_text() != vectors("b", 1)

    def test_files_in_the_way(self, exwarp, policy, folder):
        (folder / "mine.txt").write_text("mine")
        (folder / "input_shift.hex").write_text("old")
        (folder / "README.txt").unlink()
        before = {path.name: path.read_bytes() for path in folder.iterdir()}
        again = ("policy", "export", folder, "--policy", policy, "--vectors", 3)
        exwarp(*again).refused(6, ".hex exists; choose another folder, or add --overwrite")
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
        assert exwarp(*again, "--overwrite").code == 0
        assert (folder / "input_shift.hex").read_text() != "old"
        assert (folder / "mine.txt").read_text() == "mine" and (folder / "README.txt").exists()

    def test_no_folder_to_write_to(self, exwarp, policy):
        exwarp("policy", "export", policy, "--policy", policy).refused(5, "cannot write")

    def test_too_many_vectors(self, exwarp, policy, tmp_path):
        for count in (0, 10**6):
            out = exwarp("policy", "export", tmp_path, "--policy", policy, "--vectors", count)
            out.refused(2, "--vectors")


def test_alone_it_shows_its_commands(exwarp):
    result = exwarp("policy")
    assert result.code == 0
    assert all(name in result.out for name in ("cycles", "run", "export"))


class TestVerilog:
    def test_the_design_is_written_beside_what_it_reads(self, exwarp, policy, tmp_path):
        out = tmp_path / "design"
        result = exwarp("policy", "export", out, "--policy", policy, "--verilog", "--vectors", 5)
        assert result.code == 0, result.err
        names = {path.name for path in out.iterdir()}
        assert {"exwarp_predictor.v", "exwarp_core.v", "exwarp_predictor_tb.v", "Makefile"} <= names
        memories = ("weights", "scales", "biases")
        assert {f"memory{core}_{name}.hex" for core in range(4) for name in memories} <= names
        listed = json.loads((out / "manifest.json").read_text())["files"]
        assert {*listed, "manifest.json"} == names
        about = (out / "README.txt").read_text()
        for name in re.findall(r"^(\S+\.(?:v|vh|hex)|Makefile) ", about, re.MULTILINE):
            assert list(out.glob(re.sub("<.>", "*", name))), name
        assert "localparam CYCLES = 1871;" in (out / "exwarp_vectors.vh").read_text()
        for core in range(4):
            own = (out / f"core{core}_weights.hex").read_text()
            assert (out / f"memory{core}_weights.hex").read_text().startswith(own)

    def test_without_it_there_is_none(self, exwarp, policy, tmp_path):
        exwarp("policy", "export", tmp_path / "hex", "--policy", policy)
        assert not list((tmp_path / "hex").glob("*.v")) and not (tmp_path / "hex/Makefile").exists()

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--cache", "16KB"), "holds 1474 of 1837 words of weights; give a larger --cache"),
            (("--cache", "1KB"), "--cache does not do: a cache of 1024 bytes does not hold"),
            (("--cores", 11, "--macs", 12), "the design has at most 10 cores"),
            (("--cores", 5, "--macs", 4), "no more than MAC units in each"),
        ],
    )
    def test_machines_that_it_cannot_be(self, exwarp, policy, tmp_path, options, words):
        out = tmp_path / "design"
        exwarp("policy", "export", out, "--policy", policy, "--verilog", *options).refused(2, words)
        assert not out.exists()

    def test_a_port_brings_what_caches_do_not_hold(self, exwarp, policy, tmp_path):
        options = ("--verilog", "--cache", "16KB", "--port", 8)
        exwarp("policy", "export", tmp_path, "--policy", policy, *options)
        assert "parameter RESIDENT = 1474," in (tmp_path / "exwarp_parameters.vh").read_text()
        assert "localparam CYCLES = 4360;" in (tmp_path / "exwarp_vectors.vh").read_text()
        # Two beats of 8 bytes a word of 10.
        assert len((tmp_path / "refill.hex").read_text().split()) == 2 * 14260 // 10
