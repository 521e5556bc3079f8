"""Settings: bounds that are types, arguments that are remembered, objects that are built again from them."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import tiny

from datamodules import settings
from datamodules.amounts import Batching, Demonstrations
from datamodules.errors import ConfigError
from datamodules.settings import (
    Configured,
    Fraction,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    Share,
)
from plp_lightning.methods import BCPolicy
from plp_lightning.methods.plp import Alignment, PortablePolicy
from plp_lightning.methods.policy import Policy
from plp_lightning.networks import ImageEncoding


class Numbers(Configured):
    def __init__(
        self,
        layers: PositiveInt = 1,
        delay: NonNegativeInt = 0,
        width: PositiveFloat = 1.0,
        weight: NonNegativeFloat = 0.0,
        share: Share = 0.5,
        dropout: Fraction = 0.0,
        most: PositiveInt | None = None,
        channels: tuple[PositiveInt, ...] = (4, 8),
        widths: Sequence[PositiveFloat] | None = None,
        epochs: Mapping[str, NonNegativeInt] | None = None,
        mode: str = "mean",
    ) -> None:
        self.layers, self.channels = layers, channels


class Stricter(Numbers):
    def __init__(self, layers: PositiveInt = 3, name: str = "stricter") -> None:
        super().__init__(layers)
        self.name = name


class Whole(Configured):
    def __init__(self, part: Numbers, parts: tuple[Numbers, ...] = (), factor: NonNegativeFloat = 2.0) -> None:
        self.part, self.parts, self.factor = part, parts, factor


class Placed(Configured):
    def __init__(self, place: str, part: Numbers | None = None) -> None:
        self.place, self.part = place, part


@dataclass(frozen=True)
class Amounts(Configured):
    count: PositiveInt = 2
    rest: NonNegativeFloat = 0.5


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("layers", 0, "a whole number, at least 1"),
        ("layers", -3, "a whole number, at least 1"),
        ("layers", 1.5, "a whole number, at least 1"),
        ("layers", True, "a whole number, at least 1"),
        ("layers", "3", "a whole number, at least 1"),
        ("layers", None, "a whole number, at least 1"),
        ("delay", -1, "a whole number, at least 0"),
        ("width", 0.0, "a number above 0"),
        ("width", float("inf"), "a number above 0"),
        ("width", float("nan"), "a number above 0"),
        ("weight", -0.1, "a number, at least 0"),
        ("weight", float("nan"), "a number, at least 0"),
        ("share", 1.01, "a share from 0 to 1"),
        ("share", -0.01, "a share from 0 to 1"),
        ("dropout", 1.0, "a share from 0 to below 1"),
        ("most", 0, "a whole number, at least 1"),
        ("channels", (4, 0), "a whole number, at least 1"),
        ("widths", [1.0, -1.0], "a number above 0"),
    ],
)
def test_numbers_outside_of_their_bounds_are_refused(name: str, value: Any, expected: str) -> None:
    with pytest.raises(ConfigError) as refused:
        Numbers(**{name: value})
    told = str(refused.value)
    assert told.startswith(f"Numbers.{name} is ")
    assert told.endswith(f"; expected {expected}; change it")


def test_an_item_of_a_mapping_is_named() -> None:
    with pytest.raises(ConfigError, match=r"Numbers\.epochs\.alignment is -1; expected a whole number, at least 0"):
        Numbers(epochs={"adaptation": 3, "alignment": -1})


@pytest.mark.parametrize(
    "arguments",
    [
        {"layers": 1, "delay": 0, "width": 1e-9, "weight": 0, "share": 0, "dropout": 0.0},
        {"share": 1.0, "dropout": 0.999, "most": None, "widths": None, "epochs": None},
        {"most": 1, "channels": (), "widths": [], "epochs": {}},
        {"layers": 3.0, "channels": [4, 8], "widths": (0.5,), "epochs": {"alignment": 0}},
    ],
)
def test_numbers_at_their_bounds_are_taken(arguments: dict[str, Any]) -> None:
    assert Numbers(**arguments).arguments.items() >= arguments.items()


def test_arguments_are_remembered_with_defaults_whether_named_or_not() -> None:
    defaults = Numbers().arguments
    assert (defaults["layers"], defaults["channels"], defaults["most"]) == (1, (4, 8), None)
    assert Numbers(2, delay=1).arguments == {**defaults, "layers": 2, "delay": 1}


def test_the_outermost_class_is_remembered_and_its_name_is_told() -> None:
    made = Stricter(name="own")
    assert made.arguments == {"layers": 3, "name": "own"}
    assert made.layers == 3
    with pytest.raises(ConfigError, match=r"^Stricter\.layers is 0"):
        Stricter(0)


def test_wrong_names_are_an_error_of_python() -> None:
    with pytest.raises(TypeError, match="unexpected keyword argument 'layer'"):
        Numbers(layer=2)  # type: ignore[call-arg]


def test_a_dataclass_is_held_to_its_bounds_those_inherited_too() -> None:
    assert Amounts(3).arguments == {"count": 3, "rest": 0.5}
    with pytest.raises(ConfigError, match=r"Amounts\.rest is -1; expected a number, at least 0"):
        Amounts(rest=-1)
    with pytest.raises(ConfigError, match=r"Amounts\.count is 0"):
        replace(Amounts(), count=0)
    with pytest.raises(ConfigError, match=r"Demonstrations\.val_fraction is 1\.0; expected a share from 0 to below 1"):
        Demonstrations(val_fraction=1.0)
    with pytest.raises(ConfigError, match=r"Batching\.tasks_per_batch is 0; expected a whole number, at least 1"):
        Batching(tasks_per_batch=0)


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))])
@pytest.mark.parametrize(
    "made", [Numbers(5, channels=(1,)), Amounts(7), Whole(Numbers(3))], ids=lambda m: type(m).__name__
)
def test_copies_and_pickles_keep_their_arguments(made: Configured, again: Any) -> None:
    found = again(made)
    assert settings.blueprint(found) == settings.blueprint(made)
    assert type(found) is type(made)


def test_a_copied_policy_keeps_its_arguments(trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    found = copy.deepcopy(policy)
    assert found.arguments.keys() == policy.arguments.keys()
    assert settings.blueprint(found, ["problem"]) == settings.blueprint(policy, ["problem"])


def test_a_recipe_is_plain_and_builds_an_equal_object() -> None:
    made = Whole(Numbers(3, channels=(2, 4)), (Numbers(5), Stricter(6)), 4.0)
    plain = settings.blueprint(made)
    assert json.loads(json.dumps(plain)) == plain
    assert plain["class_path"].endswith("test_settings.Whole")
    assert plain["init_args"]["part"]["init_args"]["channels"] == [2, 4]
    again = settings.build(plain, Whole, [__name__])
    assert isinstance(again.part, Numbers)
    assert [(type(part), part.layers) for part in again.parts] == [(Numbers, 5), (Stricter, 6)]
    assert (again.part.layers, list(again.part.channels), again.factor) == (3, [2, 4], 4.0)


def test_what_the_caller_gives_is_left_out_and_comes_first() -> None:
    plain = settings.blueprint(Placed("here", Numbers(4)), ["place"])
    assert "place" not in plain["init_args"]
    again = settings.build(plain, Placed, [__name__], "there")
    assert again.place == "there"
    assert again.part is not None
    assert again.part.layers == 4


@pytest.mark.parametrize("path", ["os.system", "subprocess.Popen", "plp_lightning_evil.Numbers", "datamodules.Numbers"])
def test_classes_of_other_packages_are_not_imported(path: str) -> None:
    package = path.split(".")[0]
    with pytest.raises(ConfigError, match=rf"importing '{path}' is not allowed; .* add --allow_imports {package}"):
        settings.build({"class_path": path, "init_args": {}}, Configured, ["plp_lightning"])


def test_a_part_of_another_package_is_not_imported_either() -> None:
    plain = {"class_path": f"{__name__}.Placed", "init_args": {"part": {"class_path": "os.system", "init_args": {}}}}
    with pytest.raises(ConfigError, match=r"importing 'os\.system' is not allowed"):
        settings.build(plain, Placed, [__name__], "here")


@pytest.mark.parametrize(
    "path",
    [
        "plp_lightning.methods.plp.alignment.Alignment",
        "plp_lightning.methods.plp.alignment.batch_size",
        "plp_lightning.methods.plp.alignment.Absent",
    ],
)
def test_classes_of_another_kind_are_refused(path: str) -> None:
    with pytest.raises(ConfigError, match=rf"'{path}' is no Policy; expected the class that was saved"):
        settings.build({"class_path": path, "init_args": {}}, Policy, ["plp_lightning"])  # type: ignore[type-abstract]


def test_a_recipe_out_of_bounds_is_refused() -> None:
    plain = settings.blueprint(Numbers())
    plain["init_args"]["layers"] = 0
    with pytest.raises(ConfigError, match=r"Numbers\.layers is 0"):
        settings.build(plain, Numbers, [__name__])


def test_policies_of_any_class_are_built_from_their_recipes() -> None:
    problem = tiny.problem([tiny.spec("small", 3, 2), tiny.spec("large", 7, 5)], ["reach", "push"])
    for made in (
        PortablePolicy(problem, latent=4, hidden=8, image_encoder=ImageEncoding((2,), 3)),
        BCPolicy(problem, hidden=8),
    ):
        plain = json.loads(json.dumps(settings.blueprint(made, ["problem"])))
        again = settings.build(plain, Policy, ["plp_lightning"], problem)  # type: ignore[type-abstract]
        assert type(again) is type(made)
        assert settings.blueprint(again, ["problem"]) == settings.blueprint(made, ["problem"])
        again.load_state_dict(made.state_dict())


def test_a_phase_remembers_what_it_was_given(trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    phase = Alignment(policy, tiny.terms("mmd"), epochs=3)
    assert phase.arguments["policy"] is policy
    assert (phase.arguments["epochs"], phase.arguments["bc_reduction"]) == (3, "mean")
    with pytest.raises(ConfigError, match=r"Alignment\.epochs is 0; expected a whole number, at least 1; change it"):
        Alignment(policy, epochs=0)


class Plain(Configured):
    """A class without settings."""


class Unimported(Configured):
    """A class whose signature has a type that is there for type checkers alone."""

    def __init__(self, path: "Nowhere") -> None:  # type: ignore[name-defined]  # noqa: F821, UP037
        self.path = path


def test_a_class_without_settings_takes_none_and_is_built_again() -> None:
    made = Plain()
    assert made.arguments == {}
    assert isinstance(settings.build(settings.blueprint(made), Plain, [__name__]), Plain)
    with pytest.raises(TypeError, match="argument"):
        Plain(1)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="argument"):
        Plain(gain=1)  # type: ignore[call-arg]


def test_a_type_that_is_unknown_at_run_time_is_one_line() -> None:
    with pytest.raises(ConfigError, match=r"Unimported: name 'Nowhere' is not defined; expected types that its module"):
        Unimported("somewhere")
