"""Write settings.md: every option of every command, config files and exit codes, from the code.

Usage, from the repository root: ``python docs/settings_page.py``. A test compares the page.
"""

from __future__ import annotations

import re
from pathlib import Path

import click

from exwarp_cli import cli, errors
from exwarp_cli.config import every_command

PAGE = Path(__file__).parent / "settings.md"
INTRODUCTION = """# Settings and exit codes

Written by `docs/settings_page.py`.

## Where settings come from

Every option may stand on the command line, in the environment, or in a file. The first of
these that sets it counts:

1. the command line;
2. the environment: `EXWARP_UPSAMPLE_METHOD=softsplat`; switches are 1 or 0, several values
   have `;` between;
3. `exwarp.toml` in this folder or the nearest one above, in the table of its command;
4. `~/.config/exwarp/exwarp.toml`.

```toml
[upsample]
method = "s6"
metrics = ["psnr", "vmaf"]
ground-truth = "truth/shot.####.exr"
```

Paths in a file begin at its folder. `--no-NAME` takes back what a file or the environment says
of `--NAME`. `--config none` ignores files. `--isolated` ignores the environment, too, as jobs on
farms do. `exwarp doctor` shows the settings in force.

| variable | meaning |
|---|---|
| `EXWARP_CONFIG` | the file to take options from, or `none` |
| `EXWARP_FILE_TIMEOUT` | seconds that reading one file may take; 600 by default |
| `EXWARP_SUPERVISE` | `0` keeps the command in one process, for a debugger |
| `NUMBA_CACHE_DIR` | folder of the compiled kernels; may lie on a share |
"""


def option_row(option: click.Option, context: click.Context) -> str:
    """Return the table row of an option: its names and value, and its help."""
    record = option.get_help_record(context)
    assert record is not None
    # The default of --max-pixels and the like is part of the help text.
    names, text = (re.sub(r"\s+", " ", part).replace("|", "\\|") for part in record)
    return f"| `{names}` | {text} |"


def command_section(context: click.Context) -> str:
    """Return the section of a command: its purpose, its usage and its options."""
    name, command = context.command_path, context.command
    usage = " ".join(command.collect_usage_pieces(context))
    purpose = (command.help or "").split("\n\n")[0].replace("\n", " ").replace("\x08", "")
    rows = [
        option_row(option, context)
        for option in command.get_params(context)
        if isinstance(option, click.Option) and not option.hidden
    ]
    table = "\n".join(["| option | meaning |", "|---|---|", *rows])
    return f"## {name}\n\n{purpose}\n\n    {name} {usage}\n\n{table}\n"


def exit_codes() -> str:
    """Return the table of exit codes, from the tree of errors."""
    meanings = {0: "done", errors.INTERRUPTED: "interrupted", 143: "terminated"}
    kinds = [errors.ExwarpError]
    for kind in kinds:
        kinds += kind.__subclasses__()
        first_line = (kind.__doc__ or "").splitlines()[0].rstrip(".")
        meanings.setdefault(kind.exit_code, first_line)
    meanings[errors.ExwarpError.exit_code] = "A defect of ExWarp: please report it"
    rows = [f"| {code} | {meanings[code]} |" for code in sorted(meanings)]
    return "\n".join(["## Exit codes", "", "| code | meaning |", "|---|---|", *rows, ""])


def settings_page() -> str:
    """Return the whole page as Markdown."""
    root = click.Context(cli.exwarp, info_name="exwarp")
    sections = [command_section(context) for context in every_command(root)]
    text = "\n".join([INTRODUCTION, exit_codes(), *sections])
    return text.replace(str(Path.home()), "~")


if __name__ == "__main__":
    PAGE.write_text(settings_page(), encoding="utf-8")
