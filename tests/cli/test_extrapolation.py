"""The paper's paths S1 to S5 on files: frames, report, history, chunks, resuming, bad networks."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exwarp_cli.io.channels import Role
from exwarp_cli.pipeline import loading
from tests.cli import shots
from tests.cli.street import Street
from tests.unit.tiny_models import convolution, filled_warp, save

SMALL = Street(48, 27)
FORWARD = ("--motion", "next=u,-v")
VECTORS = ("--motion", "previous=X,-Y next=-Z,W")
SETTINGS = ("key", "slot")
KEYS = 5

D, G = "dropped", "generated"
PATHS = {
    "s1": ((D, G, D), "FEE", 60), "s2": ((D, G, G), "FEE", 90), "s3": ((G, G, G), "FEE", 120),
    "s4": ((G, G, G), "FEE", 120), "s5": ((G, G, G), "FFE", 120),
}  # fmt: skip
"""Kinds of slots 1 to 3; whether F alone or the network is behind each; effective fps."""


@pytest.fixture(scope="module")
def network(tmp_path_factory) -> Path:
    """An ONNX file, read only."""
    return save(tmp_path_factory.mktemp("network") / "tiny.onnx", convolution())


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> dict[str, tuple[object, ...]]:
    """Arguments that name the input, by setting: five key frames, and slots up to the last."""
    root = tmp_path_factory.mktemp("shot")
    keys = shots.sequence(root / "keys", shots.plain, range(1, KEYS + 1), SMALL)
    colour = shots.sequence(root / "colour", shots.colour_only, range(1, KEYS + 1), SMALL)
    slots = shots.sequence(
        root / "slots", shots.slot_gbuffer, range(1, 4 * KEYS - 2), SMALL, step=0.25
    )
    return {"key": (keys, *FORWARD), "slot": (colour, "--gbuffers", slots, *VECTORS)}


@pytest.fixture
def make(upsample, shot, network, tmp_path) -> Callable[..., Path]:
    """Run a method on the shot into a folder of its own; return the folder."""

    def run(name: str, method: str, *options: object, setting: str = "key", **more: Any) -> Path:
        keys, *rest = more.get("shot", shot[setting])
        out = tmp_path / name
        model = ("--extrapolator", more.get("network", network))
        upsample(keys, out, "-m", method, *rest, *model, *options)
        return out

    return run


def rows(report: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((report / "frames.csv").read_text().splitlines()))


def load(report: Path) -> dict[str, Any]:
    return json.loads((report / "report.json").read_text())


def changed_by(run: Callable[[], object], folder: Path) -> set[int]:
    """Numbers of the frames that were written anew."""
    before = {name: (folder / name).stat().st_mtime_ns for name in shots.names(folder)}
    run()
    now = {name: (folder / name).stat().st_mtime_ns for name in shots.names(folder)}
    return {int(name.split(".")[1]) for name, time in now.items() if before.get(name) != time}


def generated(*keys: int) -> set[int]:
    """Numbers of slots 1 to 3 of these key frames."""
    return {4 * (key - 1) + 1 + i for key in keys for i in (1, 2, 3)}


class TestFrames:
    @pytest.mark.parametrize("setting", SETTINGS)
    @pytest.mark.parametrize("method", PATHS)
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
        upsample(keys, tmp_path / "s6", "-m", "s6", *rest)
        for method, slots in (("s3", (1,)), ("s4", (1,)), ("s5", (1, 2))):
            out = make(method, method)
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
        out = make("out", "s3", setting=setting, network=plain)
        for order in (9, 10, 11):
            true = SMALL.colour(order / 4)
            assert shots.psnr(true, shots.colour_of(out / f"shot.{order + 1:04d}.exr")) > 27

    def test_a_network_that_brightens_shows_where_it_is_used(self, make, tmp_path):
        bright = save(tmp_path / "bright.onnx", filled_warp(gain=2))
        plain = save(tmp_path / "plain.onnx", filled_warp())
        pairs = [make(m.stem, "s4", network=m) for m in (bright, plain)]
        for order, brighter in ((9, False), (10, True), (11, True)):
            a, b = (shots.colour_of(out / f"shot.{order + 1:04d}.exr")[..., :3] for out in pairs)
            assert np.array_equal(a, b) is not brighter
            if brighter:  # the shot is brighter than 0.1 nearly everywhere
                assert np.median(a / b) > 1.8


class TestReport:
    def test_numbers(self, make, tmp_path, network):
        truth = shots.truth(tmp_path / "truth", KEYS, street=SMALL)
        reports = {}
        for method in ("s1", "s4"):
            report = tmp_path / f"{method}-report"
            make(method, method, "--report", report, "--ground-truth", truth)
            reports[method] = load(report)
        s1, s4 = reports["s1"], reports["s4"]
        told = {
            "file": str(network),
            "sha256": hashlib.sha256(network.read_bytes()).hexdigest(),
            "device": "cpu",
        }
        assert s1["extrapolator"] == s4["extrapolator"] == told
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
        upsample(keys, tmp_path / "out", "-m", "s6", *rest, "--report", tmp_path / "report")
        assert load(tmp_path / "report")["extrapolator"] is None

    def test_the_network_is_announced(self, exwarp, shot, network, tmp_path):
        keys, *rest = shot["key"]
        options = ("-m", "s5", *rest, "--extrapolator", network, "--progress", "none")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        digits = hashlib.sha256(network.read_bytes()).hexdigest()[:8]
        assert f"exwarp: extrapolation by tiny.onnx (sha256 {digits}) on cpu\n" in result.err
        assert all(line.startswith("exwarp: ") for line in result.err.splitlines())


class TestHistory:
    def test_the_first_key_frame_has_none(self, make, shot, tmp_path):
        """Alone in its sequence it gives the same frames: no other is looked at."""
        keys, *rest = shot["key"]
        alone = tmp_path / "alone"
        alone.mkdir()
        shutil.copy(keys / "shot.0001.exr", alone)
        one = make("one", "s3", shot=(alone, *rest))
        assert shots.contents(one).items() <= shots.contents(make("all", "s3")).items()
        assert len(shots.names(one)) == 4

    def test_nothing_comes_from_the_future(self, make, shot, tmp_path):
        keys, *rest = shot["key"]
        some = tmp_path / "some"
        some.mkdir()
        for number in (1, 2, 3):
            shutil.copy(keys / f"shot.{number:04d}.exr", some)
        three = make("three", "s3", shot=(some, *rest))
        assert shots.contents(three).items() <= shots.contents(make("all", "s3")).items()

    @pytest.mark.parametrize(("setting", "each"), [("key", 1), ("slot", 2)])
    def test_every_file_is_read_once(self, make, monkeypatch, setting, each):
        seen: Counter[Path] = Counter()
        true = loading.read_raw

        def read_raw(given: Any, number: int, *rest: Any) -> Any:
            seen[given.sequence.files[number]] += 1
            return true(given, number, *rest)

        monkeypatch.setattr(loading, "read_raw", read_raw)
        make("out", "s3", setting=setting)
        assert set(seen.values()) == {1}
        slots = 4 * KEYS - 3 if setting == "slot" else 0
        assert len(seen) == KEYS + slots

    def test_methods_that_do_not_extrapolate_read_what_they_always_did(
        self, upsample, monkeypatch, tmp_path
    ):
        asked: set[tuple[Role, ...]] = set()
        true = loading.read_raw

        def read_raw(given: Any, number: int, roles: tuple[Role, ...]) -> Any:
            asked.add(roles)
            return true(given, number, roles)

        monkeypatch.setattr(loading, "read_raw", read_raw)
        keys = shots.sequence(tmp_path / "keys", shots.blender4, (1, 2), SMALL)
        upsample(keys, tmp_path / "out", "-m", "s6", *VECTORS)
        geometry = (Role.DEPTH, Role.POSITION, Role.STENCIL, Role.MOTION)
        assert asked == {(Role.COLOUR, *geometry)}


class TestSameBytes:
    @pytest.mark.parametrize("setting", SETTINGS)
    def test_any_split_gives_the_whole(self, make, tmp_path, setting):
        masks = ("--write-holes", tmp_path / "masks")
        whole = make("whole", "s3", *masks, setting=setting)
        for chunk in ("4-5", "1", "2-3"):
            options = ("--write-holes", tmp_path / "part-masks", "--frames", chunk)
            parts = make("parts", "s3", *options, setting=setting)
        assert len(shots.names(whole)) == 4 * KEYS
        assert shots.contents(parts) == shots.contents(whole)
        assert shots.contents(tmp_path / "part-masks") == shots.contents(tmp_path / "masks")

    def test_windows_that_change_too(self, make, tmp_path):
        def frame(path: Path, street: Street, time: float) -> None:
            x, y = 2 * int(time) % 5, int(time) % 3
            planes = {k: v[y:25, x:44].copy() for k, v in shots.plain_planes(street, time).items()}
            place = shots.window(x - 4, y - 2, 44 - x, 25 - y)
            head = shots.header(dataWindow=place, displayWindow=shots.window(0, 0, 36, 20))
            shots.write(path, {"": planes}, head)

        keys = shots.sequence(tmp_path / "keys", frame, range(1, 6), SMALL)
        whole = make("whole", "s3", shot=(keys, *FORWARD))
        for chunk in ("3-5", "2", "1"):
            parts = make("parts", "s3", "--frames", chunk, shot=(keys, *FORWARD))
        assert shots.contents(parts) == shots.contents(whole)

    @pytest.mark.parametrize("channels", [18, 24])
    def test_threads_change_nothing(self, make, tmp_path, channels):
        network = save(tmp_path / "n.onnx", convolution(channels, scale=2, exwarp__stride="2"))
        made = [make(str(n), "s3", "--threads", n, network=network) for n in (1, 2, 5)]
        assert shots.contents(made[0]) == shots.contents(made[1]) == shots.contents(made[2])

    @pytest.mark.parametrize("setting", SETTINGS)
    @pytest.mark.parametrize("method", ["s1", "s2", "s3"])
    def test_an_interrupted_run_goes_on(self, make, method, setting):
        whole = shots.contents(make("whole", method, setting=setting))
        out = make("out", method, setting=setting)
        for number in (3, 8, 9, 12, 14, 15, 16):
            (out / f"shot.{number:04d}.exr").unlink()
        (out / "shot.0010.exr").write_bytes(whole["shot.0010.exr"][:900])

        def resume() -> None:
            make("out", method, "--skip-existing", setting=setting)

        assert changed_by(resume, out) == {3, 8, 9, 10, 12, 14, 15, 16}
        assert shots.contents(out) == whole
        assert changed_by(resume, out) == set()

    def test_another_network_counts(self, make, tmp_path):
        out = make("out", "s3")
        other = save(tmp_path / "other.onnx", convolution(seed=1))
        again = changed_by(lambda: make("out", "s3", "--skip-existing", network=other), out)
        assert again == generated(1, 2, 3, 4, 5)
        assert shots.contents(out) == shots.contents(make("fresh", "s3", network=other))

    def test_the_same_network_under_another_name_does_not(self, make, network, tmp_path):
        out = make("out", "s3")
        copy = Path(shutil.copy(network, tmp_path / "copy.onnx"))
        assert changed_by(lambda: make("out", "s3", "--skip-existing", network=copy), out) == set()

    def test_a_changed_key_frame_counts_where_it_is_history(self, make, shot, tmp_path):
        keys, *rest = shot["key"]
        keys = Path(shutil.copytree(keys, tmp_path / "keys"))
        out = make("out", "s3", shot=(keys, *rest))
        shots.plain(keys / "shot.0002.exr", SMALL, 1.1)
        again = changed_by(lambda: make("out", "s3", "--skip-existing", shot=(keys, *rest)), out)
        assert again == {5} | generated(2, 3, 4)

    def test_so_does_a_g_buffer_on_the_way_to_it(self, make, shot, tmp_path):
        colour, option, slots, *rest = shot["slot"]
        slots = Path(shutil.copytree(slots, tmp_path / "slots"))
        given = (colour, option, slots, *rest)
        out = make("out", "s3", shot=given)
        shots.slot_gbuffer(slots / "shot.0006.exr", SMALL, 1.3)  # slot 1 of key frame 2
        again = changed_by(lambda: make("out", "s3", "--skip-existing", shot=given), out)
        assert again == generated(2, 3, 4)


class TestRefusals:
    def refused(
        self,
        exwarp: Any,
        shot: Any,
        tmp_path: Path,
        code: int,
        words: tuple[str, ...],
        *options: Any,
    ) -> None:
        keys, *rest = shot["key"]
        out = tmp_path / "out"
        given = ("--progress", "none", *rest, *options)
        exwarp("upsample", keys, "-o", out, *given).refused(code, *words)
        assert not out.exists()

    @pytest.mark.parametrize(
        ("spoil", "words"),
        [
            (lambda path: path.unlink(), ("there is no model", "check the path")),
            (lambda path: path.write_bytes(b"text" * 99), ("no ONNX model", "export it again")),
            (lambda path: save(path, filled_warp(exwarp__stride="no")), ("exwarp.stride",)),
            (lambda path: save(path, filled_warp(exwarp__interface="x/2")), ("x/2", "interface")),
        ],
    )
    def test_a_bad_network(self, exwarp, shot, tmp_path, spoil, words):
        path = save(tmp_path / "bad.onnx", filled_warp())
        spoil(path)
        options = ("-m", "s3", "--extrapolator", path)
        self.refused(exwarp, shot, tmp_path, 3, ("bad.onnx", *words), *options)

    def test_cuda_that_is_not_there(self, exwarp, shot, tmp_path, network):
        options = ("-m", "s3", "--extrapolator", network, "--device", "cuda")
        self.refused(exwarp, shot, tmp_path, 7, ("--device cuda", "onnxruntime-gpu"), *options)

    @pytest.mark.parametrize("options", [("--extrapolator", "x.onnx"), ("--device", "cuda")])
    def test_options_of_a_network_for_a_method_without(self, exwarp, shot, tmp_path, options):
        words = (options[0], "--method s6", "s1, s2, s3, s4, s5")
        self.refused(exwarp, shot, tmp_path, 2, words, "-m", "s6", *options)

    def test_another_device(self, exwarp, shot, tmp_path, network):
        self.refused(exwarp, shot, tmp_path, 2, ("--device", "cpu"), "-m", "s3", "--device", "tpu")

    def test_no_motion(self, exwarp, tmp_path, network):
        keys = shots.sequence(tmp_path / "keys", shots.colour_only, street=SMALL)
        options = ("-m", "s3", "--extrapolator", network, "--progress", "none")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        result.refused(3, "no motion vectors", "hold or blend")

    @pytest.mark.parametrize("method", ["s3", "s6", "softsplat", "hold"])
    def test_slot_g_buffers_that_lead_only_forward(self, exwarp, shot, tmp_path, network, method):
        colour, option, slots, *_ = shot["slot"]
        model = ("--extrapolator", network) if method == "s3" else ()
        options = ("-m", method, *model, "--motion", "next=-Z,W", "--progress", "none")
        result = exwarp("upsample", colour, "-o", tmp_path / "out", option, slots, *options)
        result.refused(3, "--gbuffers", "previous slot")
        assert not (tmp_path / "out").exists()


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
