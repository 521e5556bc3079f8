"""A module whose parameters stand still: gradients reach its inputs alone."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn


def with_frozen_parameters(module: nn.Module) -> Callable[..., Tensor]:
    """``module``, of one tensor, as a function of its inputs: for losses of their maker and not of the module.

    A generator is taught by its discriminator's verdict, which would teach the discriminator to be fooled if the
    gradient reached it. Parameters are detached, so other losses of the same step may train them.

    Example:
        >>> linear, x = nn.Linear(2, 1), torch.ones(1, 2, requires_grad=True)
        >>> with_frozen_parameters(linear)(x).sum().backward()
        >>> linear.weight.grad is None, x.grad is None
        (True, False)
    """
    fixed = {name: parameter.detach() for name, parameter in module.named_parameters()}
    return lambda *inputs: torch.func.functional_call(module, fixed, inputs)
