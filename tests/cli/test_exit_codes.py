"""Exit codes: the classes, the tree in their docstring, docs and the help say the same."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

from exwarp_cli import cli, errors
from exwarp_cli.errors import ExwarpError

SETTINGS = Path(__file__).parents[2] / "docs" / "settings.md"
NO_ERRORS = {0, cli.TERMINATED, errors.INTERRUPTED}
"""Codes that no class of the tree has."""

_BRANCH = re.compile(
    r"^    (?P<indent> *)(?P<name>\w+Error) +(?P<code>\d+|exit code)", re.MULTILINE
)


def every_error(kind: type[ExwarpError] = ExwarpError) -> list[type[ExwarpError]]:
    below = (found for child in kind.__subclasses__() for found in every_error(child))
    return [kind, *(found for found in below if found.__module__ == errors.__name__)]


def documented() -> dict[str, tuple[str, int]]:
    """Return the parent and the exit code of every class in the docstring's tree."""
    found: dict[str, tuple[str, int]] = {}
    above = ["Exception"]
    for branch in _BRANCH.finditer(inspect.getdoc(errors) or ""):
        depth = len(branch["indent"]) // 2 + 1
        above = [*above[:depth], branch["name"]]
        # The root's column holds the heading: its code is that of a defect.
        code = 1 if branch["code"] == "exit code" else int(branch["code"])
        found[branch["name"]] = (above[depth - 1], code)
    return found


@pytest.fixture(params=["docs", "exwarp --help"])
def meanings(request, capsys) -> dict[int, str]:
    """Return the documented codes, with what is said of them."""
    if request.param == "docs":
        table = (
            SETTINGS.read_text(encoding="utf-8").partition("## Exit codes")[2].partition("## ")[0]
        )
        return {int(code): text for code, text in re.findall(r"\| (\d+) \| (.+) \|", table)}
    assert cli.run(["--help"]) == 0
    text = capsys.readouterr().out
    (sentence,) = re.findall(r"Exit codes: (.*?)\.(?= |$)", " ".join(text.split()))
    parts = [re.fullmatch(r"(\d+) (.+)", part) for part in re.split(r", (?=\d)", sentence)]
    assert None not in parts, sentence
    return {int(part[1]): part[2] for part in parts if part}


def test_the_docstring_has_every_class_where_it_stands():
    actual = {e.__name__: (e.__bases__[0].__name__, e.exit_code) for e in every_error()}
    assert documented() == actual


def test_each_branch_has_a_code_of_its_own():
    """What is below InputError shares its code on purpose: the remedy is the same.

    UnreadableError shares it, too. It stands apart so that --keep-going does not go on after it.
    """
    roots = [e for e in every_error() if "exit_code" in vars(e)]
    roots.remove(errors.UnreadableError)
    assert errors.UnreadableError.exit_code == errors.InputError.exit_code
    codes = [e.exit_code for e in roots]
    assert len(set(codes)) == len(codes) and not set(codes) & NO_ERRORS


def test_the_docstring_has_the_codes_of_no_class():
    prose = (errors.__doc__ or "").split("A message says", 1)[1]
    assert {int(code) for code in re.findall(r"\d+", prose)} == NO_ERRORS | {1}


def test_every_code_and_no_other_is_documented(meanings):
    assert set(meanings) == {e.exit_code for e in every_error()} | NO_ERRORS


def test_the_meaning_of_codes_is_documented(meanings):
    words = {0: "done", 9: "cluster", 10: "installation", 130: "interrupted", 143: "terminated"}
    for code, word in words.items():
        assert word in meanings[code]


def test_130_and_143_are_those_of_shells():
    assert (errors.INTERRUPTED, cli.TERMINATED) == (130, 143)
