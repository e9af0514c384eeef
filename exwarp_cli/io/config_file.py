"""Config files: ``exwarp.toml``, a table of options for each command.

::

    [upsample]
    method = "softsplat"
    metrics = ["psnr", "vmaf"]
    ground-truth = "truth/shot.####.exr"   # relative to the file's own folder
    tail = false

    [train.policy]
    steps = 20_000

What the tables may hold is for the commands to say; here files are found and read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exwarp_cli.domain.wording import first_line
from exwarp_cli.errors import UsageError

NAME = "exwarp.toml"
"""What the file is called, in a project's folder and in the user's own."""

NONE = ("", "none")
"""What is named instead of a file for no file at all."""


@dataclass(frozen=True)
class FoundFile:
    """A config file, and why it is one.

    Attributes
    ----------
    path
        Absolute.
    how
        What led to it: "--config", "EXWARP_CONFIG", "nearest folder" or "user's own".
    """

    path: Path
    how: str


@dataclass(frozen=True)
class ConfigFile:
    """What a config file says, not yet judged.

    Attributes
    ----------
    path
        Absolute.
    tables
        The whole document.
    """

    path: Path
    tables: Mapping[str, Any] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """What its relative paths begin at."""
        return self.path.parent


def found_files(named: str | None, how: str, user_folder: Path | None) -> tuple[FoundFile, ...]:
    """Find the config files that hold, the strongest first.

    Parameters
    ----------
    named
        The file that the user names, "none" or "" for no file at all; None to look for the nearest
        one, in the current folder and those above it.
    how
        Where it is named.
    user_folder
        Where the user's own file lies, which is weaker than any other; None without a home folder.

    Raises
    ------
    UsageError
        When there is no file of that name, or it cannot be reached.
    """
    if named is not None and named.strip().lower() in NONE:
        return ()
    nearest = _nearest() if named is None else FoundFile(_named(named, how), how)
    found = [] if nearest is None else [nearest]
    if user_folder is None:
        return tuple(found)
    own = FoundFile(user_folder.absolute() / NAME, "user's own")
    if _is_file(own.path) and not (nearest and nearest.path.resolve() == own.path.resolve()):
        found.append(own)
    return tuple(found)


def read_config_file(path: Path) -> ConfigFile:
    """Read a config file.

    Raises
    ------
    UsageError
        When it cannot be read, or is not TOML.
    """
    try:
        return ConfigFile(path, read_toml(path))
    except OSError as error:
        raise UsageError(
            f"cannot read the config file {path}: {error.strerror or error}; check its rights, or "
            "go without it by --config none"
        ) from error
    except ValueError as error:
        raise UsageError(
            f"the config file {path} is not TOML: {error}; correct it, or go without it "
            "by --config none"
        ) from error


def _nearest() -> FoundFile | None:
    """Find the file of the current folder, or of the nearest one above that has one."""
    try:
        here = Path.cwd()
    except OSError:  # the folder was removed; what the command needs of it, it will tell itself
        return None
    paths = (folder / NAME for folder in (here, *here.parents))
    return next((FoundFile(path, "nearest folder") for path in paths if _is_file(path)), None)


def _named(named: str, how: str) -> Path:
    remedy = "name a TOML file, or none to go without"
    try:
        path = Path(named).expanduser().absolute()
        if path.exists() and not path.is_dir():  # also a pipe, as in ``--config <(generate)``
            return path
        found = "is a folder" if path.is_dir() else "does not exist"
    except RuntimeError as error:
        raise UsageError(f"{how} names {named}, and no user has that home; {remedy}") from error
    except OSError as error:
        raise UsageError(
            f"{how} names {named}, which cannot be reached: {error.strerror or error}; {remedy}"
        ) from error
    raise UsageError(f"{how} names {path}, which {found}; {remedy}")


def _is_file(path: Path) -> bool:
    """Whether there is a file that may be one of settings."""
    try:
        return path.exists() and not path.is_dir()
    except OSError:  # a folder above that may not be entered has nothing for us
        return False


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file, which may begin with the mark that some editors write.

    Raises
    ------
    OSError
        When it cannot be read.
    ValueError
        When it is not TOML; the text says why and where, in one line.
    """
    import tomllib  # every command looks for config files, and most find none

    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start} is no UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        line = first_line(error)
        raise ValueError(line[:1].lower() + line[1:]) from error
    except RecursionError as error:
        raise ValueError("arrays or tables stand too deep in each other") from error
    except ValueError as error:  # of Python itself, which reads no number of thousands of digits
        raise ValueError(first_line(error)) from error
