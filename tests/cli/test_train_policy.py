"""`exwarp train policy` as a user runs it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.cli import run
from exwarp_cli.kernels import _row_bands
from exwarp_cli.models.policy_files import load_policy
from exwarp_cli.research.training import outcome_tables
from exwarp_cli.research.training.augmentation import Variant
from exwarp_cli.research.training.outcome_tables import PolicyTable, View
from tests.cli.documents import document_of
from tests.unit.training.policy_tables import tempting

MINIATURE = Path(__file__).parents[1] / "data" / "miniature" / "variety-0074"
QUICK = ("--steps", 5, "--batch", 16)
FILES = {"checksums.json", "policy-int8.onnx", "policy.json", "policy.npz", "policy.onnx"}
FEW = tuple(
    View(setting, variant)
    for variant, setting in (
        (Variant(0), "key"),
        (Variant(2), "slot"),
        (Variant(0, speed=2), "slot"),
    )
)


@pytest.fixture(scope="module", autouse=True)
def threads():
    """Measuring is done on one thread; what follows gets all of them back."""
    yield
    outcome_tables.extrapolator.cache_clear()
    _row_bands.set_threads(None)


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    for seed, scene in enumerate(("lab", "town")):
        tempting(30, seed, scene).save(folder / f"{scene}.npz")
    return folder


def benchmark(folder: Path, *names: str) -> Path:
    """Copies of the miniature as benchmark scenes."""
    for name in names:
        shutil.copytree(MINIATURE, folder / name)
        path = folder / name / "manifest.json"
        content = json.loads(path.read_text())
        path.write_text(json.dumps(content | {"scene": name, "role": "benchmark"}))
    return folder


def train(exwarp, output: Path, *options: object):
    return exwarp("train", "policy", "-o", output, *QUICK, *options)


def test_tables_are_trained_on(exwarp, tables, tmp_path):
    result = train(exwarp, tmp_path / "out", "--tables", tables)
    assert result.code == 0, result.err
    folds = {f"policy-without-{scene}.npz" for scene in ("lab", "town")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES | folds
    assert "| lab | key 64x36 |" in result.out and "| town | key 64x36 |" in result.out
    assert "without lab: training on town" in result.err
    settings = json.loads((tmp_path / "out" / "policy.json").read_bytes())["settings"]
    assert (settings["steps"], settings["batch"], settings["seed"]) == (5, 16, 0)
    out = tmp_path / "again"
    again = train(exwarp, out, "--tables", tables, "--seed", 1, "--rate", 0.01, "--json")
    found = document_of(again, "exwarp.training/1")
    assert (found["kind"], found["folder"]) == ("policy", str(out))
    assert found["model"] == str(out / "policy.npz")
    scores = json.loads((out / "policy.json").read_bytes())
    assert found["scores"] == scores
    assert (scores["settings"]["seed"], scores["settings"]["rate"]) == (1, 0.01)


def test_rendered_scenes_are_measured_once_and_trained_on(exwarp, network, tmp_path, monkeypatch):
    monkeypatch.setattr("exwarp_cli.research.training.outcome_tables.VIEWS", FEW)
    data = benchmark(tmp_path / "data", "one", "two")
    # One key interval of the second scene is not rendered yet.
    (data / "two" / "keys" / "variety-0074.0004.exr").unlink()
    measured = ("--data", data, "--extrapolator", network, "--jobs", 1)
    result = train(exwarp, tmp_path / "out", *measured)
    assert result.code == 0, result.err
    for line in (
        "one 64x36 key-phase0-speed1: 3 key intervals",
        "one 64x36 slot-phase2-speed1: 2 key intervals",
        "two 64x36 key-phase0-speed1: 2 key intervals",
        "two 64x36 slot-phase0-speed2: 1 key intervals",
    ):
        assert line in result.err.splitlines()
    assert "| one | slot 64x36 |" in result.out
    one, two = (
        PolicyTable.load(tmp_path / "out" / "tables" / f"{name}.npz") for name in ("one", "two")
    )
    assert one.groups == tuple(f"{view.name} 64x36" for view in FEW)
    assert one.group.tolist() == [0, 0, 0, 1, 1, 2] and two.group.tolist() == [0, 0, 1, 2]
    np.testing.assert_array_equal(one.outcomes[:2], two.outcomes[:2])
    checksum = load_policy(tmp_path / "out" / "policy.npz").metadata["extrapolator"]
    assert checksum == [one.network] == [two.network]

    # From the tables that were written, the same networks come.
    kept = train(exwarp, tmp_path / "kept", "--tables", tmp_path / "out" / "tables")
    assert kept.code == 0 and kept.out == result.out
    for name in ("policy.npz", "policy.json", "policy-without-one.npz"):
        assert (tmp_path / "kept" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()

    # What the cache holds is taken as it is: beside the data, for each scene, view and network.
    cache = tmp_path / "policy"
    files = sorted(cache.iterdir())
    assert len(files) == 2 * 2 * len(FEW)
    version = outcome_tables.OUTCOMES_VERSION
    (marked,) = cache.glob(f"one-64x36-slot-phase2-speed1-*[!s]-v{version}.npy")
    np.save(marked, np.load(marked) * 0 + 42.0)
    assert train(exwarp, tmp_path / "out", *measured).code == 0
    assert sorted(cache.iterdir()) == files
    changed = PolicyTable.load(tmp_path / "out" / "tables" / "one.npz").outcomes
    assert (changed[3:5] == 42).all()
    np.testing.assert_array_equal(changed[[0, 1, 2, 5]], one.outcomes[[0, 1, 2, 5]])


def test_a_damaged_frame_stops_the_measuring(exwarp, network, tmp_path):
    """Of the thirty views of two scenes only those are measured that were already on their way."""
    data, cache = benchmark(tmp_path / "data", "one", "two"), tmp_path / "cache"
    frame = data / "one" / "instants" / "variety-0074.0002.exr"
    frame.write_bytes(frame.read_bytes()[:2000])
    options = ("--data", data, "--extrapolator", network, "--jobs", 1, "--cache", cache)
    train(exwarp, tmp_path / "out", *options).refused(3, str(frame))
    assert not (tmp_path / "out").exists()
    assert len(list(cache.iterdir())) < 20


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--tables", "{tables}", "--data", "{tables}"), 2, ["--data", "--tables", "give one"]),
        (("--tables", "{empty}"), 3, ["holds no policy table", "--data"]),
        (("--tables", "{one}"), 3, ["there is only one", "--tables"]),
        (("--tables", "{twice}"), 3, ["two tables are of the scene lab"]),
        (("--tables", "{damaged}"), 3, ["lab.npz is no policy table", "make it again"]),
        (("--tables", "{tables}", "--rate", "2"), 2, ["--rate 2 is not between 0 and 1"]),
        (("--tables", "{tables}", "--rate", "nan"), 2, ["--rate nan"]),
        (("--data", "{none}"), 3, ["is no folder"]),
        (("--data", "{empty}"), 3, ["holds no benchmark scene"]),
        (("--data", "{training}"), 3, ["holds no benchmark scene"]),
        (("--data", "{data}", "--data", "{data}"), 2, ["the same scene at 64x36", "one of them"]),
        (("--data", "{data}", "--extrapolator", "{none}"), 3, ["there is no model"]),
        (("--data", "{cut}"), 3, ["no two successive key frames"]),
    ],
)
def test_mistakes_are_one_sentence(exwarp, tables, tmp_path, options, code, words):
    places = {"tables": tables, "training": MINIATURE, "none": tmp_path / "none"}
    for name in ("empty", "one", "twice", "damaged", "data", "cut"):
        places[name] = tmp_path / name
        places[name].mkdir()
    for name, copies in (("one", ["lab"]), ("twice", ["lab", "lab2"])):
        for copy in copies:
            shutil.copyfile(tables / "lab.npz", places[name] / f"{copy}.npz")
    (places["damaged"] / "lab.npz").write_bytes((tables / "lab.npz").read_bytes()[:-30])
    if "--data" in options:
        benchmark(places["data"], "one")
        benchmark(places["cut"], "one")
        (places["cut"] / "one" / "instants" / "variety-0074.0003.exr").unlink()
        for number in (1, 3):
            (places["cut"] / "one" / "keys" / f"variety-0074.{number:04d}.exr").unlink()
    given = [option.format(**places) for option in options]
    train(exwarp, tmp_path / "out", *given).refused(code, *words)
    assert not (tmp_path / "out").exists()


def test_without_the_extra_one_sentence_tells_how_to_get_it(exwarp, tables, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "exwarp_cli.research.training.training_settings.find_spec", lambda name: None
    )
    train(exwarp, tmp_path, "--tables", tables).refused(7, 'pip install "exwarp[train]"')


def test_help_needs_no_torch(without_torch, capsys):
    assert run(["train", "policy", "--help"]) == 0
    assert "--tables" in capsys.readouterr().out
