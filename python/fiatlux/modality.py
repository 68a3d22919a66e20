"""``meta/modality.json`` of a data set, which the trainer of GR00T asks for: where each group of joints is in state and action.

``python -m fiatlux.modality DATA_SET`` writes it from the names of the data set's own features.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from .dataset import COMMAND
from .spaces import joint_groups

_COMMANDS = {"navigate_command": (0, 3), "base_height_command": (3, 4), "torso_command": (4, 7)}
"""Parts of a command to the whole-body controller: velocities, height, roll, pitch and yaw of the torso."""


def modality(features: Mapping[str, Any]) -> dict[str, Any]:
    """The contents of ``modality.json`` for the features of a data set that :func:`fiatlux.export_lerobot` made.

    Joints have the keys ``left_leg``, ``right_leg``, ``waist``, ``left_arm``, ``right_arm``, ``left_hand`` and ``right_hand``; their
    velocities the same with ``_velocity``; other terms of the state their own names. A command has ``navigate_command``,
    ``base_height_command`` and ``torso_command``. Pictures are ``ego_view`` (head) and ``chest_view``.

    Raises:
        ValueError: A feature is missing, or is not one of such a data set.
    """
    for name in ("observation.state", "action"):
        if name not in features:
            raise ValueError(f"the data set has no feature {name!r}; make it with fiatlux.export_lerobot")
    state: dict[str, dict[str, int]] = {}
    names = list(features["observation.state"]["names"])
    terms = list(dict.fromkeys(name.partition(".")[0] for name in names))
    for term in terms:
        places = [index for index, name in enumerate(names) if name.partition(".")[0] == term]
        if not term.startswith("joint_"):
            state[term] = {"start": places[0], "end": places[-1] + 1}
            continue
        ending = "_velocity" if term == "joint_velocity" else ""
        joints = [names[place].partition(".")[2] for place in places]
        state |= {f"{group}{ending}": part for group, part in _groups(joints, places[0]).items()}
    actions = list(features["action"]["names"])
    if actions == list(COMMAND):
        action = {name: {"start": start, "end": end} for name, (start, end) in _COMMANDS.items()}
    else:
        action = _groups(actions, 0)
    views = {"observation.images.camera": "ego_view", "observation.images.chest_camera": "chest_view"}
    video = {view: {"original_key": name} for name, view in views.items() if name in features}
    annotation = {"human.task_description": {"original_key": "task_index"}}
    return {"state": state, "action": action, "video": video, "annotation": annotation}


def _groups(joints: Sequence[str], first: int) -> dict[str, dict[str, int]]:
    made = {}
    for group, indices in joint_groups(joints).items():
        start, end = int(indices[0]), int(indices[-1]) + 1
        if end - start != len(indices):
            raise ValueError(f"the joints of {group} do not follow each other; GR00T takes slices alone")
        made[group] = {"start": first + start, "end": first + end}
    return made


def write_modality(data_set: str | PathLike[str]) -> Path:
    """Writes ``meta/modality.json`` into a data set of any version, and returns its path.

    Raises:
        FileNotFoundError: The folder has no ``meta/info.json``.
        ValueError: As for :func:`modality`.
    """
    info = Path(data_set, "meta", "info.json")
    if not info.is_file():
        raise FileNotFoundError(f"{info} does not exist; name the folder of a LeRobot data set")
    made = modality(json.loads(info.read_text())["features"])
    path = info.with_name("modality.json")
    path.write_text(json.dumps(made, indent=2) + "\n")
    return path


def main() -> None:
    """Runs the program."""
    parser = argparse.ArgumentParser(prog="python -m fiatlux.modality", description=__doc__)
    parser.add_argument("data_set", help="folder of a LeRobot data set that fiatlux.export_lerobot made")
    arguments = parser.parse_args()
    try:
        print(write_modality(arguments.data_set))
    except (OSError, ValueError) as error:
        parser.exit(1, f"error: {error}\n")


if __name__ == "__main__":
    main()
