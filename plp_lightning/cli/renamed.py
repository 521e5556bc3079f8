"""Keys and classes that had another name once: files and flags that use it are understood, and told the new one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from datamodules.errors import ConfigError
from plp_lightning.cli.classes import find_class
from plp_lightning.cli.layers import insert
from plp_lightning.cli.yaml_files import Tree
from plp_lightning.methods.upgrade import SETTINGS

GROUPS: Mapping[str, Mapping[str, str]] = {
    "data": {"target": "target_task", "held_out": "val_fraction", "mix": "mix_ratio"},
    "collection": {"linger": "hold_steps", "wander": "random_start_steps"},
}
"""New names of settings by group."""
CLASSES = {"FlatPolicy": "BCPolicy", "FlatCloning": "BCCloning", "FlatAdaptation": "BCAdaptation"}
"""New short names of classes."""
POLICY = {"image_channels": "image_encoder.channels", "image_features": "image_encoder.features", "clip": ""}
"""Places of settings of policies now; none, if that is empty."""
OPTIMIZER = {name: f"optimizer.init_args.{name}" for name in ("lr", "weight_decay", "first_moment")}
PHASE = {"lr": OPTIMIZER["lr"], "weight_decay": OPTIMIZER["weight_decay"], "lr_schedule": "lr_scheduler"}
"""Places of settings of all phases now."""
ALIGNMENT = {
    **{f"mmd_{name}": f"terms.mmd.init_args.{name}" for name in ("weight", "bandwidths", "scale_gradient")},
    **{f"tcc_{name}": f"terms.tcc.init_args.{name}" for name in ("weight", "similarity")},
    "adversarial_weight": "terms.adversarial.init_args.weight",
    "penalty_weight": "terms.adversarial.init_args.penalty_weight",
    **{f"discriminator_{name}": f"terms.adversarial.init_args.{name}" for name in ("layers", "hidden")},
    "reconstruction_weight": "terms.reconstruction.init_args.weight",
    "reconstruction_halvings": "terms.reconstruction.init_args.downsampling",
}
"""Places of settings of the portable policy's alignment now."""
CDIL = {
    **{f"{name}_weight": f"weights.{name}" for name in ("adversarial", "cycle", "latent", "position", "penalty")},
    "first_moment": OPTIMIZER["first_moment"],
    "slowdown": "lr_scheduler.init_args.share",
}
"""Places of settings of CDIL's alignment now."""
TERMS = {"mmd": "MMD", "adversarial": "DomainAdversarial", "tcc": "TCC"}
"""Classes of the terms that once were words in a list."""
VALUES = {"lr_schedule": lambda word: {"class_path": "CosineDecay"} if word == "cosine" else None}
"""What becomes of values that are told in another way now."""
OLD_CLIP = 5.0  # The only bound of z-scored inputs that there is now


def rename(tree: Tree, phases: Sequence[str], below: Tree) -> tuple[Tree, list[str]]:
    """A configuration, as read from a file, in today's names, and for each old name ``old is new``.

    A part that names no class is of the class that it has in the configuration ``below``.

    Raises:
        ConfigError: If a setting that is gone has another value than it always has now.
    """
    found: list[str] = []
    renamed = {key: _group(key, value, found) if key in GROUPS else value for key, value in _classes(tree).items()}
    for place in (name for name in ("policy", *phases) if isinstance(renamed.get(name), Mapping)):
        kind = renamed[place].get("class_path") or (below.get(place) or {}).get("class_path")
        renamed[place] = _part(renamed[place], place, str(kind), found)
    if isinstance(renamed.get("score"), Mapping):
        renamed["score"] = [renamed["score"]]
        found.append("one score is a list of one")
    return renamed, found


def rename_flag(key: str, tree: Tree) -> str:
    """Today's name of a flag such as ``data.target``, laid over a configuration that knows the classes of phases."""
    head, _, name = key.replace(".init_args.", ".").partition(".")
    new = GROUPS.get(head, {}).get(name)
    if new is None and name not in VALUES and isinstance(tree.get(head), Mapping):
        new = _table(head, str(tree[head].get("class_path"))).get(name, "").replace(".init_args.", ".")
    return f"{head}.{new}" if new else key


def _classes(tree: Any) -> Any:
    """The same with classes that have moved under their short names."""
    if isinstance(tree, list):
        return [_classes(item) for item in tree]
    if not isinstance(tree, Mapping):
        return tree
    inner = {key: _classes(value) for key, value in tree.items()}
    path = inner.get("class_path")
    if isinstance(path, str):
        short = path.rpartition(".")[2]
        moved = path.startswith("plp_lightning.") and find_class(path, ["plp_lightning"]) is None
        inner["class_path"] = CLASSES.get(short, short if moved else path)
    return inner


def _group(name: str, settings: Any, found: list[str]) -> Any:
    if not isinstance(settings, Mapping):
        return settings
    table = GROUPS[name]
    found += [f"{name}.{old} is {name}.{table[old]}" for old in settings if old in table]
    return {table.get(key, key): value for key, value in settings.items()}


def _table(place: str, class_path: str) -> Mapping[str, str]:
    """Places of the old settings of a policy or phase now; they depend on its class."""
    kind = class_path.rpartition(".")[2]
    if place == "policy":
        return {**({"clip": ""} if kind in ("GamaPolicy", "CdilPolicy") else POLICY), **SETTINGS.get(kind, {})}
    special = {"Alignment": ALIGNMENT, "StateOnlyAlignment": ALIGNMENT, "CdilAlignment": CDIL}
    return {**PHASE, **special.get(kind, {})}


def _part(part: Mapping[str, Any], place: str, kind: str, found: list[str]) -> Tree:
    """A policy or a phase in today's names."""
    said = part.get("init_args")
    if not isinstance(said, Mapping):
        return dict(part)
    table, settings = _table(place, kind), dict[str, Any]()
    words = said.get("terms")
    for key, value in said.items():
        if table.get(key):
            insert(settings, table[key], VALUES[key](value) if key in VALUES else value)
            found.append(f"{place}.{key} is {place}.{table[key].replace('.init_args.', '.')}")
        elif key in table and value != OLD_CLIP:
            raise ConfigError(f"{place}.{key} is {value}; expected {OLD_CLIP}, which it always is now; leave it away")
        elif key not in table and not (key == "terms" and isinstance(words, list)):
            settings[key] = value
    if isinstance(words, list):
        found.append(f"the list {place}.terms is a mapping from names to classes")
        settings["terms"] = _chosen(place, words, settings.get("terms", {}))
    return {**part, "init_args": settings}


def _chosen(place: str, words: list[str], said: Mapping[str, Any]) -> Tree:
    """Terms by name for a list of words; those that it leaves out are null."""
    unknown = [word for word in words if word not in TERMS]
    if unknown:
        raise ConfigError(f"{place}.terms names {unknown[0]!r}; expected some of {', '.join(TERMS)}; mend the list")
    chosen = {name: {"class_path": kind, **said.get(name, {})} for name, kind in TERMS.items() if name in words}
    return {**said, **dict.fromkeys(TERMS), **chosen}
