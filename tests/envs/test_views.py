from __future__ import annotations

import pytest

from datamodules.errors import UserError
from plp_lightning.envs import Lift, LinearPoint, PointMaze, Reach, Window
from plp_lightning.envs.views import Arranged, Located, Planned, Reaching, Rendered, located

VIEWS = (Located, Planned, Arranged, Rendered, Reaching)


@pytest.mark.parametrize(
    ("simulator", "views"),
    [
        (Lift("UR5e"), {Located, Rendered}),
        (PointMaze("umaze"), {Located, Planned, Rendered, Reaching}),
        (Reach("front"), {Located, Arranged, Rendered}),
        (Window("front"), {Located, Rendered}),
        (LinearPoint(1), {Located, Rendered}),
    ],
    ids=["lift", "maze", "reach", "window", "linear"],
)
def test_a_simulator_has_the_views_whose_methods_it_has(simulator: object, views: set[type]) -> None:
    assert {view for view in VIEWS if isinstance(simulator, view)} == views
    assert located(simulator) is simulator


def test_without_a_shared_position_one_line_says_what_to_do() -> None:
    with pytest.raises(
        UserError, match=r"^object knows no position .*; give it shared_position\(state\), or .* --score$"
    ):
        located(object())
