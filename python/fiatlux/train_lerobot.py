"""Trains LeRobot's ACT on bags of a task that is done by hand: ``python -m fiatlux.train_lerobot BAGS --out DIR``.

    fiatlux demonstrate --task S06 --episodes 400 --out demos --record camera@10 --image 128x128
    python -m fiatlux.train_lerobot demos/bags --out runs/act --minutes 1.5
    python -m fiatlux.serve_lerobot runs/act --device cuda

The mapping `lerobot_g1_hand` plays what it writes, a checkpoint of LeRobot. Ten rows a second: head camera, proprioception without
velocities of joints, and as actions the commands to the whole-body controller, then targets of both arms and the right hand, rad.
All pictures are kept in the memory of the device, and nothing waits for a decoder. It needs the extra ``lerobot``.

Most frames stand still, and a network that sees one picture does not know for how long it has stood. So half of each batch are frames
in which the robot walks, and long pauses are shortened. The picture's encoder starts from nothing: its norms are trained, and only the
checkpoint has them frozen, as LeRobot does.
"""

import argparse
import math
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from . import dataset
from ._extras import check
from .bag import Bag, files_below

STATE = ("base_angular_velocity", "projected_gravity", "base_linear_velocity", "base_height", "joint_position")
STRIDE = 5
"""Control steps in a row of a chunk."""
BODY = 29
"""Joints of legs, waist and arms, the first ones; fingers follow."""
ARMS = slice(15, BODY)
MIN_STD = {"state": 0.02, "command": 0.02, "target": 0.05}
"""Smaller deviations are noise, and are not blown up: m/s, m and rad."""
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


def shortened(actions: Any) -> Any:
    """Numbers of the actions without those in which a pause is longer than :data:`MAX_PAUSE`; the last one is always there."""
    rows = np.arange(len(actions))
    change = np.abs(actions[np.minimum(rows + STRIDE, rows[-1])] - actions).max(axis=1)
    moves = (change > MOVES) | actions[:, VELOCITY].any(axis=1)
    last_move = np.maximum.accumulate(np.where(moves, rows, -1))
    return np.flatnonzero((rows - last_move <= MAX_PAUSE) | (rows == rows[-1]))


def episode(path: Path) -> tuple[Any, Any, Any, Any]:
    """Pictures and states of a bag, the number of the action that each has, and all actions, in pauses that are not long."""
    bag = Bag(path)
    commands, sensed = dataset._commands(bag), bag["/observation"]
    if commands is None:
        raise SystemExit(
            str(dataset.no_command(bag, path, "train on a task that is done by hand, such as S06", "hands"))
        )
    images = dataset._images(bag).get("camera", {})
    steps = [step for step in sorted(images) if step % STRIDE == 0 and step < len(commands)]
    if not steps:
        raise SystemExit(f"{path} has no pictures of the head camera; record with --record camera@10")
    names = bag.header["joint_names"]
    fingers = [index for index, name in enumerate(names) if index >= BODY and name.startswith(("R_", "right_"))]
    targets = bag["/state"]["joint_target"][1:]
    state = np.concatenate(
        [np.reshape(sensed[f"proprioception.{name}"], (len(commands) + 1, -1)) for name in STATE], axis=1
    )
    actions = np.concatenate([commands, targets[:, ARMS], targets[:, fingers]], axis=1).astype(np.float32)
    kept = shortened(actions)
    return (
        np.stack([images[step] for step in steps]),
        state[steps].astype(np.float32),
        np.searchsorted(kept, steps),
        actions[kept],
    )


def read(bags: Sequence[Path], workers: int) -> dict[str, Any]:
    """All episodes as arrays; ``at`` and ``last`` are the action of each picture, and the last one of its episode."""
    with ProcessPoolExecutor(workers) as pool:
        episodes = list(pool.map(episode, bags))
    starts = np.cumsum([0] + [len(actions) for *_, actions in episodes])
    return {
        "images": np.concatenate([images for images, *_ in episodes]),
        "state": np.concatenate([state for _, state, *_ in episodes]),
        "action": np.concatenate([actions for *_, actions in episodes]),
        "at": np.concatenate([start + at for start, (_, _, at, _) in zip(starts, episodes)]),
        "last": np.concatenate([np.full(len(e[2]), start + len(e[3]) - 1) for start, e in zip(starts, episodes)]),
    }


def varied(torch: Any, images: Any, generator: Any) -> Any:
    """Pictures from 0 to 1, with another contrast, brightness and tint each."""
    count, device = len(images), images.device

    def drawn(most: float, *shape: int) -> Any:
        return most * (2 * torch.rand(count, *shape, 1, 1, device=device, generator=generator) - 1)

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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", type=Path, help="folder of bags")
    parser.add_argument("--out", type=Path, required=True, help="folder of the checkpoint")
    parser.add_argument("--minutes", type=float, default=10.0, help="time for training [default: 10]")
    parser.add_argument("--batch", type=int, default=256, help="frames in a step [default: 256]")
    parser.add_argument("--chunk", type=int, default=20, help="rows of a chunk [default: 20]")
    parser.add_argument("--rate", type=float, default=3e-4, help="learning rate at its highest [default: 3e-4]")
    parser.add_argument("--start", type=Path, help="checkpoint to go on from")
    parser.add_argument("--workers", type=int, default=2, help="processes that read bags [default: 2]")
    given = parser.parse_args(arguments)
    try:
        Bag.below(given.bags, training=True)
    except (FileNotFoundError, ValueError) as error:
        parser.error(str(error))
    bags = files_below(given.bags)
    if not given.minutes > 0 or min(given.batch, given.chunk, given.workers) < 1:
        parser.error("--minutes, --batch, --chunk and --workers are above 0")

    try:
        check("train_lerobot", "lerobot", "torch", "torchvision", "lerobot")
    except ImportError as error:
        parser.error(str(error))
    import torch
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors
    from torchvision.ops.misc import FrozenBatchNorm2d

    device = "cuda" if torch.cuda.is_available() else "cpu"
    data = {name: torch.from_numpy(array).to(device) for name, array in read(bags, given.workers).items()}
    images, state, action = data["images"].permute(0, 3, 1, 2), data["state"], data["action"]
    config = ACTConfig(
        input_features={
            "observation.images.camera": PolicyFeature(FeatureType.VISUAL, tuple(images.shape[1:])),
            "observation.state": PolicyFeature(FeatureType.STATE, (state.shape[1],)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (action.shape[1],))},
        chunk_size=given.chunk,
        n_action_steps=given.chunk,
        dim_model=256,
        dim_feedforward=1024,
        use_vae=False,
        dropout=0.0,
        pretrained_backbone_weights=None,
        device=device,
        push_to_hub=False,
    )
    floor = torch.full((action.shape[1],), MIN_STD["target"], device=device)
    floor[: len(dataset.COMMAND)] = MIN_STD["command"]
    pixels = images[::7].float().div(255)
    norms = {
        "observation.images.camera": (pixels.mean((0, 2, 3))[:, None, None], pixels.std((0, 2, 3))[:, None, None]),
        "observation.state": (state.mean(0), state.std(0).clamp(min=MIN_STD["state"])),
        "action": (action.mean(0), torch.maximum(action.std(0), floor)),
    }
    stats = {name: {"mean": mean.cpu(), "std": std.cpu()} for name, (mean, std) in norms.items()}
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    torch.manual_seed(1)
    generator = torch.Generator(device).manual_seed(1)
    policy = ACTPolicy(config) if given.start is None else ACTPolicy.from_pretrained(given.start, config=config)
    policy.to(device, memory_format=torch.channels_last).train()
    trained_norms = exchanged(policy, torch.nn.BatchNorm2d)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=given.rate, weight_decay=1e-4)

    def normalized(name: str, values: Any) -> Any:
        mean, std = norms[name]
        return (values - mean) / std

    rows = STRIDE * torch.arange(given.chunk, device=device)
    ahead = torch.minimum(data["at"][:, None] + rows[:WALKING], data["last"][:, None])
    walking = action[ahead][..., VELOCITY].abs().amax((1, 2)).nonzero()[:, 0]
    began, step, total, counted = time.monotonic(), 0, torch.zeros((), device=device), 0
    print(f"{len(bags)} episodes, {len(images)} frames, {len(walking)} of them walk, {device}", flush=True)
    while (part := (time.monotonic() - began) / (60 * given.minutes)) < 1:
        rate = given.rate * min(1, (step + 1) / 300) * (0.02 + 0.49 * (1 + math.cos(math.pi * part)))
        for group in optimizer.param_groups:
            group["lr"] = rate
        for norm in trained_norms:
            norm.train(part < LAST_QUARTER)
        frames = torch.randint(len(images), (given.batch,), device=device, generator=generator)
        if len(walking):
            drawn = torch.randint(len(walking), (given.batch // 2,), device=device, generator=generator)
            frames[: given.batch // 2] = walking[drawn]
        seen = normalized("observation.images.camera", varied(torch, images[frames].float() / 255, generator))
        sensed = normalized("observation.state", state[frames])
        sensed = sensed + 0.05 * torch.randn(sensed.shape, device=device, generator=generator)
        wanted, last = data["at"][frames, None] + rows, data["last"][frames, None]
        target = normalized("action", action[torch.minimum(wanted, last)])
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            chunk, _ = policy.model({"observation.images": [seen], "observation.state": sensed})
        loss = ((chunk.float() - target).abs() * (wanted <= last)[..., None]).mean()
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
    exchanged(policy, FrozenBatchNorm2d)
    for part_of in (policy, before, after):
        part_of.save_pretrained(given.out)
    print(f"{step} steps, {sum(parameter.numel() for parameter in policy.parameters())} parameters: {given.out}")


if __name__ == "__main__":
    main()
