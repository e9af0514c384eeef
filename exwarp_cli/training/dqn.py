"""Deep Q-learning of the decisions (paper, section IV-C).

The network estimates the return of either choice in a state. It is trained towards the reward plus
the discounted value of the next state, by a copy of itself that lags behind. An episode is one key
interval: no decision changes what later intervals look like or earn. As the outcome of both choices
is known at every node of the table, each sampled state trains both outputs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from exwarp_cli.domain.decision import CHOICES, FEATURES, NEXT_NODE, NODES
from exwarp_cli.policy.outcomes import choice_rewards
from exwarp_cli.policy.state import INPUTS, STATE_COUNT
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.training.policy_table import PolicyTable
from exwarp_cli.training.settings import PolicySettings

F64 = npt.NDArray[np.float64]

Layers = tuple[tuple[F64, F64], ...]
"""Weights [out, in] and biases [out] of each layer."""

LAYERS = (INPUTS, 128, 256, 128, len(CHOICES))
"""Of the paper."""

AFTER = torch.tensor(
    [[NODES.index(NEXT_NODE[n, c]) if (n, c) in NEXT_NODE else -1 for c in CHOICES] for n in NODES]
)
"""Index of the node after each choice, -1 at the end: [5, 2]."""


FEATURE = torch.tensor(([1.0] * len(FEATURES) + [0.0] * len(NODES)) * STATE_COUNT)
"""Which inputs are features, and not the node: [44]."""


def make_network() -> nn.Sequential:
    """Return the paper's network with fresh weights: ReLU between its layers."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(LAYERS):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def train(tables: Sequence[PolicyTable], settings: PolicySettings) -> Layers:
    """Learn from the tables of some scenes; each scene counts alike, whatever its size.

    Returns
    -------
    tuple of pairs of arrays
        Weights float64 [out, in] and biases [out] of each layer; the same for the same tables and
        settings on one kind of processor.
    """
    with one_thread():
        return layers_of(_trained(tables, settings))


@contextmanager
def one_thread() -> Iterator[None]:
    """Train in one thread.

    Batches are small: two threads took 3 times the processor's time, and no less time in all.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def layers_of(network: nn.Sequential) -> Layers:
    """Return the weights and biases of a network's layers."""
    linear = [layer for layer in network if isinstance(layer, nn.Linear)]
    return tuple(
        (layer.weight.detach().double().numpy(), layer.bias.detach().double().numpy())
        for layer in linear
    )


def _trained(tables: Sequence[PolicyTable], settings: PolicySettings) -> nn.Sequential:
    torch.manual_seed(settings.seed)
    network, target = make_network(), make_network()
    target.load_state_dict(network.state_dict())
    states = [torch.from_numpy(table.states).float() for table in tables]
    gains = [torch.from_numpy(choice_rewards(table.outcomes)).float() for table in tables]
    optimiser = torch.optim.AdamW(
        network.parameters(), lr=settings.rate, weight_decay=settings.decay
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    for step in range(settings.steps):
        if step % settings.lag == 0:
            target.load_state_dict(network.state_dict())
        state, reward, following, goes_on = _batch(states, gains, settings.batch)
        with torch.no_grad():
            ahead = expanded(target(following).amax(dim=-1)) * goes_on
            aim = compressed(reward + settings.discount * ahead)
        state = state + settings.jitter * FEATURE * torch.randn_like(state)
        loss = (network(state) - aim).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        check_stop()
    return network


def compressed(gain: Tensor) -> Tensor:
    """Return sign(x) log(1 + |x|): what the network's outputs stand for.

    Returns are 20 dB where everything moves and a few tenths where hardly anything does; errors
    count alike so. Order is kept, hence so is every decision. (Pohlen et al., Observe and look
    further, 2018, use a square root to the same end.)
    """
    return gain.sign() * gain.abs().log1p()


def expanded(value: Tensor) -> Tensor:
    """Return the gain that an output stands for: the inverse of `compressed`."""
    return value.sign() * value.abs().expm1()


def values(layers: Layers, table: PolicyTable) -> F64:
    """Return a network's outputs at every node of every interval, float64 [N, 5, 2]."""
    found = table.states
    for weights, biases in layers[:-1]:
        found = np.maximum(found @ weights.T + biases, 0)
    weights, biases = layers[-1]
    return np.asarray(found @ weights.T + biases)


def _batch(
    states: list[Tensor], gains: list[Tensor], count: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Draw states, the rewards of both choices, what follows each, and whether anything does."""
    scene = torch.randint(len(states), (count,))
    found: list[tuple[Tensor, ...]] = []
    for index in range(len(states)):
        share = int((scene == index).sum())
        row = torch.randint(len(states[index]), (share,))
        node = torch.randint(len(NODES), (share,))
        after = AFTER[node]
        following = states[index][row[:, None], after.clamp(min=0)]
        found.append(
            (states[index][row, node], gains[index][row, node], following, (after >= 0).float())
        )
    state, reward, following, goes_on = (torch.cat(parts) for parts in zip(*found, strict=True))
    return state, reward, following, goes_on
