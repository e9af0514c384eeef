"""Every command, every option that can be set elsewhere, and a word to try each with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click
import pytest

from exwarp_cli import cli, config
from exwarp_cli.config import configurable
from exwarp_cli.option_values import long_name

Parse = Callable[..., dict[str, Any]]

BEGIN = ("upsample", "shot", "-o", "out")
"""What upsample cannot do without."""


def every_command() -> list[tuple[click.Command, tuple[str, ...]]]:
    root = click.Context(cli.exwarp, info_name="exwarp")
    return [
        (ctx.command, tuple(ctx.command_path.split()[1:])) for ctx in config.every_command(root)
    ]


EVERY_OPTION = [
    pytest.param(command, path, option, id=f"{'.'.join(path)}:{long_name(option)}")
    for command, path in every_command()
    for option in configurable(command)
]
SAMPLES = (
    "s6", "psnr", "psnr=30", "flip=0.1", "2", "17", "1", "0.5", "motion=a/b.exr", "10MHz", "tcp://a:1"
)  # fmt: skip


def needed(command: click.Command, but: click.Option) -> list[str]:
    """Arguments that a command cannot do without."""
    words: list[str] = []
    for parameter in command.params:
        if isinstance(parameter, click.Argument):
            choices = getattr(parameter.type, "choices", ("frames",))
            words += [choices[0]] if parameter.required else []
        elif parameter.required and long_name(parameter) != long_name(but):
            choices = getattr(parameter.type, "choices", ("out",))
            words += [f"--{long_name(parameter)}", choices[0]]
    return words


def sampled(option: click.Option, parse: Parse, begin: list[str]) -> tuple[str, dict[str, Any]]:
    """Find a value that the command line takes and that changes something."""
    usual = parse(*begin) if not option.required else {}
    for text in (*getattr(option.type, "choices", ()), *SAMPLES):
        try:
            taken = parse(*begin, f"--{long_name(option)}", text)
        except AssertionError:
            continue
        if taken != usual:
            return text, taken
    raise AssertionError("no sample suits")
