"""What 8-bit integers in the convolutions of the shipped networks save, and what they cost.

``python -m tests.bench.eight_bits --out FOLDER``. Each network is quantised (weights by output
channel, activations by the extremes of what it sees on one training shot) and run on the judged
scenes, as far as they are rendered.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnxruntime.quantization import (
    CalibrationDataReader,
    QuantFormat,
    QuantType,
    quantize_static,
)
from onnxruntime.quantization.shape_inference import quant_pre_process

from exwarp_cli import api
from exwarp_cli.io.dataset import RenderedScene, find_scenes
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.session import OnnxNetwork

Feeds = dict[str, np.ndarray]

# Method that runs each network, and the setting that takes its model.
NETWORKS: dict[str, tuple[str, str]] = {
    "lookahead": ("lookahead", "interpolator"),
    "extrapolator": ("s3", "extrapolator"),
}

# Side of the pictures that speed is measured on, pixels.
WIDTH, HEIGHT = 864, 480

RUNS = 5


class Recorded(CalibrationDataReader):  # type: ignore[misc]
    """The inputs that a network was given, one after the other."""

    def __init__(self, feeds: list[Feeds]) -> None:
        self._feeds = iter(feeds)

    def get_next(self) -> Feeds | None:
        return next(self._feeds, None)


def main() -> None:
    parser = argparse.ArgumentParser("tests.bench.eight_bits", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path.home() / ".cache" / "exwarp" / "scenes")
    parser.add_argument("--shot", default="variety-0020", help="What is calibrated on.")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    scenes = find_scenes(options.data, "benchmark", [])
    print("| network | scene | float dB | 8 bits dB | difference |\n|---|---|---:|---:|---:|")
    for name in NETWORKS:
        path = shipped_folder() / f"{name}.onnx"
        small = options.out / f"{name}-8-bits.onnx"
        feeds = record(name, options.data / options.shot / "keys", options.out)
        quantise(path, small, feeds)
        seconds = [speed(each, feeds[0]) for each in (path, small)]
        print(f"| {name} | s for {WIDTH}x{HEIGHT} | {seconds[0]:.2f} | {seconds[1]:.2f} | |")
        for scene in scenes:
            scores = [judge(name, scene, each, options.out) for each in (path, small)]
            gain = scores[1] - scores[0]
            print(
                f"| {name} | {scene.name} | {scores[0]:.2f} | {scores[1]:.2f} | {gain:+.3f} |",
                flush=True,
            )


def record(name: str, keys: Path, out: Path) -> list[Feeds]:
    """Return what a network is given while the first key frames of a shot are upsampled."""
    feeds: list[Feeds] = []
    answer = OnnxNetwork._answer

    def listen(self: OnnxNetwork, output: str, given: Feeds, *more: object) -> object:
        feeds.append({name: planes.copy() for name, planes in given.items()})
        return answer(self, output, given, *more)  # type: ignore[arg-type]

    OnnxNetwork._answer = listen  # type: ignore[method-assign, assignment]
    try:
        method = NETWORKS[name][0]
        api.upsample(_settings(keys, out / "frames", method=method, frames="1-2"))
    finally:
        OnnxNetwork._answer = answer  # type: ignore[method-assign]
    return [each for each in feeds if each["time"].all() and max(map(np.ptp, each.values())) > 0]


def quantise(path: Path, target: Path, feeds: list[Feeds]) -> None:
    """Write a network whose convolutions take and give unsigned 8-bit integers."""
    prepared = target.with_suffix(".prepared.onnx")
    quant_pre_process(path, prepared, skip_symbolic_shape=True)
    quantize_static(
        prepared,
        target,
        Recorded(feeds),
        quant_format=QuantFormat.QOperator,
        op_types_to_quantize=["Conv"],
        per_channel=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
        # Processors without VNNI add two products in 16 bits, which 8-bit weights overflow.
        reduce_range=True,
    )
    model = onnx.load(target)
    onnx.helper.set_model_props(
        model, {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    )
    onnx.save(model, target)


def speed(path: Path, like: Feeds) -> float:
    """Return the seconds of a frame on two threads, the median of `RUNS`."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 2
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    random = np.random.default_rng(0)
    feeds = {
        name: random.random((*planes.shape[:2], HEIGHT, WIDTH), np.float32)
        if planes.ndim == 4
        else planes
        for name, planes in like.items()
    }
    seconds = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        session.run(None, feeds)
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


def judge(name: str, scene: RenderedScene, model: Path, out: Path) -> float:
    """Return the PSNR of a scene's new frames, dB."""
    method, option = NETWORKS[name]
    settings = _settings(
        scene.folder / "keys",
        out / "frames",
        method=method,
        ground_truth=str(scene.folder / "instants"),
        **{option: str(model)},
    )
    return float(api.upsample(settings).document["quality"]["all"]["psnr_db"])


def _settings(keys: Path, out: Path, **more: str) -> api.UpsampleSettings:
    source = api.SourceSettings(str(keys), tail=False)
    return api.UpsampleSettings(source, str(out), overwrite=True, **more)


if __name__ == "__main__":
    main()
