"""Trains controllers: ``python -m fiatlux.train walk --out DIR``; needs the extra ``train``."""

from .._extras import check

check("fiatlux.train", "train", "torch", "rsl_rl", "tensordict", "safetensors")
