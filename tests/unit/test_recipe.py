"""models/recipe.toml: every stage is a command that exists, with options that it has."""

from __future__ import annotations

import importlib.util
import shlex
from pathlib import Path

import click
import pytest

from exwarp_cli.commands.train import command

SCRIPT = Path(__file__).parents[2] / "models" / "train.py"


@pytest.fixture
def train():
    spec = importlib.util.spec_from_file_location("recipe_train", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_stage_is_a_command_with_its_options(train, capsys):
    assert train.main(["--data", "scenes", "-o", "out", "--list"]) == 0
    lines = [shlex.split(line) for line in capsys.readouterr().out.splitlines()]
    assert [line[2] for line in lines] == [
        *("lookahead", "extrapolator", "tile-policy", "look-ahead-policy", "policy"),
    ]
    assert set(command.commands) == {line[2] for line in lines}
    for _, _, name, *options in lines:
        with click.Context(command.commands[name]) as context:
            command.commands[name].parse_args(context, [*options])  # raises for what it has not
        assert "scenes" in options and "--seed" in options


def test_stages_are_chosen_by_name(train, capsys):
    assert train.main(["--data", "d", "-o", "o", "--list", "policy"]) == 0
    assert capsys.readouterr().out.startswith("exwarp train policy --data d --output o/policy ")
    with pytest.raises(SystemExit):
        train.main(["--data", "d", "-o", "o", "sculptor"])
    assert "there is no stage sculptor" in capsys.readouterr().err
