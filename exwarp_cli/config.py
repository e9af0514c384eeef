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
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from exwarp_cli import option_values
from exwarp_cli.errors import UsageError
from exwarp_cli.option_values import Value, long_name

# The file's name in a project's folder and in the user's own.
FILE_NAME = "exwarp.toml"

# Options that exclude each other: the stronger of two settings silences the weaker.
MUTUALLY_EXCLUSIVE = (
    frozenset({"overwrite", "skip-existing"}),
    frozenset({"factor", "to-fps"}),
    frozenset({"workers", "cluster"}),
    frozenset({"data", "tables"}),
)

# Commands that write runs of upsample into jobs. What is set for upsample holds for them too, so
# that a job gives the frames that upsample gives in the same folder.
UPSAMPLE = "upsample"
JOB_COMMANDS = (("farm", "openjd"), ("farm", "commands"))
NOT_INHERITED = frozenset({"progress", "chunk-size", "json", "dry-run", "as-chunk"})

# Variables that set no option of a command.
OTHER_VARIABLES = frozenset(
    f"EXWARP_{name}" for name in ("ARTEFACTS", "BLENDER", "CHROMIUM", "CONFIG", "DEBUG")
)

_MESSAGES = "exwarp.messages"  # in `click.Context.meta`

_SWITCH_WORDS = {
    **dict.fromkeys(("1", "true", "yes", "on"), True),
    **dict.fromkeys(("0", "false", "no", "off"), False),
}
CommandPath = tuple[str, ...]  # names of the groups and the command: ("train", "policy")


def configurable(command: click.Command) -> list[click.Option]:
    """Return the options of a command that files and the environment can set."""
    return [
        parameter
        for parameter in command.params
        if isinstance(parameter, click.Option)
        and not parameter.hidden
        and long_name(parameter) not in ("help", "version", "config", "isolated")
    ]


def variable_name(command: Sequence[str], name: str = "") -> str:
    """Return the environment variable of an option, or what those of a command begin with."""
    return "_".join(("EXWARP", *command, name)).upper().replace("-", "_")


@dataclass(frozen=True)
class Setting:
    """The value of an option, from a config file or the environment."""

    command: CommandPath
    parameter: click.Option  # The option, as the command has it
    value: Value | None  # As the command line would give it; None resets what weaker sources set.
    place: str  # The file's path, or "the environment"
    origin: str  # The key and the file, or the variable's name, for messages

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
    def text(self) -> str:
        """The value in words."""
        if isinstance(self.value, tuple):
            return " ".join(self.value)
        return str(self.value).lower() if isinstance(self.value, bool) else self.value or ""


# Settings of one file, or of the environment, by the long names of options.
Layer = dict[str, Setting]


@dataclass(frozen=True)
class ConfigLocation:
    """The absolute path of a config file, and what led to it."""

    path: Path
    how: str  # "--config", "EXWARP_CONFIG", "nearest folder" or "user's own"


@dataclass(frozen=True)
class Configuration:
    """What files and the environment set, for all commands."""

    files: tuple[ConfigLocation, ...]  # The config files, the strongest first
    settings: tuple[Setting, ...]  # What holds; what something stronger hides is left out.
    problems: tuple[str, ...]  # What stops commands, a sentence each
    warnings: tuple[str, ...]  # Variables that no command knows


def configured_command(command: click.Command, path: CommandPath) -> click.Command:
    """Return a copy of a command, no group, whose options files and the environment set too."""
    configured, callback = copy.copy(command), command.callback
    assert callback is not None
    options = configurable(command)
    if options:
        reset_switches = [
            click.Option(
                [f"--no-{long_name(option)}", f"take_back_{option.name}"],
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
        config = ConfigOption(
            ["--config"],
            expose_value=False,
            is_eager=True,  # before other options ask for their defaults, but after --help
            **option_values.CONFIG_ATTRIBUTES,
        )
        configured.params = [*command.params, *reset_switches, isolated, config]
        usual = next((o for o in options if not o.required and not o.is_flag), options[0])
        rule = (
            f"Options may stand in exwarp.toml, in the table [{'.'.join(path)}], and in the "
            f"environment, as {variable_name(path, long_name(usual))}; see exwarp --help."
        )
        configured.epilog = f"{command.epilog}\n\n{rule}" if command.epilog else rule

    def run(**values: Any) -> Any:
        # Says first what the command takes from files and the environment, and checks its paths.
        if messages := click.get_current_context().meta.get(_MESSAGES):
            # Imported here: most calls take nothing from files.
            from exwarp_cli.pipeline.progress import JsonProgress, Progress

            reporter = JsonProgress() if values.get("progress") == "json" else Progress()
            for text in messages:
                reporter.message(text)
        option_values.require_usable_paths(command.params, values)
        return callback(**values)

    configured.callback = run
    return configured


class ConfigOption(click.Option):
    """``--config FILE`` of a command, which also looks for settings where it is not given."""

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
        option_values.refuse_expanded(args)
        # Click knows the sources of parameters (`click.Context.get_parameter_source`) only after
        # all of them are processed, which is too late to choose their defaults.
        on_command_line: dict[str, bool] = {}  # False for what it switches off or resets
        for option in configurable(ctx.command):
            name, is_reset = long_name(option), f"take_back_{option.name}" in opts
            if is_reset and option.name in opts:
                raise click.UsageError(
                    f"--{name} and --no-{name} contradict each other; give one", ctx
                )
            if is_reset or option.name in opts:
                on_command_line[name] = not is_reset and opts[option.name or ""] is not False
        path = _path_of(ctx)
        is_isolated = bool(opts.get("isolated"))
        environment: Mapping[str, str] = os.environ
        if is_isolated:
            # These change nothing of what a command makes.
            allowed = {variable_name(path, name) for name in ("threads", "progress")}
            environment = {name: text for name, text in os.environ.items() if name in allowed}
        problems: list[str] = []
        files = _find_config_files(ctx, opts.get(self.name or ""), is_isolated, problems)
        layers = _read_layers(ctx, files, environment, problems)
        if problems:
            if path != ("doctor",):  # which reports mistakes in config files
                raise UsageError(problems[0])
            layers = layers[:1]  # of the environment
        settings = settings_in_force(layers, on_command_line)
        ctx.default_map = {setting.parameter.name or "": setting.value for setting in settings}
        messages = _unknown_variables(environment, ctx)
        by_place: dict[str, list[str]] = {}
        for setting in settings:
            by_place.setdefault(setting.place, []).extend(setting.arguments)
        if by_place:
            places = (f"from {place}: {shlex.join(words)}" for place, words in by_place.items())
            messages.append(f"options {'; '.join(places)}")
        ctx.meta[_MESSAGES] = messages
        origins = ctx.find_root().ensure_object(dict)
        origins.update({f"--{setting.option}": setting.origin for setting in settings})
        return result


def configuration(ctx: click.Context) -> Configuration:
    """Find what files and the environment set for every command, and what is wrong in it."""
    problems: list[str] = []
    warnings: list[str] = []
    settings: dict[tuple[CommandPath, str, str], Setting] = {}
    known_variables = set(OTHER_VARIABLES)
    files = _find_config_files(ctx, None, False, problems)
    for context in every_command(ctx.find_root()):
        begin = variable_name(_path_of(context))
        known_variables.update(name for name in os.environ if name.startswith(begin))
        warnings += _unknown_variables(os.environ, context)
        for setting in settings_in_force(_read_layers(context, files, os.environ, problems), {}):
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


def every_command(ctx: click.Context) -> Iterator[click.Context]:
    """Yield a context for each command below a group."""
    assert isinstance(ctx.command, click.Group)
    for name in ctx.command.list_commands(ctx):
        _, command, _ = ctx.command.resolve_command(ctx, [name])
        assert command is not None
        context = click.Context(command, parent=ctx, info_name=name)
        if isinstance(command, click.Group):
            yield from every_command(context)
        else:
            yield context


def _path_of(ctx: click.Context) -> CommandPath:
    return () if ctx.parent is None else (*_path_of(ctx.parent), ctx.info_name or "")


def _find_config_files(
    ctx: click.Context, named: str | None, is_isolated: bool, problems: list[str]
) -> tuple[ConfigLocation, ...]:
    """Find the config files that hold, the strongest first.

    `named` is the command's own ``--config``. One that cannot be reached is added to `problems`.
    """
    how = "--config"
    if named is None:
        named = ctx.find_root().params.get("config")
    if named is None and is_isolated:
        return ()
    if named is None and (variable := os.environ.get("EXWARP_CONFIG")):
        named, how = variable, "EXWARP_CONFIG"
    if named is not None and named.strip().lower() in ("", "none"):
        return ()
    files: list[ConfigLocation] = []
    candidates: list[ConfigLocation] = []
    if named is not None:
        problem = None
        try:
            path = Path(named).expanduser().absolute()
            # Else a file, or a pipe, as in ``--config <(generate)``.
            if path.is_dir() or not path.exists():
                state = "is a folder" if path.is_dir() else "does not exist"
                problem = f"{how} names {path}, which {state}"
            files.append(ConfigLocation(path, how))
        except RuntimeError:
            problem = f"{how} names {named}, and no user has that home"
        except OSError as error:
            reason = error.strerror or error
            problem = f"{how} names {named}, which cannot be reached: {reason}"
        if problem is not None:
            problems.append(f"{problem}; name a TOML file, or none to go without")
            return ()
    else:
        with suppress(OSError):  # the folder was removed; the command reports what it needs of it
            folders = (Path.cwd(), *Path.cwd().parents)
            candidates += [ConfigLocation(path / FILE_NAME, "nearest folder") for path in folders]
    own = Path(click.get_app_dir("exwarp"), FILE_NAME)
    # Without a home folder it begins with "~", which would be a folder in the current one.
    candidates += [ConfigLocation(own, "user's own")] if own.is_absolute() else []
    for candidate in candidates:
        path, others = candidate.path, {file.how: file.path.resolve() for file in files}
        # A folder above that may not be entered has nothing for us.
        with suppress(OSError):
            is_there = candidate.how not in others and path.exists() and not path.is_dir()
            if is_there and path.resolve() not in others.values():
                files.append(candidate)
    return tuple(files)


def _read_layers(
    ctx: click.Context,
    files: Iterable[ConfigLocation],
    environment: Mapping[str, str],
    problems: list[str],
) -> list[Layer]:
    """Return what the environment and each file set for a command, the strongest first.

    Mistakes are added to `problems`, and their layer is empty.
    """
    targets = [ctx]
    if _path_of(ctx) in JOB_COMMANDS:
        root = ctx.find_root()
        assert isinstance(root.command, click.Group)
        _, upsample, _ = root.command.resolve_command(root, [UPSAMPLE])
        assert upsample is not None
        targets.append(click.Context(upsample, parent=root, info_name=UPSAMPLE))
    own = {long_name(option) for option in configurable(ctx.command)} - NOT_INHERITED
    layers: list[Layer] = []
    for file in (None, *files):
        for target in targets:
            try:
                layer = _read_layer(target, environment, None if file is None else file.path)
            except UsageError as error:
                problems.append(str(error))
                layer = {}
            if target is not ctx:
                layer = {name: setting for name, setting in layer.items() if name in own}
            layers.append(layer)
    return layers


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


def _read_layer(ctx: click.Context, environment: Mapping[str, str], file: Path | None) -> Layer:
    """Read what a config file sets for a command, or the environment for None.

    Raises UsageError for mistakes in it.
    """
    names = _option_names(ctx.command)
    entries = _read_environment(ctx, environment) if file is None else _read_file(ctx, file)
    layer: Layer = {}
    for name, value, origin in entries:
        option, is_positive = names[name]
        held: Value | None = value
        if not is_positive:
            if option.is_flag:
                held = not value
            elif value:
                held = None
            else:
                continue  # `no-report = false` says nothing
        if (earlier := layer.get(long_name(option))) is not None:
            raise UsageError(f"{origin} says again what {earlier.origin} says; leave one out")
        place = "the environment" if file is None else str(file)
        layer[long_name(option)] = Setting(_path_of(ctx), option, held, place, origin)
    return layer


def _read_file(ctx: click.Context, file: Path) -> Iterator[tuple[str, Value, str]]:
    """Yield name, value and origin; UsageError for unknown tables and keys, and wrong types."""
    from exwarp_cli.io.files import read_toml  # most calls find no file

    try:
        document = read_toml(file)
    except OSError as error:
        raise UsageError(
            f"cannot read the config file {file}: {error.strerror or error}; check its rights, or "
            "go without it by --config none"
        ) from error
    except ValueError as error:
        raise UsageError(
            f"the config file {file} is not TOML: {error}; correct it, or go without it "
            "by --config none"
        ) from error
    title, names = ".".join(_path_of(ctx)), _option_names(ctx.command)
    for key, value in _command_table(document, file, ctx).items():
        origin = f"{key} in [{title}] of {file}"
        if key not in names:
            line = ctx.command_path
            arguments = [p.name or "" for p in ctx.command.params if isinstance(p, click.Argument)]
            if key in [name.replace("_", "-") for name in arguments]:
                problem = f"but stands on the command line of {line}; take it out"
                raise UsageError(f"{origin} is no option, {problem}")
            near = _did_you_mean(key, names) or f"; {line} --help lists them"
            raise UsageError(f"{origin} is no option of {line}{near}")
        option, is_positive = names[key]
        if is_positive:
            yield key, option_values.toml_value(option, value, file.parent, origin), origin
        elif isinstance(value, bool):
            yield key, value, origin
        else:
            raise UsageError(f"{origin} must be true or false; correct it")


def _read_environment(
    ctx: click.Context, environment: Mapping[str, str]
) -> Iterator[tuple[str, Value, str]]:
    """Yield name, value and variable; empty variables set nothing."""
    for name, (option, is_positive) in _option_names(ctx.command).items():
        variable = variable_name(_path_of(ctx), name)
        text = environment.get(variable, "")
        if not text:
            continue
        value: Value = text
        if option.is_flag or not is_positive:
            if text.strip().lower() not in _SWITCH_WORDS:
                raise UsageError(f"{variable} is {text!r}; write 1 or 0, for on or off")
            value = _SWITCH_WORDS[text.strip().lower()]
        elif option.multiple:
            # Paths and channels may hold commas, colons and spaces.
            value = tuple(word for part in text.split(";") if (word := part.strip()))
        yield name, value, variable


def _command_table(
    table: Mapping[str, object], file: Path, ctx: click.Context
) -> Mapping[str, object]:
    """Return the table of a command; UsageError for unknown names on the way to it."""
    group = ctx.parent
    if group is None:
        return table
    table, above = _command_table(table, file, group), _path_of(group)
    assert isinstance(group.command, click.Group)
    valid = group.command.list_commands(group)
    for key, value in table.items():
        title = f"[{'.'.join((*above, key))}]"
        if not isinstance(value, dict):
            place = f" in [{'.'.join(above)}]" if above else ""
            raise UsageError(
                f"{key}{place} of {file} stands in no command's table; write it under "
                f"the command's, such as [{'.'.join((*above, valid[0]))}]"
            )
        if key not in valid:
            near = _did_you_mean(key, valid)
            raise UsageError(
                f"{title} in {file} is no command of {' '.join(('exwarp', *above))}{near}"
            )
    below = table.get(ctx.info_name or "", {})
    assert isinstance(below, dict)
    return below


def _unknown_variables(environment: Mapping[str, str], ctx: click.Context) -> list[str]:
    """Return a warning for each variable that is named after a command and none of its options."""
    # No errors: a farm's environment is shared by versions that have other options.
    path = _path_of(ctx)
    valid = {variable_name(path, name) for name in _option_names(ctx.command)}
    return [
        f"{name} in the environment is no option of exwarp {' '.join(path)}"
        f"{_did_you_mean(name, valid)}"
        for name in sorted(environment)
        if name.startswith(variable_name(path)) and name not in valid
    ]


def _did_you_mean(name: str, valid: Collection[str]) -> str:
    near = difflib.get_close_matches(name, valid, n=1)
    return f"; did you mean {near[0]}?" if near else ""
