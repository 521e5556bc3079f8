"""The Transformer beside torch's own, and step by step beside all at once."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from plp_lightning.methods.contextual.frames import Packing
from plp_lightning.methods.contextual.transformer import (
    FIRST_ROOM,
    Attention,
    DecoderLayer,
    EncoderLayer,
    TransformerDecoder,
    TransformerEncoder,
)

WIDTH, HEADS, HIDDEN = 8, 2, 12
LENGTHS, SHOWN_LENGTHS = (3, 5, 1), (4, 2, 6)


def packing(lengths: tuple[int, ...]) -> Packing:
    mask = torch.arange(max(lengths)) < torch.tensor(lengths)[:, None]
    return Packing(torch.where(mask, mask.flatten().cumsum(0).view_as(mask) - 1, 0), mask, sum(lengths))


def frames(lengths: tuple[int, ...], seed: int = 0) -> Tensor:
    return torch.randn(sum(lengths), WIDTH, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def copy_attention(ours: Attention, theirs: nn.MultiheadAttention) -> None:
    theirs.in_proj_weight.data = torch.cat([ours.query.weight, ours.key_value.weight]).data
    theirs.in_proj_bias.data = torch.cat([ours.query.bias, ours.key_value.bias]).data
    theirs.out_proj.load_state_dict(ours.output.state_dict())


def copy_rest(ours: EncoderLayer | DecoderLayer, theirs: nn.Module) -> None:
    """Normalisations and the feed-forward network, which torch names linear1, linear2, norm1, …"""
    theirs.get_submodule("linear1").load_state_dict(ours.feed_forward[0].state_dict())
    theirs.get_submodule("linear2").load_state_dict(ours.feed_forward[2].state_dict())
    for i, norm in enumerate(ours.norms):
        nn.init.normal_(norm.weight)
        nn.init.normal_(norm.bias)
        theirs.get_submodule(f"norm{i + 1}").load_state_dict(norm.state_dict())


def settings() -> dict[str, object]:
    return {"dropout": 0.0, "activation": "gelu", "batch_first": True, "norm_first": True, "dtype": torch.float64}


def test_encoder_layer_is_torchs() -> None:
    ours = EncoderLayer(WIDTH, HEADS, HIDDEN, 0.0).double()
    theirs = nn.TransformerEncoderLayer(WIDTH, HEADS, HIDDEN, **settings())  # type: ignore[arg-type]
    copy_attention(ours.attention, theirs.self_attn)
    copy_rest(ours, theirs)
    packed, x = packing(LENGTHS), frames(LENGTHS)
    expected = theirs(packed.pad(x), src_key_padding_mask=~packed.mask)
    torch.testing.assert_close(ours(x, packed), packed.pack(expected))


def test_decoder_layer_is_torchs() -> None:
    ours = DecoderLayer(WIDTH, HEADS, HIDDEN, 0.0).double()
    theirs = nn.TransformerDecoderLayer(WIDTH, HEADS, HIDDEN, **settings())  # type: ignore[arg-type]
    copy_attention(ours.past_attention, theirs.self_attn)
    copy_attention(ours.shown_attention, theirs.multihead_attn)
    copy_rest(ours, theirs)
    packed, x = packing(LENGTHS), frames(LENGTHS)
    seen, shown = packing(SHOWN_LENGTHS), frames(SHOWN_LENGTHS, seed=1)
    causal = nn.Transformer.generate_square_subsequent_mask(max(LENGTHS), dtype=torch.float64)
    expected = theirs(packed.pad(x), seen.pad(shown), causal, memory_key_padding_mask=~seen.mask)
    torch.testing.assert_close(ours(x, packed, shown, seen), packed.pack(expected))


@pytest.fixture
def encoder() -> TransformerEncoder:
    torch.manual_seed(0)
    return TransformerEncoder(WIDTH, HEADS, 2, HIDDEN, 0.3).double().eval()


@pytest.fixture
def decoder() -> TransformerDecoder:
    torch.manual_seed(0)
    return TransformerDecoder(WIDTH, HEADS, 2, HIDDEN, 0.3).double().eval()


def parts(x: Tensor, lengths: tuple[int, ...]) -> list[Tensor]:
    return list(x.split(list(lengths)))


def test_a_sequence_does_not_feel_who_is_beside_it(encoder: TransformerEncoder, decoder: TransformerDecoder) -> None:
    x, shown = frames(LENGTHS), frames(SHOWN_LENGTHS, seed=1)
    read = encoder(shown, packing(SHOWN_LENGTHS))
    together = decoder(x, packing(LENGTHS), read, packing(SHOWN_LENGTHS))
    for i, (own, own_shown) in enumerate(zip(parts(x, LENGTHS), parts(shown, SHOWN_LENGTHS), strict=True)):
        alone = packing((len(own_shown),))
        own_read = encoder(own_shown, alone)
        torch.testing.assert_close(own_read, parts(read, SHOWN_LENGTHS)[i])
        torch.testing.assert_close(decoder(own, packing((len(own),)), own_read, alone), parts(together, LENGTHS)[i])


def test_no_frame_sees_a_later_one_and_all_see_what_was_shown(decoder: TransformerDecoder) -> None:
    x, shown, packed, shown_packed = frames((5,)), frames((3,), seed=1), packing((5,)), packing((3,))
    before = decoder(x, packed, shown, shown_packed)
    x[3] += 1
    changed = (decoder(x, packed, shown, shown_packed) != before).any(dim=1)
    assert changed.tolist() == [False, False, False, True, True]
    shown[2] += 1
    assert (decoder(x, packed, shown, shown_packed) != before).any(dim=1).all()


def test_an_encoders_frame_sees_all_others(encoder: TransformerEncoder) -> None:
    x = frames((4,))
    before = encoder(x, packing((4,)))
    x[3] += 1
    assert (encoder(x, packing((4,))) != before).any(dim=1).all()


@pytest.mark.parametrize("steps", [1, FIRST_ROOM, 2 * FIRST_ROOM + 3])
@torch.no_grad()
def test_steps_give_what_all_at_once_gives(steps: int, decoder: TransformerDecoder) -> None:
    lengths, shown = (steps,) * 3, frames(SHOWN_LENGTHS, seed=1)
    x = frames(lengths)
    expected = decoder(x, packing(lengths), shown, packing(SHOWN_LENGTHS)).unflatten(0, (3, steps))
    cache = decoder.begin(shown, packing(SHOWN_LENGTHS))
    for t, step in enumerate(x.unflatten(0, (3, steps)).unbind(1)):
        assert cache.steps == t
        torch.testing.assert_close(decoder.step(step, cache), expected[:, t])


@torch.no_grad()
def test_steps_go_on_without_those_that_have_ended(decoder: TransformerDecoder) -> None:
    lengths, shown = (2, 6, 4), frames(SHOWN_LENGTHS, seed=1)
    x = parts(frames(lengths), lengths)
    expected = parts(decoder(torch.cat(x), packing(lengths), shown, packing(SHOWN_LENGTHS)), lengths)
    cache, kept = decoder.begin(shown, packing(SHOWN_LENGTHS)), np.arange(3)
    for t in range(max(lengths)):
        running = np.flatnonzero(np.array(lengths) > t)
        if len(running) < len(kept):
            cache.take(torch.from_numpy(np.searchsorted(kept, running)))
            kept = running
        found = decoder.step(torch.stack([x[i][t] for i in running]), cache)
        torch.testing.assert_close(found, torch.stack([expected[i][t] for i in running]))


@torch.no_grad()
def test_rows_may_share_what_they_are_shown(decoder: TransformerDecoder) -> None:
    shown, x = frames((4, 2), seed=1), frames((1, 1, 1))
    cache = decoder.begin(shown, packing((4, 2)))
    cache.take(torch.tensor([1, 0, 1]))
    each = [shown[4:], shown[:4], shown[4:]]
    expected = [decoder.step(x[i : i + 1], decoder.begin(s, packing((len(s),)))) for i, s in enumerate(each)]
    torch.testing.assert_close(decoder.step(x, cache), torch.cat(expected))


def test_dropout_works_in_training_alone(encoder: TransformerEncoder) -> None:
    x, packed = frames((4,)), packing((4,))
    calls = [encoder(x, packed), encoder(x, packed), encoder.train()(x, packed), encoder(x, packed)]
    assert [torch.equal(a, b) for a, b in pairwise(calls)] == [True, False, False]


@torch.no_grad()
def test_those_who_were_shown_the_same_look_at_it_together(decoder: TransformerDecoder) -> None:
    shown, x = frames((4, 2), seed=1), frames((1, 1))
    cache = decoder.begin(shown, packing((4, 2)))
    cache.take(torch.tensor([1, 0]))
    assert cache.packing.mask.shape == (2, 1)
    swapped = decoder.step(x, cache)
    parts_shown = enumerate((shown[4:], shown[:4]))
    each = [decoder.step(x[i : i + 1], decoder.begin(s, packing((len(s),)))) for i, s in parts_shown]
    torch.testing.assert_close(swapped, torch.cat(each))
    cache.take(torch.tensor([0, 0, 0]))
    assert cache.packing.mask.sum(dim=1).tolist() == [0, 3]


@pytest.mark.parametrize("lengths", [LENGTHS, (4, 4)])
def test_in_half_precision_the_processor_attends_in_float32(
    lengths: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, attend = set(), F.scaled_dot_product_attention

    def noting(query: Tensor, *rest: Tensor, **settings: bool) -> Tensor:
        seen.add(query.dtype)
        return attend(query, *rest, **settings)

    monkeypatch.setattr(F, "scaled_dot_product_attention", noting)
    with torch.autocast("cpu", torch.bfloat16):
        TransformerEncoder(WIDTH, HEADS, 1, HIDDEN, 0.0)(frames(lengths).float(), packing(lengths)).sum().backward()
    assert seen == {torch.float32}
