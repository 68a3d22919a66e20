"""Bars of evaluations on many machines, in full length: one result however it was played, kills, and 10,000 episodes.

    python cluster.py TARGET/debug FOLDER [same] [kills] [many] [--episodes 10000] [--kills 20] [--only walk,python,openpi]

Python is one with the packages fiatlux (built from this checkout), ray, and those of `bridge/requirements.txt`. Each part prints what
it compared, and ends the program with an error where something differs. `many` takes some 4 GB of disk for 10,000 episodes, and goes on
with the shards that are in its folder; the other parts empty theirs.
"""

import argparse
import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import time

TASKS, SEEDS = ["S05", "S09"], [0, 1, 2, 3]
ROOMS = ["--tasks", ",".join(TASKS), "--seeds", "0..3"]
PYTHON = """
import sys, json, numpy as np, fiatlux
class Waver:
    def reset(self, info):
        self.rng = np.random.default_rng(info["seed"])
    def __call__(self, observation):
        return self.rng.uniform(-0.1, 0.1, 53)
"""


SLOW = """
import os, pathlib, time
class Slow(Waver):
    def reset(self, info):
        super().reset(info)
        if pathlib.Path(PIDS).is_dir():
            pathlib.Path(PIDS, f"{info['seed']}-{os.getpid()}").touch()
        self.steps = 0
    def __call__(self, observation):
        time.sleep(0.02)
        return super().__call__(observation)
"""


class Lab:
    """Programs, a folder, and processes that end with it."""

    def __init__(self, programs, folder):
        self.programs, self.folder, self.running = programs, folder, []
        folder.mkdir(parents=True, exist_ok=True)

    def path(self, name):
        return self.folder / name

    def command(self, program, *args):
        return [str(self.programs / program), *map(str, args)]

    def python(self, code, *args):
        return [sys.executable, "-c", PYTHON + code, *map(str, args)]

    def run(self, command, ok=(0,)):
        done = subprocess.run(command, cwd=self.folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        if done.returncode not in ok:
            sys.exit(f"{' '.join(command)}\n{done.stdout}\nended with {done.returncode}")
        return done.stdout

    def start(self, command):
        log = open(self.path("log"), "a")
        self.running.append(subprocess.Popen(command, cwd=self.folder, stdout=log, stderr=log))
        return self.running[-1]

    def server(self, name, port, record, *more):
        place = f"tcp/127.0.0.1:{port}"
        server = self.start(self.command("sim-server", "--name", name, "-l", place, "--record", record, *more))
        until = time.monotonic() + 120
        while place not in subprocess.run(["ss", "-ltn"], text=True, capture_output=True).stdout.replace("127", "tcp/127"):
            if time.monotonic() > until:
                sys.exit(f"{place} is not listened on")
            time.sleep(0.2)
        return server

    def end(self):
        for process in self.running:
            process.kill()
            process.wait()
        self.running = []


def results(folder):
    """The results of a folder, without the names of paths, runs and servers."""
    found = json.loads((folder / "results.json").read_text())
    # A run has its registration too. Its S counts a task that was not asked for as 0; that of loose bags leaves it out.
    run = found.pop("run", None)
    assert run is None or not run.get("failures"), run
    for score in ("score", "score_strict"):
        found.pop(score)
    for episode in found["episodes"]:
        episode.pop("bag")
        for of_run in ("attempt", "attempts", "failure", "episode_index"):
            episode.pop(of_run, None)
    return json.dumps(found, sort_keys=True)


def graded(lab, out, runs):
    """Merges the folders of a run's servers."""
    lab.run(lab.command("scorer", "merge", out, *runs))
    return results(lab.path(out))


def built_in(lab, name, policy):
    """The five ways of a policy that the programs know."""
    evaluate = lab.command("fiatlux", "evaluate", *policy, *ROOMS, "--out")
    lab.run([*evaluate, f"{name}-one"])
    yield "one process", results(lab.path(f"{name}-one"))
    shards = [[*evaluate, f"{name}-{k}of4", "--shard", f"{k}/4"] for k in range(1, 5)]
    for shard in [lab.start(shard) for shard in shards]:
        assert shard.wait() == 0
    yield "4 shards", graded(lab, f"{name}-merged", [f"{name}-{k}of4" for k in range(1, 5)])
    import ray

    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, ignore_reinit_error=True)
    place = str(lab.folder)
    play = ray.remote(lambda shard: subprocess.run(shard, cwd=place, capture_output=True).returncode)
    shards = [[*evaluate, f"{name}-ray-{k}of4", "--shard", f"{k}/4"] for k in range(1, 5)]
    assert ray.get([play.remote(shard) for shard in shards]) == [0] * 4
    yield "4 shards on Ray", graded(lab, f"{name}-ray", [f"{name}-ray-{k}of4" for k in range(1, 5)])
    client = lab.command("policy-client", "evaluate", *policy, *ROOMS)
    for port, server in ((17211, "lab-1"), (17212, "lab-2")):
        lab.server(server, port, f"{name}-{server}")
    lab.run([*client, "-e", "tcp/127.0.0.1:17211", "-e", "tcp/127.0.0.1:17212", "--server", "lab", "--run-file", f"{name}-2.toml"])
    lab.end()
    yield "2 servers", graded(lab, f"{name}-servers", [lab.path(f"{name}-lab-{k}") for k in (1, 2)])
    lab.server("lab", 17213, f"{name}-lab")
    clients = [[*client, "-e", "tcp/127.0.0.1:17213", "--run-file", f"{name}-3.toml"]] * 3
    for one in [lab.start(one) for one in clients]:
        assert one.wait() in (0, 3)
    lab.end()
    yield "3 clients", graded(lab, f"{name}-clients", [lab.path(f"{name}-lab")])


def of_model(lab, name, policy):
    """The five ways of a policy that the client alone knows: each server has a folder of its own."""
    client = lab.command("policy-client", "evaluate", *policy, *ROOMS)

    def servers(way, count):
        places = []
        for k in range(1, count + 1):
            lab.server(f"lab-{k}", 17220 + k, f"{name}-{way}-{k}")
            places += ["-e", f"tcp/127.0.0.1:{17220 + k}"]
        return [*client, *places, "--server", "lab", "--run-file", f"{name}-{way}.toml"]

    def folders(way, count):
        lab.end()
        made = [lab.path(f"{name}-{way}-{k}") for k in range(1, count + 1)]
        return graded(lab, f"{name}-{way}", [folder for folder in made if any(folder.rglob("*.mcap"))])

    lab.run(servers("one", 1))
    yield "one client", folders("one", 1)
    shards = [[*servers("shards", 4), "--shard", f"{k}/4"] for k in (1,)]
    shards += [[*shards[0][:-1], f"{k}/4"] for k in (2, 3, 4)]
    lab.run(shards[0])
    for shard in [lab.start(shard) for shard in shards[1:]]:
        assert shard.wait() == 0
    yield "4 shards", folders("shards", 4)
    import ray

    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, ignore_reinit_error=True)
    place = str(lab.folder)
    play = ray.remote(lambda shard: subprocess.run(shard, cwd=place, capture_output=True).returncode)
    first = [*servers("ray", 4), "--shard", "1/4"]
    assert ray.get(play.remote(first)) == 0
    assert ray.get([play.remote([*first[:-1], f"{k}/4"]) for k in (2, 3, 4)]) == [0] * 3
    yield "4 shards on Ray", folders("ray", 4)
    lab.run(servers("two", 2))
    yield "2 servers", folders("two", 2)
    clients = [servers("clients", 1)] * 3
    for one in [lab.start(one) for one in clients]:
        assert one.wait() in (0, 3)
    yield "3 clients", folders("clients", 1)


def of_python(lab):
    """The five ways of a policy in Python."""
    say = f"TASKS, SEEDS = {TASKS!r}, {SEEDS!r}\n"
    lab.run(lab.python(say + "fiatlux.evaluate(Waver, TASKS, SEEDS, out='py-one', run_file='py.toml')"))
    yield "one process", results(lab.path("py-one"))
    shard = say + "fiatlux.evaluate(Waver, TASKS, SEEDS, out=f'py-{sys.argv[1]}of4', shard=f'{sys.argv[1]}/4', run_file='py-4.toml')"
    lab.run(lab.python(shard, 1))
    for one in [lab.start(lab.python(shard, k)) for k in (2, 3, 4)]:
        assert one.wait() == 0
    yield "4 shards", graded(lab, "py-merged", [f"py-{k}of4" for k in range(1, 5)])
    on_ray = "import fiatlux.ray, ray\nray.init(address=\"local\", num_cpus=2, include_dashboard=False, log_to_driver=False)\n"
    lab.run(lab.python(say + on_ray + "assert not fiatlux.ray.evaluate(Waver, TASKS, SEEDS, out='py-ray', shard_size=2).lost"))
    yield "4 shards on Ray", results(lab.path("py-ray"))
    client = say + "fiatlux.Client(sys.argv[2:]).evaluate(Waver, TASKS, SEEDS, server='lab', run_file=sys.argv[1])"
    places = [f"tcp/127.0.0.1:{port}" for port in (17211, 17212)]
    for port, server in ((17211, "lab-1"), (17212, "lab-2")):
        lab.server(server, port, f"py-{server}")
    lab.run(lab.python(client, "py-2.toml", *places))
    lab.end()
    yield "2 servers", graded(lab, "py-servers", [lab.path(f"py-lab-{k}") for k in (1, 2)])
    lab.server("lab", 17213, "py-lab")
    lab.run(lab.python(say + "fiatlux.evaluate(Waver, ['S05'], [0], out='py-file', run_file='unused.toml')"))
    for one in [lab.start(lab.python(client, "py-3.toml", "tcp/127.0.0.1:17213")) for _ in range(3)]:
        assert one.wait() == 0
    lab.end()
    yield "3 clients", graded(lab, "py-clients", [lab.path("py-lab")])


def same(lab, only):
    """One result of five ways, for three policies."""
    for name in only:
        double = None
        if name == "openpi":
            doubles = pathlib.Path(__file__).with_name("bridge") / "doubles.py"
            command = [sys.executable, str(doubles), "serve", "--dialect", "openpi"]
            double = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            url = f"ws://127.0.0.1:{double.stdout.readline().split()[1]}"
            ways = of_model(lab, name, ["--policy", "vla", "--dialect", "openpi", "--model", url])
        elif name == "python":
            ways = of_python(lab)
        else:
            ways = built_in(lab, name, ["--policy", name])
        first = None
        for way, found in ways:
            first = first or found
            episodes = len(json.loads(found)["episodes"])
            print(f"{name}: {way}: {episodes} episodes, {'equal' if found == first else 'DIFFERENT'}", flush=True)
            if found != first:
                for place, text in (("first.json", first), ("other.json", found)):
                    lab.path(place).write_text(json.dumps(json.loads(text), indent=1))
                sys.exit(f"see first.json and other.json in {lab.folder}")
        if double:
            double.kill()


def begun(folder, process):
    """Waits until a process records an episode below a folder; false if it ended before."""
    while process.poll() is None:
        if any(folder.rglob("*.mcap.part")):
            return True
        time.sleep(0.05)
    return False


def compared(found, expected, what):
    print(f"{what}: {'equal' if found == expected else 'DIFFERENT'}", flush=True)
    assert found == expected


def kills(lab, count):
    """Kills in the middle of episodes: of shards, of Ray's workers, and of a server; each is restarted, and the results compared."""
    draw = random.Random(58)
    shards, workers = 2 * count // 5, 3 * count // 10
    rooms = ["--tasks", "S05", "--seeds", f"0..{2 * shards - 1}"]
    evaluate = lab.command("fiatlux", "evaluate", "--policy", "walk", *rooms, "--workers", "1", "--out")
    lab.run([*evaluate, "k-one"])
    expected, killed = results(lab.path("k-one")), 0
    for k in range(1, shards + 1):
        shard = [*evaluate, f"k-{k}of{shards}", "--shard", f"{k}/{shards}"]
        process = lab.start(shard)
        assert begun(lab.path(f"k-{k}of{shards}"), process)
        time.sleep(draw.uniform(0.0, 0.5))
        killed += process.poll() is None
        process.kill()
        process.wait()
        lab.run(shard)
    found = graded(lab, "k-merged", [f"k-{k}of{shards}" for k in range(1, shards + 1)])
    compared(found, expected, f"{killed} kills of shards")
    assert killed == shards

    say = f"TASKS, SEEDS = ['S05'], list(range({workers}))\nPIDS = {str(lab.path('pids'))!r}\n" + SLOW
    lab.run(lab.python(say + "fiatlux.evaluate(Slow, TASKS, SEEDS, out='k-py', run_file='k-py.toml')"))
    lab.path("pids").mkdir()
    on_ray = 'import ray\nray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False)\nimport fiatlux.ray\n'
    process = lab.start(
        lab.python(say + on_ray + "assert not fiatlux.ray.evaluate(Slow, TASKS, SEEDS, out='k-ray', shard_size=1).lost")
    )
    killed, seen = 0, set()
    while killed < workers and process.poll() is None:
        for seed, pid in [path.name.split("-") for path in lab.path("pids").iterdir()]:
            if seed not in seen:
                time.sleep(draw.uniform(0.0, 0.5))
                os.kill(int(pid), signal.SIGKILL)
                seen.add(seed)
                killed += 1
        time.sleep(0.05)
    assert process.wait() == 0
    compared(results(lab.path("k-ray")), results(lab.path("k-py")), f"{killed} kills of Ray's workers")
    assert killed == workers

    client = lab.command("policy-client", "evaluate", "--policy", "walk", *rooms, "-e", "tcp/127.0.0.1:17214")
    server, killed = lab.server("lab", 17214, "k-lab"), 0
    client = lab.start([*client, "--server", "lab", "--run-file", "k.toml"])
    while killed < count - shards - workers and begun(lab.path("k-lab"), client):
        time.sleep(draw.uniform(0.0, 1.0))
        server.kill()
        server.wait()
        killed += 1
        for left in lab.path("k-lab").rglob("*.mcap.part"):
            left.rename(left.with_suffix(".left"))
        server = lab.server("lab", 17214, "k-lab")
    assert client.wait() == 0
    lab.end()
    compared(graded(lab, "k-servers", [lab.path("k-lab")]), expected, f"{killed} kills of a server")
    assert killed == count - shards - workers


def many(lab, episodes):
    """Many short episodes in 16 shards, merged, and a sample verified; and as many in a registered run."""
    rooms = ["--policy", "random", "--tasks", "S05", "--seeds", f"0..{episodes - 1}"]
    evaluate = lab.command("fiatlux", "evaluate", *rooms, "--workers", "1", "--out")
    names = [f"m-{k}of16" for k in range(1, 17)]
    for k, name in enumerate(names, 1):
        if not lab.path(name).is_dir():
            lab.run([*evaluate, name, "--shard", f"{k}/16"])
    process = subprocess.Popen(lab.command("scorer", "merge", "m-all", *names), cwd=lab.folder, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    took, memory = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
    bags = sorted(lab.path("m-all/bags").glob("*.mcap"))
    print(f"{len(bags)} of {episodes} episodes: merged in {took:.1f} CPU s and {memory:.0f} MB", flush=True)
    assert status == 0 and len(bags) == episodes
    sample = lab.path("sample")
    sample.mkdir(exist_ok=True)
    for bag in random.Random(58).sample(bags, min(200, episodes)):
        shutil.copy(bag, sample)
    lab.run(lab.command("scorer", "thin", "sample"))
    lab.server("lab", 17215, "m-lab")
    said = lab.run(lab.command("scorer", "verify", "sample", "-e", "tcp/127.0.0.1:17215"))
    print(f"a sample as thin bags: {said.count('equal: ')} of {min(200, episodes)} equal", flush=True)
    assert said.count("equal: ") == min(200, episodes)
    client = lab.command("policy-client", "evaluate", *rooms, "-e", "tcp/127.0.0.1:17215", "--run-file", "m.toml")
    lab.run([*client, "--shard", f"1/{episodes // 10}"])
    lab.end()
    (journal,) = lab.path("m-lab").rglob("*.run.jsonl")
    planned = json.loads(journal.read_text().splitlines()[0])
    print(f"a run of {len(json.dumps(planned))} bytes is registered, and a shard of 10 episodes played", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", type=lambda text: pathlib.Path(text).resolve())
    parser.add_argument("folder", type=lambda text: pathlib.Path(text).resolve())
    parser.add_argument("parts", nargs="*", default=["same", "kills", "many"])
    parser.add_argument("--episodes", type=int, default=10_000)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--only", type=lambda text: text.split(","), default=["walk", "python", "openpi"])
    args = parser.parse_args()
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    for part in args.parts:
        if part != "many":
            shutil.rmtree(args.folder / part, ignore_errors=True)
        lab = Lab(args.programs, args.folder / part)
        try:
            {"same": lambda: same(lab, args.only), "kills": lambda: kills(lab, args.kills), "many": lambda: many(lab, args.episodes)}[part]()
        finally:
            lab.end()


main()
