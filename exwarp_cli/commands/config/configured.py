"""Commands whose options may also stand in config files and in the environment.

`configured` makes such a command of any other, which knows nothing of it: what files and the
environment set goes to click as defaults (`click.Context.default_map`), so that its types, its
callbacks and the command itself judge it as they judge the command line.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import click

from exwarp_cli.commands.config.layers import (
    Layer,
    Setting,
    configurable,
    describe,
    environment_layer,
    in_force,
    unknown_variables,
    variable_name,
)
from exwarp_cli.commands.config.sources import config_files, environment_of, readers
from exwarp_cli.commands.misread_paths import refuse_expanded, require_usable_paths
from exwarp_cli.commands.option_names import long_name
from exwarp_cli.errors import UsageError
from exwarp_cli.io.config_file import ConfigLocation

TOLERANT = (("doctor",),)
"""Commands that a config file with mistakes does not stop, as they tell of these."""

OTHER_VARIABLES = frozenset(
    f"EXWARP_{name}" for name in ("ARTEFACTS", "BLENDER", "CHROMIUM", "CONFIG", "DEBUG")
)
"""Variables that set no option of a command."""

ISOLATED = "isolated"

_SETTINGS = "exwarp.settings"
_WARNINGS = "exwarp.warnings"


@dataclass(frozen=True)
class Configuration:
    """What files and the environment set, for all commands.

    Attributes
    ----------
    files
        The config files, the strongest first.
    settings
        What holds; what something stronger hides is left out.
    problems
        What stops commands, a sentence each.
    warnings
        Variables that no command knows, of which they only warn.
    """

    files: tuple[ConfigLocation, ...]
    settings: tuple[Setting, ...]
    problems: tuple[str, ...]
    warnings: tuple[str, ...]


def configured(
    command: click.Command, path: tuple[str, ...], *, completing: bool = False
) -> click.Command:
    """Return a command as it is, but that files and the environment set its options too.

    Parameters
    ----------
    command
        A command, or a group with all that is below it.
    path
        Its name, behind those of its groups.
    completing
        Whether a shell asks for completions; only then do its parameters have some to offer.
    """
    made = copy.copy(command)
    if isinstance(made, click.Group):
        below = made.commands.items()
        made.commands = {
            name: configured(one, (*path, name), completing=completing) for name, one in below
        }
        return made
    made.params = _suggesting(command) if completing else list(command.params)
    options = configurable(command)
    made.params += [_taking_back(option) for option in options if not option.secondary_opts]
    if options:
        made.params += [_isolated(), ConfigOption(command, path)]
        made.epilog = _epilog(command, options, path)
    if made.callback is not None:
        made.callback = _announcing(_requiring_paths(command.params, made.callback))
    return made


def _suggesting(command: click.Command) -> list[click.Parameter]:
    # Imported here: what is suggested takes 8 ms to load, which other calls need not pay.
    from exwarp_cli.commands.suggestions import suggesting

    return [suggesting(parameter) for parameter in command.params]


class ConfigOption(click.Option):
    """``--config FILE`` behind a command, which also looks for settings where it is not given."""

    def __init__(self, command: click.Command, path: tuple[str, ...]) -> None:
        super().__init__(
            ["--config"],
            type=click.Path(),
            metavar="FILE",
            expose_value=False,
            is_eager=True,  # before other options ask for their defaults, but after --help
            help="TOML file to take options from, or none; else EXWARP_CONFIG, or exwarp.toml in "
            "this folder or one above.",
        )
        self._command, self._path = command, path

    def handle_parse_result(
        self, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        """Take the option, then settle the defaults of all others.

        Raises
        ------
        UsageError
            For mistakes in the files and the environment, and for names that a shell put in the
            place of an unquoted ``*``.
        """
        result = super().handle_parse_result(ctx, opts, args)
        if ctx.resilient_parsing:  # a shell asks for completions
            return result
        refuse_expanded(args)
        given = _given(ctx, self._command, opts)
        isolated = bool(opts.get(ISOLATED))
        environment = environment_of(self._path, isolated)
        try:
            files = config_files(ctx, opts.get(self.name or ""), isolated)
            reading = readers(ctx, files, self._command, self._path, environment)
            layers = [read() for read in reading]
        except UsageError:
            if self._path not in TOLERANT:
                raise
            layers = [_environment_alone(environment, self._command, self._path)]
        settings = in_force(layers, given)
        ctx.default_map = {setting.parameter: setting.value for setting in settings}
        ctx.meta[_SETTINGS] = settings
        ctx.meta[_WARNINGS] = unknown_variables(environment, self._command, self._path)
        origins = ctx.find_root().ensure_object(dict)
        origins.update({f"--{setting.option}": setting.origin for setting in settings})
        return result


def configuration(ctx: click.Context) -> Configuration:
    """Find all that files and the environment set, for every command, with what is wrong in it."""
    problems: dict[str, None] = {}
    warnings: list[str] = []
    try:
        files = config_files(ctx, None)
    except UsageError as error:
        files = ()
        problems[str(error)] = None
    settings: list[Setting] = []
    known = set(OTHER_VARIABLES)
    for below, command, path in _every_command(ctx.find_root()):
        known.update(name for name in os.environ if name.startswith(variable_name(path)))
        warnings += unknown_variables(os.environ, command, path)
        layers: list[Layer] = []
        for read in readers(below, files, command, path, os.environ):
            try:
                layers.append(read())
            except UsageError as error:
                problems[str(error)] = None
        found = in_force(layers, {})
        problems |= dict.fromkeys(_unfit(below, command, found))
        # What is set for upsample comes again with the commands that write runs of it into jobs.
        seen = {(one.command, one.option, one.origin) for one in settings}
        settings += [one for one in found if (one.command, one.option, one.origin) not in seen]
    strange = sorted(name for name in os.environ if name.startswith("EXWARP_"))
    warnings += [
        f"{name} in the environment is no option of any command"
        for name in strange
        if name not in known
    ]
    return Configuration(files, tuple(settings), tuple(problems), tuple(warnings))


def _unfit(ctx: click.Context, command: click.Command, settings: list[Setting]) -> Iterator[str]:
    """Say which settings a command would refuse by itself: values of no use to their options."""
    options = {long_name(option): option for option in configurable(command)}
    for setting in settings:
        try:
            options[setting.option].process_value(ctx, setting.value)
        except (click.UsageError, UsageError) as error:
            said = error.format_message() if isinstance(error, click.UsageError) else str(error)
            yield f"{said.rstrip('.')}; --{setting.option} is set by {setting.origin}"


def _given(ctx: click.Context, command: click.Command, opts: Mapping[str, Any]) -> dict[str, bool]:
    """Return what the command line itself says: options, and whether they are on.

    Raises
    ------
    click.UsageError
        When it sets an option and takes it back.
    """
    given: dict[str, bool] = {}
    for option in configurable(command):
        name, taken_back = long_name(option), _back(option) in opts
        if option.name in opts:
            if taken_back:
                raise click.UsageError(
                    f"--{name} and --no-{name} contradict each other; give one", ctx
                )
            given[name] = opts[option.name] is not False
        elif taken_back:
            given[name] = False
    return given


def _back(option: click.Option) -> str:
    return f"take_back_{option.name}"


def _taking_back(option: click.Option) -> click.Option:
    """Make ``--no-NAME``, which takes back what files and the environment say of an option."""
    name = f"--no-{long_name(option)}"
    return click.Option([name, _back(option)], is_flag=True, expose_value=False, hidden=True)


def _isolated() -> click.Option:
    """Make ``--isolated``, which `ConfigOption` follows."""
    return click.Option(
        ["--isolated"],
        is_flag=True,
        expose_value=False,
        help="Take options from here alone: no config file but one that is named, and nothing of "
        "the environment but --threads and --progress. Calls in farm jobs have it.",
    )


def _epilog(command: click.Command, options: list[click.Option], path: tuple[str, ...]) -> str:
    """Say by an example how the options of a command are called elsewhere."""
    usual = next((one for one in options if not one.required and not one.is_flag), options[0])
    rule = (
        f"Options may stand in exwarp.toml, in the table [{'.'.join(path)}], and in the "
        f"environment, as {variable_name(path, long_name(usual))}; see exwarp --help."
    )
    return f"{command.epilog}\n\n{rule}" if command.epilog else rule


def _environment_alone(
    environment: Mapping[str, str], command: click.Command, path: tuple[str, ...]
) -> Layer:
    try:
        return environment_layer(environment, command, path)
    except UsageError:
        return {}


def _every_command(
    ctx: click.Context, path: tuple[str, ...] = ()
) -> Iterator[tuple[click.Context, click.Command, tuple[str, ...]]]:
    """Walk all commands: a context for each, the command, its path."""
    group = ctx.command
    assert isinstance(group, click.Group)
    for name in group.list_commands(ctx):
        command = group.get_command(ctx, name)
        if command is None:
            continue
        below = click.Context(command, parent=ctx, info_name=name)
        if isinstance(command, click.Group):
            yield from _every_command(below, (*path, name))
        else:
            yield below, command, (*path, name)


def _requiring_paths(
    parameters: list[click.Parameter], callback: Callable[..., Any]
) -> Callable[..., Any]:
    """Let a command refuse paths that do not mean what the user does."""

    def run(**values: Any) -> Any:
        require_usable_paths(parameters, values)
        return callback(**values)

    return run


def _announcing(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Let a command say first what it takes from files and the environment."""

    def run(**parameters: Any) -> Any:
        meta = click.get_current_context().meta
        settings, lines = meta.get(_SETTINGS, ()), list(meta.get(_WARNINGS, ()))
        if settings:
            lines.append(f"options {describe(settings)}")
        for line in lines:
            _tell(line, parameters.get("progress"))
        return callback(**parameters)

    return run


def _tell(line: str, progress: str | None) -> None:
    """Print a line to stderr, as an event where a program reads events."""
    from exwarp_cli.pipeline.progress import JsonProgress, NoProgress

    (JsonProgress if progress == "json" else NoProgress)().message(line)
