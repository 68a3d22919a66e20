"""Measures the first page of a board with many entries: processor time after a start, while nothing changes, and after a change.

    python tests/pages.py PROGRAMS FOLDER RESULTS COUNT

PROGRAMS has `scorer`; FOLDER is the store, which is filled if it does not exist; RESULTS is the results.json of 48 episodes, such as by
`fiatlux evaluate --policy random --seeds 0..3`. Nothing is verified: the entries are written into the database.
"""

import hashlib
import json
import random
import sqlite3
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

ADDRESS = "127.0.0.1:43120"


def admin(scorer: Path, folder: Path, *args: str) -> None:
    subprocess.run([scorer, "admin", "--folder", folder, *args], check=True, stdout=subprocess.DEVNULL)


def fill(scorer: Path, folder: Path, results: dict, count: int) -> None:
    """Adds `count` verified entries, and one that is not received yet."""
    admin(scorer, folder, "init")
    admin(scorer, folder, "account", "lab")
    draw = random.Random(1)
    with sqlite3.connect(folder / "leaderboard.sqlite") as database:
        for number in range(count + 1):
            results["policy"] = f"policy-{number:05d}"
            for row in results["episodes"]:
                row["strict_clean"] = draw.random() < number / count
            hits = sum(row["strict_clean"] for row in results["episodes"])
            rate = hits / len(results["episodes"])
            interval = [max(0.0, rate - 0.1), min(1.0, rate + 0.1)]
            results["overall"]["strict_clean_success"] = {"hits": hits, "rate": rate, "interval": interval}
            text = json.dumps(results).encode()
            digest = hashlib.sha256(text).hexdigest()
            path = folder / "blobs" / digest[:2] / digest
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text)
            manifest = json.dumps({"policy": results["policy"], "licence": "Apache-2.0"})
            state = "verified" if number < count else "uploading"
            database.execute(
                "INSERT INTO submissions (id, account, manifest, state, reason, badge, begun, received, bytes, results, indexed, drawn) "
                "VALUES (?, 'lab', ?, ?, '', '', 0, ?, 0, ?, 1, 1)",
                (f"{number:016x}", manifest, state, 1000 + number, digest),
            )
            database.executemany(
                "INSERT INTO episodes (submission, task, seed, episode, place, verdict, server, detail) "
                "VALUES (?, ?, ?, ?, 0, 'equal', '', '')",
                [(f"{number:016x}", row["task"], str(row["seed"]), str(row["episode"])) for row in results["episodes"]],
            )
    # The facts in the results are established when the store is opened.
    admin(scorer, folder, "accounts")


def main() -> None:
    programs, folder, results, count = Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4])
    scorer = programs / "scorer"
    if not folder.exists():
        fill(scorer, folder, json.loads(results.read_text()), count)
    served = subprocess.Popen(
        [scorer, "serve", "--folder", folder, "--http", ADDRESS],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert served.stdout is not None
    served.stdout.readline()

    def processor_s() -> float:
        fields = Path(f"/proc/{served.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / 100

    def ask(when: str) -> None:
        before = processor_s()
        with urllib.request.urlopen(f"http://{ADDRESS}/") as answer:
            size = len(answer.read())
        # Tables that are older than a second are made behind the answer.
        time.sleep(3)
        print(f"{when}: {processor_s() - before:.2f} s of processor time, {size} bytes")

    def set_last(state: str) -> None:
        with sqlite3.connect(folder / "leaderboard.sqlite", timeout=20) as database:
            database.execute("UPDATE submissions SET state = ? WHERE id = ?", (state, f"{count:016x}"))

    try:
        ask("first")
        ask("without a change")
        set_last("verified")
        ask("after a change")
    finally:
        set_last("uploading")
        served.terminate()
        served.wait()


if __name__ == "__main__":
    main()
