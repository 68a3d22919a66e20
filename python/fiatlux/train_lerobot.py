"""Trains LeRobot's ACT on bags of a task that is done by hand: ``python -m fiatlux.train_lerobot BAGS --out DIR``.

    fiatlux demonstrate --task S06 --episodes 400 --out demos --record camera@10 --image 128x128
    python -m fiatlux.train_lerobot demos/bags --out runs/act --minutes 1.5
    python -m fiatlux.serve_lerobot runs/act --device cuda

It writes a checkpoint of LeRobot and beside it ``mapping.toml``, with which the bridge plays it; by default it says the same as the
mapping `lerobot_g1_hand`. Ten rows a second: head camera, proprioception without velocities of joints, and as actions the commands to
the whole-body controller, then targets of both arms and the right hand, rad. ``--cameras``, ``--contacts``, ``--lidar`` and
``--history`` add inputs, which the demonstrations must have recorded, and ``--hands both`` the fingers of the left hand.
All pictures are kept in the memory of the device, and nothing waits for a decoder. It needs the extra ``lerobot``.

Most frames stand still, and a network that sees one picture does not know for how long it has stood. So half of each batch are frames
in which the robot walks, and long pauses are shortened. The picture's encoder starts from nothing: its norms are trained, and only the
checkpoint has them frozen, as LeRobot does.
"""

import argparse
import math
import shlex
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from . import dataset
from ._extras import check
from ._inputs import ARMS, DEFAULT, HORIZON, MAX_CHUNK, STRIDE, Inputs, picture_name, rows_back, sees_room
from .bag import Bag, files_below

MIN_STD = {"command": 0.02, "target": 0.05}
"""Smaller deviations of an action are noise, and are not blown up: m/s, m and rad."""
VELOCITY = slice(0, 3)
"""Part of a command."""
MOVES = 0.02
"""A pause is where commands and targets change less within a row of a chunk: m/s, m and rad."""
MAX_PAUSE = 15
"""Control steps of a pause that are kept."""
WALKING = 5
"""Rows of a chunk; a frame walks if any of the first ones has a velocity."""
LAST_QUARTER = 0.75
"""Of the time, from which norms are frozen, as they will be in the checkpoint."""
MAPPING = "mapping.toml"
"""File of the mapping, beside the checkpoint."""


def shortened(actions: Any) -> Any:
    """Numbers of the actions without those in which a pause is longer than :data:`MAX_PAUSE`; the last one is always there."""
    rows = np.arange(len(actions))
    change = np.abs(actions[np.minimum(rows + STRIDE, rows[-1])] - actions).max(axis=1)
    moves = (change > MOVES) | actions[:, VELOCITY].any(axis=1)
    last_move = np.maximum.accumulate(np.where(moves, rows, -1))
    return np.flatnonzero((rows - last_move <= MAX_PAUSE) | (rows == rows[-1]))


def episode(path: Path, inputs: Inputs = DEFAULT) -> tuple[Any, Any, Any, Any]:
    """Pictures and states of a bag, the number of the action that each has, and all actions, in pauses that are not long."""
    bag = Bag(path)
    commands = dataset._commands(bag)
    if commands is None:
        raise SystemExit(
            str(dataset.no_command(bag, path, "train on a task that is done by hand, such as S06", "hands"))
        )
    try:
        steps, images = inputs.pictures(dataset._images(bag), len(commands))
        state = inputs.state(bag, steps)
    except ValueError as error:
        raise SystemExit(f"{path} {error}") from error
    fingers = inputs.fingers(bag.header["joint_names"])
    targets = bag["/state"]["joint_target"][1:]
    actions = np.concatenate([commands, targets[:, ARMS], targets[:, fingers]], axis=1).astype(np.float32)
    kept = shortened(actions)
    return images, state, np.searchsorted(kept, steps), actions[kept]


def read(bags: Sequence[Path], workers: int, inputs: Inputs = DEFAULT) -> dict[str, Any]:
    """All episodes as arrays; ``at`` and ``last`` are the action of each picture, and the last one of its episode.

    ``images`` are frames x height x width x 3 for each camera. With a history ``past`` has, for each frame, the frames that are so far
    back, frames x times, the oldest first; before the start the first frame of the episode stands in.
    """
    with ProcessPoolExecutor(workers) as pool:
        episodes = list(pool.map(partial(episode, inputs=inputs), bags))
    for path, one in zip(bags, episodes):
        for what, part in (("pictures", 0), ("states", 1), ("actions", 3)):
            found, first = (list(of[part].shape[1:]) for of in (one, episodes[0]))
            if found != first:
                raise SystemExit(
                    f"{path} has {what} of shape {found}, and {bags[0]} of {first}; train on bags of one --image and --robot"
                )
    counts = [len(images) for images, *_ in episodes]
    starts = np.cumsum([0] + [len(actions) for *_, actions in episodes])
    data = {
        "images": np.concatenate([images for images, *_ in episodes]),
        "state": np.concatenate([state for _, state, *_ in episodes]),
        "action": np.concatenate([actions for *_, actions in episodes]),
        "at": np.concatenate([start + at for start, (_, _, at, _) in zip(starts, episodes)]),
        "last": np.concatenate([np.full(len(e[2]), start + len(e[3]) - 1) for start, e in zip(starts, episodes)]),
    }
    if inputs.history:
        began = np.repeat(np.cumsum([0, *counts[:-1]]), counts)
        data["past"] = np.maximum(np.arange(len(began))[:, None] - inputs.history, began[:, None])
    return data


def varied(torch: Any, images: Any, generator: Any) -> Any:
    """Pictures from 0 to 1, frames x times x 3 x height x width, with another contrast, brightness and tint for each frame."""
    count, device = len(images), images.device

    def drawn(most: float, *shape: int) -> Any:
        return most * (2 * torch.rand(count, 1, *shape, 1, 1, device=device, generator=generator) - 1)

    changed = (images - 0.5) * (1 + drawn(0.2, 1)) + 0.5 + drawn(0.1, 1) + drawn(0.05, 3)
    return changed.clamp_(0, 1)


def exchanged(module: Any, norm: Any) -> list[Any]:
    """Replaces all norms of a network's pictures by others with the same numbers, and returns them."""
    from torch.nn import BatchNorm2d
    from torchvision.ops.misc import FrozenBatchNorm2d

    norms: list[Any] = []
    for name, child in module.named_children():
        if isinstance(child, (BatchNorm2d, FrozenBatchNorm2d)):
            other = norm(child.weight.shape[0]).to(child.weight.device)
            # Only BatchNorm2d counts batches.
            other.load_state_dict(child.state_dict(), strict=False)
            setattr(module, name, other)
            norms.append(other)
        else:
            norms += exchanged(child, norm)
    return norms


class Frames:
    """The frames of all episodes on a device, as the network reads them."""

    def __init__(self, torch: Any, data: dict[str, Any], inputs: Inputs, bodies: int, device: str) -> None:
        """``data`` is of :func:`read`; the robot's hands have ``bodies`` that feel."""
        self.torch, self.inputs, self.device = torch, inputs, device
        self.data = {name: torch.from_numpy(array).to(device) for name, array in data.items()}
        self.images = self.data["images"].permute(0, 3, 1, 2)
        self.state, self.action = self.data["state"], self.data["action"]
        self.picture = f"observation.images.{picture_name(inputs.cameras, inputs.rows)}"
        floor = torch.full((self.action.shape[1],), MIN_STD["target"], device=device)
        floor[: len(dataset.COMMAND)] = MIN_STD["command"]
        least = torch.from_numpy(inputs.least_std(self.state.shape[1], bodies)).to(device)
        pixels = self.images[::7].unflatten(1, (-1, 3)).float().div(255)
        self.norms = {
            self.picture: (pixels.mean((0, 1, 3, 4))[:, None, None], pixels.std((0, 1, 3, 4))[:, None, None]),
            "observation.state": (self.state.mean(0), torch.maximum(self.state.std(0), least)),
            "action": (self.action.mean(0), torch.maximum(self.action.std(0), floor)),
        }

    def normalized(self, name: str, values: Any) -> Any:
        mean, std = self.norms[name]
        return (values - mean) / std

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, height and width of the picture in which all views stand side by side."""
        _, height, width, _ = self.data["images"].shape
        return 3, height, width * len(self.inputs.cameras) * len(self.inputs.rows)

    def pictures(self, frames: Any, generator: Any) -> Any:
        """Pictures of some frames, with other colours each, frames x 3 x height x width."""
        torch, times = self.torch, [frames]
        if self.inputs.history:
            times = [*self.data["past"][frames].T, frames]
        seen = []
        for camera in range(len(self.inputs.cameras)):
            of = torch.stack([self.images[time, 3 * camera : 3 * camera + 3] for time in times], 1)
            seen += list(varied(torch, of.float() / 255, generator).unbind(1))
        return self.normalized(self.picture, torch.cat(seen, -1) if len(seen) > 1 else seen[0])

    def chunks(self, frames: Any, rows: Any) -> tuple[Any, Any]:
        """Chunks of actions from some frames on, and where they are before the end of their episodes."""
        wanted, last = self.data["at"][frames, None] + rows, self.data["last"][frames, None]
        return self.normalized("action", self.action[self.torch.minimum(wanted, last)]), wanted <= last

    def walking(self, rows: Any) -> Any:
        """Numbers of the frames that have a velocity in one of the next rows."""
        ahead = self.torch.minimum(self.data["at"][:, None] + rows[:WALKING], self.data["last"][:, None])
        return self.action[ahead][..., VELOCITY].abs().amax((1, 2)).nonzero()[:, 0]


def trained(policy: Any, frames: Frames, given: argparse.Namespace) -> int:
    """Trains the network for ``given.minutes``, and returns the number of steps."""
    torch, device = frames.torch, frames.device
    generator = torch.Generator(device).manual_seed(1)
    norms = exchanged(policy, torch.nn.BatchNorm2d)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=given.rate, weight_decay=1e-4)
    rows = STRIDE * torch.arange(given.chunk, device=device)
    count, walking = len(frames.images), frames.walking(rows)
    began, step, total, counted = time.monotonic(), 0, torch.zeros((), device=device), 0
    print(f"{count} frames, {len(walking)} of them walk, {device}", flush=True)
    while (part := (time.monotonic() - began) / (60 * given.minutes)) < 1:
        rate = given.rate * min(1, (step + 1) / 300) * (0.02 + 0.49 * (1 + math.cos(math.pi * part)))
        for group in optimizer.param_groups:
            group["lr"] = rate
        for norm in norms:
            norm.train(part < LAST_QUARTER)
        chosen = torch.randint(count, (given.batch,), device=device, generator=generator)
        if len(walking):
            drawn = torch.randint(len(walking), (given.batch // 2,), device=device, generator=generator)
            chosen[: given.batch // 2] = walking[drawn]
        seen = frames.pictures(chosen, generator)
        sensed = frames.normalized("observation.state", frames.state[chosen])
        sensed = sensed + 0.05 * torch.randn(sensed.shape, device=device, generator=generator)
        target, counts = frames.chunks(chosen, rows)
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            chunk, _ = policy.model({"observation.images": [seen], "observation.state": sensed})
        loss = ((chunk.float() - target).abs() * counts[..., None]).mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        optimizer.step()
        total, counted, step = total + loss.detach(), counted + 1, step + 1
        if step % 500 == 0:
            print(
                f"step {step}, loss {total.item() / counted:.4f}, {step / (time.monotonic() - began):.1f} steps/s",
                flush=True,
            )
            total, counted = torch.zeros((), device=device), 0
    return step


def _fixed(config: Any) -> dict[str, Any]:
    """Names of pictures, widths of state and action: training goes on only if they are the same."""
    both = {**config.input_features, **config.output_features}
    return {name: "pictures" if name.startswith("observation.images") else of.shape[0] for name, of in both.items()}


def configured(frames: Frames, given: argparse.Namespace) -> Any:
    """The configuration of the network.

    Raises:
        ValueError: ``given.start`` has other inputs or actions.
    """
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig

    config = ACTConfig(
        input_features={
            frames.picture: PolicyFeature(FeatureType.VISUAL, frames.shape),
            "observation.state": PolicyFeature(FeatureType.STATE, (frames.state.shape[1],)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (frames.action.shape[1],))},
        chunk_size=given.chunk,
        n_action_steps=given.chunk,
        dim_model=256,
        dim_feedforward=1024,
        use_vae=False,
        dropout=0.0,
        pretrained_backbone_weights=None,
        device=frames.device,
        push_to_hub=False,
    )
    if given.start is not None:
        asked, begun = _fixed(config), _fixed(PreTrainedConfig.from_pretrained(given.start))
        if asked != begun:
            raise ValueError(
                f"--start has {begun}, these bags and options {asked}; give those that it was trained with"
            )
    return config


def save(frames: Frames, config: Any, given: argparse.Namespace, mapping: str) -> None:
    """Trains the network, and writes checkpoint and mapping into ``given.out``."""
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors
    from torchvision.ops.misc import FrozenBatchNorm2d

    torch = frames.torch
    stats = {name: {"mean": mean.cpu(), "std": std.cpu()} for name, (mean, std) in frames.norms.items()}
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    torch.manual_seed(1)
    policy = ACTPolicy(config) if given.start is None else ACTPolicy.from_pretrained(given.start, config=config)
    policy.to(frames.device, memory_format=torch.channels_last).train()
    steps = trained(policy, frames, given)
    exchanged(policy, FrozenBatchNorm2d)
    for part_of in (policy, before, after):
        part_of.save_pretrained(given.out)
    (given.out / MAPPING).write_text(mapping)
    print(f"{steps} steps, {sum(parameter.numel() for parameter in policy.parameters())} parameters: {given.out}")


def parsed(arguments: Sequence[str] | None) -> tuple[argparse.ArgumentParser, argparse.Namespace]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", type=Path, help="folder of bags")
    parser.add_argument("--out", type=Path, required=True, help="folder of the checkpoint")
    parser.add_argument("--minutes", type=float, default=10.0, help="time for training [default: 10]")
    parser.add_argument("--batch", type=int, default=256, help="frames in a step [default: 256]")
    parser.add_argument("--chunk", type=int, default=HORIZON, help=f"rows of a chunk [default: {HORIZON}]")
    parser.add_argument("--rate", type=float, default=3e-4, help="learning rate at its highest [default: 3e-4]")
    parser.add_argument("--start", type=Path, help="checkpoint to go on from")
    parser.add_argument("--workers", type=int, default=2, help="processes that read bags [default: 2]")
    parser.add_argument(
        "--cameras", nargs="+", default=["camera"], metavar="NAME", help="camera (head, the default), chest_camera"
    )
    parser.add_argument("--contacts", action="store_true", help="the state has the forces on both hands, too")
    parser.add_argument(
        "--lidar", type=int, default=0, metavar="N", help="the state has the LiDAR's nearest ranges in N sectors, too"
    )
    parser.add_argument(
        "--history", nargs="+", type=float, default=[], metavar="SECONDS", help="pictures of so long ago, too"
    )
    parser.add_argument(
        "--hands", choices=["right", "both"], default="right", help="whose fingers are actions [default: right]"
    )
    return parser, parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    parser, given = parsed(arguments)
    if not given.minutes > 0 or min(given.batch, given.chunk, given.workers) < 1:
        parser.error("--minutes, --batch, --chunk and --workers are above 0")
    if given.chunk > MAX_CHUNK:
        parser.error(f"--chunk is {given.chunk}; the bridge plays at most {MAX_CHUNK} rows")
    try:
        history = rows_back(given.history)
        inputs = Inputs(tuple(given.cameras), given.contacts, given.lidar, history, given.hands)
        found = Bag.below(given.bags, training=True)
        sight = sees_room(found) if given.lidar else False
    except (FileNotFoundError, ValueError) as error:
        parser.error(str(error))
    bags = files_below(given.bags)
    try:
        check("train_lerobot", "lerobot", "torch", "torchvision", "lerobot")
    except ImportError as error:
        parser.error(str(error))
    import torch

    device = "cuda" if torch.cuda.is_available() else "cpu"
    data = read(bags, given.workers, inputs)
    frames = Frames(torch, data, inputs, len(found[0].header["hand_bodies"]), device)
    _, height, width, _ = data["images"].shape
    try:
        config = configured(frames, given)
    except ValueError as error:
        parser.error(str(error))
    print(f"{len(bags)} episodes", flush=True)
    save(frames, config, given, inputs.mapping((width, height), given.chunk, sees_room=sight))
    tasks = ",".join(sorted({bag.header["task"] for bag in found}))
    print(
        f"serve it:  python -m fiatlux.serve_lerobot {shlex.quote(str(given.out))}\n"
        f"play it:   policy-client evaluate --policy vla --dialect gr00t --model tcp://127.0.0.1:5555 "
        f"--map {shlex.quote(str(given.out / MAPPING))} --robot {found[0].header['robot']} --tasks {tasks}"
    )


if __name__ == "__main__":
    main()
