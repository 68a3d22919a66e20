"""The published rooms: writes fixtures/rooms.json, which a Rust test of the layout compares with.

    python3 tests/oracle/rooms.py

The draw is written from the description of the published code, with Python's own `random`; it needs nothing else. Every
room is drawn as for S01; `anchor` is where S02 to S12 put the ladder instead.
"""

import json
import math
import random
from pathlib import Path

SEEDS = range(64)

FLOOR = ((-4.0, 4.0), (-3.0, 4.2))
FIXTURE_HALF = 0.18
FIXTURE_HEIGHT = 2.2
CEILING_STANDOFF, WALL_STANDOFF = 0.48, 0.60
# Name, fixed coordinate, the wall's extent along the other axis, direction into the room.
WALLS = (
    ("west", -4.410, (-2.622, 4.078), (1.0, 0.0)),
    ("east", 4.410, (-2.622, 4.078), (-1.0, 0.0)),
    ("south", -3.309, (-3.723, 3.723), (0.0, 1.0)),
)
# Largest first, as they are placed.
ZONES = (("bench", 1.5), ("ladder", 1.0), ("robot", 0.6), ("crate", 0.5))
GAP = 0.5
TRIES = 500
REDRAWS = 64


def clamped(point, half):
    return [min(max(value, low + half), high - half) for value, (low, high) in zip(point, FLOOR)]


def fixture(rng):
    """Mount, position, and the place of a ladder that stands ready: x, y, yaw."""
    if rng.random() < 0.5:
        position = [rng.uniform(low + FIXTURE_HALF, high - FIXTURE_HALF) for low, high in FLOOR]
        angle = rng.uniform(0.0, 2.0 * math.pi)
        bearing, mount, standoff = [math.cos(angle), math.sin(angle)], "ceiling", CEILING_STANDOFF
        for axis, (low, high) in enumerate(FLOOR):
            if not low <= position[axis] + standoff * bearing[axis] <= high:
                bearing[axis] = -bearing[axis]
    else:
        mount, fixed, (low, high), bearing = rng.choice(WALLS)
        along = rng.uniform(low + FIXTURE_HALF, high - FIXTURE_HALF)
        position = [along, fixed] if mount == "south" else [fixed, along]
        standoff = WALL_STANDOFF
    anchor = clamped([p + standoff * b for p, b in zip(position, bearing)], FIXTURE_HALF)
    yaw = math.atan2(-bearing[1], -bearing[0]) - math.pi / 2.0
    return mount, position, anchor, yaw


def once(rng):
    mount, position, anchor, anchor_yaw = fixture(rng)
    ladder_yaw = math.radians(rng.uniform(0.0, 360.0))
    taken = {"anchor": (anchor, FIXTURE_HALF)}
    for name, half in ZONES:
        for _ in range(TRIES):
            place = [rng.uniform(low + half, high - half) for low, high in FLOOR]
            apart = (max(abs(a - b) for a, b in zip(place, other)) - half - size for other, size in taken.values())
            if all(distance >= GAP for distance in apart):
                break
        else:
            return None
        taken[name] = (place, half)
    (bench, _), (robot, _) = taken["bench"], taken["robot"]
    bearing = math.atan2(bench[1] - robot[1], bench[0] - robot[0])
    return {
        "mount": mount,
        "fixture": [*position, FIXTURE_HEIGHT],
        "anchor": [*anchor, anchor_yaw],
        "ladder": [*taken["ladder"][0], ladder_yaw],
        "robot": [*robot, bearing + math.radians(rng.uniform(-15.0, 15.0))],
        "bench": bench,
        "crate": taken["crate"][0],
    }


def room(seed):
    rng = random.Random(seed)
    for _ in range(REDRAWS):
        drawn = once(rng)
        if drawn is not None:
            return {"seed": seed, **drawn}
    raise SystemExit(f"seed {seed}: the zones did not fit in {REDRAWS} draws")


if __name__ == "__main__":
    path = Path(__file__).resolve().parent / "fixtures" / "rooms.json"
    rows = ",\n".join(json.dumps(room(seed)) for seed in SEEDS)
    path.write_text(f'{{"rooms": [\n{rows}\n]}}\n')
    print(path)
