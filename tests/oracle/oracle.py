"""MuJoCo's results for our exported scenes, as fixtures that the Rust tests compare with.

    python3 tests/oracle/oracle.py all          every fixture
    python3 tests/oracle/oracle.py dynamics     one fixture
    python3 tests/oracle/oracle.py check F.xml  load a scene, fail on any warning
    python3 tests/oracle/oracle.py timing --scene F.xml [--states S.json]

Makes its own virtual environment next to itself on the first run.
"""

import argparse
import sys
from pathlib import Path

import environment

HERE = Path(__file__).resolve().parent
VENV = HERE / ".venv"


def main():
    import contacts
    import falls
    import motion
    import scene
    import timing

    fixtures = {
        "dynamics": (motion.dynamics, "mass matrix and bias force of 20 random states"),
        "dynamics_bare": (motion.dynamics_bare, "the same of the robot with welded fingers"),
        "dynamics_dex3": (motion.dynamics_dex3, "the same of the robot with Dex3 hands"),
        "tumble": (motion.tumble, "one second of tumbling in the air"),
        "closing": (motion.closing, "one second in which hands close whose outer joints follow"),
        "fall_ankles_off": (falls.fall_ankles_off, "rest poses after a fall with free ankles"),
        "fall_zero_action": (falls.fall_zero_action, "when the robot falls under zero action"),
        "firm_ankles": (falls.firm_ankles, "whether the robot stands on ankles eight times as stiff"),
        "contacts": (contacts.contacts, "distance and normal of random pairs of shapes"),
        "holding": (motion.holding, "a second of every task with the start's targets held"),
        "holding_dex3": (motion.holding_dex3, "the same of the robot with Dex3 hands"),
        "tasks": (scene.tasks, "what every task's start state holds, loaded without a warning"),
        "tasks_dex3": (scene.tasks_dex3, "the same of the robot with Dex3 hands"),
    }
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, (_, what) in fixtures.items():
        command = commands.add_parser(name, help=f"fixture: {what}")
        if name not in ("contacts", "holding", "holding_dex3", "tasks", "tasks_dex3"):
            command.add_argument("--scene", help="MJCF file to use in place of our own export")
    commands.add_parser("all", help="every fixture")
    command = commands.add_parser("check", help="load MJCF files; any warning is an error")
    command.add_argument("files", nargs="+")
    command = commands.add_parser("timing", help="microseconds per MuJoCo step, as JSON on stdout")
    timing.add_arguments(command)
    args = parser.parse_args()

    if args.command == "check":
        for path in args.files:
            print(scene.Scene.load(path).summary())
    elif args.command == "timing":
        timing.run(args)
    else:
        for name in fixtures if args.command == "all" else [args.command]:
            produce, _ = fixtures[name]
            path = getattr(args, "scene", None)
            data = produce() if path is None else produce(path)
            scene.write_fixture(name, data)


if __name__ == "__main__":
    environment.enter(__file__, VENV, HERE / "requirements.txt")
    try:
        main()
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(f"error: {error}")
