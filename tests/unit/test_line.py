"""Text on one line, whatever others put into it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.domain.wording import MAX_LINE, one_line, printable


@given(st.text(alphabet=st.characters(exclude_categories=()), max_size=100))
def test_any_text_is_one_printable_line(text):
    line = one_line(text)
    assert line.isprintable() and len(line.splitlines()) <= 1
    assert one_line(line) == line


@given(st.text(st.characters(categories=("L", "N", "P", "S"))))
def test_plain_text_stays_as_it_is(text):
    assert one_line(text) == text


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("Choose from:\n\tone,\n\ttwo", "Choose from: one, two"),
        ("a\r\nb\rc\x0bd\x85e\u2028f\u2029g", "a b c d e f g"),
        ("\nends and begins\n", "ends and begins"),
        ("two  spaces", "two  spaces"),
        ("a\x00b\x1b[2J", "a\\x00b\\x1b[2J"),
        ("caf\udce9.exr", "caf\\udce9.exr"),
        ("r\u202egnp.exe", "r\\u202egnp.exe"),
        ("größer als 東京", "größer als 東京"),
    ],
)
def test_what_cannot_be_printed_is_spelled_out(text, line):
    assert one_line(text) == line


def test_a_long_text_keeps_what_went_wrong_and_what_to_do():
    line = one_line("what " + "x" * 100_000 + " do")
    assert len(line) <= MAX_LINE
    assert line.startswith("what xx") and line.endswith("xx do") and " … " in line
    assert one_line("y" * MAX_LINE) == "y" * MAX_LINE


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\nb\tc\r", "a\\nb\\tc\\r"),
        ("\x1b[31m\x9b", "\\x1b[31m\\x9b"),
        ("r\u202egnp.\u2066exe\u2069", "r\\u202egnp.\\u2066exe\\u2069"),
        ("a\x85b\u2028c\u2029", "a\\x85b\\u2028c\\u2029"),
        ("  two  ", "  two  "),
        ("caf\udce9 \u200d\xa0\ufeff 東京", "caf\udce9 \u200d\xa0\ufeff 東京"),
    ],
)
def test_names_are_shown_as_they_are_but_for_what_misleads(text, shown):
    assert printable(text) == shown and printable(shown) == shown
