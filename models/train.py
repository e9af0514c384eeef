"""Run the stages of recipe.toml: ``python models/train.py --data SCENES -o FOLDER [STAGE ...]``.

A stage that was stopped goes on where it was; see `exwarp train --help`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

RECIPE = Path(__file__).with_name("recipe.toml")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the stages that are named, or all; return the exit code of the first that fails."""
    stages = tomllib.loads(RECIPE.read_text(encoding="utf-8"))["stages"]
    names = [stage["name"] for stage in stages]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stages", nargs="*", metavar="STAGE", help=", ".join(names))
    parser.add_argument("--data", required=True, help="folder of rendered scenes")
    parser.add_argument("-o", "--out", required=True, help="folder of the training")
    parser.add_argument("--list", action="store_true", help="print the commands alone")
    given = parser.parse_args(arguments)
    if unknown := [name for name in given.stages if name not in names]:
        parser.error(f"there is no stage {unknown[0]}; the stages are {', '.join(names)}")
    for stage in stages:
        if given.stages and stage["name"] not in given.stages:
            continue
        command = [*("exwarp", "train", stage["command"]), *_options(stage["options"], given)]
        print(" ".join(command), flush=True)
        if not given.list:
            code = subprocess.run([sys.executable, "-m", "exwarp_cli", *command[1:]]).returncode
            if code:
                return code
    return 0


def _options(options: Mapping[str, Any], given: argparse.Namespace) -> Iterator[str]:
    """Yield the options of a stage, with its folders put in."""
    for name, value in options.items():
        for each in value if isinstance(value, list) else [value]:
            yield f"--{name}"
            yield str(each).format(data=given.data, out=given.out)


if __name__ == "__main__":
    sys.exit(main())
