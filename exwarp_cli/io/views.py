"""Stereo and multi-view files: which views there are, and which channels belong to one.

OpenEXR writes views in two ways. In a single part, the attribute ``multiView`` lists them, the hero
first: a channel has its view's name before its last element (``right.R``, ``forward.right.u``), but
the hero's may go without. Nuke writes the view first (``right.forward.u``). In several parts, each
part has a ``view``. A third way is a sequence for each view: in patterns, ``%V`` is the view's
name, and ``%v`` its first letter.

A channel is known by its name without view: so names, channel maps and ``--motion`` are the same
for every view of a shot.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from glob import escape
from pathlib import Path

from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.exr.header import Channel, Part
from exwarp_cli.io.frame_names import NamePattern

ALL = "all"  # what --view takes for every view

_LEFT_RIGHT = ("left", "right")
_TOKEN = re.compile(r"(%[Vv])")
_GROUPS = {"%V": r"(?P<V>[^./\\_ -]+)", "%v": r"(?P<v>[^./\\_ -])"}
_NUMBER = r"-?[0-9]+"
_RANK = {"left": 0, "l": 1}  # the view that comes first where nothing else tells
_LETTERS = {"l": "left", "r": "right"}


def list_views(parts: Iterable[Part]) -> tuple[str, ...]:
    """Return the names of a file's views, the hero first; () if it has none.

    Of a single part without ``multiView``, layers named left and right count as views only if there
    are both, and no channel of theirs without a view: beside a beauty they are lights.
    """
    parts = tuple(parts)
    listed = [view for part in parts for view in (part.view, *part.views) if view]
    if listed:
        return tuple(dict.fromkeys(listed))
    names: dict[str, set[str]] = {"": set(), "left": set(), "right": set()}
    for part in parts:
        for channel in part.channels:
            view, name = _split_before_last(channel, part, _LEFT_RIGHT)
            names[view].add(name)
    has_both = names["left"] and names["right"]
    return _LEFT_RIGHT if has_both and not names["left"] & names["right"] & names[""] else ()


def choose_view(views: tuple[str, ...], wanted: str | None, file: object) -> str:
    """Return the wanted view, the hero if None, "" if there are no views.

    Raises LayoutError if there is no such view.
    """
    if wanted is None:
        return views[0] if views else ""
    if wanted in views:
        return wanted
    if not views:
        raise LayoutError(
            f"{file} has no views, so none is called {wanted!r}; leave --view out, or name the "
            "sequences of the views by a pattern with %V in place of the view"
        )
    raise LayoutError(
        f"{file} has the views {' and '.join(views)}, not {wanted!r}; name one of them"
    )


def view_in_file(parts: Iterable[Part], view: str, file: object, view_in_name: str = "") -> str:
    """Return the view of a file that is read, "" if it has none, or is all of one view.

    `view` is the wanted one, "" the hero; `view_in_name` that of the file by its name. Raises
    LayoutError if the file has others.
    """
    views = list_views(parts)
    if not views or (view_in_name and view not in views):
        return ""
    return choose_view(views, view or None, file)


def view_channels(parts: Iterable[Part], view: str = "") -> dict[str, Channel]:
    """Return the channels of a view by their name without it, in file order, without deep ones.

    The channels have these names, too.

    "" is the hero, and the view of files without views. Of a file that does not have the view, the
    channels without view are returned. Channels without view are the hero's in a file where the
    hero is not named, and of all views else; what a view has itself comes before them.
    """
    parts = tuple(parts)
    views = list_views(parts)
    hero = views[0] if views else ""
    view = view if views and view else hero
    placed = [
        (*_split_view(channel, part, views), channel)
        for part in parts
        if not part.deep
        for channel in part.channels
    ]
    is_hero_named = bool(hero) and any(owner == hero for owner, _, _ in placed)
    channels: dict[str, Channel] = {}
    own: set[str] = set()
    for owner, name, channel in placed:
        if owner == view:
            channels[name] = replace(channel, name=name)
            own.add(name)
        # By definition a channel without a layer is the hero's.
        elif owner == "" and name not in own and (view == hero or (is_hero_named and "." in name)):
            channels[name] = replace(channel, name=name)
    return channels


def expand_view(spec: str, wanted: str | None) -> tuple[str, str, tuple[str, ...]]:
    """Put a view's name in place of ``%V`` and its letter in place of ``%v``.

    Returns the pattern, the view, and all views for which there are files. Without a token, `spec`,
    "" and (). If `wanted` is None, the view is left, else the first by name.

    Raises InputError if no files fit, LayoutError if none of that view.
    """
    try:
        if not _TOKEN.search(spec) or Path(spec).exists():
            return spec, "", ()
        texts = _find_views(spec)
    except OSError as error:
        raise InputError(
            f"cannot look for {spec}: {error.strerror or error}; check the path and its rights"
        ) from error
    if not texts:
        raise InputError(
            f"nothing fits {spec!r} with a view's name for %V or its first letter for %v; check "
            "the pattern"
        )
    views = tuple(sorted(texts, key=lambda name: (_RANK.get(name, len(_RANK)), name)))
    view = choose_view(views, wanted, spec)
    text = texts[view]
    return _TOKEN.sub(lambda token: text if token[0] == "%V" else text[0], spec), view, views


def _find_views(spec: str) -> dict[str, str]:
    """Return the texts in place of the tokens by view: its name, or its letter alone."""
    has_name = "%V" in spec
    # Texts, tokens of views, and "#" for the frame number.
    path = Path(spec)
    pieces = re.split(_TOKEN, str(path))
    if (pattern := NamePattern.parse(path.name)) is not None:
        pieces = re.split(_TOKEN, str(path).removesuffix(path.name) + pattern.base)
        pieces += ["#", *re.split(_TOKEN, pattern.suffix)]
    wildcard, expression = "", ""
    for piece in pieces:
        group = _GROUPS.get(piece)
        if group is not None:
            # A repeated token stands for the same text.
            expression += f"(?P={piece[1]})" if group in expression else group
        else:
            expression += _NUMBER if piece == "#" else re.escape(piece)
        wildcard += "*" if group is not None or piece == "#" else escape(piece)
    views: dict[str, str] = {}
    anchor = Path(wildcard).anchor
    paths = Path(anchor).glob(str(Path(wildcard).relative_to(anchor)))
    for found in sorted(map(str, paths)):
        match = re.fullmatch(expression, found)
        if match is None:
            continue
        tokens = match.groupdict()
        text = tokens["V"] if has_name else tokens["v"]
        if text.startswith(tokens.get("v", "")):
            views.setdefault(text if has_name else _LETTERS.get(text, text), text)
    return views


def _split_view(channel: Channel, part: Part, views: tuple[str, ...]) -> tuple[str, str]:
    """Return a channel's view, or "", and its name without it."""
    view, name = _split_before_last(channel, part, views)
    first, _, rest = channel.raw_name.partition(".")
    if name == channel.name and "." in rest and first in views and part.view in ("", first):
        return first, channel.name.removesuffix(channel.raw_name) + rest
    return view, name


def _split_before_last(channel: Channel, part: Part, views: tuple[str, ...]) -> tuple[str, str]:
    """Do as `_split_view` for a view before the last element of the name, as OpenEXR has it."""
    element = channel.raw_name.rpartition(".")[0].rpartition(".")[2]
    if element in views and part.view in ("", element):
        layer, _, component = channel.name.rpartition(".")
        above = layer.rpartition(".")[0]
        return element, f"{above}.{component}" if above else component
    return part.view, channel.name
