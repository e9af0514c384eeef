"""The models that come with ExWarp: whether all are there, unchanged; and the policy in ONNX."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from exwarp_cli.accel.fixed_point import I32
from exwarp_cli.errors import InputError
from exwarp_cli.io.models import CHECKSUMS, OnnxNetwork, shipped_folder

INTEGER_POLICY = "policy-int8.onnx"
"""The policy's integers in ONNX, for runtimes of others."""


def judge_shipped() -> dict[str, str | None]:
    """Compare every shipped model with its checksum.

    Returns
    -------
    dict
        By file name what is wrong with it ("missing", "not the one that came with ExWarp" …); None
        where nothing is.

    Raises
    ------
    InputError
        When there is no list of checksums.
    """
    folder = shipped_folder()
    try:
        expected = json.loads((folder / CHECKSUMS).read_bytes())
        names = sorted(expected)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"the models that come with ExWarp, or their checksums, are missing in {folder}; "
            "install ExWarp again"
        ) from error
    return {name: _problem(folder / name, expected[name]) for name in names}


class IntegerPolicy(OnnxNetwork):
    """The shipped policy as onnxruntime computes it."""

    def __init__(self) -> None:
        path = shipped_folder() / INTEGER_POLICY
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {path}; install ExWarp again") from error
        super().__init__(path, data, 1, "cpu")

    def decide_many(self, states: I32) -> I32:
        """Return the outputs [N, 2] for states int32 [N, n] in Q16.16."""
        (given,), (asked,) = self.inputs, self.outputs
        out = self._answer(asked, {given: states}, states.shape, 1, "install ExWarp again")
        return np.asarray(out, np.int32)


def _problem(path: Path, expected: object) -> str | None:
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return "missing"
    except OSError as error:
        return f"not to be read ({error.strerror})"
    return None if digest == expected else "not the one that came with ExWarp"
