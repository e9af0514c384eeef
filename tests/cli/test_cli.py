"""The command as a process: help, exit codes, signals, start-up time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from types import SimpleNamespace

import click
import pytest

import exwarp_cli
from exwarp_cli import cli
from exwarp_cli.errors import ExwarpError, InputError

WITH_COMMAND = """
import sys, types, click
from exwarp_cli import cli
@click.command()
def upsample():
{body}
module = types.ModuleType("exwarp_cli.commands.upsample")
module.command = upsample
sys.modules["exwarp_cli.commands.upsample"] = module
sys.argv[1:] = ["upsample"]
cli.main()
"""


def script(body: str) -> list[str]:
    """Return a command line that runs `exwarp upsample` with this body."""
    text = WITH_COMMAND.format(body=textwrap.indent(textwrap.dedent(body), "    "))
    return [sys.executable, "-c", text]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "exwarp_cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def fails_with(monkeypatch):
    """Make `exwarp upsample` raise an error."""

    def install(error: BaseException) -> None:
        @click.command()
        def upsample() -> None:
            raise error

        monkeypatch.setattr(
            cli.importlib, "import_module", lambda name: SimpleNamespace(command=upsample)
        )

    monkeypatch.delenv("EXWARP_DEBUG", raising=False)
    return install


def every_error(kind: type[ExwarpError] = ExwarpError) -> list[type[ExwarpError]]:
    return [kind, *(e for below in kind.__subclasses__() for e in every_error(below))]


@pytest.mark.parametrize("parted", ["0", "1"])
def test_what_is_to_be_done_last_is_done(parted):
    """The interpreter is not taken apart, but threads end, handlers run, and nothing is unsaid."""
    body = """
        import atexit, threading, time
        atexit.register(print, "handled")
        threading.Thread(target=lambda: (time.sleep(0.3), print("threaded"))).start()
        sys.stderr.write("written")
        raise click.exceptions.Exit(7)
    """
    environment = os.environ | {"EXWARP_SUPERVISE": parted}
    result = subprocess.run(script(body), capture_output=True, text=True, env=environment)
    assert (result.returncode, result.stderr) == (7, "written")
    assert result.stdout.split() == ["threaded", "handled"]


class TestHelp:
    @pytest.mark.parametrize("arguments", [["--help"], ["-h"], []])
    def test_it_lists_every_command(self, arguments):
        result = run(*arguments)
        assert result.returncode == 0 and result.stderr == ""
        for name, text in cli.COMMANDS.items():
            assert name in result.stdout and text in result.stdout

    def test_version(self):
        assert run("--version").stdout == f"exwarp {exwarp_cli.__version__}\n"

    def test_help_imports_nothing_heavy(self):
        code = (
            "import sys; from exwarp_cli import cli; cli.run(['--help']); "
            "heavy = ('numpy', 'numba', 'rich', 'fileseq', 'OpenEXR', 'onnxruntime'); "
            "print([m for m in sys.modules if m.split('.')[0] in heavy "
            "or m.startswith('exwarp_cli.c')])"
        )
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert result.stdout.splitlines()[-1] == "['exwarp_cli.cli']"

    def test_help_of_a_command_imports_nothing_heavy_either(self):
        code = (
            "import sys; from exwarp_cli import cli\n"
            "heavy = ('numpy', 'numba', 'rich', 'fileseq', 'OpenEXR', 'onnxruntime')\n"
            "for name in cli.COMMANDS:\n"
            "    cli.run([name, '-h'])\n"
            "    print(name, 'imports', [m for m in sys.modules if m.split('.')[0] in heavy])\n"
        )
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        for name in cli.COMMANDS:
            assert f"exwarp {name}" in result.stdout
            assert f"\n{name} imports []\n" in result.stdout

    def test_what_a_decision_costs_is_printed_without_the_pipeline(self):
        code = (
            "import sys; from exwarp_cli import cli; cli.run(['policy', 'cycles']); "
            "print([m for m in sys.modules if m in ('OpenEXR', 'exwarp_cli.pipeline.job')])"
        )
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert result.stdout.splitlines()[-1] == "[]"

    def test_help_starts_at_once(self):
        resource = pytest.importorskip("resource", reason="processor times of POSIX")

        def processor_time(*arguments: str) -> float:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

        # 0.04 s against 0.01 s. The best of several; importing numpy would double it, and numba add
        # four times as much again.
        pairs = [
            (processor_time("-m", "exwarp_cli", "--help"), processor_time("-c", "pass"))
            for _ in range(5)
        ]
        ours, bare = (min(times) for times in zip(*pairs, strict=True))
        assert ours < 8 * bare


class TestErrors:
    def test_codes_are_those_of_the_table(self):
        codes = {error.__name__: error.exit_code for error in every_error()}
        assert codes == {
            "ExwarpError": 1, "UsageError": 2, "InputError": 3, "MissingFrameError": 3,
            "DamagedFileError": 3, "LayoutError": 3, "UnreadableError": 3, "MotionError": 4,
            "OutputError": 5,
            "OutputExistsError": 6, "MissingExtraError": 7, "QualityError": 8,
            "ClusterError": 9, "InstallationError": 10, "OutOfMemoryError": 11,
            "IncompleteError": 12, "ReaderGoneError": 5,
        }  # fmt: skip

    @pytest.mark.parametrize("kind", every_error())
    def test_each_becomes_one_sentence_and_its_code(self, kind, fails_with, capsys):
        fails_with(kind("frame 7 is missing; render it"))
        assert cli.run(["upsample"]) == kind.exit_code
        assert capsys.readouterr() == ("", "exwarp: error: frame 7 is missing; render it\n")

    def test_a_defect_asks_for_a_report(self, fails_with, capsys):
        fails_with(ZeroDivisionError("oops"))
        assert cli.run(["upsample"]) == 1
        message = capsys.readouterr().err
        assert message.startswith("exwarp: error: unexpected ZeroDivisionError: oops; ")
        assert "EXWARP_DEBUG=1" in message and "Traceback" not in message
        assert message.count("\n") == 1

    def test_the_traceback_comes_on_demand(self, fails_with, capsys, monkeypatch):
        monkeypatch.setenv("EXWARP_DEBUG", "1")
        fails_with(ZeroDivisionError("oops"))
        assert cli.run(["upsample"]) == 1
        assert "Traceback" in capsys.readouterr().err

    def test_memory_is_no_defect(self, fails_with, capsys):
        fails_with(MemoryError())
        assert cli.run(["upsample"]) == 11
        assert "memory" in capsys.readouterr().err

    def test_an_interruption(self, fails_with, capsys):
        fails_with(KeyboardInterrupt())
        assert cli.run(["upsample"]) == 130
        assert "exwarp: error: interrupted; " in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("command", "resumes"),
        [
            ("upsample", "--skip-existing goes on"),
            ("bench", "same command goes on"),
            ("compare", ""),
        ],
    )
    @pytest.mark.parametrize("before", [(), ("--config", "none")])
    def test_what_an_interruption_leaves(self, fails_with, capsys, command, resumes, before):
        fails_with(KeyboardInterrupt())
        assert cli.run([*before, command]) == 130
        message = capsys.readouterr().err
        assert resumes in message and ("goes on" in message) == bool(resumes)

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["up"], "no command 'up'; the commands are upsample, inspect, features, compare"),
            (["--bogus"], "--bogus"),
        ],
    )
    def test_mistakes_in_the_command_line(self, arguments, words, capsys):
        assert cli.run(arguments) == 2
        err = capsys.readouterr().err
        assert err.startswith("exwarp: error: ") and words in err
        assert err.endswith("; see exwarp --help\n") and err.count("\n") == 1

    def test_a_command_may_exit_with_its_own_code(self, monkeypatch):
        @click.command()
        @click.pass_context
        def inspect(ctx: click.Context) -> None:
            ctx.exit(9)

        monkeypatch.setattr(
            cli.importlib, "import_module", lambda name: SimpleNamespace(command=inspect)
        )
        assert cli.run(["inspect"]) == 9


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
class TestSignals:
    BODY = """
    import time
    from pathlib import Path
    from exwarp_cli.io.files import atomic_path
    from exwarp_cli.runtime.stop import check_stop
    with atomic_path(Path({target!r})) as temporary:
        temporary.write_text("half")
        click.echo("ready")
        while True:
            check_stop()
            time.sleep(0.01)
    """

    STOPS = pytest.mark.parametrize(
        ("number", "code", "word"),
        [(signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "interrupted")],
    )

    def require_stopped(self, body, number, code, word):
        """Send a signal to a command that says when it is ready; it tells that in one sentence."""
        with subprocess.Popen(
            script(body), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout.readline() == "ready\n"
            process.send_signal(number)
            err = process.stderr.read()
        assert process.returncode == code
        assert err.strip().startswith(f"exwarp: error: {word}; ") and err.strip().count("\n") == 0

    @STOPS
    def test_temporaries_go_and_one_sentence_stays(self, tmp_path, number, code, word):
        body = self.BODY.format(target=str(tmp_path / "a.exr"))
        self.require_stopped(body, number, code, word)
        assert list(tmp_path.iterdir()) == []

    @STOPS
    def test_a_library_that_crashes_when_it_is_broken_off_is_no_defect(self, number, code, word):
        body = """
            import os, time
            from exwarp_cli.runtime.stop import StopRequested, check_stop
            try:
                click.echo("ready")
                while True:
                    check_stop()
                    time.sleep(0.01)
            except StopRequested:
                os.abort()
        """
        self.require_stopped(body, number, code, word)

    def test_a_reader_that_leaves_is_no_error_to_talk_about(self):
        command = script("for i in range(100_000): click.echo(f'line {i}')")
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout.readline() == "line 0\n"
            process.stdout.close()
            assert process.stderr.read() == ""

    def test_the_handler_of_an_embedding_program_comes_back(self, fails_with):
        before = signal.getsignal(signal.SIGTERM)
        fails_with(InputError("x"))
        cli.run(["upsample"])
        assert signal.getsignal(signal.SIGTERM) is before
