"""Networks, devices and inputs that extrapolation refuses, each in one sentence."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import onnx
import pytest

from tests.cli import shots
from tests.cli.shots import FORWARD, SMALL, VECTORS
from tests.unit.test_model_weights import apart
from tests.unit.tiny_models import filled_warp, save


def as_pipe(path: Path) -> None:
    """Put a pipe that has no writer in a model's place."""
    path.unlink()
    os.mkfifo(path)


def of_opset(version: int) -> onnx.ModelProto:
    made = filled_warp()
    made.opset_import[0].version = version
    return made


EXTRAPOLATING = "causal, s1, s2, s3, s4, s5, oracle, oracle-return"


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> dict[str, tuple[object, ...]]:
    """Arguments that name two key frames, by setting."""
    root = tmp_path_factory.mktemp("shot")
    keys = shots.sequence(root / "keys", shots.plain, (1, 2), SMALL)
    colour = shots.sequence(root / "colour", shots.colour_only, (1, 2), SMALL)
    slots = shots.sequence(root / "slots", shots.slot_gbuffer, range(1, 6), SMALL, step=0.25)
    return {"key": (keys, *FORWARD), "slot": (colour, "--gbuffers", slots, *VECTORS)}


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
            (lambda path: as_pipe(path), ("cannot read the model", "a pipe or a device")),
            (
                lambda path: save(path, apart(filled_warp(), "/etc/hostname")),
                ("'/etc/hostname'", "only files in the folder of a model are read"),
            ),
            (
                lambda path: save(path, apart(filled_warp(), "lost.bin")),
                ("lost.bin", "copy that file along"),
            ),
            (lambda path: save(path, of_opset(999)), ("Opset 999", "export it again")),
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

    @pytest.mark.parametrize(
        ("options", "others", "able"),
        [
            (("--extrapolator", "x.onnx"), ("s6", "lookahead"), f"use one of {EXTRAPOLATING}"),
            (
                ("--device", "cuda"),
                ("s6", "softsplat"),
                f"use one of exwarp, {EXTRAPOLATING}, lookahead, onnx",
            ),
        ],
    )
    def test_options_of_a_network_for_a_method_without(
        self, exwarp, shot, tmp_path, options, others, able
    ):
        for method in others:
            words = options[0], f"--method {method}", able
            self.refused(exwarp, shot, tmp_path, 2, words, "-m", method, *options)

    def test_another_device(self, exwarp, shot, tmp_path, network):
        self.refused(exwarp, shot, tmp_path, 2, ("--device", "cpu"), "-m", "s3", "--device", "tpu")

    def test_no_motion(self, exwarp, tmp_path, network):
        keys = shots.sequence(tmp_path / "keys", shots.colour_only, street=SMALL)
        options = ("-m", "s3", "--extrapolator", network, "--progress", "none")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        result.refused(3, "no motion vectors", "softsplat, for which it is estimated")

    @pytest.mark.parametrize("method", ["s3", "s6", "softsplat"])
    def test_slot_g_buffers_that_lead_only_forward(self, exwarp, shot, tmp_path, network, method):
        colour, option, slots, *_ = shot["slot"]
        model = ("--extrapolator", network) if method == "s3" else ()
        options = ("-m", method, *model, "--motion", "next=-Z,W", "--progress", "none")
        result = exwarp("upsample", colour, "-o", tmp_path / "out", option, slots, *options)
        result.refused(3, "--gbuffers", "previous slot")
        assert not (tmp_path / "out").exists()
