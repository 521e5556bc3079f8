from __future__ import annotations

import torch
from torch import Tensor, nn

from plp_lightning.methods.cdil.policy import Pace, Translator
from plp_lightning.networks import TaskNetwork, with_frozen_parameters


def gradients(loss: Tensor, module: nn.Module) -> float:
    found = torch.autograd.grad(loss, [*module.parameters()], retain_graph=True, allow_unused=True)
    return sum(float(g.abs().sum()) for g in found if g is not None)


def test_pace_puts_changes_in_units_of_their_own_domain() -> None:
    pace, unit = Pace({"source": 3, "target": 2}), torch.tensor([3.0, 1.0, 0.5])
    now = torch.tensor([[0.0, 5.0, 1.0], [1.0, 5.0, 1.0]])
    pace.fit(unit, "source")
    assert pace.target.tolist() == [1, 1]
    torch.testing.assert_close(pace(now, now + 1, "source"), torch.cat([now, (1 / unit).expand(2, 3)], dim=1))


def test_a_task_network_that_only_judges_learns_nothing() -> None:
    network = TaskNetwork(3, tasks=4, outputs=2, hidden=8, layers=1)
    x, task = torch.randn(5, 3, requires_grad=True), torch.arange(5) % 4
    torch.testing.assert_close(with_frozen_parameters(network)(x, task), network(x, task))
    assert gradients(with_frozen_parameters(network)(x, task).sum(), network) == 0
    (of_x,) = torch.autograd.grad(with_frozen_parameters(network)(x, task).sum(), x)
    assert of_x.abs().sum() > 0


def test_a_task_network_tells_tasks_apart() -> None:
    network = TaskNetwork(3, tasks=4, outputs=2, hidden=8, layers=1)
    out = network(torch.ones(4, 3), torch.arange(4))
    assert len({tuple(row) for row in out.tolist()}) == 4


def test_a_translation_goes_through_the_own_encoder_and_the_others_decoder() -> None:
    translator = Translator({"source": 3, "target": 5}, latent=4, hidden=8, encoder_layers=1, decoder_layers=1)
    state = torch.randn(2, 6, 3)
    there = translator(state, "source")
    assert torch.equal(there.latent, translator.encoders["source"](state))
    assert torch.equal(there.state, translator.decoders["target"](there.latent))
    assert translator(there.state, "target").state.shape == state.shape
