"""What a configuration may import. A file that names anything else is refused before the import happens."""

ALLOWED_IMPORTS = ["plp_lightning", "datamodules", "lightning.pytorch.callbacks", "torchmetrics", "torch.optim"]
