"""Larger networks from smaller ones."""

from __future__ import annotations

import pytest
import torch

from exwarp_cli.research.training.extrapolation_network import ExtrapolationNetwork
from exwarp_cli.research.training.extrapolator_training import grow_weights
from tests.unit.training.network_inputs import example


def learnt(name: str, width: int) -> torch.nn.Module:
    """A network whose weights and statistics are all of some importance."""
    torch.manual_seed(1)
    network = ExtrapolationNetwork(name, width)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
        for name, statistic in network.named_buffers():
            if statistic.is_floating_point():
                statistic.uniform_(0.5, 1.5) if "var" in name else statistic.normal_(0, 0.2)
    return network.eval()


@pytest.mark.parametrize(
    ("small", "large"),
    [
        (("kernels-patched", 8), ("kernels-deep", 8)),
        (("kernels-patched", 8), ("kernels-patched", 12)),
        (("blend", 8), ("blend", 8)),
    ],
)
def test_larger_networks_begin_as_the_smaller_ones(small, large):
    before, after = learnt(*small), ExtrapolationNetwork(*large)
    after.load_state_dict(grow_weights(before.state_dict(), after))
    given = example(48, 32)
    with torch.no_grad():
        torch.testing.assert_close(after.eval()(**given), before(**given), rtol=1e-4, atol=1e-4)


def test_what_is_new_can_be_learnt():
    """Channels that nothing listens to still get gradients where they are listened to."""
    before, after = learnt("kernels-patched", 8), ExtrapolationNetwork("kernels-deep", 8)
    after.load_state_dict(grow_weights(before.state_dict(), after))
    after.train()(**example(48, 32)).square().sum().backward()
    weight = after.net.down[0][1].both.weight
    assert weight.grad[:, -1].abs().max() > 0
    assert all(p.grad is not None for p in after.parameters())


@pytest.mark.parametrize(
    ("small", "large"),
    [
        (("kernels-deep", 8), ("kernels-patched", 8)),
        (("blend", 8), ("kernels", 8)),
    ],
)
def test_networks_do_not_shrink_nor_answer_otherwise(small, large):
    with pytest.raises(ValueError, match=r"cannot hold|answers with"):
        grow_weights(ExtrapolationNetwork(*small).state_dict(), ExtrapolationNetwork(*large))


def test_other_layers_are_refused():
    with pytest.raises(KeyError, match="detail"):
        grow_weights(
            ExtrapolationNetwork("blend", 8).state_dict(), ExtrapolationNetwork("blend-detail", 8)
        )
