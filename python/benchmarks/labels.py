"""Measures what the expert's labels cost: labels a second on one thread, and their share of the time that steps and labels take.

python python/benchmarks/labels.py --tasks S03 S07
"""

import argparse
import json
import time

import fiatlux
import numpy as np

TASKS = [f"S{number:02}" for number in range(1, 13)]


def measure(task, worlds, steps):
    env = fiatlux.VectorEnv(task, worlds, num_threads=1, sensors=["proprioception"])
    env.reset()
    experts = fiatlux.Experts(env)
    experts.label()
    labelling = stepping = 0.0
    for _ in range(steps):
        begun = time.perf_counter()
        labels = experts.label()
        labelled = time.perf_counter()
        env.step(labels.action.astype(np.float32))
        labelling += labelled - begun
        stepping += time.perf_counter() - labelled
    return {"labels_per_s": worlds * steps / labelling, "share": labelling / (labelling + stepping)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS, metavar="TASK")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--steps", type=int, default=150, help="control steps of 20 ms from the start on")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = {}
    for task in args.tasks:
        found[task] = measure(task, args.worlds, args.steps)
        if not args.json:
            print("{}: {labels_per_s:,.0f} labels/s, {share:.0%} of the time".format(task, **found[task]), flush=True)
    if args.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
