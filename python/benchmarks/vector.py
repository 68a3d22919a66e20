"""Measures what Python and the observation of proprioception cost in a step of many worlds.

    python python/benchmarks/vector.py --worlds 1024 --threads 2

Four batches of the same worlds take turns: without an observation, with the proprioception of all joints (116 numbers, noise
included), the latter without the copies that a caller may keep, and with a reward and an end of its own in Python. The time within the
native call is measured apart, so that the share of Python itself is known. The processor's time is measured besides the clock's: it
bears a busy machine better. Then one world is copied into all others of a room, often.
"""

import argparse
import json
import time

import fiatlux
import numpy as np


def judge(observation, info):
    """A reward for going forwards, and an end where the pelvis is low."""
    return observation[:, 6], observation[:, 9] < 0.5


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=1024)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--task", default="S07")
    parser.add_argument("--steps", type=int, default=4, help="control steps of a measurement")
    parser.add_argument("--rounds", type=int, default=8, help="measurements, taken in turns; the best of each counts")
    parser.add_argument("--copies", type=int, default=600, help="times that a world is copied; the best counts")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    def make(sensors, **settings):
        return fiatlux.VectorEnv(
            args.task, args.worlds, num_threads=args.threads, observation="flat", sensors=sensors, **settings
        )

    cases = {
        "no observation": make([], copy=False, final_obs=False),
        "proprioception": make(["proprioception"]),
        "proprioception, no copies": make(["proprioception"], copy=False, final_obs=False),
        "proprioception, a judge in Python": make(["proprioception"], judge=judge),
    }
    seconds = dict.fromkeys(cases, float("inf"))
    native, processor = dict(seconds), dict(seconds)
    for _ in range(args.rounds):
        for name, env in cases.items():
            whole, inside, cpu = measure(env, args.steps)
            seconds[name], native[name] = min(seconds[name], whole), min(native[name], inside)
            processor[name] = min(processor[name], cpu)
    base = seconds["no observation"]
    report = {
        "worlds": args.worlds,
        "threads": cases["no observation"].num_threads,
        "world_steps_per_s": {name: round(args.worlds / each) for name, each in seconds.items()},
        "share_of_proprioception": 1 - base / seconds["proprioception"],
        "share_of_proprioception_without_copies": 1 - base / seconds["proprioception, no copies"],
        "share_of_proprioception_by_processor_time": 1 - processor["no observation"] / processor["proprioception"],
        "share_of_a_judge": 1 - seconds["proprioception"] / seconds["proprioception, a judge in Python"],
        "share_of_python_itself": 1 - native["proprioception"] / seconds["proprioception"],
        "copy_seconds": copying(args),
    }
    if args.json:
        print(json.dumps(report))
        return
    print(f"{args.worlds} worlds of {args.task} on {report['threads']} threads, the best of {args.rounds} rounds")
    for name, rate in report["world_steps_per_s"].items():
        print(f"  {name:<34} {rate:>8} control steps/s")
    print(f"proprioception takes {100 * report['share_of_proprioception']:.1f} % of a step (bar: at most 5 %)")
    print(f"  by the processor's time {100 * report['share_of_proprioception_by_processor_time']:.1f} %")
    print(f"  without copies {100 * report['share_of_proprioception_without_copies']:.1f} %")
    print(f"a judge in Python takes {100 * report['share_of_a_judge']:.1f} %")
    print(f"Python outside the native call takes {100 * report['share_of_python_itself']:.1f} %")
    print(f"a world is copied into {args.worlds - 1} others in {1e3 * report['copy_seconds']:.2f} ms")


def copying(args):
    """Seconds for copying a world into all others, at best."""
    env = fiatlux.VectorEnv(args.task, args.worlds, seeds=[1000], num_threads=args.threads, copy=False)
    env.reset(seed=0)
    others, best = np.arange(args.worlds) > 0, float("inf") if args.worlds > 1 else 0.0
    for _ in range(args.copies if args.worlds > 1 else 0):
        begun = time.perf_counter()
        env.copy_world(0, others)
        best = min(best, time.perf_counter() - begun)
    return best


def measure(env, steps):
    """Seconds for a step, for its native call, and of processor time, from the start of the episodes."""
    env.reset(seed=0)
    actions = np.zeros(env.action_space.shape, np.float32)
    env.step(actions)
    batch, inside = env._batch, 0.0

    class Timed:
        def step(self, *buffers):
            nonlocal inside
            begun = time.perf_counter()
            batch.step(*buffers)
            inside += time.perf_counter() - begun

        def __getattr__(self, name):
            return getattr(batch, name)

    env._batch = Timed()
    try:
        begun, cpu = time.perf_counter(), time.process_time()
        for _ in range(steps):
            env.step(actions)
        return (time.perf_counter() - begun) / steps, inside / steps, (time.process_time() - cpu) / steps
    finally:
        env._batch = batch


if __name__ == "__main__":
    main()
