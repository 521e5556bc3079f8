from __future__ import annotations

import pytest
import torch
from torch import nn

from plp_lightning.methods.plp.terms import DomainDiscriminator
from plp_lightning.networks import ActionDecoder, StateEncoder, TaskNetwork, mlp, with_frozen_parameters


def count(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.parametrize("layers", [0, 1, 3])
def test_an_mlp_is_hidden_gelu_layers_and_one_linear_layer(layers: int) -> None:
    net = mlp(5, 7, layers, 2)
    assert [type(module) for module in net] == [nn.Linear, nn.GELU] * layers + [nn.Linear]
    x = torch.randn(4, 5)
    by_hand = x
    for module in [m for m in net if isinstance(m, nn.Linear)]:
        inner = by_hand @ module.weight.T + module.bias
        by_hand = inner if module is net[-1] else inner * 0.5 * (1 + torch.erf(inner / 2**0.5))
    torch.testing.assert_close(net(x), by_hand)


def test_sizes_by_hand() -> None:
    assert count(mlp(5, 7, 3, 2)) == (5 * 7 + 7) + 2 * (7 * 7 + 7) + (7 * 2 + 2)
    assert count(StateEncoder(6, 8, 16, 2)) == (6 * 16 + 16) + (16 * 16 + 16) + (16 * 8 + 8)
    assert count(TaskNetwork(8, 5, 8, 16, 1)) == (13 * 16 + 16) + (16 * 8 + 8)
    assert count(ActionDecoder(8, 3, 2, 16, 1)) == (11 * 16 + 16) + (16 * 2 + 2)
    assert count(DomainDiscriminator(8, 3, 16, 1)) == (8 * 16 + 16) + (16 * 3 + 3)


def test_the_common_policy_sees_the_task_one_hot() -> None:
    common = TaskNetwork(4, tasks=3, outputs=4, hidden=8, layers=1)
    latent = torch.randn(3, 4)
    by_hand = common.net(torch.cat([latent, torch.eye(3)[[2, 0, 1]]], dim=1))
    torch.testing.assert_close(common(latent, torch.tensor([2, 0, 1])), by_hand)


def test_decoded_actions_lie_within_bounds() -> None:
    decoder = ActionDecoder(4, 2, 3, hidden=8, layers=1)
    actions = decoder(torch.randn(50, 4) * 1000, torch.randn(50, 2) * 1000)
    assert actions.shape == (50, 3)
    assert actions.abs().max() <= 1
    assert actions.abs().max() > 0.99


def test_judging_gives_the_same_logits_and_no_gradient_to_the_discriminator() -> None:
    discriminator = DomainDiscriminator(4, 2, hidden=8, layers=2)
    latent = torch.randn(5, 4, requires_grad=True)
    logits = with_frozen_parameters(discriminator)(latent)
    torch.testing.assert_close(logits, discriminator(latent))
    logits.square().sum().backward()
    assert latent.grad is not None
    assert latent.grad.abs().sum() > 0
    assert all(parameter.grad is None for parameter in discriminator.parameters())


def test_a_saturated_decoder_can_be_led_out_again() -> None:
    decoder = ActionDecoder(1, 0, 1, hidden=4, layers=0, gradient_floor=0.1)
    with torch.no_grad():
        decoder.net[0].weight.fill_(1.0)
        decoder.net[0].bias.zero_()
    plan = torch.tensor([[-40.0], [0.0], [0.5], [40.0]], requires_grad=True)
    action = decoder(plan, torch.zeros(4, 0))
    assert torch.equal(action, torch.tanh(plan))
    action.sum().backward()
    torch.testing.assert_close(plan.grad, 1 - torch.tanh(plan.detach()) ** 2 + 0.1)
    assert plan.grad[0] == plan.grad[3] == 0.1  # the plain slope is exactly zero there
