"""Time and memory of both shipped networks alone, by the size of the frame.

``python -m tests.bench.networks [--threads 2]``. A process a figure: peaks add up in one. Inputs
are noise, made tile by tile as a run makes them, which is in the time.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import (
    EXTRAPOLATOR_INTERFACE,
    LOOKAHEAD_INTERFACE,
    NetworkInterface,
    NetworkPictures,
)
from exwarp_cli.models.picture_network import (
    PictureNetwork,
    load_extrapolator,
    load_lookahead,
)

NETWORKS: dict[str, tuple[Callable[..., PictureNetwork], NetworkInterface]] = {
    "lookahead": (load_lookahead, LOOKAHEAD_INTERFACE),
    "extrapolator": (load_extrapolator, EXTRAPOLATOR_INTERFACE),
}

SIZES = ((854, 480), (1920, 1080), (3840, 2160))


@dataclass(frozen=True)
class Noise:
    """Inputs of a frame that are drawn part by part; see `LazyInputs`."""

    shape: tuple[int, int]
    interface: NetworkInterface

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkPictures:
        size = (rows.stop - rows.start, columns.stop - columns.start)
        if room is None:
            room = np.empty((self.interface.channels, *size), np.float32)
        np.random.default_rng(0).random(out=room, dtype=np.float32)
        return NetworkPictures(self.interface.split(room), 0.5)


def measure(name: str, width: int, height: int, threads: int) -> None:
    """Print the seconds of a frame, and by how many MB the peak rose meanwhile."""
    load, interface = NETWORKS[name]
    network = load(None, threads, "cpu")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.perf_counter()
    for _ in network.answers(Noise((height, width), interface)):
        pass
    spent = time.perf_counter() - begin
    more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print(f"| {name} | {width}x{height} | {spent:.2f} | {more / 1024:.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser("tests.bench.networks", description=__doc__)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", nargs=3, metavar=("NETWORK", "WIDTH", "HEIGHT"))
    options = parser.parse_args()
    if options.only:
        name, width, height = options.only
        measure(name, int(width), int(height), options.threads)
        return
    print("| network | size | s a frame | MB |\n|---|---|---:|---:|", flush=True)
    for name in NETWORKS:
        for width, height in SIZES:
            more = ["--threads", options.threads, "--only", name, width, height]
            command = [sys.executable, "-m", "tests.bench.networks", *map(str, more)]
            subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
