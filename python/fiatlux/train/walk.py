"""Training of the whole-body controller.

A run is a row of segments. At the end of each stands a checkpoint, and the worlds begin anew with random streams that follow
from the run's seed and the segment's number: a run that was interrupted goes on as if it had not been.
"""

import csv
import dataclasses
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage

from .._progress import Line, duration
from .evaluation import score
from .settings import SCENES, Settings, weights_of, worlds_of
from .start import begin_with
from .symmetry import MOVED, Mirror, SymmetricModel
from .worlds import Worlds

GROUPS = {"actor": ["policy"], "critic": ["critic"]}
VELOCITY = ("velocity", "slow_velocity")
"""The reward's terms of velocity, each of which is its weight at best."""
STOP_KL = 1.0
"""A policy that moves so far in one iteration has broken, but for the first ones, in which the normaliser has yet to settle."""
SETTLES = 5
START_RATE = 3e-5
"""Learning rate with which a policy that has learned already goes on, before it is adjusted."""
FIXED = ("hidden", "critic", "without")
"""Settings that a resumed run cannot change: its networks have these forms."""


class Stopped(RuntimeError):
    """The run cannot go on; the last checkpoint stands."""


def models(worlds: Worlds, settings: Settings) -> tuple[MLPModel, MLPModel]:
    """Policy and critic, new."""
    deviation = {"class_name": "GaussianDistribution", "init_std": 0.6, "std_type": "log", "std_range": (0.05, 1.0)}
    observation, mirrors = worlds.observation, worlds.mirrors
    is_symmetric = "symmetry" not in settings.without

    def model(group: str, part: str, outputs: int, mirror: Mirror, hidden: tuple[int, ...], **more: Any) -> MLPModel:
        kind = SymmetricModel if is_symmetric else MLPModel
        more |= {"inputs": mirrors[group], "outputs": mirror} if is_symmetric else {"obs_normalization": True}
        return kind(observation, GROUPS, part, outputs, hidden_dims=list(hidden), activation="elu", **more)

    actor = model("policy", "actor", worlds.num_actions, MOVED, settings.hidden, distribution_cfg=deviation)
    return actor, model("critic", "critic", 1, ([0], [1.0]), settings.critic)


def _number(seed: int, segment: int) -> int:
    """A seed for a segment, by Weyl's sequence."""
    return (seed * 1_000_003 + segment * 0x9E3779B1) % (1 << 48)


class Run:
    """A run in progress."""

    def __init__(self, out: Path, settings: Settings, device: str, threads: int | None) -> None:
        self.out, self.settings, self.device, self.threads = out, settings, device, threads
        self.segment = self.samples = 0
        self.seconds, self.difficulty = 0.0, settings.start_difficulty
        self.best = -math.inf
        torch.manual_seed(settings.seed)
        self.worlds = self._worlds()
        actor, critic = models(self.worlds, settings)
        storage = RolloutStorage(
            "rl", settings.worlds, settings.steps, self.worlds.observation, [self.worlds.num_actions], device
        )
        self.ppo = PPO(
            actor,
            critic,
            storage,
            num_learning_epochs=settings.epochs,
            num_mini_batches=settings.batches,
            desired_kl=settings.desired_kl,
            entropy_coef=settings.entropy,
            use_clipped_value_loss=False,
            device=device,
        )

    def _worlds(self) -> Worlds:
        seed = _number(self.settings.seed, self.segment)
        torch.manual_seed(seed)
        given = worlds_of(self.difficulty, self.settings.pushes) | SCENES[self.settings.scene]
        given["reward_weights"] = weights_of(self.settings.reward)
        return Worlds(
            self.settings.worlds, self.device, self.settings.without, num_threads=self.threads, seed=seed, **given
        )

    def calm(self) -> None:
        """Less exploration the longer a run lasts."""
        settings = self.settings
        done = min(max((self.samples - settings.calm_from) / settings.calm_over, 0.0), 1.0)
        self.ppo.entropy_coef = settings.entropy * (1 - done * 5 / 6)
        least = settings.least_std + done * (min(0.05, settings.least_std) - settings.least_std)
        self.ppo.actor.distribution.log_std_range[0] = math.log(least)

    def run_segment(self, goes_on: Callable[[int], bool]) -> dict[str, float]:
        """Takes a segment's iterations; what they came to. ``goes_on``, called with the number of those that are done, ends it
        early."""
        start = time.monotonic()
        ppo, settings, worlds = self.ppo, self.settings, self.worlds
        ppo.train_mode()
        if settings.start:
            ppo.actor.requires_grad_(self.segment > 0).train(self.segment > 0)
            ppo.learning_rate = START_RATE if self.segment == 1 else ppo.learning_rate
        self.calm()
        totals = {"reward": 0.0, "falls": 0.0, "timeouts": 0.0, "rollout_s": 0.0, "kl": 0.0, "value_loss": 0.0}
        terms = np.zeros(len(worlds.env.reward_terms))
        iterations = 0
        while iterations < settings.segment and (iterations == 0 or goes_on(iterations)):
            iterations += 1
            began = time.monotonic()
            with torch.inference_mode():
                for _ in range(settings.steps):
                    actions = ppo.act(worlds.observation)
                    reward, terminated, truncated, paid = worlds.step(actions)
                    ended = torch.from_numpy(terminated | truncated).to(self.device)
                    extras = {"time_outs": torch.from_numpy(truncated).to(self.device)}
                    ppo.process_env_step(worlds.observation, reward, ended, extras)
                    totals["reward"] += float(reward.mean())
                    totals["falls"] += float(terminated.mean())
                    totals["timeouts"] += float(truncated.mean())
                    terms = terms + paid.mean(axis=0)
                ppo.compute_returns(worlds.observation)
                totals["rollout_s"] += time.monotonic() - began
                before = self._opinion()
            losses = ppo.update()
            with torch.inference_mode():
                kl = float(ppo.actor.get_kl_divergence(before, self._opinion()).mean())
            totals["kl"] += kl
            totals["value_loss"] += losses["value"]
            self._check(losses, kl, may_jump=self.segment == 0 and iterations <= SETTLES)
        steps = iterations * settings.steps
        self.samples += steps * settings.worlds
        self.segment += 1
        taken = time.monotonic() - start
        self.seconds += taken
        falls = 1000 * totals["falls"] / steps
        row = {
            "segment": self.segment,
            "samples": self.samples,
            "minutes": self.seconds / 60,
            "steps_per_s": steps * settings.worlds / taken,
            "rollout_share": totals["rollout_s"] / taken,
            "difficulty": self.difficulty,
            "reward": totals["reward"] / steps / 0.02,
            "falls_per_1000_steps": falls,
            "kl": totals["kl"] / iterations,
            "learning_rate": ppo.learning_rate,
            "deviation": float(ppo.actor.distribution.std.mean()),
            "value_loss": totals["value_loss"] / iterations,
        }
        paid_terms = dict(zip(worlds.env.reward_terms, (terms / steps / 0.02).tolist()))
        row.update({f"reward/{name}": value for name, value in paid_terms.items()})
        # A robot that is made to bend and carry before it walks learns to step in place.
        could_pay = sum(worlds.env.reward_weights[name] for name in VELOCITY)
        if falls < settings.falls and sum(paid_terms[name] for name in VELOCITY) >= settings.tracks * could_pay:
            self.difficulty = min(self.difficulty + settings.harder, settings.most_difficult)
        return row

    def _opinion(self) -> tuple[torch.Tensor, ...]:
        """The policy's distribution in the worlds' present state."""
        self.ppo.actor(self.worlds.observation, stochastic_output=True)
        return tuple(part.clone() for part in self.ppo.actor.output_distribution_params)

    def _check(self, losses: Mapping[str, float], kl: float, may_jump: bool) -> None:
        broken = [name for name, loss in losses.items() if not math.isfinite(loss)]
        if broken or not math.isfinite(kl):
            raise Stopped(f"{', '.join(broken) or 'the policy'} is not finite")
        if kl > STOP_KL and not may_jump:
            raise Stopped(f"the policy moved by a KL of {kl:.2f} in one iteration")

    def begin_segment(self) -> None:
        """New worlds, as of the segment's number."""
        self.worlds = self._worlds()

    def save(self, file: Path) -> None:
        """Writes a checkpoint; a broken-off write leaves the last one whole."""
        state = {
            "settings": dataclasses.asdict(self.settings),
            "ppo": self.ppo.save(),
            "learning_rate": self.ppo.learning_rate,
            "progress": {name: getattr(self, name) for name in ("segment", "samples", "seconds", "difficulty", "best")},
        }
        part = file.with_suffix(".part")
        torch.save(state, part)
        os.replace(part, file)

    def load(self, state: Mapping[str, Any]) -> None:
        """Goes on from a checkpoint."""
        self.ppo.load(dict(state["ppo"]), None, True)
        self.ppo.learning_rate = state["learning_rate"]
        for name, value in state["progress"].items():
            setattr(self, name, value)


def load_checkpoint(file: Path) -> dict[str, Any]:
    """A checkpoint's state.

    Raises:
        ValueError: The file does not exist, or is not a checkpoint of this version.
    """
    last = file.with_name("last.pt")
    if not file.is_file() and file.name == "best.pt" and last.is_file():
        segments = settings_of(load_checkpoint(last), {}).evaluate
        raise ValueError(
            f"{file} does not exist: the first test comes after {segments} segments; name last.pt, or go on with --resume"
        )
    if not file.is_file():
        raise ValueError(
            f"{file} does not exist; train a controller with python -m fiatlux.train walk --out {file.parent}"
        )
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
        settings_of(state, {})
        if not {"ppo", "progress", "learning_rate"} <= state.keys():
            raise KeyError("ppo")
    except Exception as error:  # PyTorch's reader fails in a dozen ways on what is not its own.
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"{file} is not a checkpoint of this version's training: {reason}") from error
    return state


def settings_of(state: Mapping[str, Any], given: Mapping[str, Any]) -> Settings:
    """A checkpoint's settings, but for those that are given."""
    kept = {name: tuple(value) if isinstance(value, list) else value for name, value in state["settings"].items()}
    for name in FIXED:
        if given.get(name, kept[name]) != kept[name]:
            raise ValueError(
                f"{name} is {given[name]}, but the checkpoint's is {kept[name]}; leave it out or begin a new run"
            )
    return Settings(**{**kept, **given})


def device_of(name: str) -> str:
    """The name of a PyTorch device, if there is one."""
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        why = without_cuda() if name.startswith("cuda") else "give cpu, or cuda where there is a GPU"
        raise ValueError(f"device: PyTorch has no {name!r} here; {why}") from error
    return name


def without_cuda() -> str:
    """Why PyTorch trains on the processor, and how it gets a GPU."""
    if torch.version.cuda is None:
        return (
            f"PyTorch {torch.__version__} is built without CUDA, so the networks train on the processor; for an NVIDIA GPU install "
            "a build with CUDA into this environment (docs/training.md)"
        )
    return (
        f"PyTorch {torch.__version__} finds no GPU that it can use with CUDA {torch.version.cuda}, so the networks train on the "
        "processor; where there is one, nvidia-smi shows whether its driver works (docs/training.md)"
    )


class _Interrupt:
    """Ctrl-C: once, to end after the present iteration; twice, at once."""

    def __init__(self) -> None:
        self.is_set = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def _note(self, number: int, frame: Any) -> None:
        if self.is_set:
            raise KeyboardInterrupt
        self.is_set = True
        print("\nstops after this iteration, with a checkpoint; once more to stop at once", file=sys.stderr, flush=True)


def _given(settings: Settings) -> str:
    """The settings that differ from the defaults, as flags."""
    differ = [
        (field.name.replace("_", "-"), value)
        for field in dataclasses.fields(settings)
        if (value := getattr(settings, field.name)) != field.default
    ]
    flags = [
        f"--{name} {' '.join(map(str, value if isinstance(value, tuple) else (value,)))}" for name, value in differ
    ]
    return " ".join(flags) + ", others by default" if flags else "all by default"


def _writer(out: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(out))


def train(
    out: Path, given: Mapping[str, Any], resume: bool, minutes: float | None, device: str | None, threads: int | None
) -> int:
    """Trains until the samples or the minutes are over; the exit code."""
    began = time.monotonic()
    if device is None and not torch.cuda.is_available():
        print(without_cuda(), file=sys.stderr, flush=True)
    device = device_of(device or ("cuda" if torch.cuda.is_available() else "cpu"))
    last, best, curve = out / "last.pt", out / "best.pt", out / "curve.csv"
    if resume and not last.exists():
        raise ValueError(f"{last} does not exist, so there is nothing to go on with; begin without --resume")
    if resume:
        state = load_checkpoint(last)
        run = Run(out, settings_of(state, given), device, threads)
        run.load(state)
        if "start_difficulty" in given:
            run.difficulty = run.settings.start_difficulty
        if "widen" in given:
            run.ppo.actor.distribution.log_std_param.data += math.log(run.settings.widen)
    elif last.exists():
        raise ValueError(f"{last} exists; go on with --resume or name another --out")
    else:
        run = Run(out, Settings(**given), device, threads)
        if run.settings.start:
            begin_with(run, Path(run.settings.start))
        out.mkdir(parents=True, exist_ok=True)
    settings = run.settings
    if run.samples >= settings.samples:
        print(f"the run has its {run.samples} samples already; give more --samples to go on")
        return 0
    writer = _writer(out)
    interrupt = _Interrupt()
    resumed_at = run.samples
    setting_up = time.monotonic() - began
    print(
        f"settings: {_given(settings)}; device {device}, {run.worlds.env.num_threads} threads; set up in {setting_up:.1f} s"
    )
    steps = settings.segment * settings.steps * settings.worlds
    print(f"a line follows after each segment of {steps:,} steps; walk --help explains it", flush=True)
    stopped, line = None, Line()
    while run.samples < settings.samples:
        begin = time.monotonic()
        run.begin_segment()
        made = time.monotonic() - begin

        def goes_on(done: int, begin: float = begin) -> bool:
            rate = done * settings.steps * settings.worlds / (time.monotonic() - begin)
            line.show(f"  segment {run.segment + 1}: iteration {done} of {settings.segment}, {rate:.0f} steps/s")
            return not interrupt.is_set

        try:
            row = run.run_segment(goes_on)
        except Stopped as error:
            print(f"stopped: {error}", flush=True)
            remedy = "go on from the last checkpoint with --resume and a smaller --desired-kl"
            if not last.exists():
                remedy = "no checkpoint has been written yet: begin anew with more --worlds or larger networks"
            print(remedy, flush=True)
            return 1
        line.show("")
        if run.segment % settings.evaluate == 0 and not interrupt.is_set:
            row |= {
                f"test/{name}": value for name, value in score(run.ppo.actor, device, threads, settings.without).items()
            }
            if row["test/score"] > run.best:
                run.best = row["test/score"]
                run.save(best)
        run.save(last)
        _record(curve, writer, row)
        elapsed = time.monotonic() - began
        # Of this call: an earlier piece of the run may have had another machine.
        rate = (run.samples - resumed_at) / elapsed
        left = f"{duration((settings.samples - run.samples) / rate)} left to {settings.samples / 1e6:g} M samples"
        if minutes is not None:
            left = f"{duration(60 * minutes - elapsed)} left"
        tested = " ".join(f"{name[5:]} {value:.3f}" for name, value in row.items() if name.startswith("test/"))
        print(
            f"{row['samples'] / 1e6:7.2f} M  {row['steps_per_s']:7.0f}/s (worlds {made:.1f} s, rollout {row['rollout_share']:.2f})  "
            f"difficulty {row['difficulty']:.2f}  reward {row['reward']:6.3f}  falls {row['falls_per_1000_steps']:6.2f}  "
            f"kl {row['kl']:.4f}  lr {row['learning_rate']:.1e}  std {row['deviation']:.3f}  {left}  {tested}",
            flush=True,
        )
        if interrupt.is_set:
            print(f"stopped; {last} is written, and --resume goes on from there", flush=True)
            return 3
        ends = elapsed + (time.monotonic() - begin)
        if minutes is not None and ends > 60 * minutes and run.samples < settings.samples:
            stopped = (
                f"the next segment would end after {ends / 60:.1f} min; {last} has {run.samples / 1e6:.2f} M samples"
            )
            break
    print(
        "reward a second, by term: "
        + " ".join(f"{name[7:]} {value:.3f}" for name, value in row.items() if name.startswith("reward/")),
        flush=True,
    )
    if stopped is not None:
        print(f"stopped: {stopped}; go on with --resume", flush=True)
    return 0


def _record(curve: Path, writer: Any, row: Mapping[str, float]) -> None:
    is_new = not curve.exists()
    fields = [name for name in row if not name.startswith("test/")]
    tests = ["survived", "velocity", "turning", "height", "torso", "score"]
    fields += [f"test/{name}" for name in tests]
    with curve.open("a", newline="") as file:
        table = csv.DictWriter(file, fields, extrasaction="ignore")
        if is_new:
            table.writeheader()
        table.writerow({name: f"{value:.6g}" for name, value in row.items()})
    if writer is not None:
        for name, value in row.items():
            writer.add_scalar(name, value, int(row["samples"]))
        writer.flush()
