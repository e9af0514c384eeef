"""Every option of every command can be set by a file and by the environment."""

from __future__ import annotations

import json

import click
import pytest

from exwarp_cli import cli, config
from exwarp_cli.config import MUTUALLY_EXCLUSIVE, configurable, variable_name
from exwarp_cli.option_values import long_name
from tests.cli.config.commands import EVERY_OPTION, every_command, needed, sampled
from tests.cli.config.files import write


class TestEveryOption:
    @pytest.mark.parametrize(("command", "path", "option"), EVERY_OPTION)
    def test_it_can_stand_in_a_file_and_in_the_environment(
        self, command, path, option, parse, project, monkeypatch
    ):
        begin, name = [*path, *needed(command, option)], long_name(option)
        if option.is_flag:
            value, text = ("false", "0") if option.default is True else ("true", "1")
            word = option.secondary_opts[0] if value == "false" else f"--{name}"
            wanted = parse(*begin, word)
            assert wanted != parse(*begin)
        else:
            text, wanted = sampled(option, parse, begin)
            value = text if text.isdigit() else json.dumps(text)
        file = write(project, f"[{'.'.join(path)}]\n{name} = {value}\n")
        assert parse(*begin) == wanted
        file.unlink()
        monkeypatch.setenv(variable_name(path, name), text)
        assert parse(*begin) == wanted

    def test_groups_have_none_of_their_own(self):
        for name in cli.COMMANDS:
            _, command, _ = cli.exwarp.resolve_command(click.Context(cli.exwarp), [name])
            if isinstance(command, click.Group):
                assert configurable(command) == []

    def test_no_command_is_called_as_another_variable(self):
        begins = tuple(variable_name(path) for _, path in every_command())
        assert not [name for name in config.OTHER_VARIABLES if f"{name}_".startswith(begins)]

    def test_rivals_are_options(self):
        known = [
            {long_name(one) for one in configurable(command)} for command, _ in every_command()
        ]
        for rivals in MUTUALLY_EXCLUSIVE:
            assert any(rivals <= names for names in known), rivals

    def test_the_commands_of_the_modules_stay_as_they_are(self):
        from exwarp_cli.commands.upsample import command

        before = list(command.params)
        cli.exwarp.resolve_command(click.Context(cli.exwarp), ["upsample"])
        assert command.params == before and command.epilog is None
