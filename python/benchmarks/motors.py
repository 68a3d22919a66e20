"""Compares the robot's motors in recorded episodes with their limits: the table of docs/notes/walking.md.

    python python/benchmarks/motors.py results/walk

Takes bags and folders of bags. Left and right count together. Each row of a bag has the mean effort of a control step of
20 ms and the joint's speed at its end. An action is outside the box where its magnitude is above 1.
"""

import argparse
import json
from pathlib import Path

import fiatlux
import numpy as np

BODY = 29
"""Joints of legs, waist and arms, the first ones; fingers are left out."""
AT_LIMIT = 0.999


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+", type=Path, metavar="BAG|DIR")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    bags = [bag for path in args.paths for bag in (sorted(path.rglob("*.mcap")) if path.is_dir() else [path])]
    if not bags:
        parser.error("there is no bag in these paths")
    joints, drives, steps = {}, None, 0
    for path in bags:
        bag = fiatlux.Bag(path)
        if drives is not None and drives != bag.header["drives"][:BODY]:
            parser.error(f"{path}: other gains or another robot than in the bags before it")
        drives = bag.header["drives"][:BODY]
        # Row 0 is the start state.
        state = {name: bag["/state"][name][1:, :BODY] for name in ("joint_effort", "joint_velocity", "action")}
        steps += len(state["action"])
        for index, name in enumerate(bag.header["joint_names"][:BODY]):
            parts = joints.setdefault(group(name), [])
            drive = drives[index]
            parts.append(
                (
                    np.abs(state["joint_effort"][:, index]) / drive["effort_limit"],
                    np.abs(state["joint_velocity"][:, index]) / drive["speed_limit"],
                    np.abs(state["action"][:, index]),
                    drive,
                )
            )
    table = {name: summary(parts) for name, parts in joints.items()}
    if args.json:
        print(json.dumps({"fiatlux": fiatlux.__version__, "episodes": len(bags), "steps": steps, "joints": table}))
        return
    print(f"{len(bags)} episodes, {steps} steps of 20 ms")
    columns = list(next(iter(table.values())))
    print(f"{'':<18}" + "".join(f"{name:>16}" for name in columns))
    for name, row in table.items():
        print(f"{name:<18}" + "".join(f"{row[column]:>16.4g}" for column in columns))


def group(name):
    """A joint's name without its side."""
    return name.removeprefix("left_").removeprefix("right_").removesuffix("_joint")


def summary(parts):
    effort, speed, action = (np.concatenate([part[column] for part in parts]) for column in range(3))
    drive = parts[0][3]
    return {
        "limit, N m": drive["effort_limit"],
        "effort p99, %": 100 * float(np.percentile(effort, 99)),
        "at limit, %": 100 * float(np.mean(effort >= AT_LIMIT)),
        "rated, rad/s": drive["speed_limit"],
        "speed p99, %": 100 * float(np.percentile(speed, 99)),
        "beyond rated, %": 100 * float(np.mean(speed > 1.0)),
        "action p99": float(np.percentile(action, 99)),
        "out of box, %": 100 * float(np.mean(action > 1.0)),
    }


if __name__ == "__main__":
    main()
