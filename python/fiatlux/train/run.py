"""A run of PPO: segments, checkpoints and the curve, whatever is trained.

A run is a row of segments. At the end of each stands a checkpoint, and random streams begin anew as of the run's seed and the
segment's number: a run that was interrupted goes on as if it had not been.
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
from typing import Any, ClassVar

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage

from .._progress import Line, duration
from .settings import KINDS, Settings
from .worlds import Worlds

GROUPS = {"actor": ["policy"], "critic": ["critic"]}
CONTROL_DT = 0.02
"""Time of a control step, s."""
LEARNING_RATES = (1e-5, 1e-2)
"""Least and greatest learning rate, as of RSL-RL."""


class Stopped(RuntimeError):
    """The run cannot go on; the last checkpoint stands."""


class Run:
    """A run in progress. What is trained is a subclass."""

    kind: ClassVar[str]
    """Its command, which the checkpoints name."""
    tests: ClassVar[tuple[str, ...]]
    """Columns of a test in the curve."""
    progress: ClassVar[tuple[str, ...]] = ("segment", "samples", "seconds", "best")
    """Content of a checkpoint besides networks and settings."""

    def __init__(self, out: Path, settings: Any, device: str, threads: int | None) -> None:
        self.out, self.settings, self.device, self.threads = out, settings, device, threads
        self.segment = self.samples = 0
        self.seconds, self.best = 0.0, -math.inf
        self.prepare()
        torch.manual_seed(settings.seed)
        self.worlds = self.make_worlds(self.seed_noise())
        actor, critic = self.models()
        observation, actions = self.worlds.observation, [self.worlds.num_actions]
        storage = RolloutStorage("rl", settings.worlds, settings.steps, observation, actions, device)
        self.ppo = PPO(actor, critic, storage, device=device, **self.algorithm())

    def prepare(self) -> None:
        """Sets what a subclass keeps, before there are worlds."""

    def begin_new(self) -> None:
        """Is called once, before the first segment of a new run."""

    def resume_with(self, given: Mapping[str, Any]) -> None:
        """Is called once where a run goes on, with the settings that are given anew."""

    def make_worlds(self, seed: int) -> Worlds:
        """Worlds for a segment."""
        raise NotImplementedError

    def models(self) -> tuple[MLPModel, MLPModel]:
        """Policy and critic, new."""
        raise NotImplementedError

    def algorithm(self) -> dict[str, Any]:
        """Arguments of PPO."""
        settings = self.settings
        return {
            "num_learning_epochs": settings.epochs,
            "num_mini_batches": settings.batches,
            "desired_kl": settings.desired_kl,
            "entropy_coef": settings.entropy,
            "use_clipped_value_loss": False,
        }

    def test(self) -> dict[str, float]:
        """A short test of the mean policy, which has a ``score``: higher is better."""
        raise NotImplementedError

    def begin_iterations(self) -> None:
        """Is called before the iterations of a segment."""

    def end_iterations(self, row: dict[str, float], paid: Mapping[str, float]) -> None:
        """Is called after them, with the segment's row for the curve and what each term paid a second."""

    def described(self, row: Mapping[str, float]) -> str:
        """Own part of the line of a segment."""
        return ""

    def check_update(self, kl: float, iteration: int) -> None:
        """Raises `Stopped` if the policy moved too far."""

    def look(self, steps: int) -> None:
        """Finds the scales of the observation with actions of the new policy."""
        with torch.inference_mode():
            for _ in range(steps):
                for model in (self.ppo.actor, self.ppo.critic):
                    model.update_normalization(self.worlds.observation)
                self.worlds.step(self.ppo.actor(self.worlds.observation, stochastic_output=True))

    def adapt(self, kl: float) -> None:
        """Is called after each iteration with the size of its update."""

    def adapt_once(self, kl: float) -> None:
        """Adjusts the learning rate to the size of an iteration's whole update.

        RSL-RL adjusts it after each of the minibatches, to the distance from the policy that collected the samples. That begins at zero in each
        iteration and grows over all its passes: with eight passes the rate would rise in the first ones and fall to its least in the
        others, whatever the rate.
        """
        wanted = self.settings.desired_kl
        factor = 1 / 1.5 if kl > 2.0 * wanted else 1.5 if kl < 0.5 * wanted else 1.0
        self.ppo.learning_rate = min(max(self.ppo.learning_rate * factor, LEARNING_RATES[0]), LEARNING_RATES[1])
        for group in self.ppo.optimizer.param_groups:
            group["lr"] = self.ppo.learning_rate

    def seed_noise(self) -> int:
        """Begins the random stream of a segment; its seed."""
        seed: int = (self.settings.seed * 1_000_003 + self.segment * 0x9E3779B1) % (1 << 48)  # Weyl's sequence.
        torch.manual_seed(seed)
        return seed

    def begin_segment(self) -> None:
        """New random streams, as of the segment's number."""
        self.worlds = self.make_worlds(self.seed_noise())

    def run_segment(self, goes_on: Callable[[int], bool]) -> dict[str, float]:
        """Takes a segment's iterations; what they came to. ``goes_on``, called with the number of those that are done, ends it
        early."""
        start = time.monotonic()
        ppo, settings, worlds = self.ppo, self.settings, self.worlds
        ppo.train_mode()
        self.begin_iterations()
        totals = dict.fromkeys(("reward", "falls", "timeouts", "successes", "rollout_s", "kl", "value_loss"), 0.0)
        terms = np.zeros(len(worlds.reward_terms))
        iterations = 0
        while iterations < settings.segment and (iterations == 0 or goes_on(iterations)):
            iterations += 1
            began = time.monotonic()
            with torch.inference_mode():
                for _ in range(settings.steps):
                    actions = ppo.act(worlds.observation)
                    reward, terminated, truncated, info = worlds.step(actions)
                    ended = torch.from_numpy(terminated | truncated).to(self.device)
                    extras = {"time_outs": torch.from_numpy(truncated).to(self.device)}
                    ppo.process_env_step(worlds.observation, reward, ended, extras)
                    totals["reward"] += float(reward.mean())
                    totals["falls"] += float((terminated & ~info["success"]).mean())
                    totals["timeouts"] += float(truncated.mean())
                    totals["successes"] += float(info["success"].mean())
                    terms = terms + info["reward_terms"].mean(axis=0)
                ppo.compute_returns(worlds.observation)
                totals["rollout_s"] += time.monotonic() - began
                before = self._opinion()
            losses = ppo.update()
            with torch.inference_mode():
                kl = float(ppo.actor.get_kl_divergence(before, self._opinion()).mean())
            totals["kl"] += kl
            totals["value_loss"] += losses["value"]
            broken = [name for name, loss in losses.items() if not math.isfinite(loss)]
            if broken or not math.isfinite(kl):
                raise Stopped(f"{', '.join(broken) or 'the policy'} is not finite")
            self.check_update(kl, iterations)
            self.adapt(kl)
        steps = iterations * settings.steps
        self.samples += steps * settings.worlds
        self.segment += 1
        taken = time.monotonic() - start
        self.seconds += taken
        row = {
            "segment": self.segment,
            "samples": self.samples,
            "minutes": self.seconds / 60,
            "steps_per_s": steps * settings.worlds / taken,
            "rollout_share": totals["rollout_s"] / taken,
            "reward": totals["reward"] / steps / CONTROL_DT,
            "falls_per_1000_steps": 1000 * totals["falls"] / steps,
            "timeouts_per_1000_steps": 1000 * totals["timeouts"] / steps,
            "successes_per_1000_steps": 1000 * totals["successes"] / steps,
            "kl": totals["kl"] / iterations,
            "learning_rate": ppo.learning_rate,
            "deviation": float(ppo.actor.distribution.std.mean()),
            "value_loss": totals["value_loss"] / iterations,
        }
        paid = dict(zip(worlds.reward_terms, (terms / steps / CONTROL_DT).tolist()))
        self.end_iterations(row, paid)
        row.update({f"reward/{name}": value for name, value in paid.items()})
        return row

    def _opinion(self) -> tuple[torch.Tensor, ...]:
        """The policy's distribution in the worlds' present state."""
        self.ppo.actor(self.worlds.observation, stochastic_output=True)
        return tuple(part.clone() for part in self.ppo.actor.output_distribution_params)

    def state(self) -> dict[str, Any]:
        """Content of a checkpoint."""
        return {
            "kind": self.kind,
            "settings": dataclasses.asdict(self.settings),
            "ppo": self.ppo.save(),
            "learning_rate": self.ppo.learning_rate,
            "progress": {name: getattr(self, name) for name in self.progress},
        }

    def save(self, file: Path) -> None:
        """Writes a checkpoint; a broken-off write leaves the last one whole."""
        part = file.with_suffix(".part")
        torch.save(self.state(), part)
        os.replace(part, file)

    def load(self, state: Mapping[str, Any]) -> None:
        """Goes on from a checkpoint."""
        self.ppo.load(dict(state["ppo"]), None, True)
        self.ppo.learning_rate = state["learning_rate"]
        for name, value in state["progress"].items():
            setattr(self, name, value)


def load_checkpoint(file: Path, kind: str | None = None) -> dict[str, Any]:
    """A checkpoint's state.

    Raises:
        ValueError: The file does not exist, is not a checkpoint of this version, or is of a run of another kind.
    """
    last = file.with_name("last.pt")
    if not file.is_file() and file.name == "best.pt" and last.is_file():
        segments = settings_of(load_checkpoint(last), {}).evaluate
        raise ValueError(
            f"{file} does not exist: the first test comes after {segments} segments; name last.pt, or go on with --resume"
        )
    if not file.is_file():
        raise ValueError(
            f"{file} does not exist; train with python -m fiatlux.train {kind or 'walk'} --out {file.parent}"
        )
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
        settings_of(state, {})
        if not {"ppo", "progress", "learning_rate"} <= state.keys():
            raise KeyError("ppo")
        if "obs_normalizer._mean" not in state["ppo"]["actor_state_dict"]:
            raise KeyError("its policy does not normalise observations; begin a new run")
    except Exception as error:  # PyTorch's reader fails in a dozen ways on what is not its own.
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"{file} is not a checkpoint of this version's training: {reason}") from error
    if kind not in (None, kind_of(state)):
        raise ValueError(f"{file} is of a run of {kind_of(state)}; this needs one of {kind}")
    return state


def kind_of(state: Mapping[str, Any]) -> str:
    """Which command trained it; the first ones did not say."""
    return state.get("kind", "walk")


def settings_of(state: Mapping[str, Any], given: Mapping[str, Any]) -> Any:
    """A checkpoint's settings, but for those that are given."""
    kind = KINDS[kind_of(state)]
    kept = {name: tuple(value) if isinstance(value, list) else value for name, value in state["settings"].items()}
    for name in kind.FIXED:
        if given.get(name, kept[name]) != kept[name]:
            raise ValueError(
                f"{name} is {given[name]}, but the checkpoint's is {kept[name]}; leave it out or begin a new run"
            )
    return kind(**{**kept, **given})


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


def _begun(kind: type[Run], out: Path, given: Mapping[str, Any], resume: bool, device: str, threads: int | None) -> Run:
    """A new run, or one that goes on."""
    last = out / "last.pt"
    if resume and not last.exists():
        raise ValueError(f"{last} does not exist, so there is nothing to go on with; begin without --resume")
    if last.exists() and not resume:
        raise ValueError(f"{last} exists; go on with --resume or name another --out")
    if resume:
        state = load_checkpoint(last, kind.kind)
        run = kind(out, settings_of(state, given), device, threads)
        run.load(state)
        run.resume_with(given)
        return run
    run = kind(out, KINDS[kind.kind](**given), device, threads)
    run.begin_new()
    out.mkdir(parents=True, exist_ok=True)
    return run


def train(
    kind: type[Run],
    out: Path,
    given: Mapping[str, Any],
    resume: bool,
    minutes: float | None,
    device: str | None,
    threads: int | None,
) -> int:
    """Trains until the samples or the minutes are over; the exit code."""
    began = time.monotonic()
    if device is None and not torch.cuda.is_available():
        print(without_cuda(), file=sys.stderr, flush=True)
    device = device_of(device or ("cuda" if torch.cuda.is_available() else "cpu"))
    last, best, curve = out / "last.pt", out / "best.pt", out / "curve.csv"
    run = _begun(kind, out, given, resume, device, threads)
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
    print(f"a line follows after each segment of {steps:,} steps; {run.kind} --help explains it", flush=True)
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
            row |= {f"test/{name}": value for name, value in run.test().items()}
            if row["test/score"] > run.best:
                run.best = row["test/score"]
                run.save(best)
        run.save(last)
        _record(curve, writer, row, run.tests)
        elapsed = time.monotonic() - began
        # Of this call: an earlier piece of the run may have had another machine.
        rate = (run.samples - resumed_at) / elapsed
        left = f"{duration((settings.samples - run.samples) / rate)} left to {settings.samples / 1e6:g} M samples"
        if minutes is not None:
            left = f"{duration(60 * minutes - elapsed)} left"
        tested = " ".join(f"{name[5:]} {value:.3f}" for name, value in row.items() if name.startswith("test/"))
        print(
            f"{row['samples'] / 1e6:7.2f} M  {row['steps_per_s']:7.0f}/s (worlds {made:.1f} s, rollout {row['rollout_share']:.2f})  "
            f"{run.described(row)}reward {row['reward']:6.3f}  falls {row['falls_per_1000_steps']:6.2f}  "
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


def _record(curve: Path, writer: Any, row: Mapping[str, float], tests: tuple[str, ...]) -> None:
    is_new = not curve.exists()
    fields = [name for name in row if not name.startswith("test/")] + [f"test/{name}" for name in tests]
    if not is_new:
        # An earlier version's columns.
        with curve.open(newline="") as file:
            fields = next(csv.reader(file), fields)
    with curve.open("a", newline="") as file:
        table = csv.DictWriter(file, fields, extrasaction="ignore")
        if is_new:
            table.writeheader()
        table.writerow({name: f"{value:.6g}" for name, value in row.items()})
    if writer is not None:
        for name, value in row.items():
            writer.add_scalar(name, value, int(row["samples"]))
        writer.flush()
