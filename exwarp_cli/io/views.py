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

import os
import re
from collections.abc import Iterable
from glob import escape
from pathlib import Path

from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.exr.header import Channel, Part
from exwarp_cli.io.frame_names import NamePattern

ALL = "all"
"""What ``--view`` takes for every view."""

_USUAL = frozenset({"left", "right"})
_TOKEN = re.compile(r"(%[Vv])")
_GROUPS = {"%V": r"(?P<V>[^./\\_ -]+)", "%v": r"(?P<v>[^./\\_ -])"}
_NUMBER = r"-?[0-9]+"
# The view that comes first where nothing else tells.
_RANK = {"left": 0, "l": 1}
_LETTERS = {"l": "left", "r": "right"}


def views_of(parts: Iterable[Part]) -> tuple[str, ...]:
    """Return the names of a file's views, the hero first; () where it has none.

    Of a single part without ``multiView``, layers named left and right count as views only where
    there are both, and no channel of theirs without a view: beside a beauty they are lights.
    """
    parts = tuple(parts)
    listed = [view for part in parts for view in (part.view, *part.views) if view]
    if listed:
        return tuple(dict.fromkeys(listed))
    placed = [_place_before_last(c, part, tuple(_USUAL)) for part in parts for c in part.channels]
    names = {owner: {name for of, name, _ in placed if of == owner} for owner in ("", *_USUAL)}
    both = names["left"] and names["right"]
    return ("left", "right") if both and not names["left"] & names["right"] & names[""] else ()


def choose(views: tuple[str, ...], asked: str | None, where: object) -> str:
    """Return the view that is asked for, the hero without asking, "" where there are none.

    Raises
    ------
    LayoutError
        When there is no such view.
    """
    if asked is None:
        return views[0] if views else ""
    if asked in views:
        return asked
    if not views:
        raise LayoutError(
            f"{where} has no views, so none is called {asked!r}; leave --view out, or name the "
            "sequences of the views by a pattern with %V in place of the view"
        )
    raise LayoutError(
        f"{where} has the views {' and '.join(views)}, not {asked!r}; name one of them"
    )


def channels_of(parts: Iterable[Part], view: str = "") -> dict[str, Channel]:
    """Return the channels of a view by their name without it; deep ones are left out.

    Parameters
    ----------
    parts
        Of one file.
    view
        Name of a view; "" for the hero, and for files without views. Where the file does not have
        it, the channels without view are returned.

    Returns
    -------
    dict
        In the file's order. Channels without view are the hero's in a file where the hero is not
        named, and of all views else; what a view has itself comes before them.
    """
    parts = tuple(parts)
    views = views_of(parts)
    hero = views[0] if views else ""
    view = view if views and view else hero
    placed = [_place(c, part, views) for part in parts if not part.deep for c in part.channels]
    hero_named = bool(hero) and any(owner == hero for owner, _, _ in placed)
    found: dict[str, Channel] = {}
    own: set[str] = set()
    for owner, name, channel in placed:
        if owner == view:
            found[name] = channel
            own.add(name)
        # By definition a channel without a layer is the hero's.
        elif owner == "" and name not in own and (view == hero or (hero_named and "." in name)):
            found[name] = channel
    return found


def expand(spec: str, asked: str | None) -> tuple[str, str, tuple[str, ...]]:
    """Put a view's name in place of ``%V`` and its letter in place of ``%v``.

    Parameters
    ----------
    spec
        As the user wrote it.
    asked
        The view; None for the first: left, else by name.

    Returns
    -------
    spec : str
        Of that view's own sequence; `spec` itself where it has no token.
    view : str
        Its name; "" without a token.
    views : tuple of str
        All views for which there are files; () without a token.

    Raises
    ------
    InputError
        When no files fit, or none of that view.
    """
    if not _TOKEN.search(spec):
        return spec, "", ()
    try:
        if Path(spec).exists():
            return spec, "", ()
        found = _views_on_disk(spec)
    except OSError as error:
        raise InputError(
            f"cannot look for {spec}: {error.strerror or error}; check the path and its rights"
        ) from error
    if not found:
        raise InputError(
            f"nothing fits {spec!r} with a view's name for %V or its first letter for %v; check "
            "the pattern"
        )
    views = tuple(sorted(found, key=lambda name: (_RANK.get(name, len(_RANK)), name)))
    view = choose(views, asked, spec)
    return _filled(spec, found[view]), view, views


def _views_on_disk(spec: str) -> dict[str, str]:
    """Return what stands for the tokens by the view's name: its name, or its letter alone."""
    whole = "%V" in spec
    wild, expression = "", ""
    for piece in _pieces(spec):
        group = _GROUPS.get(piece)
        if group is not None:
            # A token that stands there again stands for the same.
            expression += f"(?P={piece[1]})" if group in expression else group
        else:
            expression += _NUMBER if piece == "#" else re.escape(piece)
        wild += "*" if group is not None or piece == "#" else escape(piece)
    views: dict[str, str] = {}
    sought = Path(wild)
    found = Path(sought.anchor).glob(str(sought.relative_to(sought.anchor)))
    for path in sorted(map(str, found)):
        match = re.fullmatch(expression, path)
        if match is None:
            continue
        named = match.groupdict()
        text = named["V"] if whole else named["v"]
        if text.startswith(named.get("v", "")):
            views.setdefault(text if whole else _LETTERS.get(text, text), text)
    return views


def _pieces(spec: str) -> list[str]:
    """Split a pattern into texts, views, and "#" for the frame number."""
    path = Path(spec)
    pattern = NamePattern.parse(path.name)
    if pattern is None:
        return re.split(_TOKEN, str(path))
    folder = "" if path.parent == Path() else f"{path.parent}{os.sep}".replace(2 * os.sep, os.sep)
    begin = folder + pattern.base
    return [*re.split(_TOKEN, begin), "#", *re.split(_TOKEN, pattern.suffix)]


def _filled(spec: str, text: str) -> str:
    return _TOKEN.sub(lambda token: text if token[0] == "%V" else text[0], spec)


def _place(channel: Channel, part: Part, views: tuple[str, ...]) -> tuple[str, str, Channel]:
    """Return a channel's view, or "", and its name without it."""
    owner, name, _ = _place_before_last(channel, part, views)
    first, _, rest = channel.raw_name.partition(".")
    if name == channel.name and "." in rest and first in views and part.view in ("", first):
        return first, channel.name.removesuffix(channel.raw_name) + rest, channel
    return owner, name, channel


def _place_before_last(
    channel: Channel, part: Part, views: tuple[str, ...]
) -> tuple[str, str, Channel]:
    """Do as `_place` where the view stands before the last element, as OpenEXR has it."""
    element = channel.raw_name.rpartition(".")[0].rpartition(".")[2]
    if element in views and part.view in ("", element):
        layer, _, component = channel.name.rpartition(".")
        above = layer.rpartition(".")[0]
        return element, f"{above}.{component}" if above else component, channel
    return part.view, channel.name, channel
