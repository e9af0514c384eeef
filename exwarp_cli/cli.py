"""The command ``exwarp``: finds its subcommand, and turns what goes wrong into one sentence.

Commands are imported when they run, so that ``exwarp --help`` loads neither numpy nor numba.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

import click

from exwarp_cli import __version__
from exwarp_cli.errors import INTERRUPTED, ExwarpError

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
"""Every command by its module in `exwarp_cli.commands`, with what ``exwarp --help`` says of it."""

DEFECT = 1
TERMINATED = 128 + signal.SIGTERM


class Terminated(BaseException):
    """SIGTERM arrived; not an `Exception`, so that nothing on the way takes it for a failure."""


class LazyGroup(click.Group):
    """A group that imports a command when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands, in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"exwarp_cli.commands.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the arguments name."""
        if args[0] not in COMMANDS:
            ctx.fail(f"there is no command {args[0]!r}; the commands are {', '.join(COMMANDS)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Run 'exwarp COMMAND --help' for the options of a command.",
)
@click.version_option(__version__, prog_name="exwarp", message="%(prog)s %(version)s")
@click.pass_context
def exwarp(ctx: click.Context) -> None:
    """Upsample rendered EXR sequences to four times their frame rate."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def main() -> NoReturn:
    """Run the command line of this process and exit with its code."""
    code = run(sys.argv[1:])
    try:
        sys.stdout.flush()
    except BrokenPipeError:  # as in `exwarp inspect … | head`: the reader has what it wanted
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def run(args: list[str]) -> int:
    """Run a command line and return the exit code; errors are printed to stderr."""
    try:
        with _terminable():
            result = exwarp.main(args, prog_name="exwarp", standalone_mode=False)
        return result if isinstance(result, int) else 0
    except ExwarpError as error:
        return _fail(str(error), error.exit_code)
    except click.ClickException as error:
        return _fail(_with_hint(error), error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        return _fail(f"interrupted; {_afterwards(args)}", INTERRUPTED)
    except Terminated:
        return _fail(f"terminated; {_afterwards(args)}", TERMINATED)
    except MemoryError:
        return _fail(
            "the memory does not suffice; close other programs, or use fewer threads", DEFECT
        )
    except Exception as error:
        return _fail(
            f"unexpected {type(error).__name__}: {error}; this is a defect of ExWarp, please "
            "report it with the details that EXWARP_DEBUG=1 in the environment shows",
            DEFECT,
        )


def _afterwards(args: list[str]) -> str:
    """Say what a stopped command leaves, and how to go on."""
    return {
        "upsample": "frames written so far are whole, and --skip-existing goes on from there",
        "bench": "what was measured so far is kept, and the same command goes on from there",
    }.get(next(iter(args), ""), "what was written so far is whole; run the command again")


def _fail(sentence: str, code: int) -> int:
    if os.environ.get("EXWARP_DEBUG", "0") not in ("", "0"):
        traceback.print_exc()
    click.echo(f"exwarp: error: {sentence}", err=True)
    return code


def _with_hint(error: click.ClickException) -> str:
    """Name the help of the command in whose options the mistake is."""
    sentence = error.format_message().rstrip(".")
    context = error.ctx if isinstance(error, click.UsageError) else None
    return sentence if context is None else f"{sentence}; see {context.command_path} --help"


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM raise in the main thread, so that temporary files are removed on the way out."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals cannot be caught here, and are the embedding program's business
        return
    before = signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _terminate(_number: int, _frame: FrameType | None) -> NoReturn:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not break off the clean-up
    raise Terminated
