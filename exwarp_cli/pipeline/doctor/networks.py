"""Whether the models that come with ExWarp are whole, and run as they must."""

from __future__ import annotations

import numpy as np

from exwarp_cli.accel.kernel import MlpKernel
from exwarp_cli.accel.quantised_mlp import infer_reference
from exwarp_cli.domain.checkup import Check, Remark, failure, warning
from exwarp_cli.domain.wording import counted, enumerated
from exwarp_cli.errors import ExwarpError
from exwarp_cli.io.models import CUDA, load_extrapolator, providers, runtime_version, shipped_folder
from exwarp_cli.io.policy_files import load_policy
from exwarp_cli.io.shipped import IntegerPolicy, judge_shipped
from exwarp_cli.pipeline.accelerator import sample_states

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
    remarks = tuple(_remark_on(device, said) for device, said in problems.items() if said)
    good = [device.upper() for device, said in problems.items() if said is None]
    facts = {
        "onnxruntime": runtime_version(),
        "providers": list(offered),
        "devices": {device: said is None for device, said in problems.items()},
    }
    runs = (
        f"runs the extrapolator on {enumerated(good)}" if good else "does not run the extrapolator"
    )
    told = f"onnxruntime {runtime_version()} {runs}"
    lines = [f"offers {', '.join(_PROVIDERS.get(name, name) for name in offered)}"]
    if CUDA not in offered:
        told += "; no CUDA"
        lines.append("for CUDA put onnxruntime-gpu in the place of onnxruntime")
    return Check(told, remarks, facts, tuple(lines))


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
    found = f"{counted(len(states), 'decision')} in 8-bit integers, the same in all forms"
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


def _remark_on(device: str, said: str) -> Remark:
    """A network that does not run on the CPU is a failure; elsewhere there is still the CPU."""
    return failure(said) if device == "cpu" else warning(said)
