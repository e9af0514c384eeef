"""What shells offer for values that click does not know: methods, lists of metrics, sequences.

Names are written out here, as the registries that hold them import numba and OpenEXR, which a
person who pressed a key should not wait for; a test holds them against the registries.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import click
from click.shell_completion import CompletionItem
from click.types import StringParamType

from exwarp_cli.commands.option_names import long_name, names_paths
from exwarp_cli.domain.metric import ALL, BY_OPTION, METRICS, SCOPES
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


@dataclass(frozen=True)
class Words:
    """What can be written for a value.

    Attributes
    ----------
    words
        All of them.
    listed
        Whether several may stand with commas between.
    """

    words: tuple[str, ...]
    listed: bool = False

    def after(self, text: str) -> list[str]:
        """Return what a text can become."""
        before, comma, last = text.rpartition(",") if self.listed else ("", "", text)
        taken = before.split(",")
        left = (word for word in self.words if word not in taken)
        return [f"{before}{comma}{word}" for word in left if word.startswith(last)]


def _limits(*, more_is_better: bool) -> Iterator[str]:
    """Yield how limits on quality begin, with a metric's name and what it is taken over."""
    for prefix in SCOPES:
        for metric in METRICS:
            if metric.more_is_better == more_is_better and (metric.in_holes or prefix != "holes"):
                yield f"{prefix}.{metric.option}=".removeprefix(".")


VALUES: Mapping[str, Words] = {
    "method": Words(METHODS),
    "metrics": Words((*BY_OPTION, ALL), listed=True),
    "compression": Words(COMPRESSIONS),
    "motion": Words(CONVENTIONS),
    "layers": Words(("beauty", "all")),
    "cuts": Words(("auto", "none"), listed=True),
    "view": Words(("all", "left", "right")),
    "systems": Words(SYSTEMS, listed=True),
    "fail-below": Words(tuple(_limits(more_is_better=True))),
    "fail-above": Words(tuple(_limits(more_is_better=False))),
}
"""Suggestions by the long names of options."""


class Suggested(StringParamType):
    """Text for which a shell offers words, or files and folders."""

    def __init__(self, words: Words | None = None, roles: bool = False) -> None:
        self._words, self._roles = words, roles

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer what the text can become."""
        if self._words is not None:
            return [CompletionItem(word) for word in self._words.after(incomplete)]
        role, equals, path = incomplete.partition("=")
        if not self._roles:
            return [CompletionItem(incomplete, type="file")]
        if not equals:
            return [CompletionItem(f"{name}=") for name in ROLES if name.startswith(role)]
        return [CompletionItem(f"{role}={found}") for found in _paths(path)]


def suggesting(parameter: click.Parameter) -> click.Parameter:
    """Return a parameter as it is, but that a shell has something to offer for its value."""
    if type(parameter.type) is not StringParamType:
        return parameter
    if isinstance(parameter, click.Option):
        words = VALUES.get(long_name(parameter))
        paths = names_paths(parameter)
        if words is None and not paths:
            return parameter
        kind = Suggested(words, roles="=" in (parameter.metavar or ""))
    else:
        kind = Suggested()  # arguments that are plain text are sequences
    made = copy.copy(parameter)
    made.type = kind
    return made


def _paths(start: str) -> Iterator[str]:
    """Yield files and folders whose paths begin so; shells do it where a path is the whole word."""
    folder, name = os.path.split(start)
    try:
        entries = sorted(Path(folder or ".").iterdir())
    except OSError:
        return
    for entry in entries:
        if entry.name.startswith(name) and (name.startswith(".") or entry.name[0] != "."):
            slash = "/" if entry.is_dir() else ""
            yield f"{folder}{'/' if folder not in ('', '/') else ''}{entry.name}{slash}"
