"""Trains a policy that sees by the expert's labels: ``python -m fiatlux.dagger train --tasks S05 S07 S09 --out DIR``."""

from .._extras import check

check("fiatlux.dagger", "train", "torch", "safetensors")
