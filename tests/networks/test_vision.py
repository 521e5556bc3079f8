from __future__ import annotations

import math

import pytest
import torch
from torch import nn

from datamodules.errors import ConfigError
from plp_lightning.networks import ImageDecoder, ImageEncoder, ImageEncoding
from plp_lightning.networks.vision import downsampled_sizes, initialise, pixel_coordinates


def images(count: int, height: int, width: int) -> torch.Tensor:
    return torch.randint(
        0, 256, (count, height, width, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
    )


def convolved(image: torch.Tensor, layer: nn.Conv2d) -> torch.Tensor:
    """Kernel 3, stride 2, padding 1, pixel by pixel: ``(C, H, W)`` → ``(C', ⌈H/2⌉, ⌈W/2⌉)``."""
    channels, height, width = image.shape
    padded = torch.zeros(channels, height + 2, width + 2, dtype=image.dtype)
    padded[:, 1:-1, 1:-1] = image
    rows, columns = range(math.ceil(height / 2)), range(math.ceil(width / 2))
    patches = [[padded[:, 2 * i : 2 * i + 3, 2 * j : 2 * j + 3] for j in columns] for i in rows]
    out = [[(layer.weight * patch).sum((1, 2, 3)) + layer.bias for patch in row] for row in patches]
    return torch.stack([torch.stack(row, dim=-1) for row in out], dim=1)


@pytest.mark.parametrize("sides", [(8, 8), (7, 5)])
def test_the_encoder_sees_colours_and_coordinates(sides: tuple[int, int]) -> None:
    encoder = ImageEncoder((*sides, 3), channels=(4, 6), features=5).double()
    image = images(1, *sides)
    maps = torch.cat([image[0].double() / 255, pixel_coordinates(*sides).double()], dim=-1).permute(2, 0, 1)
    for layer in (m for m in encoder.convolutions if isinstance(m, nn.Conv2d)):
        maps = convolved(maps, layer)
        maps = maps * 0.5 * (1 + torch.erf(maps / 2**0.5))
    by_hand = encoder.linear.weight @ maps.flatten() + encoder.linear.bias
    torch.testing.assert_close(encoder(image)[0], by_hand)


def test_coordinates_run_from_minus_one_to_one_along_each_side() -> None:
    assert pixel_coordinates(2, 3).tolist() == [[[-1, -1], [-1, 0], [-1, 1]], [[1, -1], [1, 0], [1, 1]]]
    assert pixel_coordinates(1, 2).tolist() == [[[0, -1], [0, 1]]]


def test_the_same_spot_elsewhere_is_something_else() -> None:
    encoder = ImageEncoder((16, 16, 3), channels=(4,), features=8)
    image = torch.zeros(2, 16, 16, 3, dtype=torch.uint8)
    image[0, 3, 3], image[1, 11, 7] = 255, 255
    assert not torch.allclose(*encoder(image))


def test_sizes_of_the_paper() -> None:
    encoder = ImageEncoder((64, 64, 3), (64, 64, 128, 128, 128), 1024)
    assert downsampled_sizes((64, 64), 5) == [(64, 64), (32, 32), (16, 16), (8, 8), (4, 4), (2, 2)]
    weights = 9 * (5 * 64 + 64 * 64 + 64 * 128 + 128 * 128 + 128 * 128) + 2 * 64 + 3 * 128
    assert sum(p.numel() for p in encoder.parameters()) == weights + 2 * 2 * 128 * 1024 + 1024


def test_images_are_looked_at_a_few_at_a_time_where_nobody_learns() -> None:
    encoder = ImageEncoder((16, 16, 3), channels=(4, 4), features=5)
    seen: list[int] = []
    encoder.convolutions.register_forward_hook(lambda module, args, out: seen.append(len(out)))
    image, encoder.most_rows = images(7, 16, 16), 3
    learning = encoder(image)
    with torch.no_grad():
        looking = encoder(image)
    assert seen == [7, 3, 3, 1]
    torch.testing.assert_close(looking, learning)


def test_first_activations_without_gradients_stay_below_the_bound() -> None:
    encoder = ImageEncoder((64, 64, 3), (64, 64), 8)
    assert encoder.most_rows * 4 * 64 * 32 * 32 == 64 * 2**20
    assert ImageEncoder((2048, 2048, 1), (64, 1), 1).most_rows == 1


@pytest.mark.parametrize(
    ("channels", "features", "told"),
    [((4, 0), 5, "channels is 0"), ((-1,), 5, "channels is -1"), ((4,), 0, "features is 0")],
)
def test_sizes_that_cannot_be_are_refused(channels: tuple[int, ...], features: int, told: str) -> None:
    with pytest.raises(ConfigError, match=rf"ImageEncoding\.{told}; expected a whole number, at least 1; change it"):
        ImageEncoding(channels, features)


@pytest.mark.parametrize("shape", [(64, 64, 3), (17, 30, 1), (1, 5, 3)])
@pytest.mark.parametrize("channels", [(4,), (4, 6, 8)])
def test_the_decoder_gives_back_the_shape_of_the_image(shape: tuple[int, int, int], channels: tuple[int, ...]) -> None:
    decoder = ImageDecoder(5, 2, shape, channels)
    image = decoder(torch.randn(3, 5), torch.tensor([0, 1, 1]))
    assert image.shape == (3, *shape)
    assert ((image > 0) & (image < 1)).all()


def test_the_decoder_is_told_the_domain() -> None:
    decoder = ImageDecoder(5, 2, (8, 8, 3), (4,))
    one, other = decoder(torch.ones(2, 5), torch.tensor([0, 1]))
    assert not torch.allclose(one, other)


def test_the_decoder_mirrors_the_encoder() -> None:
    encoder, decoder = ImageEncoder((64, 64, 3), (4, 6, 8), 10), ImageDecoder(5, 2, (64, 64, 3), (4, 6, 8))
    down = [m for m in encoder.convolutions if isinstance(m, nn.Conv2d)]
    up = [m for m in decoder.convolutions if isinstance(m, nn.ConvTranspose2d)]
    assert [(m.in_channels, m.out_channels) for m in up] == [(8, 6), (6, 4), (4, 3)]
    assert [(m.out_channels, m.in_channels) for m in reversed(down)] == [(8, 6), (6, 4), (4, 5)]
    assert not isinstance(decoder.convolutions[-1], nn.GELU)


@pytest.mark.parametrize("layer", [nn.Linear(512, 400), nn.Conv2d(64, 80, 3), nn.ConvTranspose2d(64, 80, 3, 2, 1, 1)])
def test_layers_keep_the_size_of_half_rectified_activations(layer: nn.Module) -> None:
    torch.manual_seed(0)
    initialise(layer)
    shape = (64, 512) if isinstance(layer, nn.Linear) else (16, 64, 12, 12)
    activations = torch.randn(shape).relu()
    inner = layer(activations)
    inner = inner if isinstance(layer, nn.Linear) else inner[:, :, 1:-1, 1:-1]
    assert inner.square().mean().item() == pytest.approx(2 * activations.square().mean().item(), rel=0.1)


def test_weights_lie_in_memory_as_images_do() -> None:
    encoder, decoder = ImageEncoder((8, 8, 3), (4, 6), 5), ImageDecoder(5, 2, (8, 8, 3), (4, 6))
    for weight in (p for net in (encoder, decoder) for p in net.parameters() if p.ndim == 4):
        assert weight.is_contiguous(memory_format=torch.channels_last)
    maps: list[torch.Tensor] = []
    encoder.convolutions.register_forward_hook(lambda module, args, out: maps.append(args[0]))
    encoder(images(2, 8, 8))
    assert maps[0].is_contiguous(memory_format=torch.channels_last)
    assert decoder(torch.randn(2, 5), torch.tensor([0, 1])).is_contiguous()
