"""A trained policy as one file that carries its contract."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file

from .. import _native
from ..baseline import FORMAT
from ..hand import FORMAT as HAND_FORMAT
from .ppo import worlds_of
from .run import kind_of, load_checkpoint, settings_of
from .settings import FIRST_ROOM
from .symmetry import FIELDS, _join
from .walk import models
from .worlds import MIN_DEVIATION, WalkingWorlds

FRAMES = 4
CLIMBER_EPS = 1e-2
"""RSL-RL adds this to each deviation of an observation where nothing else is asked for."""
POLICY = [name for name in FIELDS if not name.startswith("privileged.")]


def export(checkpoint: Path, file: Path, hardware: str, overwrites: bool = False) -> None:
    """Writes a checkpoint's policy; the normaliser goes into the first layer.

    The file has ``layerN.weight`` (outputs x inputs) and ``layerN.bias``, ELU between the layers, of the first halves of the
    hidden layers' units; the others are those in the mirror. It also has an observation with its action, by which a loader
    checks itself.

    Raises:
        ValueError: The checkpoint is not one, or is not to be exported; or the file has another ending or exists.
    """
    _check_name(file, overwrites)
    state = load_checkpoint(checkpoint)
    if kind_of(state) == "ppo":
        tensors, contract, play = _baseline(state, hardware)
    elif kind_of(state) == "hand":
        tensors, contract, play = _hand(state, hardware)
    elif kind_of(state) == "climb":
        tensors, contract, play = _climber(state, hardware)
    else:
        tensors, contract, play = _controller(checkpoint, hardware)
    if not all(tensor.isfinite().all() for tensor in tensors.values()):
        raise ValueError(f"{checkpoint} has numbers that are not finite; choose another checkpoint")
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    save_file(tensors, part, metadata={"contract": contract})
    # The library's file is for its owner alone.
    umask = os.umask(0)
    os.umask(umask)
    part.chmod(0o666 & ~umask)
    os.replace(part, file)
    print(f"{file}: {file.stat().st_size} bytes, {state['progress']['samples'] / 1e6:.1f} M samples")
    print(f"play it: {play.format(file)}")


def _check_name(file: Path, overwrites: bool) -> None:
    if file.suffix != ".safetensors":
        raise ValueError(f"{file}: name a file that ends in .safetensors")
    if file.exists() and not overwrites:
        raise ValueError(f"{file} exists; name another file, or overwrite it with --force")


Exported = tuple[dict[str, torch.Tensor], str, str]
"""Tensors, contract, and a command that plays the file."""


def _layers(weights: Mapping[str, torch.Tensor], least: torch.Tensor | float) -> dict[str, torch.Tensor]:
    """Layers of a policy with the scales of its observation in the first one, and an observation with its action. ``least`` is what
    is added to each deviation of the observation."""
    mean, deviation = (weights[f"obs_normalizer.{name}"].double().squeeze(0).cpu() for name in ("_mean", "_std"))
    names = [name for name in weights if name.startswith("mlp.") and name.endswith(".weight")]
    tensors = {}
    for number, name in enumerate(names):
        weight, bias = (weights[name.replace("weight", part)].double().cpu() for part in ("weight", "bias"))
        if number == 0:
            weight = weight / (deviation + least)
            bias = bias - weight @ mean
        tensors[f"layer{number}.weight"] = weight.float().contiguous()
        tensors[f"layer{number}.bias"] = bias.float().contiguous()
    random = torch.Generator().manual_seed(0)
    noise = torch.randn(mean.shape, generator=random, dtype=torch.float64)
    numbers = tensors["check.observation"] = (mean + deviation * noise).float()
    for number in range(len(names)):
        numbers = tensors[f"layer{number}.weight"] @ numbers + tensors[f"layer{number}.bias"]
        numbers = torch.nn.functional.elu(numbers) if number < len(names) - 1 else numbers
    tensors["check.action"] = numbers
    return tensors


def _baseline(state: dict[str, Any], hardware: str) -> Exported:
    settings, progress = settings_of(state, {}), state["progress"]
    sensors = list(settings.sensors or _native.body_sensors(settings.task))
    worlds = worlds_of(settings, "cpu", 1, FIRST_ROOM, 0, 1)
    worlds.env.close()
    tensors = _layers(state["ppo"]["actor_state_dict"], worlds.floors["policy"].double())
    contract = {
        "format": FORMAT,
        "task": settings.task,
        "robot": settings.robot,
        "sensors": sensors,
        "hidden": list(settings.hidden),
        "training": _training(settings, progress, hardware),
    }
    play = f'fiatlux.evaluate(fiatlux.Baseline("{{}}"), tasks=["{settings.task}"])'
    return tensors, json.dumps(contract), play


def _training(settings: Any, progress: Mapping[str, Any], hardware: str) -> dict[str, Any]:
    return {
        "seed": settings.seed,
        "samples": progress["samples"],
        "minutes": progress["seconds"] / 60,
        "hardware": hardware,
    }


def _hand(state: dict[str, Any], hardware: str) -> Exported:
    settings, progress = settings_of(state, {}), state["progress"]
    contract = {
        "format": HAND_FORMAT,
        "task": "S08",
        "grasp": state["grasp"],
        "hidden": list(settings.hidden),
        "training": _training(settings, progress, hardware),
    }
    play = 'fiatlux.evaluate(fiatlux.hand.HandPolicy("{}"), tasks=["S08"])'
    return _layers(state["ppo"]["actor_state_dict"], MIN_DEVIATION), json.dumps(contract), play


def _climber(state: dict[str, Any], hardware: str) -> Exported:
    settings, progress = settings_of(state, {}), state["progress"]
    tensors = _layers(state["ppo"]["actor_state_dict"], CLIMBER_EPS)
    contract = _native.climber_contract(
        list(settings.hidden),
        settings.until,
        settings.seed,
        progress["samples"],
        progress["seconds"] / 60,
        hardware,
    )
    return tensors, contract, "fiatlux evaluate --policy climb:{} --tasks S02"


def _controller(checkpoint: Path, hardware: str) -> Exported:
    state = load_checkpoint(checkpoint, "walk")
    settings, progress, weights = settings_of(state, {}), state["progress"], state["ppo"]["actor_state_dict"]
    if settings.without:
        raise ValueError(
            f"{checkpoint} was trained without {', '.join(settings.without)}; only whole controllers are exported"
        )
    index, sign = _join(*(FIELDS[name] for name in POLICY for _ in range(FRAMES)))
    index, sign = torch.tensor(index), torch.tensor(sign)
    # The normaliser is symmetric but for rounding; here exactly.
    mean, deviation = (weights[f"obs_normalizer.{name}"].double().squeeze(0) for name in ("_mean", "_std"))
    mean = 0.5 * (mean + sign * mean[index])
    deviation = 0.5 * (deviation + deviation[index]) + 0.01
    actor, _ = models(WalkingWorlds(1, "cpu"), settings)
    actor.load_state_dict(weights)
    layers = [[part.detach().double() for part in layer] for layer in actor.mlp.layers()]
    layers[0][0] = layers[0][0] / deviation
    layers[0][1] = layers[0][1] - layers[0][0] @ mean
    *hidden, (weight, bias) = layers
    halves = [(weight[: len(weight) // 2], bias[: len(bias) // 2]) for weight, bias in hidden]
    # The mean of what this makes of the units and of their mirror images.
    halves.append((2 * weight[:, : weight.shape[1] // 2], bias))
    tensors = {}
    for number, (weight, bias) in enumerate(halves):
        tensors[f"layer{number}.weight"] = weight.float().contiguous()
        tensors[f"layer{number}.bias"] = bias.float().contiguous()

    def network(numbers: torch.Tensor) -> torch.Tensor:
        for number, (weight, bias) in enumerate(layers):
            numbers = weight.float() @ numbers + bias.float()
            numbers = torch.nn.functional.elu(numbers) if number < len(layers) - 1 else numbers
        return numbers

    random = torch.Generator().manual_seed(0)
    observation = (mean + deviation * torch.randn(mean.shape, generator=random, dtype=torch.float64)).float()
    tensors["check.observation"], tensors["check.action"] = observation, network(observation)
    contract = _native.controller_contract(
        FRAMES, list(settings.hidden), settings.seed, progress["samples"], progress["seconds"] / 60, hardware
    )
    return tensors, contract, "fiatlux evaluate --policy wbc:{},vx=0.4 --tasks S07"
