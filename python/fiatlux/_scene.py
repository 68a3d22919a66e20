"""Numbers of the published room by section, with the names that `crates/world/scene.toml` explains."""

import json
from typing import Any

from . import _native

SCENE: dict[str, Any] = json.loads(_native.published_scene())
