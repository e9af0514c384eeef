"""``exwarp completion``: what completes commands, options and their values in a shell."""

from __future__ import annotations

import click

SHELLS = ("bash", "zsh", "fish")

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
"""What goes behind click's script: bash takes ``motion=vec/`` for three words, and sets a space
behind ``motion=``, where the value goes on."""

MENDED = {
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
"""What click's scripts say, and what is better said, by shell."""


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
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None
    root = click.get_current_context().find_root()
    name = root.info_name or "exwarp"
    script = kind(root.command, {}, name, f"_{name.upper()}_COMPLETE").source()
    if shell in MENDED:
        script = script.replace(*MENDED[shell])
    click.echo(script + (BASH if shell == "bash" else ""))
