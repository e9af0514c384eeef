"""Where the settings of a command come from: which files and tables hold, the strongest first."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import click

from exwarp_cli.commands.config.layers import (
    Layer,
    configurable,
    environment_layer,
    file_layer,
    variable_name,
)
from exwarp_cli.commands.option_names import long_name
from exwarp_cli.io.config_file import ConfigLocation, find_config_files, read_config_file

UPSAMPLE = ("upsample",)

AS_UPSAMPLE = (("farm", "openjd"), ("farm", "commands"))
"""Commands that write runs of upsample into jobs: where nothing is set for themselves, what is set
for upsample holds, so that a job gives the frames that the command gives in the same folder."""

OWN_OF_JOBS = frozenset({"progress", "chunk-size", "json", "dry-run", "as-chunk"})
"""Options that say how a command itself runs, and so are not taken over."""


OF_MACHINES = frozenset({"threads", "progress"})
"""Options that change nothing of what a command makes, so that a machine may always set them."""


def environment_of(path: tuple[str, ...], isolated: bool) -> Mapping[str, str]:
    """Return the variables that a command looks at; where it is isolated, only of `OF_MACHINES`."""
    if not isolated:
        return os.environ
    wanted = {variable_name(path, name) for name in OF_MACHINES}
    return {name: text for name, text in os.environ.items() if name in wanted}


def config_files(
    ctx: click.Context, named: str | None, isolated: bool = False
) -> tuple[ConfigLocation, ...]:
    """Find the config files: those of the command line, the environment, the folders, the user."""
    how = "--config"
    if named is None:
        named = ctx.find_root().params.get("config")
    if named is None and isolated:
        return ()
    if named is None and (variable := os.environ.get("EXWARP_CONFIG")):
        named, how = variable, "EXWARP_CONFIG"
    own = Path(click.get_app_dir("exwarp"))
    # Without a home folder it begins with "~", which would be a folder in the current one.
    return find_config_files(named, how, own if own.is_absolute() else None)


def readers(
    ctx: click.Context,
    files: tuple[ConfigLocation, ...],
    command: click.Command,
    path: tuple[str, ...],
    environment: Mapping[str, str],
) -> list[Callable[[], Layer]]:
    """Return what reads the layers of a command, the strongest first."""
    groups = _groups(ctx)
    own = partial(environment_layer, environment, command, path)
    readers: list[list[Callable[[], Layer]]] = [[own]]
    readers += [[partial(_file_layer, file, groups, command, path)] for file in files]
    if path in AS_UPSAMPLE:
        names, model = groups[:1], _command(ctx.find_root(), UPSAMPLE)
        taken = partial(_taken_over, command)
        readers[0].append(partial(taken, partial(environment_layer, environment, model, UPSAMPLE)))
        for file, one in zip(files, readers[1:], strict=True):
            one.append(partial(taken, partial(_file_layer, file, names, model, UPSAMPLE)))
    return [read for source in readers for read in source]


def _file_layer(
    file: ConfigLocation, groups: list[list[str]], command: click.Command, path: tuple[str, ...]
) -> Layer:
    return file_layer(read_config_file(file.path), groups, command, path)


def _taken_over(command: click.Command, read: Callable[[], Layer]) -> Layer:
    """Keep of another command's settings those that this one has, too."""
    names = {long_name(option): option.name or "" for option in configurable(command)}
    return {
        name: replace(setting, parameter=names[name])
        for name, setting in read().items()
        if name in names and name not in OWN_OF_JOBS
    }


def _command(root: click.Context, path: tuple[str, ...]) -> click.Command:
    assert isinstance(root.command, click.Group)
    command = root.command.get_command(root, path[0])
    assert command is not None
    return command


def _groups(ctx: click.Context) -> list[list[str]]:
    """Return the names that there are on each level above a command."""
    above = []
    while ctx.parent is not None:
        ctx = ctx.parent
        assert isinstance(ctx.command, click.Group)
        above.append(ctx.command.list_commands(ctx))
    return above[::-1]
