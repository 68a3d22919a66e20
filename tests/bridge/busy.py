"""Measures the load of a model server in a run: a double of 145 ms a chunk, a server, and `policy-client evaluate` over 48 episodes.

    python busy.py TARGET/debug [--parallel 16] [--prefix 16] [--stand SECONDS] [--tasks S01,S04,S05,S07] [--seeds 0..11]

By default the model's joint targets go to the robot as they are, without a whole-body controller, so that it falls soon and the 48
episodes are short: the hard case, for sessions are opened all the time. With `--stand` the controller keeps it upright, and the
measurement is cut after so many seconds. It prints the share of the time from the first request to the last answer in which the
model was computing.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import time


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", type=pathlib.Path)
    parser.add_argument("--parallel", type=int, default=16)
    parser.add_argument("--seeds", default="0..11")
    parser.add_argument("--tasks", default="S01,S04,S05,S07")
    parser.add_argument("--prefix", type=int, default=16)
    parser.add_argument("--delay", type=float, default=0.145)
    parser.add_argument("--stand", type=float, default=0.0)
    args = parser.parse_args()
    doubles = pathlib.Path(__file__).with_name("doubles.py")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        stats = folder / "stats.json"
        double = [sys.executable, doubles, "serve", "--dialect", "gr00t", "--delay", str(args.delay), "--stats", stats]
        double = subprocess.Popen(double, stdout=subprocess.PIPE, text=True)
        url = "tcp://127.0.0.1:" + double.stdout.readline().split()[1]
        server = [args.programs / "sim-server", "--name", "busy", "-l", "tcp/127.0.0.1:0", "--record", folder / "bags"]
        log = folder / "log"
        with log.open("w") as file:
            server = subprocess.Popen(server, stdout=file, stderr=subprocess.STDOUT)
        try:
            while "listening on tcp/127.0.0.1:" not in (line := log.read_text()):
                time.sleep(0.1)
            port = line.split("listening on tcp/127.0.0.1:")[1].split()[0]
            client = [args.programs / "policy-client", "evaluate", "--policy", "vla", "--dialect", "gr00t"]
            client += ["--model", url, "--prefix", str(args.prefix), "-e", f"tcp/127.0.0.1:{port}", "--json"]
            client += ["--tasks", args.tasks, "--seeds", args.seeds, "--parallel", str(args.parallel)]
            client += ["--run-file", folder / "RUN.toml"]
            if not args.stand:
                text = (doubles.parents[2] / "crates/bridge/mappings/unitree_g1.toml").read_text()
                text = text.replace('term = "height"', "skip = 1").replace('term = "navigate"', "skip = 3")
                (folder / "direct.toml").write_text('body = "direct"\n' + text)
                client += ["--map", folder / "direct.toml"]
            else:
                client = ["timeout", "-s", "INT", str(args.stand), *client]
            start = time.monotonic()
            played = subprocess.run(client, stdout=subprocess.PIPE, text=True)
            wall = time.monotonic() - start
        finally:
            server.kill()
            double.kill()
        measured = json.loads(stats.read_text())
        episodes = json.loads(played.stdout or "{}").get("episodes", [])
        line = {"exit": played.returncode, "episodes": len(episodes), "wall_s": round(wall, 1)}
        print(json.dumps(line | measured))


if __name__ == "__main__":
    main()
