"""Measures what pictures of many worlds cost: steps a second on one thread, and memory.

    python python/benchmarks/pictures.py

Batches of the same worlds take turns: without pictures, with one every tenth of a second, and with one in each step. Memory is the
growth of this process from before many worlds are made to after some steps, without pictures and with them; the caller keeps the last ones.
"""

import argparse
import json
import time
from pathlib import Path

import fiatlux
import numpy as np

CASES = {"no pictures": [], "at 10 Hz": ["camera@10"], "in each step": ["camera"]}
ROW = 5  # a picture at 10 Hz is drawn in every fifth step


def make(args, worlds, sensors):
    env = fiatlux.VectorEnv(
        args.task, worlds, num_threads=1, sensors=["proprioception", *sensors], image_size=args.size, observation="dict"
    )
    env.reset()
    return env


def step(env, steps):
    actions = np.zeros(env.action_space.shape, np.float32)
    for _ in range(steps):
        env.step(actions)


def resident():
    """Memory of this process, bytes."""
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS")]
    return 1024 * int(line.split()[1])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="S07")
    parser.add_argument("--worlds", type=int, default=16, help="whose steps are timed")
    parser.add_argument("--many", type=int, default=1024, help="worlds whose memory is measured")
    parser.add_argument("--size", type=int, nargs=2, default=(128, 128), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--rounds", type=int, default=8, help="measurements, taken in turns; the best of each counts")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    # The first batch of a process takes memory that belongs to no world.
    envs = {name: make(args, args.worlds, sensors) for name, sensors in CASES.items()}
    rates = dict.fromkeys(CASES, 0.0)
    for _ in range(args.rounds):
        for name, env in envs.items():
            begun = time.perf_counter()
            step(env, 4 * ROW)
            rates[name] = max(rates[name], 4 * ROW * args.worlds / (time.perf_counter() - begun))
    grown = []
    for sensors in ([], ["camera"]):
        before = resident()
        env = make(args, args.many, sensors)
        step(env, 4 * ROW)
        grown.append(resident() - before)
        # The next batch must not find its memory.
        envs[len(envs)] = env
    report = {"steps_per_s": rates, "worlds": args.many, "bytes_of_pictures": grown[1] - grown[0]}
    if args.json:
        print(json.dumps(report))
        return
    for name, rate in rates.items():
        print(f"{name}: {rate:,.0f} steps/s of {args.worlds} worlds on one thread")
    print(f"pictures of {args.many} worlds: {report['bytes_of_pictures'] / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
