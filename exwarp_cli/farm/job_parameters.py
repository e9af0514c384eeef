"""Job parameters of Open Job Description: what may be changed when a job is submitted."""

from __future__ import annotations

import os.path
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exwarp_cli.errors import UsageError
from exwarp_cli.farm.places import Flow, Place

LONGEST = 1024
"""Characters that a parameter's value may have."""

BRACES = ("{{", "}}")
"""What stands around the name of a value in a format string. Nothing escapes them there, so texts
that have them become parameters, whose values are taken as they are."""

_GROUPS = {Flow.READ: "Input", Flow.WRITTEN: "Output"}


@dataclass
class JobParameters:
    """The parameters of one template, found on the way through its commands.

    Attributes
    ----------
    folder
        Where the template is going to lie. Engines take a default path relative to it, and refuse
        those that lead out of it; None gives no path a default.
    definitions
        As the template lists them.
    values
        What has no default and must be given when the job is submitted, by name.
    """

    folder: Path | None
    definitions: list[dict[str, Any]] = field(default_factory=list)
    values: dict[str, str] = field(default_factory=dict)
    _names: dict[object, str] = field(default_factory=dict)

    def add(self, name: str, kind: str, default: str | int, label: str, **more: Any) -> str:
        """Define a parameter with a default, and return how a format string refers to it.

        Raises
        ------
        UsageError
            When the default is too long.
        """
        group, hidden = more.pop("group"), more.pop("hidden", False)
        _require_length(str(default), label)
        shown = {"label": label, "groupLabel": group} | ({"control": "HIDDEN"} if hidden else {})
        definition = {
            "name": name,
            "type": kind,
            "default": default,
            **more,
            "userInterface": shown,
        }
        self.definitions.append(definition)
        return _reference(name)

    def of_text(self, text: str) -> str:
        """Return a text as a format string."""
        if not any(pair in text for pair in BRACES):
            return text
        if text not in self._names:
            self._names[text] = name = f"Text{len(self.definitions)}"
            self.add(name, "STRING", text, name, group="ExWarp", hidden=True)
        return _reference(self._names[text])

    def of_place(self, place: Place) -> str:
        """Return a place as a format string, whose path and pattern are parameters."""
        if place not in self._names:
            group = _GROUPS[place.purpose.flow]
            name = f"{place.name}{'File' if place.is_file else 'Folder'}"
            reference = self._path(name, place.path, place.is_file, place, place.label)
            for what, path in place.beside.items():
                self._path(
                    f"{place.name}{what}", path, True, place, f"{place.label}: {what.lower()}"
                )
            rest = place.rest
            if place.pattern:
                pattern, name = f"{place.pattern}{place.after}", f"{place.name}Pattern"
                rest = "/" + self.add(name, "STRING", pattern, f"{place.label}: names", group=group)
            else:
                rest = self.of_text(rest)
            self._names[place] = f"{place.before}{reference}{rest}"
        return self._names[place]

    def _path(self, name: str, path: Path, is_file: bool, place: Place, label: str) -> str:
        flow = place.purpose.flow
        definition = {
            "name": name,
            "type": "PATH",
            "objectType": "FILE" if is_file else "DIRECTORY",
            "dataFlow": flow.value,
            "userInterface": {"label": label, "groupLabel": _GROUPS[flow]},
        }
        default = None if self.folder is None else _within(path, self.folder)
        if default is None:
            self.values[name] = str(path)
        else:
            definition["default"] = default
        _require_length(str(path), label)
        self.definitions.append(definition)
        return _reference(name)


def _reference(name: str) -> str:
    return f"{{{{Param.{name}}}}}"


def _within(path: Path, folder: Path) -> str | None:
    """Return a path relative to a folder that it is in, None where it is not."""
    normal = Path(os.path.normpath(path))
    return normal.relative_to(folder).as_posix() if normal.is_relative_to(folder) else None


def _require_length(value: str, label: str) -> None:
    if len(value) > LONGEST:
        raise UsageError(
            f"the value of {label!r} has {len(value)} characters, and Open Job Description takes "
            f"{LONGEST} at most; shorten it, or take 'exwarp farm commands'"
        )
