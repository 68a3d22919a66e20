"""Objects for the benchmark's room: from a picture or a mesh to USD, MJCF and data of our engine, checked and tried.

``python -m fiatlux.assets --help`` lists the stages; docs/assets.md explains them. It needs the extra ``assets`` of the wheel.
"""

from .error import AssetError

__all__ = ["AssetError"]
