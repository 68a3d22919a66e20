"""Trains controllers: ``python -m fiatlux.train walk --out DIR``; needs the extra ``train``."""
