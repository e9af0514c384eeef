"""Extrapolation networks: what they answer, and what holes look like to them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from exwarp_cli.domain.network_api import TIME_INPUT, NetworkPictures
from exwarp_cli.models.picture_network import load_extrapolator
from exwarp_cli.research.training.extrapolation_network import (
    ARCHITECTURES,
    SIDES,
    STRIDE,
    Architecture,
    ExtrapolationNetwork,
    _first_visible,
)
from tests.unit.training.network_inputs import example


@pytest.fixture(params=ARCHITECTURES)
def network(request):
    torch.manual_seed(0)
    return ExtrapolationNetwork(request.param, 8).eval()


@pytest.mark.parametrize("size", [(STRIDE, 2 * STRIDE), (48, 80)])
def test_networks_answer_at_any_multiple_of_the_stride(network, size):
    answer = network(**example(*size))
    assert answer.shape == (1, 3, *size)
    assert torch.isfinite(answer).all()


@pytest.mark.parametrize(
    "name", [n for n, a in ARCHITECTURES.items() if not (a.residual or a.patched)]
)
def test_weights_invent_nothing(name):
    """Where all candidates are of one colour, so is the answer."""
    torch.manual_seed(1)
    network = ExtrapolationNetwork(name, 8).eval()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    given = example(32, 48)
    given["warped"][:, 3:] = 0.7
    for index in range(3):
        given["history"][:, 4 * index : 4 * index + 3] = 0.7
    np.testing.assert_allclose(network(**given).detach().numpy(), 0.7, rtol=1e-5)


def test_an_unknown_past_is_replaced_by_the_filled_warp():
    network = ExtrapolationNetwork("kernels", 8).eval()
    given = example(32, 32)
    given["warped"][:, 3:] = 0.7
    given["history"].zero_()
    np.testing.assert_allclose(network(**given).detach().numpy(), 0.7, rtol=1e-5)


def test_candidates_are_counted_right():
    for name, architecture in ARCHITECTURES.items():
        network = ExtrapolationNetwork(name, 8)
        given = example(32, 32)
        filled = given["warped"][:, 3:]
        flow = torch.zeros(1, 2 * architecture.flow, 32, 32)
        reach, mask = architecture.reach, given["mask"]
        sides = [_first_visible(filled, mask, side, reach) for side in SIDES] if reach else []
        when = given[TIME_INPUT].reshape(-1, 1, 1, 1)
        made = network._candidates(filled, given["history"], when, flow, sides)
        assert not architecture.candidates or len(made) == network.candidate_count


def test_a_candidate_can_be_moved():
    network = ExtrapolationNetwork("kernels-flow", 8)
    frame = torch.arange(12.0).reshape(1, 1, 3, 4).repeat(1, 3, 1, 1)
    history, when = torch.zeros(1, 12, 3, 4), torch.zeros(1, 1, 1, 1)
    flow = torch.zeros(1, 4, 3, 4)
    flow[:, 0] = 1  # the first one by a column, the second one by two rows
    flow[:, 3] = 2
    *_, first, second = network._candidates(frame, history, when, flow, [])
    np.testing.assert_allclose(first[0, 0, :, :3], frame[0, 0, :, 1:], atol=1e-5)
    np.testing.assert_allclose(second[0, 0, 0], frame[0, 0, 2], atol=1e-5)


@pytest.mark.parametrize(
    ("seen", "side", "colours", "distances"),
    [
        ([1, 6], (1, 0), [0, 1, 1, 1, 1, 5, 6, 6], [3, 0, 1, 2, 3, 3, 0, 1]),
        ([1, 6], (-1, 0), [1, 1, 2, 6, 6, 6, 6, 7], [1, 0, 3, 3, 2, 1, 0, 3]),
        ([1, 2, 4], (1, 0), [0, 1, 2, 2, 4, 4, 4, 4], [3, 0, 0, 1, 0, 1, 2, 3]),
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_holes_look_to_their_sides(seen, side, colours, distances, turned):
    """What is further than the reach is not found: the colour is the frame's own."""
    frame = torch.arange(8.0).reshape(1, 1, 1, 8).repeat(1, 3, 1, 1)
    mask = torch.zeros(1, 1, 1, 8)
    mask[..., seen] = 1
    if turned:
        frame, mask, side = frame.mT, mask.mT, side[::-1]
    found = _first_visible(frame, mask, side, 3).flatten(2)
    assert found[0, 0].tolist() == colours
    np.testing.assert_allclose(3 * found[0, 3], distances, rtol=1e-6)


class TestLight:
    """A network that changes nothing but the light of what is visible."""

    @pytest.fixture
    def answers(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Filled warp and mask; what the same weights answer with that bound and without it."""
        networks = [
            ExtrapolationNetwork(name, 8).eval() for name in ("kernels-light", "kernels-deep")
        ]
        torch.manual_seed(2)
        with torch.no_grad():
            for parameter in networks[0].parameters():
                parameter.add_(0.2 * torch.randn_like(parameter))
            networks[1].load_state_dict(networks[0].state_dict())
            given = example(96, 128)
            given["mask"][:] = 1
            given["mask"][..., 40:60, 30:70] = 0
            lit, free = (network(**given) for network in networks)
        return given["warped"][:, 3:], given["mask"], lit, free

    def test_holes_are_as_without_the_bound(self, answers):
        _, mask, lit, free = answers
        hole = (mask == 0).expand_as(lit)
        torch.testing.assert_close(lit[hole], free[hole])

    def test_detail_is_that_of_the_warp(self, answers):
        filled, mask, lit, free = answers
        pairs = (mask[..., 1:] * mask[..., :-1]).expand_as(lit[..., 1:]) > 0
        change, before = ((x - filled).diff(dim=3)[pairs].abs().mean() for x in (lit, free))
        assert 0 < change < before / 5

    def test_light_is_that_of_the_answer(self, answers):
        filled, _, lit, free = answers
        left_of_holes = (slice(None), slice(None), slice(None), slice(76, None))
        lit, free = ((x - filled)[left_of_holes].mean() for x in (lit, free))
        torch.testing.assert_close(lit, free, rtol=0.3, atol=0.005)

    def test_where_all_is_hidden_nothing_is_divided_by_zero(self):
        given = example(32, 48)
        given["mask"].zero_()
        assert torch.isfinite(ExtrapolationNetwork("kernels-light", 8).eval()(**given)).all()


def test_architectures_differ():
    assert len(set(ARCHITECTURES.values())) == len(ARCHITECTURES) >= 4
    assert Architecture() == ARCHITECTURES["blend"]


def test_threads_change_nothing():
    pictures = {name: p[0].numpy() for name, p in example(120, 213).items() if name != TIME_INPUT}
    one, *more = (
        load_extrapolator(None, threads, "cpu")(NetworkPictures(pictures, 0.5))
        for threads in (1, 2, 3)
    )
    for answer in more:
        np.testing.assert_array_equal(answer, one)
    assert np.abs(one - pictures["warped"][3:]).mean() > 0.01, "the network does something"
