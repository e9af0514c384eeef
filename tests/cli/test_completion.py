"""Completion: what is offered, and that shells take it; a shell that is not here is skipped."""

from __future__ import annotations

import os
import re
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.shell_completion import BashComplete

from exwarp_cli import cli
from exwarp_cli.commands import completion
from exwarp_cli.commands.completion import SHELLS
from tests.cli.config.commands import EVERY_OPTION

SCRIPT = """#!/bin/sh
exec {python} -m exwarp_cli "$@"
"""


@pytest.fixture
def offered(tmp_path, monkeypatch):
    """Return what is offered for the last word, as "value", or "<file>" and "<dir>"."""
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> list[str]:
        shell = BashComplete(cli.exwarp, {"obj": {}}, "exwarp", "_EXWARP_COMPLETE")
        items = shell.get_completions(list(words[:-1]), words[-1])
        return [one.value if one.type == "plain" else f"<{one.type}>" for one in items]

    return run


class TestOffers:
    def test_commands(self, offered):
        assert offered("") == list(cli.COMMANDS)
        assert offered("m") == ["merge-reports", "models"]
        assert offered("train", "") == [
            *("extrapolator", "look-ahead-policy", "lookahead", "policy", "tile-policy"),
        ]
        assert offered("--co") == ["--config"]
        assert offered("--config", "x", "up") == ["upsample"]

    def test_options(self, offered):
        assert set(offered("upsample", "--me")) == {"--method", "--metrics"}
        assert offered("upsample", "--no-") == ["--no-gate", "--no-tail"]
        assert "--config" in offered("upsample", "-")

    @pytest.mark.parametrize(
        ("words", "wanted"),
        [
            (("upsample", "--method", "sof"), ["softsplat"]),
            (("upsample", "-m", "oracle"), ["oracle", "oracle-return"]),
            (("upsample", "--method=sof"), ["softsplat"]),
            (("upsample", "--metrics", "psnr,v"), ["psnr,vmaf"]),
            (("upsample", "--metrics", "psnr,p"), ["psnr,pulse"]),
            (("upsample", "--metrics", "psnr,ps"), []),
            (("upsample", "--motion", "unreal"), ["unreal", "unreal-mrq"]),
            (("upsample", "--compression", "dw"), ["dwaa", "dwab"]),
            (("upsample", "--progress", "j"), ["json"]),
            (("upsample", "--device", "c"), ["cpu", "cuda"]),
            (("upsample", "--aov", "mo"), ["motion="]),
            (("compare", "--preset", ""), ["extranet"]),
            (("compare", "--fail-below", "worst."), ["worst.psnr=", "worst.ssim=", "worst.vmaf="]),
            (("bench", "--systems", "s1,s"), ["s1,s2", "s1,s3", "s1,s4", "s1,s5", "s1,s6"]),
            (("completion", ""), list(SHELLS)),
        ],
    )
    def test_values(self, words, wanted, offered):
        assert set(wanted) <= set(offered(*words)) and (wanted or not offered(*words))

    @pytest.mark.parametrize(
        "words",
        [
            ("upsample", "sh"),
            ("upsample", "-o", ""),
            ("upsample", "--ground-truth", "tr"),
            ("upsample", "--gbuffers", "tr"),
            ("upsample", "--channel-map", "tr"),
            ("upsample", "--policy", "tr"),
            ("upsample", "--config", "ex"),
            ("--config", "ex"),
            ("compare", "a", "b"),
            ("bench", "a", "b"),
            ("inspect", "--write-channel-map", "m"),
        ],
    )
    def test_files_are_left_to_the_shell(self, words, offered):
        assert offered(*words) == ["<file>"]

    def test_files_behind_a_role(self, offered, tmp_path):
        (tmp_path / "vec").mkdir()
        (tmp_path / "vec" / "v.0001.exr").touch()
        (tmp_path / "vec" / ".hidden").touch()
        assert offered("upsample", "--aov", "motion=v") == ["motion=vec/"]
        assert offered("upsample", "--aov", "motion=vec/") == ["motion=vec/v.0001.exr"]
        assert offered("upsample", "--aov", f"motion={tmp_path}/ve") == [f"motion={tmp_path}/vec/"]
        assert offered("upsample", "--aov", "motion=nowhere/") == []

    def test_names_are_those_of_the_registries(self):
        from exwarp_cli.domain.motion import PRESETS
        from exwarp_cli.io.channels import Role
        from exwarp_cli.io.exr.writer import COMPRESSIONS
        from exwarp_cli.io.generated_frames import OPENEXR_COMPRESSIONS
        from exwarp_cli.synthesis.methods import METHODS

        assert tuple(METHODS) == completion.METHODS
        assert (*COMPRESSIONS, *OPENEXR_COMPRESSIONS) == completion.COMPRESSIONS
        assert tuple(PRESETS) == completion.CONVENTIONS
        assert tuple(role.value for role in Role) == completion.ROLES

    def test_every_suggestion_is_for_an_option(self):
        names = {one.id.rpartition(":")[2] for one in EVERY_OPTION}
        assert set(completion.WORDS) <= names

    def test_settings_are_not_looked_at(self, offered, tmp_path, monkeypatch):
        monkeypatch.delenv("EXWARP_CONFIG")
        (tmp_path / "exwarp.toml").write_text("[upsample")
        assert offered("upsample", "-m", "sof") == ["softsplat"]


@pytest.fixture
def environment(tmp_path) -> dict[str, str]:
    """A home of our own, and exwarp on the path."""
    script = tmp_path / "bin" / "exwarp"
    script.parent.mkdir()
    script.write_text(SCRIPT.format(python=sys.executable))
    script.chmod(0o755)
    (tmp_path / "work" / "shots").mkdir(parents=True)
    (tmp_path / "work" / "network.onnx").touch()
    path = f"{script.parent}{os.pathsep}{os.environ['PATH']}"
    return os.environ | {
        "PATH": path, "HOME": str(tmp_path), "TERM": "dumb", "PYTHONPATH": str(Path.cwd())
    }  # fmt: skip


class TestProcess:
    def complete(self, environment, words: str, *flags: str) -> subprocess.CompletedProcess[str]:
        asked = {"COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
        return subprocess.run(
            [sys.executable, *flags, "-m", "exwarp_cli"],
            env=environment | asked | {"_EXWARP_COMPLETE": "bash_complete"},
            capture_output=True, text=True, check=False,
        )  # fmt: skip

    def test_listing_commands_imports_none(self, environment):
        result = self.complete(environment, "exwarp ", "-X", "importtime")
        assert "plain,upsample" in result.stdout
        assert "exwarp_cli.commands" not in result.stderr

    def test_values_import_nothing_heavy(self, environment):
        result = self.complete(environment, "exwarp upsample --method soft", "-X", "importtime")
        assert result.stdout.split() == ["plain,softsplat"]
        imported = set(re.findall(r"\| +([a-zA-Z_0-9]+)\n", result.stderr))
        assert not imported & {"numpy", "numba", "rich", "OpenEXR", "onnxruntime"}

    def test_an_unknown_command_prints_nothing_over_the_line(self, environment):
        result = self.complete(environment, "exwarp foo ")
        assert (result.stdout.strip(), result.stderr) == ("", "")


@pytest.fixture(params=SHELLS)
def shell(request) -> str:
    """A shell that is here."""
    if shutil.which(request.param) is None:
        pytest.skip(f"no {request.param} on the path")
    return str(request.param)


class TestShells:
    def test_each_reads_its_script(self, shell, exwarp, tmp_path):
        result = exwarp("completion", shell)
        assert result.code == 0 and result.err == ""
        script = tmp_path / "script"
        script.write_text(result.out)
        check = subprocess.run([shell, "-n", str(script)], capture_output=True, text=True)
        assert (check.returncode, check.stderr) == (0, "")

    @pytest.mark.parametrize(
        ("typed", "wanted"),
        [
            ("exwarp upsam", "exwarp upsample "),
            ("exwarp upsample -m softs", "exwarp upsample -m softsplat "),
            ("exwarp upsample netw", "exwarp upsample network.onnx "),
            ("exwarp upsample --metrics psnr,vm", "exwarp upsample --metrics psnr,vmaf "),
            ("exwarp upsample --aov moti", "exwarp upsample --aov motion="),
            ("exwarp upsample --aov motion=sho", "exwarp upsample --aov motion=shots/"),
        ],
    )
    def test_what_a_key_makes_of_a_line(self, shell, typed, wanted, environment, tmp_path):
        if shell == "fish":
            line = f"source (exwarp completion fish | psub); complete -C '{typed}'"
            run = subprocess.run(
                ["fish", "-N", "-c", line],
                env=environment, cwd=tmp_path / "work", capture_output=True, text=True,
            )  # fmt: skip
            (found,) = run.stdout.splitlines()
            assert f"{typed.rpartition(' ')[0]} {found.partition(chr(9))[0]}" == wanted.rstrip()
        else:
            assert pressed(shell, typed, environment, tmp_path / "work") == wanted


BEGIN = {
    "bash": "PS1='> '; PS2=; bind 'set enable-bracketed-paste off'; bind 'set bell-style none'\n"
    'eval "$(exwarp completion bash)"; stty -echo; echo read""y\n',
    "zsh": "PS1='> '; unsetopt zle_bracketed_paste prompt_cr prompt_sp; autoload -Uz compinit\n"
    'compinit -u -D; eval "$(exwarp completion zsh)"; unset zle_bracketed_paste; echo read""y\n',
}
KEY = {  # that writes down the line
    "bash": """line() { printf %s "$READLINE_LINE" > 'NOTE'; }; bind -x '"\\C-t": line'\n""",
    "zsh": """line() { print -rn -- "$BUFFER" > 'NOTE' }; zle -N line; bindkey '^T' line\n""",
}
INTERACTIVE = {"bash": ["bash", "--norc", "--noprofile", "-i"], "zsh": ["zsh", "-f", "-i"]}


def pressed(shell: str, typed: str, environment: dict[str, str], folder: Path) -> str:
    """Type into an interactive shell, press Tab, and have the shell write down its line."""
    import pty

    note = folder.parent / "line"
    key = KEY[shell].replace("NOTE", str(note))
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        os.execvpe(shell, INTERACTIVE[shell], environment)
    try:
        os.write(terminal, (key + BEGIN[shell]).encode())
        _read(terminal, b"ready")
        os.write(terminal, typed.encode() + b"\t\x14")
        deadline = time.monotonic() + 30
        while not (note.exists() and note.read_text()) and time.monotonic() < deadline:
            _read(terminal, None)
        return note.read_text()
    finally:
        os.close(terminal)
        os.kill(child, 9)
        os.waitpid(child, 0)


def _read(terminal: int, word: bytes | None) -> None:
    """Read what a shell prints: up to a word, or whatever it is just now."""
    seen, deadline = b"", time.monotonic() + 30
    while time.monotonic() < deadline:
        if select.select([terminal], [], [], 0.1)[0]:
            seen += os.read(terminal, 4096)
        if word is None or word in seen:
            return
    raise AssertionError(seen)
