"""The command ``exwarp``: finds its subcommand, and turns every error into one sentence.

Commands are imported when they run, so that ``exwarp --help`` loads neither numpy nor numba.
"""

from __future__ import annotations

import atexit
import importlib
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import NoReturn

import click

from exwarp_cli import __version__, errors
from exwarp_cli.domain.wording import one_line
from exwarp_cli.option_values import CONFIG_ATTRIBUTES
from exwarp_cli.runtime.compilation import compilation
from exwarp_cli.runtime.stop import StopRequested, graceful_stop
from exwarp_cli.standard_streams import is_debugging, prepare_streams
from exwarp_cli.supervisor import FORWARDED_SIGNALS, ChildExit, fork_command, is_supervised

# Every command by its module in `exwarp_cli.commands`, with its line in ``exwarp --help``.
COMMANDS = {
    "upsample": "Write four frames for every rendered one.",
    "inspect": "Show what a sequence holds and how its motion is read.",
    "features": "Print what the policy sees of a sequence, as CSV.",
    "compare": "Score a sequence against ground truth.",
    "merge-reports": "Join the reports of chunks into one.",
    "farm": "Write jobs for render farms, and lists of chunks.",
    "bench": "Measure all methods: every table and figure of the paper.",
    "train": "Train the networks on rendered scenes (extra: train).",
    "models": "Make networks of others fit for upsample.",
    "policy": "Look into the learned policy and its accelerator.",
    "doctor": "Check the installation.",
    "completion": "Print what completes commands and options in a shell.",
}

EPILOG = """Run 'exwarp COMMAND --help' for the options of a command.

Options may also stand in exwarp.toml, in the table of their command ([upsample] method =
"softsplat"; paths are relative to the file), or in the environment
(EXWARP_UPSAMPLE_METHOD=softsplat; switches are 1 or 0, several values have ';' between).
The command line wins over the environment, that over the file of this folder or the nearest above,
that over USERS_FILE. --no-NAME takes back what these say of --NAME, and 'exwarp doctor' shows it.

Exit codes: 0 done, 2 options, 3 input, 4 motion convention unknown, 5 output, 6 frames in the way,
7 missing extra, 8 quality below a limit, 9 cluster, 10 installation, 11 out of memory or threads,
12 intervals left out, 130 interrupted, 143 terminated, 1 a defect of ExWarp.
""".replace("USERS_FILE", f"{click.get_app_dir('exwarp')}/exwarp.toml")

DEFECT = 1
RENDER_AGAIN = "render, export or copy that file again"
TERMINATED = 128 + signal.SIGTERM


class LazyGroup(click.Group):
    """A group that lists commands by the table, and imports one when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands, in the order of the table."""
        return list(COMMANDS)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str, click.Command, list[str]]:
        """Import the command of the first word; UsageError where there is none of that name."""
        name, *rest = args
        if name not in COMMANDS:
            if ctx.resilient_parsing:  # a shell asks for completions, and there are none
                return name, click.Command(name), rest
            ctx.fail(f"there is no command {name!r}; the commands are {', '.join(COMMANDS)}")
        from exwarp_cli.commands.options import with_settings

        module = importlib.import_module(f"exwarp_cli.commands.{name.replace('-', '_')}")
        command = with_settings(module.command, (name,), completing=ctx.resilient_parsing)
        return name, command, rest


@click.group(
    cls=LazyGroup,
    # For help and completion alone: `resolve_command` imports the real ones.
    commands={name: click.Command(name, short_help=text) for name, text in COMMANDS.items()},
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=EPILOG,
)
@click.option("--config", **CONFIG_ATTRIBUTES)
@click.version_option(__version__, prog_name="exwarp", message="%(prog)s %(version)s")
@click.pass_context
def exwarp(ctx: click.Context, config: str | None) -> None:
    """Upsample rendered EXR sequences to four times their frame rate."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def main() -> NoReturn:
    """Run the command line of this process and exit with its code."""
    # OpenEXR, farms and renderers name files in UTF-8, whatever the locale of this terminal is. So
    # start again in Python's UTF-8 mode where the locale has another encoding.
    is_utf8 = os.name == "nt" or sys.getfilesystemencoding() == "utf-8"
    if not is_utf8 and "PYTHONUTF8" not in os.environ and sys.executable:
        os.environ["PYTHONUTF8"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    codes: list[int] = []
    if is_supervised():
        atexit.register(_exit_now, codes)  # before all others, which run before it
    # BLAS would begin a thread a core with numpy, for products that are small here: 0.04 s.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    prepare_streams()
    if not is_debugging():
        # numpy warns of overflow, with a line of code, for values that no renderer means.
        warnings.simplefilter("ignore")
    args = sys.argv[1:]
    child_exit = None
    try:
        # Help and completions read no files, so they need no parent process.
        if set(COMMANDS) & set(args) and not {"-h", "--help"} & set(args):
            child_exit = fork_command(_print_message)
    except OSError as error:
        code = _report_error(error, args, {})
    else:
        code = run(args, is_last=True) if child_exit is None else _report_exit(child_exit, args)
    try:
        sys.stdout.flush()
    except errors.OutputError as error:
        code = code or _fail(str(error), error.exit_code)
    codes.append(code)
    sys.exit(code)


def _exit_now(codes: list[int]) -> None:
    """End this process, if its code is known, without taking the interpreter apart: 0.1 s.

    Its threads have ended by now, and the other exit handlers are done.
    """
    for code in codes:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, errors.OutputError, ValueError, AttributeError):
                stream.flush()
        os._exit(code)


def _report_exit(child_exit: ChildExit, args: list[str]) -> int:
    """Report how the child ended where it could not do so itself; return the exit code."""
    if child_exit.code >= 0:
        return child_exit.code
    ended_by = signal.Signals(-child_exit.code)
    if ended_by in FORWARDED_SIGNALS:
        signal.signal(ended_by, signal.SIG_DFL)
        os.kill(os.getpid(), ended_by)
    hint = _resume_hint(args)
    if child_exit.overdue:
        return _fail(
            f"{child_exit.reason}, so it was ended; {RENDER_AGAIN}, or allow more; {hint}",
            errors.DamagedFileError.exit_code,
        )
    if child_exit.stopped:  # libraries crash when they are broken off: that is of no interest
        return _report_error(StopRequested(child_exit.stopped), args, {})
    if ended_by == signal.SIGKILL:
        while_reading = f" while it read {child_exit.files}" if child_exit.reading else ""
        return _fail(
            f"the process that worked was killed{while_reading}, as systems do that run out of "
            f"memory; close other programs, or use fewer threads; {hint}",
            errors.OutOfMemoryError.exit_code,
        )
    if child_exit.reading:
        return _fail(
            f"{child_exit.reason}; {RENDER_AGAIN}; {hint}", errors.DamagedFileError.exit_code
        )
    return _fail(
        f"a library crashed ({ended_by.name}); this is a defect of ExWarp or of what it uses, "
        f"please report it; {hint}",
        DEFECT,
    )


def run(args: list[str], is_last: bool = False) -> int:
    """Run a command line and return the exit code; errors are printed to stderr.

    With `is_last` the process ends afterwards, and signals are ignored from there on.
    """
    origins: dict[str, str] = {}  # of options that files and the environment set, by name

    stops = graceful_stop(partial(_last_words, args), is_last)
    try:
        with stops, compilation.messages_to(_print_message):
            try:
                result = exwarp.main(args, prog_name="exwarp", standalone_mode=False, obj=origins)
            except click.exceptions.NoArgsIsHelpError as error:  # a group without a command
                click.echo(error.format_message())
                return 0
        return result if isinstance(result, int) else 0
    except (Exception, KeyboardInterrupt, StopRequested) as error:
        return _report_error(error, args, origins)


def _report_error(error: BaseException, args: list[str], origins: Mapping[str, str]) -> int:
    """Print the sentence for an error that ended a command; return the exit code."""
    if isinstance(error, StopRequested | KeyboardInterrupt | click.Abort):
        number = error.number if isinstance(error, StopRequested) else signal.SIGINT
        if is_debugging():
            traceback.print_exc()
        click.echo(_last_words(args, number), err=True)
        return errors.INTERRUPTED if number == signal.SIGINT else TERMINATED
    if isinstance(error, MemoryError):
        return _fail(
            "the memory does not suffice; close other programs, or use fewer threads",
            errors.OutOfMemoryError.exit_code,
        )
    hint = ""
    if isinstance(error, click.ClickException):
        sentence, code = error.format_message().rstrip("."), error.exit_code
        if isinstance(error, click.UsageError) and error.ctx is not None:
            hint = f"; see {error.ctx.command_path} --help"
    elif (user_error := errors.to_exwarp_error(error)) is not None:
        sentence, code = str(user_error), user_error.exit_code
    else:
        return _fail(
            f"unexpected {type(error).__name__}: {error}; this is a defect of ExWarp, please "
            "report it with the details that EXWARP_DEBUG=1 in the environment shows",
            DEFECT,
        )
    # Where the options in the sentence were set, if not on the command line.
    names = (name for name in origins if re.search(rf"(?<![\w-]){name}(?![\w-])", sentence))
    where = [f"{name} is set by {origins[name]}" for name in names if origins[name] not in sentence]
    return _fail(f"{'; '.join((sentence, *where))}{hint}", code)


def _last_words(args: list[str], number: int) -> str:
    if number == signal.SIGINT:  # a blank line, which parts it from the terminal's own "^C"
        return f"\nexwarp: error: interrupted; {_resume_hint(args)}"
    return f"exwarp: error: terminated; {_resume_hint(args)}"


def _resume_hint(args: list[str]) -> str:
    """Return what a stopped command leaves, and how to go on."""
    hints = {
        "upsample": "frames written so far are whole, and --skip-existing goes on from there",
        "bench": "what was measured so far is kept, and the same command goes on from there",
    }
    default = "what was written so far is whole; run the command again"
    return hints.get(next((word for word in args if word in COMMANDS), ""), default)


def _fail(sentence: str, code: int) -> int:
    if is_debugging():
        traceback.print_exc()
    if sentence:
        _print_message(f"error: {sentence}")
    return code


def _print_message(sentence: str) -> None:
    with suppress(OSError, errors.OutputError):  # a stream that fails is no reason to end the work
        click.echo(f"exwarp: {one_line(sentence)}", err=True)
