"""TOML files that people write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from exwarp_cli.domain.wording import first_line


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
