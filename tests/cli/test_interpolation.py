"""Networks that interpolate, on files: frames, report, what is made anew, and what is refused."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.shots import FORWARD, SMALL, changed_by, generated
from tests.unit.tiny_interpolators import PAIR, convolution, first_frame, put, rife, untimed
from tests.unit.tiny_models import save

TIMED = {"inputs": PAIR | {"timestep": "time"}}
KEYS = 3


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Three key frames of colour alone; read only."""
    folder = tmp_path_factory.mktemp("colour") / "keys"
    return shots.sequence(folder, shots.colour_only, range(1, KEYS + 1), SMALL)


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """A network with its card; read only."""
    keys = {**TIMED, "name": "Tiny", "padding": {"multiple": 2}}
    return put(tmp_path_factory.mktemp("net") / "tiny.onnx", convolution(scale=2), keys)


@pytest.fixture
def interpolate(upsample, keys, model, tmp_path) -> Callable[..., Path]:
    def run(name: str, *options: object, shot: Any = None, network: Any = None) -> Path:
        given = ("-m", "onnx", "--interpolator", network or model)
        upsample(shot or keys, tmp_path / name, *given, *options)
        return tmp_path / name

    return run


class TestFrames:
    def test_without_motion_vectors(self, interpolate, tmp_path, model):
        out = interpolate("out", "--report", tmp_path / "report")
        document = json.loads((tmp_path / "report" / "report.json").read_text())
        assert (document["method"], document["lookahead"]) == ("onnx", True)
        card = model.with_suffix(".json")
        sums = [hashlib.sha256(path.read_bytes()).hexdigest() for path in (model, card)]
        assert document["interpolator"] == {
            "name": "Tiny", "file": str(model), "sha256": sums[0], "card_sha256": sums[1],
            "device": "cpu", "policy_sha256": None, "effort": None,
        }  # fmt: skip
        assert document["extrapolator"] is None
        assert document["timing_ms"]["interpolate"] > 0 and document["timing_ms"]["warp"] is None
        tail = (4 * KEYS - 2, 4 * KEYS - 1, 4 * KEYS)
        for number in generated(*range(1, KEYS + 1)):
            header, _ = shots.read(out / f"shot.{number:04d}.exr")
            assert header["exwarp:method"] == ("hold" if number in tail else "onnx")
            if number not in tail:
                assert header["exwarp:madeBy"] == "interpolate"
                key = (number - 1) // 4 + 1
                assert header["exwarp:sources"] == f"{key},{key + 1}"

    def test_a_network_that_fades_shows_a_blend_of_what_it_sees(self, interpolate, keys, tmp_path):
        out = interpolate("out", network=put(tmp_path / "fade.onnx", rife(), TIMED))
        before, after = (shots.colour_of(keys / f"shot.000{n}.exr") for n in (1, 2))
        for slot in (1, 2, 3):
            found = shots.colour_of(out / f"shot.000{slot + 1}.exr")
            low, high = np.minimum(before, after), np.maximum(before, after)
            assert (found >= low - 2e-3 * (1 + np.abs(low))).all()
            assert (found <= high + 2e-3 * (1 + np.abs(high))).all()
            nearer = np.abs(found - before).mean() < np.abs(found - after).mean()
            assert slot == 2 or nearer == (slot == 1)

    def test_a_network_without_time_makes_all_slots(self, interpolate, tmp_path):
        out = interpolate("out", network=put(tmp_path / "mid.onnx", untimed(), {}))
        pixels = [shots.colour_of(out / f"shot.{n:04d}.exr") for n in range(1, 6)]
        gaps = [np.abs(b - a).mean() for a, b in pairwise(pixels)]
        assert max(gaps) < 2 * min(gaps)

    def test_after_the_last_key_frame_it_warps_where_there_is_motion(self, interpolate, tmp_path):
        shot = shots.sequence(tmp_path / "moving", numbers=(1, 2), street=SMALL)
        out = interpolate("out", *FORWARD, "--write-holes", tmp_path / "holes", shot=shot)
        methods = [
            shots.read(out / f"shot.{n:04d}.exr")[0]["exwarp:method"] for n in (2, 3, 4, 6, 7, 8)
        ]
        assert methods == ["onnx"] * 3 + ["s6"] * 3
        assert len(shots.names(tmp_path / "holes")) == 6  # by the motion that it does not use


class TestSameBytes:
    def test_any_split_and_any_threads_give_the_whole(self, interpolate):
        whole = interpolate("whole")
        for chunk in ("3", "1-2"):
            parts = interpolate("parts", "--frames", chunk)
        assert shots.contents(parts) == shots.contents(whole)
        assert shots.contents(interpolate("three", "--threads", 3)) == shots.contents(whole)

    def test_an_interrupted_run_goes_on(self, interpolate):
        whole, out = shots.contents(interpolate("whole")), interpolate("out")
        (out / "shot.0003.exr").unlink()
        assert changed_by(lambda: interpolate("out", "--skip-existing"), out) == {3}
        assert shots.contents(out) == whole

    def test_another_network_or_card_counts_and_another_place_does_not(
        self, interpolate, model, tmp_path
    ):
        out, copy = interpolate("out"), tmp_path / "copy.onnx"

        def again() -> set[int]:
            return changed_by(lambda: interpolate("out", "--skip-existing", network=copy), out)

        shutil.copy(model, copy)
        shutil.copy(model.with_suffix(".json"), copy.with_suffix(".json"))
        assert again() == set()
        card = json.loads(copy.with_suffix(".json").read_text())
        copy.with_suffix(".json").write_text(json.dumps(card | {"encoding": "linear"}))
        assert again() == generated(1, 2, 3)
        save(copy, convolution(seed=1, scale=2))
        assert again() == generated(1, 2, 3)


class TestRefusals:
    def refused(
        self, exwarp: Any, keys: Path, tmp_path: Path, code: int, words: Any, *options: Any
    ) -> None:
        out = tmp_path / "out"
        exwarp("upsample", keys, "-o", out, "--progress", "none", *options).refused(code, *words)
        assert not out.exists()

    def test_no_network(self, exwarp, keys, tmp_path):
        words = ("--method onnx", "--interpolator", "softsplat")
        self.refused(exwarp, keys, tmp_path, 2, words, "-m", "onnx")

    @pytest.mark.parametrize("method", ["hold", "s3", "softsplat"])
    def test_a_network_for_another_method(self, exwarp, keys, tmp_path, model, method):
        words = (
            "--interpolator is for",
            f"--method {method}",
            "or use one of exwarp, lookahead, onnx",
        )
        options = ("-m", method, "--interpolator", model)
        self.refused(exwarp, keys, tmp_path, 2, words, *options)

    def test_a_network_that_extrapolates(self, exwarp, keys, tmp_path, model):
        options = ("-m", "onnx", "--interpolator", model, "--extrapolator", model)
        self.refused(exwarp, keys, tmp_path, 2, ("--extrapolator", "--method onnx"), *options)

    def test_a_device_that_is_not_there(self, exwarp, keys, tmp_path, model):
        options = ("-m", "onnx", "--interpolator", model, "--device", "cuda")
        self.refused(exwarp, keys, tmp_path, 7, ("--device cuda", "onnxruntime-gpu"), *options)

    def test_no_card(self, exwarp, keys, tmp_path):
        path = save(tmp_path / "net.onnx", untimed())
        words = ("net.onnx has no card net.json", "models interpolator-card")
        self.refused(exwarp, keys, tmp_path, 3, words, "-m", "onnx", "--interpolator", path)

    def test_a_network_that_does_not_fit_its_card(self, exwarp, keys, tmp_path):
        path = put(tmp_path / "net.onnx", rife(), {})
        words = ("net.onnx has the input 'timestep'", "net.json does not name")
        self.refused(exwarp, keys, tmp_path, 3, words, "-m", "onnx", "--interpolator", path)


class TestCards:
    COMMAND = ("models", "interpolator-card")

    def test_a_begun_card_serves(self, exwarp, interpolate, tmp_path):
        path = save(tmp_path / "net.onnx", rife("plane"))
        result = exwarp(*self.COMMAND, path, "--shape", "rife")
        card = tmp_path / "net.json"
        assert result.code == 0 and result.err == ""
        assert result.out.startswith(f"{card}: look it over, then give {path} to exwarp upsample")
        interpolate("out", "--frames", "1", network=path)
        exwarp(*self.COMMAND, path, "--shape", "rife").refused(6, "net.json exists", "--overwrite")

    def test_refusals(self, exwarp, tmp_path):
        path = save(tmp_path / "net.onnx", first_frame((9, 9, 9)))
        exwarp(*self.COMMAND, path, "--shape", "film").refused(3, "not those of a film export")
        exwarp(*self.COMMAND, path, "--shape", "rife").refused(3, "outside of the range")
        exwarp(*self.COMMAND, tmp_path / "no.onnx", "--shape", "rife").refused(3, "no model")
        exwarp(*self.COMMAND, path, "--shape", "dain").refused(2, "rife", "ema-vfi", "film")
        assert shots.names(tmp_path) == ["net.onnx"]
