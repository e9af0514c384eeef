"""The learned policy: from what surrounds a key interval to its path (paper, section IV-C)."""

from __future__ import annotations

from exwarp_cli.accel.fixed_point import to_fixed
from exwarp_cli.accel.kernel import MlpKernel
from exwarp_cli.accel.quantised_mlp import QuantisedMlp
from exwarp_cli.domain.decision import CHOICES, SLOTS, Decision, Plan, path_of, walk
from exwarp_cli.policy.state import Surroundings


class LearnedPolicy:
    """The predictor as the accelerator runs it: integers from the state's inputs to the decision.

    Parameters
    ----------
    network
        Takes the 44 inputs of `exwarp_cli.policy.state`.
    """

    def __init__(self, network: QuantisedMlp) -> None:
        self._kernel = MlpKernel(network)

    def plan(self, surroundings: Surroundings) -> Plan:
        """Decide all slots of a key interval; the larger output wins, a tie goes to warping."""
        decisions: list[Decision] = []

        def choose(node: str) -> str:
            state = surroundings.inputs(node)
            fixed = to_fixed(state)
            outputs, chosen = self._kernel.decide(fixed)
            choice = CHOICES[chosen]
            decisions.append(
                Decision(
                    node,
                    choice,
                    surroundings.now[SLOTS[node] - 1],
                    tuple(int(value) for value in fixed),
                    outputs,
                )
            )
            return choice

        return Plan(path_of(dict(walk(choose))), tuple(decisions))
