"""Options of commands from config files and from the environment.

A name is the same everywhere: ``--ground-truth`` of ``exwarp upsample`` is ``ground-truth`` in
table ``[upsample]`` and ``EXWARP_UPSAMPLE_GROUND_TRUTH`` in the environment. ``no-`` in front
resets an option that a weaker source sets: ``--no-report``, ``no-report = true``.

The command line wins over the environment, that over the nearest file, that over the user's own.
What holds goes to click as `click.Context.default_map`, so that its types and callbacks, and the
command itself, judge it as they judge the command line.
"""

from __future__ import annotations

import copy
import difflib
import os
import shlex
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from exwarp_cli.errors import UsageError
from exwarp_cli.io.config_file import ConfigLocation, find_config_files, read_config_file
from exwarp_cli.option_values import (
    Value,
    long_name,
    refuse_expanded,
    require_usable_paths,
    toml_value,
)

# Options that neither files nor the environment set.
NOT_CONFIGURED = frozenset({"help", "version", "config", "isolated"})

# Options that exclude each other: the stronger of two settings silences the weaker.
MUTUALLY_EXCLUSIVE = (
    frozenset({"overwrite", "skip-existing"}),
    frozenset({"factor", "to-fps"}),
    frozenset({"workers", "cluster"}),
    frozenset({"data", "tables"}),
)

# Commands that write runs of upsample into jobs. What is set for upsample holds for them too, so
# that a job gives the frames that upsample gives in the same folder.
UPSAMPLE = ("upsample",)
JOB_COMMANDS = (("farm", "openjd"), ("farm", "commands"))
NOT_INHERITED = frozenset({"progress", "chunk-size", "json", "dry-run", "as-chunk"})

# Options that change nothing of what a command makes: --isolated lets the environment set them.
MACHINE_OPTIONS = frozenset({"threads", "progress"})

# Commands that report mistakes in config files instead of being stopped by them.
TOLERANT = (("doctor",),)

# Variables that set no option of a command.
OTHER_VARIABLES = frozenset(
    f"EXWARP_{name}" for name in ("ARTEFACTS", "BLENDER", "CHROMIUM", "CONFIG", "DEBUG")
)

# Between the values of one variable: paths and channels may hold commas, colons and spaces.
SEPARATOR = ";"

_SETTINGS, _WARNINGS = "exwarp.settings", "exwarp.warnings"

_SWITCH_WORDS = {
    **dict.fromkeys(("1", "true", "yes", "on"), True),
    **dict.fromkeys(("0", "false", "no", "off"), False),
}
CommandPath = tuple[str, ...]


def configurable(command: click.Command) -> list[click.Option]:
    """Return the options of a command that files and the environment can set."""
    return [
        parameter
        for parameter in command.params
        if isinstance(parameter, click.Option)
        and not parameter.hidden
        and long_name(parameter) not in NOT_CONFIGURED
    ]


def variable_name(command: Sequence[str], name: str = "") -> str:
    """Return the environment variable of an option, or what those of a command begin with."""
    return "_".join(("EXWARP", *command, name)).upper().replace("-", "_")


@dataclass(frozen=True)
class Setting:
    """The value of an option, from a config file or the environment."""

    command: CommandPath  # Names of the groups and the command: ("train", "policy").
    parameter: click.Option  # The option, as the command has it
    value: Value | None  # As the command line would give it; None resets what weaker sources set.
    source: str  # The file's path or the variable's name
    origin: str  # The same with the key, for messages

    @property
    def option(self) -> str:
        """Long name of the option, without dashes."""
        return long_name(self.parameter)

    @property
    def arguments(self) -> tuple[str, ...]:
        """The setting as words of a command line: ("--steps", "20000"), ("--no-tail",)."""
        if self.value is None or self.value is False:
            return (*self.parameter.secondary_opts[:1],) or (f"--no-{self.option}",)
        name = f"--{self.option}"
        if self.value is True:
            return (name,)
        values = (self.value,) if isinstance(self.value, str) else self.value
        return tuple(word for value in values for word in (name, value))

    @property
    def place(self) -> str:
        """The file, or the environment."""
        return "the environment" if self.source == self.origin else self.source

    @property
    def text(self) -> str:
        """The value in words."""
        if isinstance(self.value, tuple):
            return " ".join(self.value)
        return str(self.value).lower() if isinstance(self.value, bool) else self.value or ""


# Settings of one file, or of the environment, by the long names of options.
Layer = dict[str, Setting]


@dataclass(frozen=True)
class Configuration:
    """What files and the environment set, for all commands."""

    files: tuple[ConfigLocation, ...]  # The config files, the strongest first
    settings: tuple[Setting, ...]  # What holds; what something stronger hides is left out.
    problems: tuple[str, ...]  # What stops commands, a sentence each
    warnings: tuple[str, ...]  # Variables that no command knows


def configured_command(command: click.Command, path: CommandPath) -> click.Command:
    """Return a copy of a command, no group, whose options files and the environment set too."""
    configured = copy.copy(command)
    options = configurable(command)
    if options:
        reset_switches = [
            click.Option(
                [f"--no-{long_name(option)}", _reset_name(option)],
                is_flag=True,
                expose_value=False,
                hidden=True,
            )
            for option in options
            if not option.secondary_opts
        ]
        isolated = click.Option(
            ["--isolated"],
            is_flag=True,
            expose_value=False,
            help="Take options from here alone: no config file but one that is named, and nothing "
            "of the environment but --threads and --progress. Calls in farm jobs have it.",
        )
        configured.params = [
            *command.params,
            *reset_switches,
            isolated,
            ConfigOption(command, path),
        ]
        usual = next((o for o in options if not o.required and not o.is_flag), options[0])
        rule = (
            f"Options may stand in exwarp.toml, in the table [{'.'.join(path)}], and in the "
            f"environment, as {variable_name(path, long_name(usual))}; see exwarp --help."
        )
        configured.epilog = f"{command.epilog}\n\n{rule}" if command.epilog else rule
    if configured.callback is not None:
        checked = _with_path_checks(command.params, configured.callback)
        configured.callback = _with_startup_messages(checked)
    return configured


class ConfigOption(click.Option):
    """``--config FILE`` of a command, which also looks for settings where it is not given."""

    def __init__(self, command: click.Command, path: CommandPath) -> None:
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

        Raises UsageError for mistakes in the files and the environment, and for names that a shell
        put in the place of an unquoted ``*``.
        """
        result = super().handle_parse_result(ctx, opts, args)
        if ctx.resilient_parsing:  # a shell asks for completions
            return result
        refuse_expanded(args)
        command, path = self._command, self._path
        on_command_line = _options_on_command_line(ctx, command, opts)
        is_isolated = bool(opts.get("isolated"))
        environment: Mapping[str, str] = os.environ
        if is_isolated:
            allowed = {variable_name(path, name) for name in MACHINE_OPTIONS}
            environment = {name: text for name, text in os.environ.items() if name in allowed}
        problems: list[str] | None = [] if path in TOLERANT else None
        files = _config_files(ctx, opts.get(self.name or ""), is_isolated, problems)
        layers = _read_layers(ctx, files, command, path, environment, problems)
        if problems:
            layers = layers[:1]  # of the environment
        settings = settings_in_force(layers, on_command_line)
        ctx.default_map = {setting.parameter.name or "": setting.value for setting in settings}
        ctx.meta[_SETTINGS] = settings
        ctx.meta[_WARNINGS] = _unknown_variables(environment, command, path)
        origins = ctx.find_root().ensure_object(dict)
        origins.update({f"--{setting.option}": setting.origin for setting in settings})
        return result


def _options_on_command_line(
    ctx: click.Context, command: click.Command, opts: Mapping[str, Any]
) -> dict[str, bool]:
    """Return the options that a command line names, with False for what it switches off or resets.

    Click knows the sources of parameters (`click.Context.get_parameter_source`) only after all of
    them are processed, which is too late to choose their defaults.
    """
    named: dict[str, bool] = {}
    for option in configurable(command):
        name, is_reset = long_name(option), _reset_name(option) in opts
        if option.name in opts:
            if is_reset:
                raise click.UsageError(
                    f"--{name} and --no-{name} contradict each other; give one", ctx
                )
            named[name] = opts[option.name] is not False
        elif is_reset:
            named[name] = False
    return named


def _reset_name(option: click.Option) -> str:
    return f"take_back_{option.name}"


def _with_path_checks(
    parameters: list[click.Parameter], callback: Callable[..., Any]
) -> Callable[..., Any]:
    def run(**values: Any) -> Any:
        require_usable_paths(parameters, values)
        return callback(**values)

    return run


def _with_startup_messages(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Let a command say first what it takes from files and the environment."""

    def run(**parameters: Any) -> Any:
        meta = click.get_current_context().meta
        settings, lines = meta.get(_SETTINGS, ()), list(meta.get(_WARNINGS, ()))
        by_place: dict[str, list[str]] = {}
        for setting in settings:
            by_place.setdefault(setting.place, []).extend(setting.arguments)
        if by_place:
            places = (f"from {place}: {shlex.join(words)}" for place, words in by_place.items())
            lines.append(f"options {'; '.join(places)}")
        if lines:
            # Imported here: most calls take nothing from files.
            from exwarp_cli.pipeline.progress import JsonProgress, Progress

            reporter = JsonProgress() if parameters.get("progress") == "json" else Progress()
            for line in lines:
                reporter.message(line)
        return callback(**parameters)

    return run


def configuration(ctx: click.Context) -> Configuration:
    """Find what files and the environment set for every command, and what is wrong in it."""
    problems: list[str] = []
    warnings: list[str] = []
    settings: dict[tuple[CommandPath, str, str], Setting] = {}
    known_variables = set(OTHER_VARIABLES)
    files = _config_files(ctx, None, False, problems)
    for context, command, path in every_command(ctx.find_root()):
        known_variables.update(v for v in os.environ if v.startswith(variable_name(path)))
        warnings += _unknown_variables(os.environ, command, path)
        layers = _read_layers(context, files, command, path, os.environ, problems)
        for setting in settings_in_force(layers, {}):
            try:
                setting.parameter.process_value(context, setting.value)
            except (click.UsageError, UsageError) as error:
                reason = (
                    error.format_message() if isinstance(error, click.UsageError) else str(error)
                )
                origin = f"--{setting.option} is set by {setting.origin}"
                problems.append(f"{reason.rstrip('.')}; {origin}")
            # Job commands inherit upsample's settings, which are listed once.
            settings.setdefault((setting.command, setting.option, setting.origin), setting)
    warnings += [
        f"{name} in the environment is no option of any command"
        for name in sorted(os.environ)
        if name.startswith("EXWARP_") and name not in known_variables
    ]
    unique_problems = tuple(dict.fromkeys(problems))
    return Configuration(files, tuple(settings.values()), unique_problems, tuple(warnings))


def every_command(
    ctx: click.Context, path: CommandPath = ()
) -> Iterator[tuple[click.Context, click.Command, CommandPath]]:
    """Yield a context for each command below a group, the command and its path."""
    assert isinstance(ctx.command, click.Group)
    for name in ctx.command.list_commands(ctx):
        command = ctx.command.get_command(ctx, name)
        if command is None:
            continue
        context = click.Context(command, parent=ctx, info_name=name)
        if isinstance(command, click.Group):
            yield from every_command(context, (*path, name))
        else:
            yield context, command, (*path, name)


def _config_files(
    ctx: click.Context, named: str | None, is_isolated: bool, problems: list[str] | None
) -> tuple[ConfigLocation, ...]:
    """Find the config files: of the command line, the environment, the folders, the user."""
    source = "--config"
    if named is None:
        named = ctx.find_root().params.get("config")
    if named is None and is_isolated:
        return ()
    if named is None and (variable := os.environ.get("EXWARP_CONFIG")):
        named, source = variable, "EXWARP_CONFIG"
    folder = Path(click.get_app_dir("exwarp"))
    try:
        # Without a home folder it begins with "~", which would be a folder in the current one.
        return find_config_files(named, source, folder if folder.is_absolute() else None)
    except UsageError as error:
        if problems is None:
            raise
        problems.append(str(error))
        return ()


def _read_layers(
    ctx: click.Context,
    files: Iterable[ConfigLocation],
    command: click.Command,
    path: CommandPath,
    environment: Mapping[str, str],
    problems: list[str] | None,
) -> list[Layer]:
    """Return what the environment and each file set for a command, the strongest first.

    Mistakes are added to `problems`, and their layer is empty; without it they are raised.
    """
    names_above = _names_above(ctx)
    targets = [(command, path, names_above)]
    if path in JOB_COMMANDS:
        root = ctx.find_root()
        assert isinstance(root.command, click.Group)
        upsample = root.command.get_command(root, *UPSAMPLE)
        assert upsample is not None
        targets.append((upsample, UPSAMPLE, names_above[:1]))
    own = {long_name(option): option for option in configurable(command)}
    layers: list[Layer] = []
    for file in (None, *files):
        for target, target_path, names in targets:
            try:
                if file is None:
                    layer = _read_environment(environment, target, target_path)
                else:
                    layer = _read_file(file.path, names, target, target_path)
            except UsageError as error:
                if problems is None:
                    raise
                problems.append(str(error))
                layer = {}
            if target is not command:
                layer = {
                    name: replace(setting, parameter=own[name])
                    for name, setting in layer.items()
                    if name in own and name not in NOT_INHERITED
                }
            layers.append(layer)
    return layers


def _names_above(ctx: click.Context) -> list[list[str]]:
    """Return the names that there are at each level above a command, from the root on."""
    levels = []
    while ctx.parent is not None:
        ctx = ctx.parent
        assert isinstance(ctx.command, click.Group)
        levels.append(ctx.command.list_commands(ctx))
    return levels[::-1]


def settings_in_force(
    layers: Iterable[Layer], on_command_line: Mapping[str, bool]
) -> list[Setting]:
    """Choose what holds out of layers, the strongest first.

    `on_command_line` has the long names of options; False where one is switched off or reset.
    """
    settled = set(on_command_line)
    active = {name for name, is_on in on_command_line.items() if is_on}
    chosen: list[Setting] = []
    for layer in layers:
        fresh = [
            setting
            for name, setting in layer.items()
            if name not in settled
            and not any(name in group and group & active for group in MUTUALLY_EXCLUSIVE)
        ]
        chosen += [setting for setting in fresh if setting.value is not None]
        active |= {setting.option for setting in fresh if setting.value not in (None, False)}
        settled |= layer.keys()
    return chosen


def _option_names(command: click.Command) -> dict[str, tuple[click.Option, bool]]:
    """Return every name, without dashes, that sets an option (True) or resets it (False)."""
    names: dict[str, tuple[click.Option, bool]] = {}
    for option in configurable(command):
        backwards = option.secondary_opts or [f"--no-{long_name(option)}"]
        for is_positive, spellings in ((True, option.opts), (False, backwards)):
            for name in spellings:
                if name.startswith("--"):
                    names[name.removeprefix("--")] = option, is_positive
    return names


def _read_file(
    file: Path, names_above: Sequence[Collection[str]], command: click.Command, path: CommandPath
) -> Layer:
    """Read what a config file sets; UsageError for unknown tables and keys, and wrong types."""
    names = _option_names(command)
    title = f"[{'.'.join(path)}]"
    layer: Layer = {}
    for key, value in _command_table(file, names_above, path).items():
        origin = f"{key} in {title} of {file}"
        if key not in names:
            raise UsageError(_unknown_key(key, origin, command, path, names))
        option, is_positive = names[key]
        if is_positive:
            held: Value = toml_value(option, value, file.parent, origin)
        elif isinstance(value, bool):
            held = value
        else:
            raise UsageError(f"{origin} must be true or false; correct it")
        setting = Setting(path, option, held, str(file), origin)
        _add_setting(layer, setting, is_positive)
    return layer


def _read_environment(
    environment: Mapping[str, str], command: click.Command, path: CommandPath
) -> Layer:
    """Read what the environment sets; empty variables set nothing."""
    layer: Layer = {}
    for name, (option, is_positive) in _option_names(command).items():
        variable = variable_name(path, name)
        text = environment.get(variable, "")
        if not text:
            continue
        value: Value = text
        if option.is_flag or not is_positive:
            switch = _SWITCH_WORDS.get(text.strip().lower())
            if switch is None:
                raise UsageError(f"{variable} is {text!r}; write 1 or 0, for on or off")
            value = switch
        elif option.multiple:
            value = tuple(word for part in text.split(SEPARATOR) if (word := part.strip()))
        _add_setting(layer, Setting(path, option, value, variable, variable), is_positive)
    return layer


def _add_setting(layer: Layer, setting: Setting, is_positive: bool) -> None:
    name, value = setting.option, setting.value
    if not is_positive:
        if setting.parameter.is_flag:
            value = not value
        elif value:
            value = None
        else:
            return  # `no-report = false` says nothing
    if name in layer:
        earlier = layer[name].origin
        raise UsageError(f"{setting.origin} says again what {earlier} says; leave one out")
    layer[name] = replace(setting, value=value)


def _command_table(
    file: Path, names_above: Sequence[Collection[str]], path: CommandPath
) -> Mapping[str, object]:
    """Return the table of a command; UsageError for unknown names on the way to it."""
    table: Mapping[str, object] = read_config_file(file)
    for depth, (valid, name) in enumerate(zip(names_above, path, strict=True)):
        for key, value in table.items():
            title = f"[{'.'.join((*path[:depth], key))}]"
            if not isinstance(value, dict):
                place = f" in [{'.'.join(path[:depth])}]" if depth else ""
                raise UsageError(
                    f"{key}{place} of {file} stands in no command's table; write it under "
                    f"the command's, such as [{'.'.join((*path[:depth], next(iter(valid))))}]"
                )
            if key not in valid:
                group = " ".join(("exwarp", *path[:depth]))
                raise UsageError(
                    f"{title} in {file} is no command of {group}{_did_you_mean(key, valid)}"
                )
        below = table.get(name, {})
        assert isinstance(below, dict)
        table = below
    return table


def _unknown_key(
    key: str, origin: str, command: click.Command, path: CommandPath, names: Collection[str]
) -> str:
    line = " ".join(("exwarp", *path))
    arguments = (p for p in command.params if isinstance(p, click.Argument))
    if key in {(argument.name or "").replace("_", "-") for argument in arguments}:
        return f"{origin} is no option, but stands on the command line of {line}; take it out"
    near = _did_you_mean(key, names)
    return f"{origin} is no option of {line}{near or f'; {line} --help lists them'}"


def _unknown_variables(
    environment: Mapping[str, str], command: click.Command, path: CommandPath
) -> list[str]:
    """Return a warning for each variable that is named after a command and none of its options."""
    # No errors: a farm's environment is shared by versions that have other options.
    valid = {variable_name(path, name) for name in _option_names(command)}
    return [
        f"{name} in the environment is no option of exwarp {' '.join(path)}"
        f"{_did_you_mean(name, valid)}"
        for name in sorted(environment)
        if name.startswith(variable_name(path)) and name not in valid
    ]


def _did_you_mean(name: str, valid: Collection[str]) -> str:
    near = difflib.get_close_matches(name, valid, n=1)
    return f"; did you mean {near[0]}?" if near else ""
