"""Whether the models that come with ExWarp are whole, and run as they must."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from exwarp_cli.accelerator.mlp import MlpKernel, infer_reference
from exwarp_cli.domain.wording import enumerated, pluralise
from exwarp_cli.errors import ExwarpError, InputError
from exwarp_cli.io.models import (
    CHECKSUMS,
    CUDA,
    OnnxNetwork,
    load_extrapolator,
    providers,
    runtime_version,
    shipped_folder,
)
from exwarp_cli.io.policy_files import load_policy
from exwarp_cli.kernels.array_types import I32
from exwarp_cli.pipeline.accelerator import sample_states
from exwarp_cli.pipeline.doctor.examine import Check, failure, warning

INTEGER_POLICY = "policy-int8.onnx"
"""The policy's integers in ONNX, for runtimes of others."""

STATES = 96
"""Made-up states that are decided: of any size, and at which bits carry."""

_PROVIDERS = {"CPUExecutionProvider": "CPU", CUDA: "CUDA"}
"""Those that networks are run on here, by onnxruntime's names."""


def check_models() -> Check:
    """Compare the shipped models with their checksums."""
    folder = shipped_folder()
    problems = judge_shipped()
    remarks = tuple(
        failure(f"the model {folder / name} is {problem}; install ExWarp again")
        for name, problem in problems.items()
        if problem is not None
    )
    whole = sum(problem is None for problem in problems.values())
    facts = {
        "folder": str(folder),
        "files": {name: problem or "as shipped" for name, problem in problems.items()},
    }
    lines = (str(folder), *(f"{name}: {state}" for name, state in facts["files"].items()))  # type: ignore[attr-defined]
    return Check(f"{whole} of {len(problems)} files as shipped", remarks, facts, lines)


def check_network() -> Check:
    """Load the shipped network, and run it, on all that onnxruntime offers here."""
    offered = providers()
    devices = ["cpu", *(["cuda"] if CUDA in offered else [])]
    problems = {device: _problem_on(device) for device in devices}
    remarks = tuple(
        # There is still the CPU where CUDA does not start.
        failure(said) if device == "cpu" else warning(said)
        for device, said in problems.items()
        if said
    )
    good = [device.upper() for device, said in problems.items() if said is None]
    facts = {
        "onnxruntime": runtime_version(),
        "providers": list(offered),
        "devices": {device: said is None for device, said in problems.items()},
    }
    runs = (
        f"runs the extrapolator on {enumerated(good)}" if good else "does not run the extrapolator"
    )
    found = f"onnxruntime {runtime_version()} {runs}"
    lines = [f"offers {', '.join(_PROVIDERS.get(name, name) for name in offered)}"]
    if CUDA not in offered:
        found += "; no CUDA"
        lines.append("for CUDA put onnxruntime-gpu in the place of onnxruntime")
    return Check(found, remarks, facts, tuple(lines))


def check_policy() -> Check:
    """Let the policy decide in all its forms, which must agree in every bit.

    The form that defines it is plain numpy; a golden answer would say no more, as the file itself
    is known by its checksum.
    """
    policy = load_policy(None)
    states = sample_states(policy.network.sizes[0], STATES, 0)
    expected = infer_reference(policy.network, states).outputs
    forms = {
        "compiled": MlpKernel(policy.network).decide_many(states)[0],
        "ONNX": IntegerPolicy().decide_many(states),
    }
    wrong = [name for name, outputs in forms.items() if not np.array_equal(outputs, expected)]
    remarks = tuple(
        failure(
            f"the {name} policy does not decide as its definition in integers does; "
            + _REMEDIES[name]
        )
        for name in wrong
    )
    warps = int((expected[:, 1] <= expected[:, 0]).sum())
    facts = {
        "checksum": policy.checksum,
        "states": len(states),
        "warps": warps,
        "agree": {name: name not in wrong for name in forms},
    }
    found = f"{pluralise(len(states), 'decision')} in 8-bit integers, the same in all forms"
    return Check("forms disagree" if wrong else found, remarks, facts)


_REMEDIES = {
    "compiled": "delete the folder of compiled kernels, and if that does not help install numba "
    "again",
    "ONNX": "install onnxruntime again",
}


def _problem_on(device: str) -> str | None:
    try:
        load_extrapolator(None, 1, device)
    except ExwarpError as error:
        return str(error)
    return None


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
