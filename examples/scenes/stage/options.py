"""The command line that all scene scripts share."""

from __future__ import annotations

import argparse
from pathlib import Path

from stage.manifest import default_data
from stage.shooting import KINDS, Order, Script, shoot

RESOLUTIONS = {
    "240p": (427, 240),
    "480p": (854, 480),
    "720p": (1280, 720),
    "1080p": (1920, 1080),
}
LOOKS = ("clean", "hurried")


def main(script: Script) -> None:
    """Read the command line of one scene's script and render."""
    parser = argparse.ArgumentParser(
        description=f"Render the scene {script.name}: {script.about} Frames that exist are kept.",
    )
    options(parser)
    shoot(script, order(parser.parse_args()))


def options(parser: argparse.ArgumentParser, resolution: str = "240p") -> None:
    """Add the options that all scripts share; `resolution` is the usual one."""
    add = parser.add_argument
    add("--data", type=Path, default=default_data(), help="folder of all scenes (%(default)s)")
    add(
        "--resolution",
        type=size,
        default=size(resolution),
        help=f"{', '.join(RESOLUTIONS)} or WIDTHxHEIGHT ({resolution})",
    )
    add(
        "--look",
        choices=LOOKS,
        default=LOOKS[0],
        help="how a scene to be judged on is rendered: with hardly any noise, or as a hurried "
        "artist delivers it, into the folder 'hurried' (%(default)s)",
    )
    add("--samples", type=count, metavar="N", help="per pixel of each render (the look's)")
    add("--renders", type=count, metavar="N", help="whose mean a frame is (the look's)")
    add("--frames", type=ranges, default=frozenset(), help="instants, as in 1-49,97 (all)")
    add("--gpu", action="store_true", help="Cycles renders on NVIDIA cards, with CUDA")
    add("--what", choices=(*KINDS, "all"), default="all")
    add(
        "--key-step",
        type=count,
        metavar="N",
        help="every Nth instant is rendered as a key frame too (4; 1 for training shots)",
    )


def order(chosen: argparse.Namespace) -> Order:
    """Turn options into an order."""
    what = KINDS if chosen.what == "all" else (chosen.what,)
    return Order(
        chosen.data.expanduser().resolve(),
        chosen.resolution,
        samples=chosen.samples,
        seeds=chosen.renders,
        hurried=chosen.look == "hurried",
        frames=chosen.frames,
        what=frozenset(what),
        on_gpu=chosen.gpu,
        key_step=chosen.key_step,
    )


def size(text: str) -> tuple[int, int]:
    """Read a resolution: a name, or as in 320x180."""
    if text in RESOLUTIONS:
        return RESOLUTIONS[text]
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) > 0 and int(height) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is no resolution; write it as 320x180")
    return int(width), int(height)


def count(text: str) -> int:
    """Read a whole number from 1 on."""
    if not (text.isdigit() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 on")
    return int(text)


def ranges(text: str) -> frozenset[int]:
    """Read frame numbers such as 1-49,97 or 1-241x24."""
    found: set[int] = set()
    for part in text.split(","):
        span, _, step = part.partition("x")
        first, dash, last = span.partition("-")
        numbers = [first, last if dash else first, step or "1"]
        if not all(number.isdigit() and int(number) > 0 for number in numbers):
            raise argparse.ArgumentTypeError(f"{part!r} is no range of frames; write it as 1-49")
        found.update(range(int(numbers[0]), int(numbers[1]) + 1, int(numbers[2])))
    return frozenset(found)
