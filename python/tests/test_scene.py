"""The room's numbers as Python has them."""

import re
from pathlib import Path

from fiatlux._scene import SCENE


def test_the_numbers_are_those_of_the_scene():
    text = (Path(__file__).parents[2] / "crates/world/scene.toml").read_text()
    names = {"bulb.seat_z", "fixture.mouth_height", "fixture.stop_height", "bench.surface_height"}
    for section, name in (name.split(".") for name in names):
        part = text.split(f"\n[{section}]")[1].split("\n[")[0]
        found = re.search(rf"^{name} = ([\d.]+)", part, re.MULTILINE)
        assert found is not None
        assert SCENE[section][name] == float(found[1])
    assert SCENE["bulb"]["solids"][-1][0] > SCENE["bulb"]["seat_z"]
    assert SCENE["bulb"]["outline"][0][0] == SCENE["bulb"]["seat_z"]
