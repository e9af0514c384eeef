"""A folder without settings of anybody's, and what a command would be given there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import pytest

from exwarp_cli import cli
from tests.cli.config.commands import Parse


@pytest.fixture
def project(tmp_path, monkeypatch) -> Path:
    """A folder to work in, with no config file in or above it, and an empty home."""
    folder = tmp_path / "project"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.delenv("EXWARP_CONFIG")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    return folder


@pytest.fixture
def parse(project, monkeypatch, capsys) -> Parse:
    """Run a command line up to where the command would begin; return what it would be given."""
    taken: list[dict[str, Any]] = []

    original = click.Command.invoke

    def invoke(command: click.Command, ctx: click.Context) -> Any:
        if isinstance(command, click.Group):
            return original(command, ctx)
        return taken.append(ctx.params)

    monkeypatch.setattr(click.Command, "invoke", invoke)

    def run(*arguments: object) -> dict[str, Any]:
        taken.clear()
        code = cli.run([str(argument) for argument in arguments])
        assert code == 0, capsys.readouterr().err
        return taken[0]

    return run
