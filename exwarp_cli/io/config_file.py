"""Config files: ``exwarp.toml``, a table of options for each command.

::

    [upsample]
    method = "softsplat"
    metrics = ["psnr", "vmaf"]
    ground-truth = "truth/shot.####.exr"   # relative to the file's own folder
    tail = false

    [train.policy]
    steps = 20_000

The commands judge what the tables hold; here files are found and read.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exwarp_cli.domain.wording import first_line
from exwarp_cli.errors import UsageError

# The file's name in a project's folder and in the user's own.
NAME = "exwarp.toml"

# Named instead of a file, these mean no file at all.
NONE = ("", "none")


@dataclass(frozen=True)
class ConfigLocation:
    """The absolute path of a config file, and what led to it.

    `how` is "--config", "EXWARP_CONFIG", "nearest folder" or "user's own".
    """

    path: Path
    how: str


def find_config_files(
    named: str | None, how: str, user_folder: Path | None
) -> tuple[ConfigLocation, ...]:
    """Find the config files that hold, the strongest first.

    `named` is the file that the user names by `how`, "none" or "" for no file at all; None to look
    for the nearest one, in the current folder and those above it. The one in `user_folder`, None
    without a home folder, is the weakest.

    Raises UsageError if there is no file of that name, or it cannot be reached.
    """
    if named is not None and named.strip().lower() in NONE:
        return ()
    files: list[ConfigLocation] = []
    if named is not None:
        files.append(ConfigLocation(_named_path(named, how), how))
    else:
        folders: tuple[Path, ...] = ()
        with suppress(OSError):  # of a removed folder; the command reports what it needs of it
            folders = (Path.cwd(), *Path.cwd().parents)
        nearest = next((path for folder in folders if _is_file(path := folder / NAME)), None)
        if nearest is not None:
            files.append(ConfigLocation(nearest, "nearest folder"))
    if user_folder is not None:
        own = user_folder.absolute() / NAME
        if _is_file(own) and own.resolve() not in [file.path.resolve() for file in files]:
            files.append(ConfigLocation(own, "user's own"))
    return tuple(files)


def read_config_file(path: Path) -> dict[str, Any]:
    """Read the tables of a config file; UsageError if it cannot be read, or is not TOML."""
    try:
        return read_toml(path)
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


def _named_path(named: str, how: str) -> Path:
    remedy = "name a TOML file, or none to go without"
    try:
        path = Path(named).expanduser().absolute()
        if path.exists() and not path.is_dir():  # also a pipe, as in ``--config <(generate)``
            return path
        problem = "is a folder" if path.is_dir() else "does not exist"
    except RuntimeError as error:
        raise UsageError(f"{how} names {named}, and no user has that home; {remedy}") from error
    except OSError as error:
        raise UsageError(
            f"{how} names {named}, which cannot be reached: {error.strerror or error}; {remedy}"
        ) from error
    raise UsageError(f"{how} names {path}, which {problem}; {remedy}")


def _is_file(path: Path) -> bool:
    try:
        return path.exists() and not path.is_dir()
    except OSError:  # a folder above that may not be entered has nothing for us
        return False


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file, which may begin with the byte order mark that some editors write.

    Raises OSError if it cannot be read, ValueError with one line of text if it is not TOML.
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
