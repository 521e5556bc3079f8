"""Checkpoints of earlier versions, in today's names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from datamodules.settings import blueprint
from plp_lightning.networks import ImageEncoding

PREFIXES = {
    "discriminator.": "terms.adversarial.discriminator.",
    "image_decoder.": "terms.reconstruction.image_decoder.",
    "policy.perception.eyes.": "policy.perception.image_encoders.",
}
"""New prefixes of parameters by their old ones; the first two of the portable policy's alignment alone."""
SETTINGS: Mapping[str, Mapping[str, str]] = {
    "ContextualPolicy": {"encoder_layers": "encoder_blocks", "decoder_layers": "decoder_blocks"},
    "CdilPolicy": {f"{part}_layers": f"translator_{part}_layers" for part in ("encoder", "decoder")},
}
"""New names of policies' settings by class. They had the names of PLP's own networks, whose sizes pages state."""
ONLY_ENCODER = re.compile(r"\bimage_encoder\.(convolutions|linear)\.")
"""Names from when all images had one shape; networks take them as those of their only shape when they load them."""


def upgrade_checkpoint(checkpoint: dict[str, Any]) -> None:
    """Brings a checkpoint, as Lightning saves it, up to date in place; one of today's stays as it is."""
    if any(ONLY_ENCODER.search(name) for name in checkpoint["state_dict"]):
        _forget_hashes(checkpoint)
    if "architecture" not in checkpoint["policy"]:
        return
    # GAMA's discriminator is where it was: it has a unit of changes, which the domain discriminator has not.
    prefixes = dict(PREFIXES)
    if any(name.startswith(("discriminator.unit", "discriminators.")) for name in checkpoint["state_dict"]):
        prefixes.pop("discriminator.")
    names = [*checkpoint["state_dict"]]
    checkpoint["state_dict"] = {_moved(name, prefixes): value for name, value in checkpoint["state_dict"].items()}
    if any("eyes" in name for name in names):
        _forget_hashes(checkpoint)
    if not checkpoint.get("lr_schedulers"):
        # CDIL's rates fell without a scheduler: one that goes on has to know the epoch.
        groups = [len(state["param_groups"]) for state in checkpoint.get("optimizer_states", [])]
        epoch = checkpoint.get("epoch", 0)
        checkpoint["lr_schedulers"] = [{"last_epoch": epoch, "lr_lambdas": [None] * count} for count in groups]


def _forget_hashes(checkpoint: dict[str, Any]) -> None:
    """Hashes of frozen parts go over names too; they are taken anew."""
    checkpoint.get("callbacks", {}).pop("FreezeGuard", None)


def _moved(name: str, prefixes: dict[str, str]) -> str:
    found = next((old for old in prefixes if name.startswith(old)), "")
    return prefixes.get(found, "") + name.removeprefix(found)


def upgrade_blueprint(class_path: str, architecture: Mapping[str, Any]) -> dict[str, Any]:
    """Blueprint of a policy that an earlier version saved with this class and these settings."""
    short = class_path.rpartition(".")[2].replace("FlatPolicy", "BCPolicy")
    settings = {name: value for name, value in architecture.items() if name != "clip"}
    if "image_features" in settings:  # the others keep their image_channels
        sizes = tuple(settings.pop("image_channels")), settings.pop("image_features")
        settings["image_encoder"] = blueprint(ImageEncoding(*sizes))
    return with_todays_settings({"class_path": f"plp_lightning.methods.{short}", "init_args": settings})


def with_todays_settings(policy: Mapping[str, Any]) -> dict[str, Any]:
    """The blueprint of a policy with today's names of its settings."""
    names = SETTINGS.get(str(policy["class_path"]).rpartition(".")[2], {})
    said = policy.get("init_args", {})
    return {**policy, "init_args": {names.get(name, name): value for name, value in said.items()}}
