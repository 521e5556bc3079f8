from __future__ import annotations

import pytest
import torch

from plp_lightning.methods.translation import SpatialEncoder


def test_points_are_expected_places_of_a_softmax_over_pixels() -> None:
    torch.manual_seed(0)
    eyes, image = SpatialEncoder((6, 10, 3), [4, 2]), torch.randint(0, 256, (2, 6, 10, 3), dtype=torch.uint8)
    with torch.no_grad():
        eyes.sharpness.fill_(0.7)
    points = eyes(image)
    assert eyes.size == points.shape[1] == 4
    maps = eyes.convolutions(image.permute(0, 3, 1, 2) / 255).detach().double()
    maps = maps.exp() ** float(torch.tensor(0.7).exp())
    assert maps.shape == (2, 2, 3, 5)
    for picture in range(2):
        for channel in range(2):
            share = maps[picture, channel] / maps[picture, channel].sum()
            row = sum(float(share[i].sum()) * place for i, place in enumerate((-1, 0, 1)))
            column = sum(float(share[:, j].sum()) * place for j, place in enumerate((-1, -0.5, 0, 0.5, 1)))
            found = points[picture, 2 * channel : 2 * channel + 2].tolist()
            assert found == pytest.approx([row, column], abs=1e-5)


def test_a_point_follows_what_it_is_a_feature_of() -> None:
    eyes = SpatialEncoder((16, 16, 3), [1])
    with torch.no_grad():
        eyes.convolutions[0].weight.fill_(1.0)
        eyes.sharpness.fill_(3.0)
    image = torch.zeros(2, 16, 16, 3, dtype=torch.uint8)
    image[0, 3:6, 11:14], image[1, 11:14, 3:6] = 255, 255
    first, second = eyes(image)
    assert first[0] < -0.3 < 0.3 < first[1]
    assert second[1] < -0.3 < 0.3 < second[0]
