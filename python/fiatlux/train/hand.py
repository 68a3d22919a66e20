"""PPO of a task of one hand on top of the whole-body controller, with starts from rows of demonstrations."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from .._scene import SCENE
from ..bag import Bag, files_below
from ..hand import ACTIONS, REPEAT, SENSORS, HandActions
from ..vector import Start, VectorEnv
from ..whole_body import ARMS, LEGS_AND_WAIST
from .run import CONTROL_DT, GROUPS, Run
from .settings import FIRST_ROOM, FIRST_TEST_ROOM, Hand
from .worlds import MIN_DEVIATION, Worlds

GLASS: float = SCENE["bulb"]["solids"][-1][0]
"""Height of the glass's centre above the bulb's origin, m."""
SUCCESS, FAILURE = 10.0, -2.0
"""Rewards of an episode's end."""
TIME, EFFORT = -0.01, -0.001
"""Cost of a decision, and of the square of each of its numbers."""
LOOKS = 40
"""Decisions by which the scales of the observation are found before the first iteration."""
TEST_EPISODES, TEST_STEPS = 64, 1500
"""Episodes and control steps of a test during the run."""
BESIDE = np.array([0.10, 0.04, 0.0])
"""Where the palm waits beside the grasp, in its own frame, m."""
PARTS = np.linspace(0.0, 1.0, 9)
BODY = LEGS_AND_WAIST + ARMS
STAGES = ("near", "gripped", "lifted")


def grasp(demonstrations: Sequence[tuple[int, Sequence[Mapping[str, Any]]]]) -> dict[str, Any]:
    """All that is to be known of hand and bulb: the closed hand of the start of S09, which has the bulb in the hand, and how the
    palm grasps the bulb as the demonstrations begin to lift it."""
    held = VectorEnv("S09", 1, seeds=[FIRST_ROOM], num_threads=1)
    closed = held.row(0)["joint_target"]
    closed = closed[-(len(closed) - BODY) // 2 :]
    held.close()
    lying = VectorEnv("S08", 1, seeds=[FIRST_ROOM], num_threads=1, observation="dict", sensors=SENSORS, noise=False)
    seen, _ = lying.reset(seed=0)
    q0 = lying.row(0)["joint_position"] - seen["joint_position"][0]
    task = {
        "closed": closed.tolist(),
        "thumb": [index < 4 for index in range(len(closed))],
        "height": float(lying.row(0)["fresh_bulb_pose"][2]),
        "glass": GLASS,
        "centre": [0.0, 0.0, 0.0],
        "turn": [1.0, 0.0, 0.0, 0.0],
        "place": [0.0, 0.0],
    }
    hand = HandActions(task)
    found: dict[str, list[Any]] = {"centre": [], "palm_turn": [], "bulb": []}
    for _, rows in demonstrations:
        lies = [row for row in rows if abs(row["fresh_bulb_pose"][2] - task["height"]) < 1e-3]
        row = lies[-1]
        robot, bulb = row["robot_pose"], row["fresh_bulb_pose"]
        parts = {
            "joint_position": row["joint_position"] - q0,
            "robot_position": robot[:3],
            "robot_quaternion": robot[3:],
        }
        parts |= {"fresh_bulb_position": bulb[:3], "fresh_bulb_quaternion": bulb[3:]}
        hand.observe({name: parts.get(name.removeprefix("privileged."), numbers) for name, numbers in seen.items()})
        for name, values in found.items():
            values.append(hand.seen[name][0])
    turns = np.array(found["palm_turn"])
    turns *= np.sign(turns @ turns[0])[:, None]
    turn = turns.mean(axis=0)
    lying.close()
    return task | {
        "centre": np.mean(found["centre"], axis=0).tolist(),
        "turn": (turn / np.linalg.norm(turn)).tolist(),
        "place": np.mean(found["bulb"], axis=0)[:2].tolist(),
    }


def demonstrated(folder: str, rooms: Sequence[int], last_s: float, every: int = 10) -> list[tuple[int, list[Any]]]:
    """Rooms and rows of the bags in a folder, from their last seconds."""
    found = []
    for file in files_below(Path(folder)):
        bag = Bag(file)
        seed = int(bag.header["seed"])
        if seed not in rooms:
            continue
        steps = len(bag["/state"]["step"])
        found.append(
            (seed, [bag.row(step) for step in range(max(0, steps - int(last_s / CONTROL_DT)), steps - 5, every)])
        )
    if not found:
        raise ValueError(f"demonstrations: {folder} has no bag of the rooms {rooms[0]} to {rooms[-1]}")
    return found


def potential(hand: HandActions) -> tuple[NDArray[np.float64], dict[str, NDArray[np.bool_]]]:
    """Progress of a take, and the stages that hold."""
    seen = hand.seen
    apart = seen["centre"] - hand.centre
    distance, turned = np.linalg.norm(apart, axis=1), np.linalg.norm(seen["twist"], axis=1)
    # The way to the grasp leads past a point beside the bulb, so that the hand goes around the glass.
    ways = [2.5 * np.linalg.norm(apart + part * BESIDE, axis=1) + part * np.linalg.norm(BESIDE) for part in PARTS]
    way = np.min(ways, axis=0)
    fingers = seen["force"][:, -len(hand.closed) :]
    thumb, others = fingers[:, hand.thumb].max(axis=1), fingers[:, ~hand.thumb].max(axis=1)
    grip = np.minimum(thumb, 1.0) * np.minimum(others, 1.0)
    risen, upright = seen["risen"][:, 0], seen["upright"][:, 0]
    lift = np.clip(risen / 0.05, 0.0, 1.0) * np.minimum(1.0, 3.0 * grip)
    lies = np.clip((1.0 - upright) / 0.3, 0.0, 1.0) * (risen < 0.02)
    worth = (
        np.exp(-way / 0.5)
        + np.exp(-way / 0.15)
        + np.exp(-way / 0.05)
        + 0.7 * np.exp(-turned / 0.6)
        + 1.5 * grip * np.exp(-distance / 0.04)
        + 4.0 * lift
        - 1.5 * lies
    )
    return worth, {"near": distance < 0.05, "gripped": grip > 0.3, "lifted": lift > 0.6}


class HandWorlds(Worlds):
    """Worlds of S08 whose steps are decisions."""

    def __init__(
        self,
        settings: Hand,
        task: Mapping[str, Any],
        device: str,
        num_envs: int,
        first_room: int,
        seed: int,
        threads: int | None,
        starts: list[Start] | None,
        horizon_steps: int | None,
    ) -> None:
        rooms = range(first_room, first_room + min(settings.rooms, num_envs))
        self.env = VectorEnv(
            settings.task,
            num_envs,
            seeds=rooms,
            episodes=settings.episodes,
            starts=starts,
            num_threads=threads,
            seed=seed,
            observation="flat",
            sensors=SENSORS,
            action_form="joint_target",
            protocol="strict",
            horizon_steps=horizon_steps,
            copy=False,
            final_obs=False,
        )
        self.num_envs, self.num_actions, self.device = num_envs, ACTIONS, device
        self.hand = HandActions(task, num_envs, self.env.num_threads)
        self.reset(seed)

    def reset(self, seed: int) -> None:
        self._look(self.env.reset(seed=seed)[0])
        self.hand.begin(np.ones(self.num_envs, np.bool_))
        self._worth, self.stages = potential(self.hand)
        self._see()

    def _look(self, numbers: NDArray[np.float32]) -> None:
        self.hand.observe({name: numbers[:, place] for name, (place, _) in self.env.fields.items()})

    def _see(self) -> None:
        numbers = torch.from_numpy(self.hand.features()).to(self.device)
        groups = {"policy": numbers, "critic": numbers}
        self.observation = TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def step(self, actions: torch.Tensor) -> tuple[torch.Tensor, np.ndarray, np.ndarray, dict[str, Any]]:
        """Takes a decision; returns reward, terminated, truncated, and info."""
        hand = self.hand
        numbers = actions.detach().cpu().numpy()
        hand.decide(numbers)
        reward = TIME + EFFORT * np.square(hand.last).sum(axis=1)
        terminated, truncated, success = (np.zeros(self.num_envs, np.bool_) for _ in range(3))
        for _ in range(REPEAT):
            seen, _, ended, out, info = self.env.step(hand.targets())
            self._look(seen)
            over = ended | out
            if over.any():
                first = over & ~terminated & ~truncated
                success |= first & info["success"]
                terminated |= first & ended
                truncated |= first & out
                hand.begin(over)
        fell = hand.seen["upright"][:, 0] < 0.6
        fell &= ~(terminated | truncated)
        if fell.any():
            self._look(self.env.terminate(fell))
            hand.begin(fell)
            terminated |= fell
        over = terminated | truncated
        worth, self.stages = potential(hand)
        reward += np.where(over, 0.0, worth - self._worth)
        reward += SUCCESS * success + FAILURE * (terminated & ~success)
        self._worth = worth
        self._see()
        info = {"success": success, "reward_terms": np.stack([stage & ~over for stage in self.stages.values()], 1)}
        return torch.from_numpy(reward.astype(np.float32)).to(self.device), terminated, truncated, info

    @property
    def reward_terms(self) -> tuple[str, ...]:
        """Stages that hold, as shares of the decisions."""
        return STAGES


def models(worlds: HandWorlds, settings: Hand) -> tuple[MLPModel, MLPModel]:
    """Policy and critic, new."""
    deviation = {"class_name": "GaussianDistribution", "init_std": settings.std, "std_type": "log"}
    common = {"activation": "elu", "obs_normalization": True}
    actor = MLPModel(
        worlds.observation,
        GROUPS,
        "actor",
        worlds.num_actions,
        hidden_dims=list(settings.hidden),
        distribution_cfg=deviation,
        **common,
    )
    critic = MLPModel(worlds.observation, GROUPS, "critic", 1, hidden_dims=list(settings.critic), **common)
    actor.obs_normalizer.eps = critic.obs_normalizer.eps = MIN_DEVIATION
    return actor, critic


class HandRun(Run):
    """A run of a task of one hand."""

    kind = "hand"
    tests = (*STAGES, "success", "failed", "seconds", "score")
    settings: Hand
    worlds: HandWorlds

    def prepare(self) -> None:
        settings = self.settings
        self.rooms = range(FIRST_ROOM, FIRST_ROOM + min(settings.rooms, settings.worlds))
        self.demonstrations = demonstrated(settings.demonstrations, self.rooms, settings.last_s)
        self.grasp = grasp(self.demonstrations)

    def make_worlds(self, seed: int) -> HandWorlds:
        settings = self.settings
        starts = [Start(weight=settings.own), *(Start(rows=rows, seed=room) for room, rows in self.demonstrations)]
        return HandWorlds(
            settings, self.grasp, self.device, settings.worlds, FIRST_ROOM, seed, self.threads, starts, settings.horizon
        )

    def begin_new(self) -> None:
        self.look(LOOKS)

    def begin_segment(self) -> None:
        self.worlds.reset(self.seed_noise())

    def models(self) -> tuple[MLPModel, MLPModel]:
        return models(self.worlds, self.settings)

    def algorithm(self) -> dict[str, Any]:
        return super().algorithm() | {
            "clip_param": 0.2,
            "gamma": self.settings.gamma,
            "lam": 0.95,
            "value_loss_coef": 1.0,
            "learning_rate": self.settings.learning_rate,
            "max_grad_norm": 1.0,
            "schedule": "fixed",
        }

    def adapt(self, kl: float) -> None:
        self.adapt_once(kl)

    def state(self) -> dict[str, Any]:
        return super().state() | {"grasp": self.grasp}

    def described(self, row: Mapping[str, float]) -> str:
        return f"successes {row['successes_per_1000_steps']:.2f}  "

    def test(self) -> dict[str, float]:
        actor = self.ppo.actor
        found = measure(actor, self.settings, self.grasp, self.device, self.threads, TEST_EPISODES, TEST_STEPS)
        actor.train()
        return found


def measure(
    actor: Any,
    settings: Hand,
    task: Mapping[str, Any],
    device: str,
    threads: int | None,
    episodes: int,
    steps: int | None = None,
    progress: Callable[[int], None] = lambda step: None,
) -> dict[str, float]:
    """Plays episodes from the task's own start in rooms that training has not seen, with the policy's mean actions; shares of all."""
    worlds = HandWorlds(settings, task, device, episodes, FIRST_TEST_ROOM, 1, threads, None, steps)
    steps = steps or worlds.env.horizon_steps
    alive, success, failed = np.ones(episodes, bool), np.zeros(episodes, bool), np.zeros(episodes, bool)
    stages, lasted = {name: np.zeros(episodes, bool) for name in STAGES}, np.zeros(episodes)
    actor.eval()
    with torch.inference_mode():
        for step in range(0, steps, REPEAT):
            progress(step)
            if not alive.any():
                break
            _, terminated, truncated, info = worlds.step(actor(worlds.observation))
            ended = terminated | truncated
            lasted += alive * REPEAT
            for name, holds in stages.items():
                holds |= alive & ~ended & worlds.stages[name]
            success |= alive & info["success"]
            failed |= alive & terminated & ~info["success"]
            alive &= ~ended
    worlds.env.close()
    shares = {name: float(holds.mean()) for name, holds in stages.items()}
    done = float(success.mean())
    return {
        **shares,
        "success": done,
        "failed": float(failed.mean()),
        "seconds": float(lasted.mean()) * CONTROL_DT,
        "score": done + 0.3 * shares["lifted"] + 0.1 * shares["gripped"] + 0.1 * shares["near"],
    }
