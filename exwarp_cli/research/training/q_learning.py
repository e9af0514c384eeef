"""Deep Q-learning of the decisions (paper, section IV-C), and the network in integers.

The network estimates the return of either choice in a state. It is trained towards the reward plus
the discounted value of the next state, by a copy of itself that lags behind. An episode is one key
interval: no decision changes what later intervals look like or earn. As the outcome of both choices
is known at every node of the table, each sampled state trains both outputs.

The integers are the accelerator's (paper, section IV-C2): weights int8 with a scale for each
neuron, symmetric; biases int32 in the scale of the sums. Inputs lie in 0 … 1 by definition, so
theirs is 1/127; activations are scaled by the largest value that calibration states bring forth,
and saturate there. The last layer has one scale, as its two sums are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from exwarp_cli.accelerator import mlp
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import CHOICES, FEATURES, NEXT_NODE, NODES
from exwarp_cli.policy.outcomes import choice_rewards
from exwarp_cli.policy.state import INPUTS, STATE_COUNT
from exwarp_cli.research.training.outcome_tables import F64, PolicyTable
from exwarp_cli.research.training.training_settings import PolicySettings, TilePolicySettings
from exwarp_cli.runtime.stop import check_stop

# Weights [out, in] and biases [out] of each layer.
Layers = tuple[tuple[F64, F64], ...]

# Index of the node after each choice, -1 at the end: [5, 2].
AFTER = torch.tensor(
    [[NODES.index(NEXT_NODE[n, c]) if (n, c) in NEXT_NODE else -1 for c in CHOICES] for n in NODES]
)

# Which inputs are features, and not the node: [44].
FEATURE = torch.tensor(([1.0] * len(FEATURES) + [0.0] * len(NODES)) * STATE_COUNT)

MULTIPLIER_BITS = 31

# Weights are scaled so that no bias is larger, which leaves the sums as much again.
MOST_BIAS = 2.0**30


def make_network() -> nn.Sequential:
    """Return the paper's network with fresh weights: ReLU between its layers."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(mlp.PAPER_SIZES):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def fit_network(
    settings: PolicySettings | TilePolicySettings,
    draw: Callable[[nn.Module], tuple[Tensor, Tensor]],
    loss_of: Callable[[Tensor, Tensor], Tensor],
) -> Layers:
    """Train a network in one thread; the same on one kind of processor.

    `draw` takes the lagging copy and returns states [B, ..., 44] and what the network should
    answer; `loss_of` takes the network's answer and what it should be.
    """
    threads = torch.get_num_threads()
    # Batches are small: two threads took 3 times the processor's time, and no less time in all.
    torch.set_num_threads(1)
    try:
        torch.manual_seed(settings.seed)
        network, target = make_network(), make_network()
        optimiser = torch.optim.AdamW(
            network.parameters(), lr=settings.rate, weight_decay=settings.decay
        )
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
        for step in range(settings.steps):
            if step % settings.lag == 0:
                target.load_state_dict(network.state_dict())
            with torch.no_grad():
                states, aim = draw(target)
                states = states + settings.jitter * FEATURE * torch.randn_like(states)
            loss = loss_of(network(states), aim)
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            schedule.step()
            check_stop()
    finally:
        torch.set_num_threads(threads)
    return tuple(
        (layer.weight.detach().double().numpy(), layer.bias.detach().double().numpy())
        for layer in network
        if isinstance(layer, nn.Linear)
    )


def train_decisions(tables: Sequence[PolicyTable], settings: PolicySettings) -> Layers:
    """Learn from the tables of some scenes; each scene counts alike, whatever its size."""
    states = [torch.from_numpy(table.states).float() for table in tables]
    gains = [torch.from_numpy(choice_rewards(table.outcomes)).float() for table in tables]

    def draw(target: nn.Module) -> tuple[Tensor, Tensor]:
        """Draw states and the returns of both choices: reward, and the value of what follows."""
        scene = torch.randint(len(states), (settings.batch,))
        batch: list[tuple[Tensor, ...]] = []
        for index in range(len(states)):
            count = int((scene == index).sum())
            row = torch.randint(len(states[index]), (count,))
            node = torch.randint(len(NODES), (count,))
            after = AFTER[node]
            following = states[index][row[:, None], after.clamp(min=0)]
            batch.append(
                (states[index][row, node], gains[index][row, node], following, (after >= 0).float())
            )
        state, reward, following, continues = (torch.cat(part) for part in zip(*batch, strict=True))
        ahead = expand_value(target(following).amax(dim=-1)) * continues
        return state, compress_gain(reward + settings.discount * ahead)

    return fit_network(settings, draw, lambda answer, aim: (answer - aim).square().mean())


def compress_gain(gain: Tensor) -> Tensor:
    """Return sign(x) log(1 + |x|): what the network's outputs stand for."""
    # Returns are 20 dB where everything moves and a few tenths where hardly anything does; errors
    # count alike so. Order is kept, hence so is every decision. (Pohlen et al., Observe and look
    # further, 2018, use a square root to the same end.)
    return gain.sign() * gain.abs().log1p()


def expand_value(value: Tensor) -> Tensor:
    """Return the gain that an output stands for: the inverse of `compress_gain`."""
    return value.sign() * value.abs().expm1()


def q_values(layers: Layers, table: PolicyTable) -> F64:
    """Return a network's outputs at every node of every interval, float64 [N, 5, 2]."""
    values = table.states
    for number, (weights, biases) in enumerate(layers):
        values = (np.maximum(values, 0) if number else values) @ weights.T + biases
    return values


def integer_values(network: mlp.QuantisedMlp, states: F64) -> npt.NDArray[np.int64]:
    """Return a network's outputs in integers for states float64 [N, nodes, 44], [N, nodes, 2]."""
    outputs, _ = MlpKernel(network).decide_many(mlp.to_fixed(states.reshape(-1, INPUTS)))
    return outputs.astype(np.int64).reshape(*states.shape[:2], len(CHOICES))


def quantise(network: Layers, states: F64) -> mlp.QuantisedMlp:
    """Return a network in integers, calibrated on states, float64 [..., in], 0 to 1."""
    unit = 1 / mlp.MAX_ACTIVATION
    inputs = factors(np.full(states.shape[-1], mlp.MAX_ACTIVATION / mlp.ONE))
    layers: list[mlp.QuantisedLayer] = []
    activations = states.reshape(-1, states.shape[-1])
    for number, (weight, bias) in enumerate(network):
        is_last = number == len(network) - 1
        largest = np.abs(weight).max(axis=1) / mlp.MAX_ACTIVATION
        scale = np.maximum(np.maximum(largest, np.abs(bias) / (MOST_BIAS * unit)), 1e-14)
        if is_last:
            scale = np.full(bias.shape, scale.max())
        integers = np.rint(weight / scale[:, None]).astype(np.int8)
        offset = np.rint(bias / (scale * unit)).astype(np.int32)
        if is_last:
            layers.append(mlp.QuantisedLayer(integers, offset))
            break
        activations = np.maximum(activations @ weight.T + bias, 0)
        following = max(float(activations.max()), 1e-12) / mlp.MAX_ACTIVATION
        layers.append(mlp.QuantisedLayer(integers, offset, factors(scale * unit / following)))
        unit = following
    return mlp.QuantisedMlp(inputs, tuple(layers))


def factors(ratios: F64) -> mlp.Requantisation:
    """Return positive ratios as int32 multipliers and shifts, to 30 bits where they fit."""
    _, exponents = np.frexp(ratios)
    shifts = np.clip(MULTIPLIER_BITS - exponents, 0, mlp.MAX_SHIFT)
    multipliers = np.rint(np.ldexp(ratios, shifts)).clip(1, 2**MULTIPLIER_BITS - 1)
    return mlp.Requantisation(multipliers.astype(np.int32), shifts.astype(np.uint8))
