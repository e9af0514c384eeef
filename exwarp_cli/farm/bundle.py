"""Templates as text, and the job bundles that AWS Deadline Cloud submits."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from exwarp_cli.domain.line import misleads
from exwarp_cli.errors import OutputExistsError
from exwarp_cli.farm.openjd import JobTemplate
from exwarp_cli.io.atomic import atomic_write_text, is_there, make_folder

TEMPLATE_FILE = "template.yaml"
VALUES_FILE = "parameter_values.yaml"

_PLAIN = re.compile(r"(--)?[A-Za-z][A-Za-z0-9_-]*")


class _Dumper(yaml.SafeDumper):
    """Quotes all strings but bare words: readers of YAML 1.2 see numbers in ``1e3`` and ``0o7``."""

    def ignore_aliases(self, data: object) -> bool:
        """Write out what occurs twice."""
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if _PLAIN.fullmatch(text) else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent_text)


def yaml_text(document: dict[str, Any]) -> str:
    """Write a document as YAML that every version reads alike."""
    text = _yaml(document, as_it_is=True)
    # Of what no editor shows, such as marks that turn the direction of a line, escapes do.
    return _yaml(document, as_it_is=False) if misleads(text.replace("\n", "")) else text


def _yaml(document: dict[str, Any], as_it_is: bool) -> str:
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=as_it_is, width=100)


def write_bundle(folder: Path, template: JobTemplate) -> None:
    """Write a job bundle: a folder with the template and the values of its parameters.

    Raises
    ------
    OutputExistsError
        When there is a bundle already.
    OutputError
        When it cannot be written.
    """
    for name in (TEMPLATE_FILE, VALUES_FILE):
        if is_there(folder / name):
            raise OutputExistsError(
                f"{folder} has a {name} already; remove it, or name another folder with --bundle"
            )
    make_folder(folder)
    values = [{"name": name, "value": value} for name, value in template.values.items()]
    atomic_write_text(folder / VALUES_FILE, yaml_text({"parameterValues": values}))
    atomic_write_text(folder / TEMPLATE_FILE, yaml_text(template.document))
