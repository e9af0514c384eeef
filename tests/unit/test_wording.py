"""Counts, names, sizes and errors of others in words."""

from __future__ import annotations

import pytest

from exwarp_cli.domain.wording import enumerated, first_line, pluralise, size_text


@pytest.mark.parametrize(("count", "words"), [(0, "0 frames"), (1, "1 frame"), (2, "2 frames")])
def test_counts(count, words):
    assert pluralise(count, "frame") == words


@pytest.mark.parametrize(
    ("names", "words"),
    [((), ""), (("a",), "a"), (("a", "b"), "a and b"), (("a", "b", "c"), "a, b and c")],
)
def test_names(names, words):
    assert enumerated(names) == words


@pytest.mark.parametrize(
    ("count", "words"),
    [(0, "0 bytes"), (1023, "1023 bytes"), (1536, "1.5 KiB"), (10 << 20, "10 MiB"),
     (1 << 42, "4.0 TiB"), (1 << 52, "4096 TiB")],
)  # fmt: skip
def test_sizes(count, words):
    assert size_text(count) == words


@pytest.mark.parametrize(
    ("text", "words"),
    [("", "ValueError"), ("...", "ValueError"), ("no.\nmore", "no"), ("\n  late \n", "late")],
)
def test_errors(text, words):
    assert first_line(ValueError(text)) == words


def test_a_long_error_is_cut():
    assert first_line(ValueError("x" * 300)) == "x" * 197 + "..."
