"""SETTINGS: a constructor's signature states a setting's name, type, default and bound, and nothing states them again.

Bounds are types. The command line's parser knows them, and :class:`Configured` holds whoever builds an object in Python
to the same ones. What an object was built with it remembers, so that a checkpoint can build it again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import inspect
import math
import operator
import types
from collections.abc import Callable, Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    TypeAlias,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from jsonargparse.typing import register_type

from datamodules.errors import ConfigError

if TYPE_CHECKING:
    from typing_extensions import Self

    # To the type checker a bounded number is a number.
    PositiveInt: TypeAlias = int
    NonNegativeInt: TypeAlias = int
    PositiveFloat: TypeAlias = float
    NonNegativeFloat: TypeAlias = float
    Share: TypeAlias = float
    Fraction: TypeAlias = float
    Seed: TypeAlias = int
    Threads: TypeAlias = int
    Depth: TypeAlias = int


LIMITS: Mapping[str, Callable[[float, float], bool]] = {
    "minimum": operator.ge,
    "exclusiveMinimum": operator.gt,
    "maximum": operator.le,
    "exclusiveMaximum": operator.lt,
}
"""Comparisons of a number and its limit by the keyword of JSON Schema."""


@dataclasses.dataclass(frozen=True)
class Bound:
    """Finite numbers that a setting may be: their type, the words for the bound, and limits in JSON Schema's words."""

    kind: type[int] | type[float]
    told: str
    limits: Mapping[str, float]

    def holds(self, number: float) -> bool:
        """Tell whether a number is within the bound."""
        return number < math.inf and all(LIMITS[name](number, limit) for name, limit in self.limits.items())

    def read(self, value: Any) -> int | float:
        """Read a number of the plain type, or raise ValueError if the value is none within the bound."""
        with contextlib.suppress(TypeError, ValueError, OverflowError):
            number = self.kind(value)
            if not isinstance(value, bool) and (isinstance(value, str) or number == value) and self.holds(number):
                return number
        raise ValueError(f"{value}; expected {self.told}")


BOUNDS: dict[Any, Bound] = {}  # By type that stands for the bound in signatures

if not TYPE_CHECKING:

    def _bounded(name: str, bound: Bound) -> type:
        """A type for signatures; the parser gives plain numbers for it."""
        made = type(name, (), {"__doc__": bound.told})
        fits = lambda value, _: type(value) is bound.kind and bound.holds(value)  # noqa: E731
        register_type(made, lambda number: number, bound.read, type_check=fits)
        BOUNDS[made] = bound
        return made

    PositiveInt = _bounded("PositiveInt", Bound(int, "a whole number, at least 1", {"minimum": 1}))
    NonNegativeInt = _bounded("NonNegativeInt", Bound(int, "a whole number, at least 0", {"minimum": 0}))
    PositiveFloat = _bounded("PositiveFloat", Bound(float, "a number above 0", {"exclusiveMinimum": 0}))
    NonNegativeFloat = _bounded("NonNegativeFloat", Bound(float, "a number, at least 0", {"minimum": 0}))
    Seed = _bounded("Seed", Bound(int, "a whole number from 0 to 4294967295", {"minimum": 0, "maximum": (1 << 32) - 1}))
    Threads = _bounded("Threads", Bound(int, "a whole number from 1 to 1024", {"minimum": 1, "maximum": 1024}))
    Depth = _bounded("Depth", Bound(int, "a whole number from 1 to 1000", {"minimum": 1, "maximum": 1000}))
    Share = _bounded("Share", Bound(float, "a share from 0 to 1", {"minimum": 0, "maximum": 1}))
    Fraction = _bounded("Fraction", Bound(float, "a share from 0 to below 1", {"minimum": 0, "exclusiveMaximum": 1}))

T = TypeVar("T")


class Configured:
    """Remembers the arguments that it was built with and refuses those outside of the bounds in its signature.

    Raises:
        ConfigError: If an argument is outside of its bound, or a type in the signature has a name that is unknown when
            the program runs.
    """

    arguments: dict[str, Any]  # By name, defaults included; those of the outermost class that was built
    beginnings: ClassVar[tuple[str, ...]] = ()
    """Arguments that say with which weights an object begins; blueprints leave them out: checkpoints hold weights."""

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Look at the arguments before the constructor does, so that no class has to hand them on."""
        made = super().__new__(cls)
        # A class without a constructor would take anything, and say nothing.
        constructor = cls.__init__ if cls.__init__ is not object.__init__ else _take_nothing
        # Copies and unpickled objects are made without arguments; their state brings what is remembered.
        bound = inspect.signature(constructor).bind_partial(made, *args, **kwargs)
        bound.apply_defaults()
        found = dict([*bound.arguments.items()][1:])
        object.__setattr__(made, "arguments", found)
        hints = _hints(cls, constructor)
        for name, value in found.items():
            _check_bounds(f"{cls.__name__}.{name}", hints.get(name), value)
        return made


def _take_nothing(self: object) -> None:
    """Stand for the constructor of a class that has none."""


def _hints(kind: type, constructor: Callable[..., None]) -> dict[str, Any]:
    try:
        # A dataclass inherits fields, each with names of the module that it stands in.
        return get_type_hints(kind if dataclasses.is_dataclass(kind) else constructor)
    except NameError as error:
        raise ConfigError(
            f"{kind.__name__}: {error}; expected types that its module imports, not for type checkers alone"
        ) from None


def _check_bounds(place: str, hint: Any, value: Any) -> None:
    """Hold a value, or every item of a collection, to the bound that its type states, if it states one."""
    parts = get_args(hint)
    if hint in BOUNDS:
        _check_number(place, hint, value)
    elif value is None and not _may_be_none(hint):
        raise ConfigError(f"{place} is null; expected a value; change it or leave it away")
    elif get_origin(hint) in (Union, types.UnionType):
        by_name = [option for option in parts if get_origin(option) is dict] if isinstance(value, Mapping) else []
        for option in () if _is_word(value, parts) else by_name or parts:
            _check_bounds(place, option, value)
    elif isinstance(value, Mapping):
        for name, item in value.items():
            _check_bounds(f"{place}.{name}", parts[-1] if parts else None, item)
    elif isinstance(value, Sequence) and not isinstance(value, str) and parts:
        for item in value:
            _check_bounds(place, parts[0], item)


def _is_word(value: Any, options: Sequence[Any]) -> bool:
    """True for one of the words of a union, or for null where it has that."""
    words = [word for option in options if get_origin(option) is Literal for word in get_args(option)]
    return types.NoneType in options if value is None else isinstance(value, str) and value in words


def _may_be_none(hint: Any) -> bool:
    """True where a type is unknown or says so; the parser takes null for arguments of any type."""
    union = get_origin(hint) in (Union, types.UnionType)
    return (
        hint in (None, Any, object, types.NoneType)
        or isinstance(hint, TypeVar)
        or (union and types.NoneType in get_args(hint))
    )


def _check_number(place: str, bound: Any, value: Any) -> None:
    if isinstance(value, str):
        raise ConfigError(f"{place} is {value!r}; expected {BOUNDS[bound].told}; change it")
    try:
        BOUNDS[bound].read(value)
    except ValueError as error:
        raise ConfigError(f"{place} is {error}; change it") from None


def blueprint(made: Configured, leaving_out: Sequence[str] = ()) -> dict[str, Any]:
    """Tell how to build an object again, as plain lists, strings and numbers: ``{class_path, init_args}``.

    Arguments in ``leaving_out`` are not told: the caller of :func:`build` gives them.
    """
    kind, left = type(made), (*leaving_out, *made.beginnings)
    arguments = {name: _plain(value) for name, value in made.arguments.items() if name not in left}
    return {"class_path": f"{kind.__module__}.{kind.__qualname__}", "init_args": arguments}


def _plain(value: Any) -> Any:
    if isinstance(value, Configured):
        return blueprint(value)
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def build(made_by: Mapping[str, Any], kind: type[T], allowed: Sequence[str], *first: Any) -> T:
    """Build the object that :func:`blueprint` tells of.

    Args:
        made_by: A blueprint, from a checkpoint for instance.
        kind: Class that the object has to be of.
        allowed: Packages that may be imported for it; nothing else is.
        first: Arguments that the blueprint leaves out, which come first.

    Raises:
        ConfigError: If the blueprint names something else than a class of that kind in an allowed package.
    """
    path = str(made_by["class_path"])
    module, _, name = path.rpartition(".")
    if not any(module == package or module.startswith(f"{package}.") for package in allowed):
        package = path.split(".")[0]
        raise ConfigError(f"importing {path!r} is not allowed; if you trust it, add --allow_imports {package}")
    found = getattr(importlib.import_module(module), name, None)
    if not isinstance(found, type) or not issubclass(found, kind):
        raise ConfigError(f"{path!r} is no {kind.__name__}; expected the class that was saved")
    return found(*first, **_built(made_by["init_args"], allowed))


def _built(value: Any, allowed: Sequence[str]) -> Any:
    if isinstance(value, Mapping):
        if "class_path" in value:
            return build(value, Configured, allowed)
        return {name: _built(item, allowed) for name, item in value.items()}
    return [_built(item, allowed) for item in value] if isinstance(value, list) else value
