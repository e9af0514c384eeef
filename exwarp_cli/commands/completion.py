"""``exwarp completion``, and what shells offer for values that click does not know.

Names of methods and the like are written out here, as importing the registries that hold them would
delay each completion by the import of numba and OpenEXR. A test compares both.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import click
from click.shell_completion import CompletionItem, get_completion_class
from click.types import StringParamType

from exwarp_cli.domain.metric import ALL, BY_OPTION, METRICS, SCOPES
from exwarp_cli.option_values import long_name, names_paths
from exwarp_cli.research.bench.systems import SYSTEMS

METHODS = (
    "exwarp", "causal", "s1", "s2", "s3", "s4", "s5", "s6", "oracle", "oracle-return",
    "softsplat", "lookahead", "onnx", "blend", "hold",
)  # fmt: skip
COMPRESSIONS = (
    "none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab",
    "zips:4", "zip:4", "pxr24:4",
)  # fmt: skip
CONVENTIONS = (
    "blender", "unreal", "unreal-mrq", "arnold", "vray", "redshift", "renderman", "karma",
    "moonray", "nuke", "reelsmart", "twixtor", "forward", "backward", "forward+backward",
)  # fmt: skip
ROLES = (
    "colour", "depth", "motion", "normal", "position", "stencil", "albedo", "specular",
    "roughness", "metallic",
)  # fmt: skip


# How limits on quality begin: with what a metric is taken over, and its name.
LIMITS = {
    f"{prefix}.{metric.option}=".removeprefix("."): metric
    for prefix in SCOPES
    for metric in METRICS
    if metric.in_holes or prefix != "holes"
}

# Suggested words by the long names of options, and the options that take several with commas.
WORDS: Mapping[str, tuple[str, ...]] = {
    "method": METHODS,
    "metrics": (*BY_OPTION, ALL),
    "compression": COMPRESSIONS,
    "motion": CONVENTIONS,
    "layers": ("beauty", "all"),
    "cuts": ("auto", "none"),
    "view": ("all", "left", "right"),
    "systems": SYSTEMS,
    "fail-below": tuple(limit for limit in LIMITS if LIMITS[limit].more_is_better),
    "fail-above": tuple(limit for limit in LIMITS if not LIMITS[limit].more_is_better),
}
LISTED = frozenset({"metrics", "cuts", "systems"})


@dataclass(eq=False)
class SuggestedText(StringParamType):
    """Text for which a shell offers words, or files and folders where there are no words."""

    words: tuple[str, ...]
    is_list: bool  # several words with commas between
    has_role: bool  # a file comes behind ``ROLE=``

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer what the text can become."""
        if self.words:
            before, comma, last = (
                incomplete.rpartition(",") if self.is_list else ("", "", incomplete)
            )
            unused = (word for word in self.words if word not in before.split(","))
            return [
                CompletionItem(f"{before}{comma}{word}") for word in unused if word.startswith(last)
            ]
        role, equals, path = incomplete.partition("=")
        if not self.has_role:
            return [CompletionItem(incomplete, type="file")]
        if not equals:
            return [CompletionItem(f"{name}=") for name in ROLES if name.startswith(role)]
        # Shells list files themselves only where a path is the whole word.
        folder, name = os.path.split(path)
        begin = f"{role}={folder}" if folder in ("", "/") else f"{role}={folder}/"
        try:
            entries = sorted(Path(folder or ".").iterdir())
        except OSError:
            return []
        return [
            CompletionItem(f"{begin}{entry.name}{'/' if entry.is_dir() else ''}")
            for entry in entries
            if entry.name.startswith(name) and (name.startswith(".") or entry.name[0] != ".")
        ]


def with_suggestions(command: click.Command) -> click.Command:
    """Return a copy of a command for whose values a shell has something to offer."""
    suggesting = copy.copy(command)
    suggesting.params = []
    for original in command.params:
        parameter = copy.copy(original)
        suggesting.params.append(parameter)
        if type(parameter.type) is not StringParamType:
            continue
        # Arguments that are plain text are sequences: files.
        name = long_name(parameter) if isinstance(parameter, click.Option) else ""
        words = WORDS.get(name, ())
        if name and not words and not names_paths(parameter):
            continue
        has_role = "=" in (parameter.metavar or "")
        parameter.type = SuggestedText(words, name in LISTED, has_role)
    return suggesting


SHELLS = ("bash", "zsh", "fish")

# Follows click's script: bash takes ``motion=vec/`` for three words, and sets a space behind
# ``motion=``, where the value goes on.
BASH = r"""
_exwarp_words() {
    local -a words=()
    local i last=0
    for ((i = 0; i <= COMP_CWORD; i++)); do
        if ((i > 1)) && [[ ${COMP_WORDS[i]} == "=" || ${COMP_WORDS[i - 1]} == "=" ]]; then
            words[last]+=${COMP_WORDS[i]}
        else
            words+=("${COMP_WORDS[i]}")
            last=$((${#words[@]} - 1))
        fi
    done
    local -a COMP_WORDS=("${words[@]}")
    local COMP_CWORD=$last
    _exwarp_completion "$@"
    if [[ ${words[last]} == *=* && $COMP_WORDBREAKS == *=* ]]; then
        COMPREPLY=("${COMPREPLY[@]#*=}")
    fi
    if [[ ${COMPREPLY[*]} == *[=/] ]]; then
        compopt -o nospace
    fi
    return 0
}
complete -o nosort -F _exwarp_words exwarp
"""

# What click's scripts say, and what replaces it, by shell.
REPLACED = {
    # A value that goes on gets no space behind it.
    "zsh": (
        "compadd -U -V unsorted -a completions",
        "if [[ -n ${completions[(r)*[=/]]} ]]; then "
        "compadd -U -S '' -V unsorted -a completions; "
        "else compadd -U -V unsorted -a completions; fi",
    ),
    # Lists and descriptions hold commas.
    "fish": ('string split "," $completion', 'string split --max 1 "," $completion'),
}


@click.command("completion")
@click.argument("shell", type=click.Choice(SHELLS))
def command(shell: str) -> None:
    """Print a script that lets SHELL complete commands, options, values and files.

    \b
    bash, in ~/.bashrc:   eval "$(exwarp completion bash)"
    zsh, in ~/.zshrc:     eval "$(exwarp completion zsh)", below compinit
    fish, once:           exwarp completion fish > ~/.config/fish/completions/exwarp.fish

    Open a new shell afterwards. Bash must be 4.4 or newer.
    """
    kind = get_completion_class(shell)
    assert kind is not None
    root = click.get_current_context().find_root()
    name = root.info_name or "exwarp"
    script = kind(root.command, {}, name, f"_{name.upper()}_COMPLETE").source()
    if shell in REPLACED:
        script = script.replace(*REPLACED[shell])
    click.echo(script + (BASH if shell == "bash" else ""))
