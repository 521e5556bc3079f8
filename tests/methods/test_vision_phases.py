"""Both phases with images: one look at each, in training as in file, in single as in half precision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pytest
import seen
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.batches.images import ImageFile
from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec
from plp_lightning.callbacks.checkpointing import RandomState, best_and_last
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.losses import behavioural_cloning, reconstruction
from plp_lightning.methods.plp import Adaptation, Alignment
from plp_lightning.methods.plp.losses import mmd, tcc
from plp_lightning.methods.plp.policy import DecoderState, PortablePolicy
from plp_lightning.methods.plp.terms import MMD, TCC, DomainAdversarial, ImageReconstruction, TermFactory
from plp_lightning.networks import ImageDecoder, ImageEncoding

WEIGHED: dict[str, TermFactory] = {
    "mmd": partial(MMD, weight=0.3),
    "tcc": partial(TCC, weight=0.7),
    "adversarial": DomainAdversarial,
}


class Recorded(Alignment):
    """Keeps the parts of a step instead of logging them."""

    logs_now = True  # type: ignore[assignment]

    def log_parts(self, parts: dict[str, Tensor], batch_size: int) -> None:
        self.parts = parts


def looks(phase: Alignment | Adaptation) -> list[int]:
    """How many images each pass through the image encoder saw, as they happen."""
    counts: list[int] = []
    assert phase.policy.image_encoder is not None
    (encoder,) = phase.policy.image_encoder.values()
    encoder.register_forward_hook(lambda module, args, out: counts.append(len(args[0])))
    return counts


def align(
    data: TransferDataModule, names: Sequence[str], weight: float = 0.5, decoder_state: DecoderState = "none"
) -> Recorded:
    torch.manual_seed(1)
    terms = {name: WEIGHED[name] for name in names} | {"reconstruction": partial(ImageReconstruction, weight=weight)}
    return Recorded(seen.policy(data, decoder_state), terms, optimizer=tiny.adamw(1e-3), lr_scheduler=None)


def reconstruction_of(phase: Alignment) -> ImageReconstruction:
    term = phase.terms["reconstruction"]
    assert isinstance(term, ImageReconstruction)
    return term


def image_decoder_of(phase: Alignment) -> ImageDecoder:
    decoders = reconstruction_of(phase).image_decoder
    assert decoders is not None
    (decoder,) = decoders.values()
    assert isinstance(decoder, ImageDecoder)
    return decoder


@pytest.mark.parametrize("decoder_state", ["none", "all"])
def test_one_pass_over_all_images_gives_the_losses_of_separate_passes(
    decoder_state: DecoderState, seen_file: Path
) -> None:
    data = seen.data_module(seen_file)
    phase = align(data, ["mmd", "tcc"], decoder_state=decoder_state)
    batch, counts = next(iter(data.loader(BatchSpec(pairs="thinned")))), looks(phase)
    total = phase.training_step(batch, 0)
    frames = sum(len(s.observation.state) for s in batch.pairs.values())
    assert counts == [32 + frames]
    policy, steps = phase.policy, batch.steps
    latent = {d: policy.encode({d: s.observation})[d] for d, s in steps.items()}
    plan = policy.latent_action(latent, {d: s.task for d, s in steps.items()})
    action = policy.decode(plan, {d: s.observation for d, s in steps.items()})
    memory = {d: image_decoder_of(phase)(latent[d], torch.full((16,), i)) for i, d in enumerate(steps)}
    (u, of_u), (v, of_v) = ((policy.encode({d: s.observation})[d], s) for d, s in batch.pairs.items())
    expected = {
        "bc": behavioural_cloning(action, {d: s.action for d, s in steps.items()}),
        "mmd": mmd([*latent.values()], bandwidths=tiny.KERNELS),
        "reconstruction": reconstruction(memory, {d: s.observation.images["camera"] for d, s in steps.items()}),
        "tcc": tcc(u[of_u.frame], of_u.mask, v[of_v.frame], of_v.mask),
    }
    for name, value in expected.items():
        torch.testing.assert_close(phase.parts[name], value, msg=name)
    weights = {"bc": 1, "mmd": 0.3, "tcc": 0.7, "reconstruction": 0.5}
    torch.testing.assert_close(total, sum(weights[name] * value for name, value in expected.items()))


def test_reconstruction_teaches_the_image_encoder(seen_file: Path) -> None:
    data = seen.data_module(seen_file)
    phase = align(data, [])
    phase.training_step(next(iter(data.loader(BatchSpec("proxy_tasks")))), 0)
    parameters = [*phase.policy.image_encoder.parameters(), *image_decoder_of(phase).parameters()]  # type: ignore[union-attr]
    found = torch.autograd.grad(phase.parts["reconstruction"], parameters)
    assert all(gradient.abs().sum() > 0 for gradient in found)


def test_a_weight_of_zero_leaves_the_image_decoder_away(seen_file: Path) -> None:
    data = seen.data_module(seen_file)
    phase = align(data, ["mmd"], weight=0.0)
    assert reconstruction_of(phase).image_decoder is None
    phase.training_step(next(iter(data.loader(BatchSpec("proxy_tasks")))), 0)
    assert "reconstruction" not in phase.parts


@pytest.mark.parametrize(("halved", "sides"), [(0, (9, 9)), (1, (5, 5))])
def test_images_may_be_halved_before_they_are_reconstructed(
    seen_file: Path, halved: int, sides: tuple[int, int]
) -> None:
    data = seen.data_module(seen_file)
    term = ImageReconstruction(seen.policy(data), downsampling=halved)
    image = term.reconstruct({"right": torch.zeros(2, 8)})["right", "camera"]
    assert image.shape == (2, *sides, 3)


@pytest.mark.parametrize(("halved", "expected"), [(-1, "a whole number, at least 0"), (2, "0 to 1")])
def test_images_are_not_halved_away(seen_file: Path, halved: int, expected: str) -> None:
    with pytest.raises(ConfigError, match=f"ImageReconstruction.downsampling is {halved}; expected {expected}"):
        ImageReconstruction(seen.policy(seen.data_module(seen_file)), downsampling=halved)


def test_the_image_decoder_is_no_part_of_the_policy(seen_file: Path) -> None:
    phase = align(seen.data_module(seen_file), [])
    assert {name.split(".")[0] for name in phase.state_dict()} == {"policy", "terms"}
    assert {name.split(".")[2] for name in phase.state_dict() if name.startswith("terms")} == {"image_decoder"}
    assert not [name for name in phase.policy.state_dict() if "image_decoder" in name]


def trained(
    phase: Alignment | Adaptation, data: TransferDataModule, trainer: Trainer, resume: Path | None = None
) -> dict[str, Tensor]:
    trainer.fit(phase, datamodule=data, ckpt_path=resume, weights_only=True)
    return {name: value.clone() for name, value in phase.state_dict().items()}


def same(one: dict[str, Tensor], other: dict[str, Tensor]) -> bool:
    return all(torch.equal(one[name], other[name]) for name in one)


def test_training_from_disk_gives_the_weights_of_training_from_memory(
    seen_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    one, other = (seen.data_module(seen_file, place) for place in (seen.IN_MEMORY, seen.HALF))
    assert same(*(trained(align(d, ["mmd", "tcc"]), d, make_trainer(epochs=1)) for d in (one, other)))
    assert same(
        *(
            trained(Adaptation(seen.policy(d), optimizer=tiny.adamw(1e-3)), d, make_trainer(epochs=1))
            for d in (one, other)
        )
    )


def test_a_stopped_run_gives_the_weights_of_an_unbroken_one(
    seen_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    def run(folder: str, epochs: int, place: float, resume: Path | None = None) -> dict[str, Tensor]:
        data = seen.data_module(seen_file, place)
        trainer = make_trainer(RandomState(), *best_and_last(tmp_path / folder, "val/bc"), epochs=epochs)
        return trained(align(data, ["mmd", "tcc"]), data, trainer, resume)

    unbroken = run("unbroken", 2, seen.IN_MEMORY)
    run("broken", 1, seen.IN_MEMORY)
    assert same(unbroken, run("broken", 2, seen.ON_DISK, tmp_path / "broken" / "last.ckpt"))


def test_adaptation_looks_at_every_image_once(seen_file: Path, make_trainer: Callable[..., Trainer]) -> None:
    data = seen.data_module(seen_file, seen.ON_DISK)
    phase = Adaptation(seen.policy(data), optimizer=tiny.adamw(1e-3))
    counts = looks(phase)
    before = {name: value.clone() for name, value in phase.state_dict().items()}
    after = trained(phase, data, make_trainer(FreezeGuard(), epochs=3))
    assert counts == [len(dataset) for dataset in data.datasets.values()]
    changed = {name for name, value in after.items() if not torch.equal(value, before[name])}
    assert changed == {name for name in before if name.startswith("policy.common.")}


def test_adaptation_shows_images_to_a_decoder_that_sees_them(
    seen_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = seen.data_module(seen_file, seen.ON_DISK)
    torch.manual_seed(0)
    policy = PortablePolicy(data.problem, 8, 16, decoder_state="all", image_encoder=ImageEncoding((4, 6), 5))
    phase = Adaptation(policy, optimizer=tiny.adamw(1e-3))
    before = {name: value.clone() for name, value in phase.state_dict().items()}
    after = trained(phase, data, make_trainer(FreezeGuard(), epochs=1))
    changed = {name for name, value in after.items() if not torch.equal(value, before[name])}
    assert changed == {name for name in before if name.startswith("policy.common.")}


def test_adaptation_encodes_few_large_images_at_a_time(
    seen_file: Path, make_trainer: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("datamodules.batches.dataset.MOST_IMAGE_BYTES", 50 * 9 * 9 * 3)
    data = seen.data_module(seen_file, seen.ON_DISK)
    phase = Adaptation(seen.policy(data))
    counts = looks(phase)
    make_trainer(epochs=1).fit(phase, datamodule=data)
    assert max(counts) == 50
    assert sum(counts) == sum(map(len, data.datasets.values()))
    images = data.datasets["left"].observation.images["camera"]
    assert isinstance(images, ImageFile)
    assert images.held_bytes == 0


def test_held_out_losses_of_adaptation_are_those_of_a_full_pass(
    seen_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = seen.data_module(seen_file)
    phase = Adaptation(seen.policy(data))
    found = make_trainer(epochs=1).validate(phase, datamodule=data, verbose=False)[0]["val/bc"]
    steps = data.datasets["left"].take(torch.from_numpy(data.rows(data.target_tasks, "val")["left"]))
    action = phase.policy({"left": steps.observation}, {"left": steps.task}).action
    assert found == pytest.approx(behavioural_cloning(action, {"left": steps.action}).item(), rel=1e-4)


@pytest.mark.parametrize("terms", [["mmd", "tcc"], ["adversarial", "tcc"]])
def test_half_precision_gives_nearly_the_losses_of_single_precision(seen_file: Path, terms: list[str]) -> None:
    data = seen.data_module(seen_file)
    batch, phase = next(iter(data.loader(BatchSpec(pairs="thinned")))), align(data, terms)
    phase.training_step(batch, 0)
    single = phase.parts
    with torch.autocast("cpu", torch.bfloat16):
        total = phase.training_step(batch, 0)
    total.backward()
    for name, value in single.items():
        torch.testing.assert_close(phase.parts[name].float(), value, rtol=0.05, atol=0.02, msg=name)
    assert total.dtype is torch.float32
    assert all(p.grad is not None and p.grad.isfinite().all() for p in phase.policy.parameters())
