"""The paper's paths S1 to S5 on files: frames, report, and what is read."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exwarp_cli.io.channels import Role
from exwarp_cli.pipeline import key_frames, motion_convention
from tests.blender_layers import Planes, layer
from tests.cli import shots
from tests.cli.shots import FORWARD, KEYS, SMALL, VECTORS
from tests.cli.street import Street
from tests.matrix import combinations
from tests.unit.tiny_models import blur, filled_warp, save

pytestmark = pytest.mark.usefixtures("unpainted_plots")

SETTINGS = ("key", "slot")

D, G = "dropped", "generated"
PATHS = {
    "s1": ((D, G, D), "FEE", 60), "s2": ((D, G, G), "FEE", 90), "s3": ((G, G, G), "FEE", 120),
    "s4": ((G, G, G), "FEE", 120), "s5": ((G, G, G), "FFE", 120),
}  # fmt: skip
"""Kinds of slots 1 to 3; whether F alone or the network is behind each; effective fps."""


def rows(report: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((report / "frames.csv").read_text().splitlines()))


def load(report: Path) -> dict[str, Any]:
    return json.loads((report / "report.json").read_text())


class TestFrames:
    @pytest.mark.parametrize(("method", "setting"), combinations(tuple(PATHS), SETTINGS))
    def test_every_path(self, make, tmp_path, method, setting):
        report = tmp_path / "report"
        out = make("out", method, "--report", report, setting=setting)
        kinds, behind, fps = PATHS[method]
        table = rows(report)
        assert [row["file"] for row in table] == shots.names(out)
        assert len(table) == 4 * KEYS
        for key in range(1, KEYS + 1):
            slots = table[4 * key - 3 : 4 * key]
            assert tuple(row["kind"] for row in slots) == kinds
            history = " ".join(str(n) for n in range(max(1, key - 2), key + 1))
            expected = [history if source == "E" else str(key) for source in behind]
            if kinds[0] == D:
                expected[0] = str(key)
            assert [row["sources"] for row in slots] == expected
            assert {row["method"] for row in slots} == {method}
        pixels = [shots.colour_of(out / row["file"]) for row in table]
        for before, frame, row in zip(pixels, pixels[1:], table[1:], strict=False):
            assert np.isfinite(frame).all()
            if row["kind"] == D:
                np.testing.assert_array_equal(frame, before)
            else:
                assert not np.array_equal(frame, before)
        for row in table:
            header, _ = shots.read(out / row["file"])
            if row["kind"] != "key":
                assert header["exwarp:kind"] == row["kind"]
                assert header["exwarp:method"] == method
                assert header["exwarp:sources"] == row["sources"].replace(" ", ",")
        document = load(report)
        dropped = kinds.count(D) * KEYS
        assert document["frames"]["dropped"] == dropped
        assert document["frames"]["generated"] == 3 * KEYS - dropped
        assert document["fps"]["effective"] == fps
        assert document["setting"] == setting and document["lookahead"] is False
        assert document["decisions"]["paths"] == {
            f"S{i}": KEYS * (f"s{i}" == method) for i in range(1, 7)
        }

    def test_warped_frames_are_those_of_s6(self, make, shot, upsample, tmp_path):
        keys, *rest = shot["key"]
        upsample(keys, tmp_path / "s6", "-m", "s6", *rest, "--frames", 3)
        for method, slots in (("s3", (1,)), ("s4", (1,)), ("s5", (1, 2))):
            out = make(method, method, "--frames", 3)
            for i in slots:
                name = f"shot.{9 + i:04d}.exr"
                np.testing.assert_array_equal(
                    shots.colour_of(out / name), shots.colour_of(tmp_path / "s6" / name)
                )

    @pytest.mark.parametrize("setting", SETTINGS)
    def test_with_a_network_that_changes_nothing_they_look_like_the_truth(
        self, make, tmp_path, setting
    ):
        plain = save(tmp_path / "plain.onnx", filled_warp())
        out = make("out", "s3", "--frames", 3, setting=setting, network=plain)
        for order in (9, 10, 11):
            true = SMALL.colour(order / 4)
            assert shots.psnr(true, shots.colour_of(out / f"shot.{order + 1:04d}.exr")) > 27

    def test_a_network_that_brightens_shows_where_it_is_used(self, make, tmp_path):
        bright = save(tmp_path / "bright.onnx", filled_warp(gain=2))
        plain = save(tmp_path / "plain.onnx", filled_warp())
        pairs = [make(m.stem, "s4", "--frames", 3, network=m) for m in (bright, plain)]
        for order, brighter in ((9, False), (10, True), (11, True)):
            a, b = (shots.colour_of(out / f"shot.{order + 1:04d}.exr")[..., :3] for out in pairs)
            assert np.array_equal(a, b) is not brighter
            if brighter:  # as bright as what lies beside it in the key frame
                assert np.median(a / b) > 1.2


class TestElement:
    """An object rendered alone, on nothing."""

    @pytest.mark.parametrize("setting", SETTINGS)
    def test_a_network_that_spreads_colour_leaves_what_is_empty_empty(
        self, make, upsample, tmp_path, setting
    ):
        keys, *rest = element(tmp_path, setting)
        blurred = save(tmp_path / "blur.onnx", blur())
        out = make("out", "s3", "--frames", "2-3", shot=(keys, *rest), network=blurred)
        upsample(keys, tmp_path / "s6", "-m", "s6", *rest, "--frames", "2-3")
        for order in range(5, 13):
            name = f"shot.{order:04d}.exr"
            made, warped = (shots.read(folder / name) for folder in (out, tmp_path / "s6"))
            (left, top), (right, bottom) = (np.asarray(c) for c in made[0]["dataWindow"])
            (x, y), (to_x, to_y) = (np.asarray(c) for c in warped[0]["dataWindow"])
            assert x <= left and y <= top and right <= to_x and bottom <= to_y
            clear = made[1]["A"] == 0
            if order % 4 in (2, 3, 0) and clear.any():
                assert (shots.colour_of(out / name)[clear] == 0).all()


def element(folder: Path, setting: str) -> tuple[object, ...]:
    """Arguments for the moving box alone: no colour around it, and data windows that fit it."""

    def alone(planes_of: Callable[[Street, float], Planes]) -> shots.FrameWriter:
        def frame(path: Path, street: Street, time: float) -> None:
            inside = street.geometry(time)["id"] == 1
            planes = planes_of(street, time)
            for letter in "RGBA":
                if letter in planes:
                    planes[letter] = np.where(inside, planes[letter], 0).astype(np.float16)
            rows, columns = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
            place = shots.window(
                columns[0], rows[0], columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1
            )
            display = shots.window(0, 0, street.width, street.height)
            cut = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            head = shots.header(dataWindow=place, displayWindow=display)
            shots.write(path, {"": {name: v[cut].copy() for name, v in planes.items()}}, head)

        return frame

    keys = folder / "keys"
    if setting == "key":
        return (
            shots.sequence(keys, alone(shots.plain_planes), range(1, KEYS + 1), SMALL),
            *FORWARD,
        )
    shots.sequence(keys, alone(shots.colour_planes), range(1, KEYS + 1), SMALL)
    slots = shots.sequence(
        folder / "slots", alone(shots.slot_planes), range(1, 4 * KEYS - 2), SMALL, 0.25
    )
    return (keys, "--gbuffers", slots, *VECTORS)


class TestReport:
    def test_numbers(self, make, tmp_path, network):
        truth = shots.truth(tmp_path / "truth", KEYS, street=SMALL)
        reports = {}
        for method in ("s1", "s4"):
            report = tmp_path / f"{method}-report"
            make(method, method, "--report", report, "--ground-truth", truth)
            reports[method] = load(report)
        s1, s4 = reports["s1"], reports["s4"]
        expected = {
            "file": str(network),
            "sha256": hashlib.sha256(network.read_bytes()).hexdigest(),
            "device": "cpu",
            "demodulated": False,
        }
        assert s1["extrapolator"] == s4["extrapolator"] == expected
        scored = KEYS - 1
        by = s4["quality"]["by_decision"]
        assert (by["warp"]["frames"], by["extrapolate"]["frames"]) == (2 * scored, scored)
        assert s4["quality"]["dropped"]["frames"] == 0
        by = s1["quality"]["by_decision"]
        assert (by["warp"]["frames"], by["extrapolate"]["frames"]) == (0, scored)
        assert s1["quality"]["dropped"]["frames"] == 2 * scored
        assert s1["quality"]["all"]["frames"] == 3 * scored
        assert (
            s1["quality"]["dropped"]["psnr_db"]
            < s1["quality"]["by_decision"]["extrapolate"]["psnr_db"]
        )
        assert s1["decisions"]["nodes"]["d1"] == {"warp": 0, "extrapolate": KEYS}
        assert s1["timing_ms"]["warp"] is None and s1["timing_ms"]["hold"] >= 0
        assert s1["timing_ms"]["extrapolate"] > s1["timing_ms"]["hold"]
        assert s4["timing_ms"]["warp"] > 0 and s4["timing_ms"]["extrapolate"] > 0

    def test_without_a_network_there_is_none(self, shot, upsample, tmp_path):
        keys, *rest = shot["key"]
        options = ("--frames", 1, "--report", tmp_path / "report")
        upsample(keys, tmp_path / "out", "-m", "s6", *rest, *options)
        assert load(tmp_path / "report")["extrapolator"] is None

    def test_the_network_is_announced(self, exwarp, shot, network, tmp_path):
        keys, *rest = shot["key"]
        options = ("-m", "s5", "--frames", 1, *rest, "--extrapolator", network)
        options += ("--progress", "none")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        digits = hashlib.sha256(network.read_bytes()).hexdigest()[:8]
        assert f"exwarp: extrapolation by tiny.onnx (sha256 {digits}) on cpu\n" in result.err
        assert all(line.startswith("exwarp: ") for line in result.err.splitlines())

    @pytest.mark.parametrize(
        ("found", "setting"),
        combinations(
            (
                (("Diffuse Color", "Glossy Color"), None),
                (("Diffuse Color",), "no glossy colour"),
                (("Glossy Color",), "no diffuse colour"),
                ((), "no diffuse and no glossy colour"),
            ),
            SETTINGS,
        ),
    )
    def test_whether_surface_colour_is_divided_out_is_reported(
        self, exwarp, network, tmp_path, setting, found
    ):
        passes, missing = found

        def with_passes(planes_of: Callable[[Street, float], Planes]) -> shots.FrameWriter:
            def frame(path: Path, street: Street, time: float) -> None:
                planes = planes_of(street, time)
                for name in passes:
                    planes |= layer(name, "RGB", street.colour(time)[..., :3])
                shots.write(path, {"": planes})

            return frame

        first = with_passes(shots.plain_planes) if setting == "key" else shots.colour_only
        keys = shots.sequence(tmp_path / "keys", first, (1, 2), SMALL)
        rest: tuple[object, ...] = FORWARD
        if setting == "slot":
            writer = with_passes(shots.slot_planes)
            slots = shots.sequence(tmp_path / "slots", writer, range(1, 6), SMALL, 0.25)
            rest = ("--gbuffers", slots, *VECTORS)
        options = ("-m", "s3", *rest, "--extrapolator", network, "--report", tmp_path / "report")
        options += ("--threads", 1, "--progress", "none", "--frames", "1")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        assert result.code == 0, result.err
        assert load(tmp_path / "report")["extrapolator"]["demodulated"] is (missing is None)
        sentence = f"exwarp: {missing}: shading is extrapolated together with surface colour\n"
        assert (sentence in result.err) == (missing is not None)
        assert ("surface colour" in result.err) == (missing is not None)


class TestHistory:
    def test_the_first_key_frame_has_none(self, make, shot, tmp_path):
        """Alone in its sequence it gives the same frames: no other is looked at."""
        keys, *rest = shot["key"]
        alone = tmp_path / "alone"
        alone.mkdir()
        shutil.copy(keys / "shot.0001.exr", alone)
        one = make("one", "s3", shot=(alone, *rest))
        shots.require_part(one, make("all", "s3", "--frames", 1), 4)

    def test_nothing_comes_from_the_future(self, make, shot, tmp_path):
        keys, *rest = shot["key"]
        some = tmp_path / "some"
        some.mkdir()
        for number in (1, 2, 3):
            shutil.copy(keys / f"shot.{number:04d}.exr", some)
        three = make("three", "s3", shot=(some, *rest))
        shots.require_part(three, make("whole", "s3", "--frames", "1-3"), 12)

    @pytest.mark.parametrize(("setting", "each"), [("key", 1), ("slot", 2)])
    def test_every_file_is_read_once(self, make, monkeypatch, setting, each):
        """By the run, beside the frames that vectors are measured by."""
        by_run, by_measuring = (
            shots.reads_of(monkeypatch, module) for module in (key_frames, motion_convention)
        )
        make("out", "s3", setting=setting)
        assert set(by_run.values()) == {1}
        slots = 4 * KEYS - 3 if setting == "slot" else 0
        assert len({*by_run, *by_measuring}) == KEYS + slots

    def test_methods_that_do_not_extrapolate_read_what_they_always_did(
        self, upsample, monkeypatch, tmp_path
    ):
        asked: set[tuple[Role, ...]] = set()
        true = key_frames.read_raw

        def read_raw(given: Any, number: int, roles: tuple[Role, ...], **more: Any) -> Any:
            asked.add(roles)
            return true(given, number, roles, **more)

        monkeypatch.setattr(key_frames, "read_raw", read_raw)
        keys = shots.sequence(tmp_path / "keys", shots.blender4, (1, 2), SMALL)
        upsample(keys, tmp_path / "out", "-m", "s6", *VECTORS)
        geometry = (Role.DEPTH, Role.POSITION, Role.STENCIL, Role.MOTION)
        assert asked == {(Role.COLOUR, *geometry)}


def test_methods_without_a_network_do_not_import_onnxruntime(shot, tmp_path):
    keys, *rest = shot["key"]
    code = (
        "import sys; from exwarp_cli import cli; assert cli.run(sys.argv[1:]) == 0; "
        "assert 'numba' in sys.modules; print('onnxruntime' in sys.modules)"
    )
    options = ["-m", "s6", *map(str, rest), "--progress", "none", "--frames", "1"]
    command = [sys.executable, "-c", code, "upsample", str(keys), "-o", str(tmp_path), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
    assert done.stdout.splitlines()[-1] == "False"
