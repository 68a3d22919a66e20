#!/usr/bin/env python3
"""Draws the pictures of README and the book with the programs of this checkout.

    python3 deploy/pictures.py [PART...] [--programs DIR]

Parts are clip (the whole errand, at the head of README), tasks (the start of each task), strips (what a skill does), terminal, board,
replay and teleop; all of them where none is named. DIR has the programs, built with `cargo build --release --workspace --bins
--features network` [default: target/release]. Needs Python with Pillow, and for the clip this package, whose wheel `python/wheel.sh`
makes; board, replay and teleop need Node 20 with npm, and chromium. The clip takes about ten minutes of one core, the others a few.

docs/pictures/figures.toml says which figures the pictures of scores show; `.ci/figures.py` compares it with docs/figures.toml.
"""

import argparse
import hashlib
import html
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs/pictures"
TASKS = [*(f"S{number:02}" for number in range(1, 13)), "replace", "climb"]
#: Strips: name, task, room, columns, size of a picture, parts that the time is cut into, and the ones of which the end is shown.
STRIPS = [
    ("ladder_s01", "S01", 1000, 3, (420, 340), 20, (0, 7, 10, 13, 16, 20)),
    ("hands_s03", "S03", 1000, 3, (400, 340), 20, (0, 7, 10, 13, 16, 20)),
    ("hands_s06", "S06", 1000, 3, (400, 340), 20, (0, 6, 9, 12, 16, 20)),
    ("hands_s08", "S08", 1000, 3, (400, 340), 20, (0, 7, 11, 14, 17, 20)),
    ("hands_s11", "S11", 1000, 3, (400, 340), 20, (0, 7, 10, 13, 16, 20)),
    ("climb_s04", "S04", 1000, 8, (200, 260), 7, tuple(range(8))),
    ("climb_s10", "S10", 1000, 8, (200, 260), 7, tuple(range(8))),
    ("climb_s12", "S12", 1000, 8, (200, 260), 7, tuple(range(8))),
]
#: The room of the clip, which is one for training, its size, pictures a second, and the time for which the last one stays, s.
CLIP_ROOM, CLIP_SIZE, CLIP_RATE, CLIP_STAYS = 1000, (960, 540), 10, 2.5
#: Largest file that README may ask its readers to load, bytes.
MAX_CLIP = 3_000_000
#: Parts of the clip: subtask, caption, phases of the expert with which it begins, and its length in the clip, s.
CLIP = [
    ("S01", "carries the ladder under the lamp", "Enter", 2.8),
    ("S02", "climbs", "Walk", 2.0),
    ("S03", "takes the spent bulb out", "Clear Lean", 2.8),
    ("S04", "climbs down with it", "Stand Climb", 1.6),
    ("S05", "carries it to the crate", "Walk", 1.4),
    ("S06", "lays it in", "StepUp Settle Above", 2.0),
    ("S07", "walks to the bench", "Walk", 1.2),
    ("S08", "takes the fresh bulb", "StepBack Raise StepUp", 2.2),
    ("S09", "carries it to the ladder", "Walk", 1.6),
    ("S10", "climbs", "Climb", 1.8),
    ("S11", "puts it in: the lamp is lit", "Clear Lean", 3.2),
    ("S12", "climbs down", "Stand Climb", 2.0),
]
#: Commands of the picture of a terminal, and how many lines of each answer it shows.
TERMINAL = [
    ("fiatlux evaluate --policy expert --tasks S05,S08 --seeds 0..1", 6),
    ("fiatlux render results/expert/bags/S08-s0-e0.mcap -o still.png", 1),
    ("fiatlux tasks", 5),
]
#: Lines of progress, which a terminal writes over.
PROGRESS = re.compile(r"\d+/\d+ episodes|\d+ of \d+ bags|replay \d+ of|frame \d+/|\d+ frames? in ")


class Drawer:
    def __init__(self, programs: Path, work: Path) -> None:
        self.programs, self.work = programs, work

    def run(self, program: str, *args: object) -> None:
        command = [str(self.programs / program), *map(str, args)]
        ended = subprocess.run(command, check=False, capture_output=True, text=True, cwd=self.work)
        if ended.returncode:
            raise SystemExit(f"{' '.join(command)}\n{ended.stderr}")

    def bag(self, policy: str, task: str, room: int, *more: object, needs_success: bool = True) -> tuple[Path, dict]:
        """A recorded episode, and its row of the results."""
        out = self.work / f"{policy}-{task}-{room}"
        if not out.exists():
            args = ["--policy", policy, "--tasks", task, "--seeds", room, "--out", out, *more]
            subprocess.run([self.programs / "fiatlux", "evaluate", *map(str, args)], capture_output=True, check=False)
        [row] = json.loads((out / "results.json").read_text())["episodes"]
        if needs_success and not row["strict_success"]:
            raise SystemExit(f"{policy} fails {task} in room {room} ({row['strict_end']}): name another room")
        return out / row["bag"], row

    def still(self, bag: Path, at_s: float, view: str, size: tuple[int, int]) -> Path:
        out = self.work / f"still-{bag.stem}-{at_s:.2f}-{size[0]}.png"
        self.run("fiatlux", "render", bag, "--at", f"{at_s:.2f}", "--view", view, "--size", "{}x{}".format(*size), "-o", out, "--force")
        return out

    def frames(self, bag: Path, view: str, size: tuple[int, int], steps: tuple[int, int], count: int, rate: int) -> list[Path]:
        """About `count` pictures from one step of an episode to another, by the camera of a clip with `rate` of them a second."""
        first, last = steps
        out = self.work / f"frames-{bag.stem}-{view}-{first}-{size[0]}".replace(":", "-")
        # A frame is a row, and steps between frames are whole.
        between = max(round((last - first) / (count - 1)), 1)
        shown = ["--view", view, "--size", "{}x{}".format(*size), "--samples", 2, "--fps", rate, "--speed", between * rate / 50]
        if not out.exists():
            part = out.with_name(f"begun-{out.name}")
            self.run("fiatlux", "render", bag, *shown, "--from", f"{first / 50:.2f}", "--to", f"{last / 50:.2f}", "-o", part, "--force")
            part.rename(out)
        return sorted(out.glob("*.png"))

    def clip(self) -> None:
        import fiatlux
        from PIL import Image

        bag, row = self.bag("expert", "replace", CLIP_ROOM)
        names, _ = fiatlux.Bag(bag).phases()
        ends = [*begins(names), row["strict_steps"]]
        pictures, lengths = [], []
        for (task, said, _, length), first, last in zip(CLIP, ends, ends[1:]):
            drawn = self.frames(bag, f"follow:{task}", CLIP_SIZE, (first, last), round(length * CLIP_RATE), CLIP_RATE)
            speed = f"{(last - first) / 50 / (len(drawn) / CLIP_RATE):.0f}x"
            pictures += [captioned(Image.open(path).convert("RGB"), task, said, speed) for path in drawn]
            lengths += [round(1000 / CLIP_RATE)] * len(drawn)
        lengths[-1] = round(1000 * CLIP_STAYS)
        out = PICTURES / "errand.webp"
        for quality in (75, 65, 55, 45, 35):
            pictures[0].save(out, save_all=True, append_images=pictures[1:], duration=lengths, loop=0, quality=quality, method=4)
            if out.stat().st_size <= MAX_CLIP:
                break
        else:
            raise SystemExit(f"{out} has {out.stat().st_size} bytes, {MAX_CLIP} are allowed: show less")
        wrote(out)

    def tasks(self) -> None:
        from PIL import Image

        for task in TASKS:
            # The start is all that is drawn: a robot that does nothing is the quickest to play.
            bag, _ = self.bag("zero", task, 0, needs_success=False)
            # Where robot and goal are far apart.
            view = "room" if task in ("S01", "S07", "replace") else "follow"
            picture = Image.open(self.still(bag, 0.0, view, (640, 480))).convert("RGB")
            picture.save(wrote(PICTURES / f"tasks/{task}.jpg"), quality=85, optimize=True)

    def strips(self) -> None:
        from PIL import Image

        for name, task, room, columns, size, parts, shown in STRIPS:
            bag, row = self.bag("expert", task, room)
            width, height = size
            # As slow as this the camera keeps up with the robot.
            drawn = self.frames(bag, "follow", size, (0, row["strict_steps"]), parts + 1, 1)
            sheet = Image.new("RGB", (columns * width, len(shown) // columns * height))
            for number, part in enumerate(shown):
                sheet.paste(Image.open(drawn[min(part, len(drawn) - 1)]).convert("RGB"), (number % columns * width, number // columns * height))
            sheet.save(wrote(PICTURES / f"{name}.webp"), quality=80, method=6)

    def terminal(self) -> None:
        """A session in a terminal, as SVG: text with its colours."""
        path = f"{self.programs}:{os.environ['PATH']}"
        lines: list[list[tuple[str, str]]] = []
        for command, shown in TERMINAL:
            lines.append([("prompt", "$ "), ("", command)])
            given = f"stty cols 80; {command}"
            told = subprocess.run(
                ["script", "-qec", given, "/dev/null"],
                cwd=self.work,
                capture_output=True,
                text=True,
                env={**os.environ, "PATH": path, "TERM": "xterm-256color"},
                check=True,
            )
            answer = [styled(line) for line in told.stdout.replace("\r\n", "\n").rstrip("\n").split("\n")]
            said = [parts for parts in answer if not PROGRESS.match("".join(text for _, text in parts))]
            while not said[0]:
                said.pop(0)
            lines += [*said[:shown], []]
        wrote(PICTURES / "terminal.svg").write_text(svg(lines))

    def board(self) -> None:
        out, port = self.work / "board", 43180
        programs = {name.upper().replace("-", "_"): str(self.programs / name) for name in ("fiatlux", "sim-server", "scorer", "policy-client")}
        command = [ROOT / "deploy/leaderboard/make.sh", "--out", out, "--policies", "zero,random,stand,expert", "--hosted", "see,carry", "--http", f"127.0.0.1:{port}"]
        with running(command, out=self.work / "board.said", until="shows them", env={**os.environ, **programs}):
            address = f"http://127.0.0.1:{port}"
            # Stills and clips come after the badges.
            for _ in range(600):
                page = urllib.request.urlopen(address).read().decode()
                if "no picture yet" not in page:
                    break
                time.sleep(2)
            self.shot(address + "/", PICTURES / "leaderboard.png", "desktop")
        # The gallery has the best of each subtask, and the table is below the picture.
        results = json.loads((out / "runs/expert/results.json").read_text())
        note("leaderboard.png", "board", results["conditions"]["benchmark_version"], {"expert_first_rooms": of(results)})

    def replay(self) -> None:
        from PIL import Image

        bag, _ = self.bag("expert", "S05", 1000, "--record", "camera@5")
        with running([self.programs / "fiatlux", "view", bag, "--no-open"], out=self.work / "view.said", until="http") as said:
            address = re.search(r"http\S+", said.read_text())[0]
            for name, kind in (("replay", "desktop"), ("replay_telephone", "telephone-dark")):
                self.shot(address, self.work / f"{name}.png", kind, 0.5)
                Image.open(self.work / f"{name}.png").convert("RGB").save(wrote(PICTURES / f"{name}.jpg"), quality=85, optimize=True)

    def shot(self, address: str, out: Path, kind: str, *share: float) -> None:
        """A picture of a page, by the browser of the tests."""
        place = self.work / "browser"
        if not place.exists():
            shutil.copytree(ROOT / "tests/browser", place, ignore=shutil.ignore_patterns("node_modules"))
            subprocess.run(["npm", "ci", "--prefix", place, "--no-audit", "--no-fund", "--silent"], check=True)
        subprocess.run(["node", place / "shot.mjs", address, wrote(out), kind, *map(str, share)], check=True)

    def teleop(self) -> None:
        """Those that the tests of the page take anyway."""
        from PIL import Image

        shots = self.work / "shots"
        programs = {name.upper().replace("-", "_"): str(self.programs / name) for name in ("fiatlux", "sim-server", "scorer", "policy-client")}
        subprocess.run([ROOT / "tests/browser/run.sh", shots], check=True, env={**os.environ, **programs, "ONLY": "teleop", "EYES": "1000x500"})
        for name, shot in (("teleop", "first"), ("teleop_telephone", "thumbs"), ("teleop_eyes", "eyes"), ("teleop_hands", "hands")):
            taken = Image.open(shots / f"teleop-{shot}.png").convert("RGB")
            # A telephone has more pixels than its page.
            if taken.height > taken.width:
                taken = taken.resize((390, round(390 * taken.height / taken.width)), Image.Resampling.LANCZOS)
            taken.save(wrote(PICTURES / f"{name}.jpg"), quality=85, optimize=True)


PARTS = ("clip", "tasks", "strips", "terminal", "board", "replay", "teleop")


def wrote(path: Path) -> Path:
    """The path, which is said."""
    print(path.relative_to(ROOT) if path.is_relative_to(ROOT) else path.name, flush=True)
    return path


def begins(names: list[str]) -> list[int]:
    """The steps in which the clip's parts begin, of an errand that tries no part twice."""
    at, found = 0, []
    for task, _, first, _ in CLIP:
        at = next((step for step in range(at, len(names)) if names[step] in first.split()), -1)
        if at < 0:
            raise SystemExit(f"room {CLIP_ROOM} has no {task} as the clip expects it: name another room")
        found.append(at)
    return found


def captioned(picture, task: str, said: str, speed: str):
    """A picture with a bar below that says what is done, and how fast it is shown."""
    from PIL import Image, ImageDraw, ImageFont

    width, height = picture.size
    bar = Image.new("RGB", (width, 42), "#16181d")
    picture.paste(Image.blend(picture.crop((0, height - 42, width, height)), bar, 0.75), (0, height - 42))
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(22)
    draw.text((18, height - 21), task, fill="#ffd479", font=font, anchor="lm")
    draw.text((78, height - 21), said, fill="#f2f2f2", font=font, anchor="lm")
    draw.text((width - 18, height - 21), speed, fill="#c9ccd1", font=font, anchor="rm")
    return picture


def of(results: dict) -> str:
    """Strict successes of a run's episodes."""
    rows = results["episodes"]
    return f"{sum(row['strict_success'] for row in rows)} of {len(rows)}"


def note(name: str, part: str, version: int, figures: dict[str, str]) -> None:
    """Says in docs/pictures/figures.toml what a picture shows."""
    path = PICTURES / "figures.toml"
    head, *entries = path.read_text().split("\n[")
    kept = [entry for entry in entries if not entry.startswith(f'"{name}"]')]
    digest = hashlib.sha256((PICTURES / name).read_bytes()).hexdigest()
    lines = [f'"{name}"]', f'part = "{part}"', f"version = {version}", f'sha256 = "{digest}"']
    lines += [f'figures.{figure} = "{said}"' for figure, said in sorted(figures.items())]
    path.write_text("\n[".join([head, *sorted([*(entry.rstrip("\n") + "\n" for entry in kept), "\n".join(lines) + "\n"])]))


@contextmanager
def running(command: list, *, out: Path, until: str, env: dict | None = None):
    """A program that goes on until the end, once it has said something."""
    with out.open("w") as said:
        process = subprocess.Popen(list(map(str, command)), stdout=said, stderr=said, env=env, start_new_session=True)
    try:
        while until not in out.read_text():
            if process.poll() is not None:
                raise SystemExit(f"{command[0]} has ended:\n{out.read_text()}")
            time.sleep(0.3)
        yield out
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()


COLOURS = {"31": "#ff7b72", "32": "#56d364", "33": "#e3b341", "34": "#79c0ff", "35": "#d2a8ff", "36": "#56d4dd", "90": "#8b949e", "2": "#8b949e"}


def styled(line: str) -> list[tuple[str, str]]:
    """A line as a terminal shows it, in parts with a style each."""
    # What was written over does not count.
    line = re.sub(r"\x1b\[[0-9;?]*[A-LN-Za-ln-z]", "", line.split("\r")[-1])
    parts, style = [], ""
    for piece in re.split(r"(\x1b\[[0-9;]*m)", line):
        if piece.startswith("\x1b["):
            for code in piece[2:-1].split(";"):
                style = "" if code in ("", "0", "39", "22") else style + " bold" if code == "1" else f"{style} c{code}"
        elif piece:
            parts.append((style.strip(), piece))
    return parts


def svg(lines: list[list[tuple[str, str]]]) -> str:
    """Lines of text in a dark window; the picture's alternative text is in the page."""
    line, letter, edge = 19, 8.43, 16
    width, height = 80 * letter + 2 * edge, len(lines) * line + 2 * edge
    rows = []
    for number, parts in enumerate(lines):
        spans = "".join(f'<tspan class="{style}">{html.escape(text)}</tspan>' if style else html.escape(text) for style, text in parts)
        if spans:
            rows.append(f'<text x="{edge}" y="{edge + (number + 0.75) * line:.0f}">{spans}</text>')
    colours = "".join(f".c{code}{{fill:{colour}}}" for code, colour in COLOURS.items())
    style = f"text{{font:14px 'DejaVu Sans Mono',monospace;white-space:pre;fill:#e6edf3}}.bold{{font-weight:bold}}.prompt{{fill:#8b949e}}{colours}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height}" width="{width:.0f}" height="{height}">'
        f'<style>{style}</style><rect width="100%" height="100%" rx="8" fill="#161b22"/>\n' + "\n".join(rows) + "\n</svg>\n"
    )


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("parts", nargs="*", metavar="PART")
    arguments.add_argument("--programs", type=Path, default=ROOT / "target/release")
    given = arguments.parse_args()
    for part in given.parts:
        if part not in PARTS:
            arguments.error(f"unknown part '{part}'; known ones are {', '.join(PARTS)}")
    with tempfile.TemporaryDirectory() as work:
        drawer = Drawer(given.programs.resolve(), Path(os.environ.get("FIATLUX_WORK", work)))
        for part in given.parts or PARTS:
            getattr(drawer, part)()


if __name__ == "__main__":
    main()
