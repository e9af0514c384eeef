"""What a policy has to beat: a linear regression that looks at the next reward only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import NODES
from exwarp_cli.policy.outcomes import rewards
from exwarp_cli.training.policy_table import PolicyTable

F64 = npt.NDArray[np.float64]

RIDGE = 1e-2
"""Weight of the squared coefficients beside the mean squared error, in units of the inputs."""


def regress(tables: Sequence[PolicyTable]) -> F64:
    """Fit the reward of both choices at each node to the states of some scenes.

    Returns
    -------
    float64 [5, 45, 2]
        Coefficients of the 44 inputs and of a constant, by node and choice.
    """
    states = np.concatenate([table.states for table in tables])
    gains = np.concatenate([rewards(table.outcomes) for table in tables])
    weights = np.concatenate([np.full(len(table), 1 / len(table)) for table in tables])
    out = []
    for node in range(len(NODES)):
        x = np.concatenate([states[:, node], np.ones((len(states), 1))], axis=1)
        scaled = x * weights[:, None] / weights.sum()
        out.append(
            np.linalg.solve(scaled.T @ x + RIDGE * np.eye(x.shape[1]), scaled.T @ gains[:, node])
        )
    return np.array(out)


def predicted(coefficients: F64, table: PolicyTable) -> F64:
    """Return the expected reward of both choices at every node, float64 [N, 5, 2]."""
    states = table.states
    x = np.concatenate([states, np.ones((*states.shape[:2], 1))], axis=2)
    return np.asarray(np.einsum("nki,kic->nkc", x, coefficients))
