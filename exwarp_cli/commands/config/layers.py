"""What config files and the environment set: their tables and variables, and which of them holds.

A name is the same everywhere: ``--ground-truth`` of ``exwarp upsample`` is ``ground-truth`` in the
table ``[upsample]`` and ``EXWARP_UPSAMPLE_GROUND_TRUTH`` in the environment. ``no-`` in front takes
back what something weaker sets: ``--no-report``, ``no-report = true``.
"""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import click

from exwarp_cli.commands.config.values import Value, from_environment, from_toml
from exwarp_cli.commands.option_names import long_name
from exwarp_cli.errors import UsageError
from exwarp_cli.io.config_file import ConfigFile

NOT_CONFIGURED = frozenset({"help", "version", "config", "isolated"})
"""Options that neither files nor the environment set."""

RIVALS = (
    frozenset({"overwrite", "skip-existing"}),
    frozenset({"factor", "to-fps"}),
    frozenset({"workers", "cluster"}),
    frozenset({"data", "tables"}),
)
"""Options that exclude each other: the stronger of two settings silences the other."""


@dataclass(frozen=True)
class Setting:
    """The value of an option, from a config file or the environment.

    Attributes
    ----------
    command
        Names of the groups and the command: ("train", "policy").
    option
        Its long name without dashes.
    parameter
        What the command calls it.
    value
        As the command line would give it; None takes back what weaker layers set.
    arguments
        The same written on a command line: ("--steps", "20000"), ("--no-tail",).
    source
        The file's path or the variable's name.
    origin
        The same with the key, for messages.
    """

    command: tuple[str, ...]
    option: str
    parameter: str
    value: Value | None
    arguments: tuple[str, ...]
    source: str
    origin: str

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


Layer = Mapping[str, Setting]
"""Settings of one file, or of the environment, by the long names of options."""


@dataclass(frozen=True)
class Named:
    """What a name stands for: an option, set or taken back."""

    option: click.Option
    positive: bool


def configurable(command: click.Command) -> list[click.Option]:
    """Return the options of a command that files and the environment can set."""
    options = (one for one in command.params if isinstance(one, click.Option) and not one.hidden)
    return [one for one in options if long_name(one) not in NOT_CONFIGURED]


def option_names(options: Iterable[click.Option]) -> dict[str, Named]:
    """Return every name that sets an option or takes it back, without dashes."""
    names: dict[str, Named] = {}
    for option in options:
        backwards = option.secondary_opts or [f"--no-{long_name(option)}"]
        for positive, spellings in ((True, option.opts), (False, backwards)):
            for name in spellings:
                if name.startswith("--"):
                    names[name.removeprefix("--")] = Named(option, positive)
    return names


def variable_name(command: Sequence[str], name: str = "") -> str:
    """Return the environment variable of an option, or what those of a command begin with."""
    return "_".join(("EXWARP", *command, name)).upper().replace("-", "_")


def file_layer(file: ConfigFile, groups: Sequence[Collection[str]], command: click.Command,
               path: tuple[str, ...]) -> Layer:  # fmt: skip
    """Read what a config file sets for a command.

    Parameters
    ----------
    file
        The file.
    groups
        The names that there are at each level above the command.
    command, path
        The command, and its name behind those of its groups.

    Raises
    ------
    UsageError
        For a table or key that there is not, and for a value of another type.
    """
    names = option_names(configurable(command))
    table = _table(file, groups, path)
    title = f"[{'.'.join(path)}]"
    found: dict[str, Setting] = {}
    for key, value in table.items():
        where = f"{key} in {title} of {file.path}"
        if key not in names:
            raise UsageError(_unknown_key(key, where, command, path, names))
        named = names[key]
        if named.positive:
            setting = from_toml(named.option, value, file.folder, where)
            _add(found, named, setting, str(file.path), where, path)
        elif not isinstance(value, bool):
            raise UsageError(f"{where} must be true or false; correct it")
        else:
            _add(found, named, value, str(file.path), where, path)
    return found


def environment_layer(
    environment: Mapping[str, str], command: click.Command, path: tuple[str, ...]
) -> Layer:
    """Read what the environment sets for a command; empty variables set nothing.

    Raises
    ------
    UsageError
        When a switch is neither on nor off.
    """
    found: dict[str, Setting] = {}
    for name, named in option_names(configurable(command)).items():
        variable = variable_name(path, name)
        text = environment.get(variable, "")
        if not text:
            continue
        if named.positive:
            value = from_environment(named.option, text, variable)
        else:
            value = from_environment(_SWITCH, text, variable)
        _add(found, named, value, variable, variable, path)
    return found


def unknown_variables(
    environment: Mapping[str, str], command: click.Command, path: tuple[str, ...]
) -> list[str]:
    """Say which variables are named after a command and none of its options.

    They are no errors: a farm's environment is shared by versions that have other options.
    """
    known = {variable_name(path, name) for name in option_names(configurable(command))}
    strange = (name for name in environment if name.startswith(variable_name(path)))
    return [
        f"{name} in the environment is no option of exwarp {' '.join(path)}{_nearest(name, known)}"
        for name in sorted(strange)
        if name not in known
    ]


def in_force(layers: Iterable[Layer], given: Mapping[str, bool]) -> list[Setting]:
    """Choose what holds out of layers, the strongest first.

    Parameters
    ----------
    layers
        Settings of the environment, then of the files.
    given
        What the command line says: names of options, and whether they are on; False where one is
        switched off or taken back.
    """
    settled = set(given)
    active = {name for name, on in given.items() if on}
    chosen: list[Setting] = []
    for layer in layers:
        fresh = [
            setting
            for name, setting in layer.items()
            if name not in settled and not any(name in one and one & active for one in RIVALS)
        ]
        chosen += [setting for setting in fresh if setting.value is not None]
        active |= {setting.option for setting in fresh if setting.value not in (None, False)}
        settled |= layer.keys()
    return chosen


_SWITCH = click.Option(["--switch"], is_flag=True)


def _table(
    file: ConfigFile, groups: Sequence[Collection[str]], path: Sequence[str]
) -> Mapping[str, object]:
    """Return the table of a command, having looked at the names above and beside it."""
    table: Mapping[str, object] = file.tables
    for depth, (known, name) in enumerate(zip(groups, path, strict=True)):
        for key, value in table.items():
            title = f"[{'.'.join((*path[:depth], key))}]"
            if not isinstance(value, dict):
                place = f" in [{'.'.join(path[:depth])}]" if depth else ""
                raise UsageError(
                    f"{key}{place} of {file.path} stands in no command's table; write it under "
                    f"the command's, such as [{'.'.join((*path[:depth], next(iter(known))))}]"
                )
            if key not in known:
                group = " ".join(("exwarp", *path[:depth]))
                raise UsageError(
                    f"{title} in {file.path} is no command of {group}{_nearest(key, known)}"
                )
        below = table.get(name, {})
        assert isinstance(below, dict)
        table = below
    return table


def _unknown_key(
    key: str, where: str, command: click.Command, path: Sequence[str], names: Mapping[str, Named]
) -> str:
    called = " ".join(("exwarp", *path))
    arguments = (one for one in command.params if isinstance(one, click.Argument))
    if key in {(one.name or "").replace("_", "-") for one in arguments}:
        return f"{where} is no option, but stands on the command line of {called}; take it out"
    near = _nearest(key, names)
    return f"{where} is no option of {called}{near or f'; {called} --help lists them'}"


def _nearest(name: str, known: Collection[str]) -> str:
    """Name what was probably meant."""
    near = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _add(
    found: dict[str, Setting], named: Named, value: Value, source: str, origin: str,
    path: tuple[str, ...],
) -> None:  # fmt: skip
    """Put a value among the settings of a layer."""
    option = long_name(named.option)
    held: Value | None = value
    if not named.positive:
        if named.option.is_flag:
            held = not value
        elif value:
            held = None
        else:  # `no-report = false` says nothing
            return
    if option in found:
        raise UsageError(f"{origin} says again what {found[option].origin} says; leave one out")
    words = _arguments(named.option, held)
    found[option] = Setting(path, option, named.option.name or "", held, words, source, origin)


def _arguments(option: click.Option, value: Value | None) -> tuple[str, ...]:
    """Write a value as on a command line."""
    name = f"--{long_name(option)}"
    if value is None or value is False:
        return (option.secondary_opts[0] if option.secondary_opts else f"--no-{long_name(option)}",)
    if value is True:
        return (name,)
    if isinstance(value, str):
        return (name, value)
    if option.multiple:
        return tuple(word for one in value for word in (name, one))
    return (name, *value)


def describe(settings: Iterable[Setting]) -> str:
    """Say what each source adds to a command line, in one line."""
    by_source: dict[str, list[str]] = {}
    for setting in settings:
        words = by_source.setdefault(setting.place, [])
        words += setting.arguments
    return "; ".join(f"from {place}: {shlex.join(words)}" for place, words in by_source.items())
