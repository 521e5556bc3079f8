"""Transformer: an encoder that reads sequences, and a causal decoder that also goes on step by step.

"Attention Is All You Need" (https://arxiv.org/abs/1706.03762), with normalisation before each sublayer ("On Layer
Normalization in the Transformer Architecture", https://arxiv.org/abs/2002.04745) and GELU. Dropout is where the
first of these has it (Section 5.4): on what each sublayer gives, not on the attention weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from plp_lightning.methods.contextual.dropout import Dropout
from plp_lightning.methods.contextual.frames import Packing, group

FIRST_ROOM = 64
"""Steps that a cache has room for when it begins; the room doubles whenever it is full."""


class Attention(nn.Module):
    """Multi-head scaled dot-product attention (Section 3.2 of the paper above), H ``heads`` of W / H units each."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.output = nn.Linear(width, width)

    def forward(self, x: Tensor, packing: Packing, seen: Tensor, seen_packing: Packing, causal: bool = False) -> Tensor:
        """Looks frames ``(F, W)`` of P sequences up in those of P others, ``seen (S, W)``, as ``(F, W)``.

        Where ``causal``, both are the same frames, and none looks at a frame behind its own.
        """
        query, key_value = self.query(x), self.key_value(seen)
        if packing.lengths is None or seen_packing.lengths is None:
            mask = None if causal else seen_packing.mask[:, None, None]
            found = packing.pack(self.look(packing.pad(query), self._padded(key_value, seen_packing), mask, causal))
        else:
            found = self._look_one_by_one(query, key_value, packing.lengths, seen_packing.lengths, causal)
        added: Tensor = self.output(found)
        return added

    def _look_one_by_one(
        self, query: Tensor, key_value: Tensor, lengths: list[int], seen_lengths: list[int], causal: bool
    ) -> Tensor:
        """Looks sequences end to end, ``(F, W)``, up in ``(S, 2 W)``, each for itself, so that nothing is padded."""
        dtype = torch.promote_types(query.dtype, torch.float32)
        queries = query.to(dtype).split(lengths)
        keys, values = (part.split(seen_lengths) for part in key_value.to(dtype).chunk(2, dim=1))
        found = [
            _attend(self._heads(q[None]), self._heads(k[None]), self._heads(v[None]), causal=causal)
            for q, k, v in zip(queries, keys, values, strict=True)
        ]
        return torch.cat([x.transpose(1, 2).flatten(0, 1) for x in found]).flatten(1)

    def remember(self, x: Tensor, packing: Packing) -> Tensor:
        """Keys and values ``(2, P, H, T, W / H)`` of frames ``(F, W)``."""
        return self._padded(self.key_value(x), packing)

    def look(self, query: Tensor, memory: Tensor, mask: Tensor | None = None, causal: bool = False) -> Tensor:
        """Looks queries ``(P, T, W)`` up in a memory ``(2, P, H, S, W / H)``, as ``(P, T, W)``."""
        found = _attend(self._heads(query), memory[0], memory[1], mask, causal)
        return found.transpose(1, 2).flatten(-2)

    def step(self, x: Tensor, past: Past) -> Tensor:
        """Looks the next frame ``(P, W)`` of each sequence up in those before it and itself, as ``(P, W)``."""
        memory = past.append(self._split(self.key_value(x)[:, None]))
        found: Tensor = self.output(self.look(self.query(x)[:, None], memory)[:, 0])
        return found

    def recall(self, x: Tensor, memory: Tensor, mask: Tensor, packing: Packing) -> Tensor:
        """Looks frames ``(F, W)`` up in the memory of their sequence, as ``(F, W)``."""
        found: Tensor = self.output(packing.pack(self.look(packing.pad(self.query(x)), memory, mask)))
        return found

    def _heads(self, x: Tensor) -> Tensor:
        """``(P, T, W)`` → ``(P, H, T, W / H)``."""
        heads: Tensor = x.unflatten(-1, (self.heads, -1))
        return heads.transpose(1, 2)

    def _padded(self, key_value: Tensor, packing: Packing) -> Tensor:
        """``(F, 2 W)`` → ``(2, P, H, T, W / H)``."""
        return self._split(packing.pad(key_value))

    def _split(self, key_value: Tensor) -> Tensor:
        """``(P, T, 2 W)`` → ``(2, P, H, T, W / H)``."""
        heads: Tensor = key_value.unflatten(-1, (2, self.heads, -1))
        return heads.permute(2, 0, 3, 1, 4)


def _attend(query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None = None, causal: bool = False) -> Tensor:
    """Torch's attention, on a processor in float32 or better: its gradients take six times as long in bfloat16."""
    if query.device.type != "cpu":
        return F.scaled_dot_product_attention(query, key, value, mask, is_causal=causal)
    dtype = torch.promote_types(query.dtype, torch.float32)
    with torch.autocast("cpu", enabled=False):
        return F.scaled_dot_product_attention(query.to(dtype), key.to(dtype), value.to(dtype), mask, is_causal=causal)


class Past:
    """Keys and values of all steps so far, in one layer, with room for more."""

    def __init__(self) -> None:
        self.store: Tensor | None = None
        self.steps = 0

    def append(self, memory: Tensor) -> Tensor:
        """Keeps a step's ``(2, P, H, 1, W / H)`` and gives those of all steps so far, ``(2, P, H, T, W / H)``."""
        if self.store is None:
            self.store = memory[:, :, :, :0]
        if self.steps == self.store.shape[3]:
            self.store = F.pad(self.store, (0, 0, 0, max(FIRST_ROOM, self.steps)))
        self.store[:, :, :, self.steps] = memory[:, :, :, 0]
        self.steps += 1
        return self.store[:, :, :, : self.steps]

    def take(self, rows: Tensor) -> None:
        """Goes on with the sequences ``rows (n,)`` alone."""
        if self.store is not None:
            self.store = self.store[:, rows]


class Cache:
    """Memory of a decoder for sequences that go on step by step: frames shown to them, and their past.

    Args:
        shown: Keys and values ``(2, U, H, S, W / H)`` of the frames shown, by layer; each may be shown to several.
        mask: ``(U, 1, 1, S)`` bool, False behind the end of the frames shown.
    """

    def __init__(self, shown: Sequence[Tensor], mask: Tensor) -> None:
        self.shown, self.mask = list(shown), mask
        self.past = [Past() for _ in shown]
        self._show(torch.arange(len(mask), device=mask.device))

    @property
    def steps(self) -> int:
        """Steps so far."""
        return self.past[0].steps

    def take(self, rows: Tensor) -> None:
        """Goes on with the sequences ``rows (n,)`` alone, an index array that may also repeat some."""
        self._show(self.which[rows])
        for past in self.past:
            past.take(rows)

    def _show(self, which: Tensor) -> None:
        """Notes the numbers ``(P,)`` of what was shown to each sequence: those of one number look at it together."""
        self.which, self.packing = which, group(which, len(self.mask))


def _feed_forward(width: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(width, hidden), nn.GELU(), nn.Linear(hidden, width))


class EncoderLayer(nn.Module):
    """Self-attention over whole sequences, then a feed-forward network."""

    def __init__(self, width: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.attention, self.feed_forward = Attention(width, heads), _feed_forward(width, hidden)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(2))
        self.dropout = Dropout(dropout)

    def forward(self, x: Tensor, packing: Packing) -> Tensor:
        """``(F, W)`` → ``(F, W)``."""
        seen = self.norms[0](x)
        x = x + self.dropout(self.attention(seen, packing, seen, packing))
        added: Tensor = x + self.dropout(self.feed_forward(self.norms[1](x)))
        return added


class DecoderLayer(nn.Module):
    """Self-attention over the past, attention over frames shown, then a feed-forward network."""

    def __init__(self, width: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.past_attention, self.shown_attention = Attention(width, heads), Attention(width, heads)
        self.feed_forward = _feed_forward(width, hidden)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(3))
        self.dropout = Dropout(dropout)

    def forward(self, x: Tensor, packing: Packing, shown: Tensor, shown_packing: Packing) -> Tensor:
        """``(F, W)``, and the encoder's ``(S, W)`` that its P sequences were shown → ``(F, W)``, all steps at once."""
        seen = self.norms[0](x)
        x = x + self.dropout(self.past_attention(seen, packing, seen, packing, causal=True))
        x = x + self.dropout(self.shown_attention(self.norms[1](x), packing, shown, shown_packing))
        added: Tensor = x + self.dropout(self.feed_forward(self.norms[2](x)))
        return added

    def step(self, x: Tensor, past: Past, shown: Tensor, cache: Cache) -> Tensor:
        """Does the same for the next frame ``(P, W)`` of each sequence, as ``(P, W)``."""
        x = x + self.dropout(self.past_attention.step(self.norms[0](x), past))
        x = x + self.dropout(self.shown_attention.recall(self.norms[1](x), shown, cache.mask, cache.packing))
        added: Tensor = x + self.dropout(self.feed_forward(self.norms[2](x)))
        return added


class TransformerEncoder(nn.Module):
    """Reads whole sequences; the decoder and the layers of both have the same arguments.

    Args:
        width: W, units of a frame; a multiple of ``heads``.
        heads: H, attention heads of each layer.
        layers: Number of layers.
        hidden: Units of each feed-forward network.
        dropout: Share of the units of each sublayer that training leaves out.
    """

    def __init__(self, width: int, heads: int, layers: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.layers = nn.ModuleList(EncoderLayer(width, heads, hidden, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(width)

    def forward(self, x: Tensor, packing: Packing) -> Tensor:
        """``(F, W)`` → ``(F, W)``."""
        for layer in self.layers:
            x = layer(x, packing)
        normal: Tensor = self.norm(x)
        return normal


class TransformerDecoder(nn.Module):
    """Goes through sequences that look back at themselves, and at others shown to them."""

    def __init__(self, width: int, heads: int, layers: int, hidden: int, dropout: float) -> None:
        super().__init__()
        stack = nn.ModuleList(DecoderLayer(width, heads, hidden, dropout) for _ in range(layers))
        self.layers = cast("Sequence[DecoderLayer]", stack)  # torch's own type does not say which modules
        self.norm = nn.LayerNorm(width)

    def forward(self, x: Tensor, packing: Packing, shown: Tensor, shown_packing: Packing) -> Tensor:
        """All steps at once: ``(F, W)``, and the encoder's ``(S, W)`` that its P sequences were shown → ``(F, W)``."""
        for layer in self.layers:
            x = layer(x, packing, shown, shown_packing)
        normal: Tensor = self.norm(x)
        return normal

    def begin(self, shown: Tensor, packing: Packing) -> Cache:
        """Makes a cache for sequences that begin now and were shown the encoder's frames ``(S, W)``, packed alike."""
        memories = [layer.shown_attention.remember(shown, packing) for layer in self.layers]
        return Cache(memories, packing.mask[:, None, None])

    def step(self, x: Tensor, cache: Cache) -> Tensor:
        """The next frame ``(P, W)`` of each of the cache's sequences → ``(P, W)``, as :meth:`forward` has it there."""
        for layer, past, memory in zip(self.layers, cache.past, cache.shown, strict=True):
            x = layer.step(x, past, memory, cache)
        normal: Tensor = self.norm(x)
        return normal
