"""Begins a run with an exported controller in place of new networks."""

import json
import math
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open

from .._files import regular

DEVIATION = 0.18
"""Standard deviation of each action at the start, as at the end of the shipped controller's training; no file holds it."""
LOOKS = 100
"""Control steps by which the scales of the observation are found, which the file has in its first layer."""


def read(file: Path) -> tuple[list[torch.Tensor], dict[str, Any]]:
    """Weight and bias of each layer, one after the other, and the contract.

    Raises:
        ValueError: The file is not an exported controller.
    """
    try:
        with safe_open(str(regular(file)), "pt") as tensors:
            contract = json.loads(tensors.metadata()["contract"])
            layers = range(len(contract["layers"]) - 1)
            parts = [tensors.get_tensor(f"layer{number}.{part}") for number in layers for part in ("weight", "bias")]
    except Exception as error:  # The reader has errors of its own for what is not its format.
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"start: {file} is not an exported controller: {reason}") from error
    return parts, contract


def begin_with(run: Any, file: Path) -> None:
    """Gives a new `walk.WalkRun` the policy of an exported controller, and counts on from its samples and minutes. The critic is new.

    Raises:
        ValueError: The file is not an exported controller, or its networks differ from the settings.
    """
    parts, contract = read(file)
    hidden = tuple(contract["layers"][1:-1])
    if run.settings.without or hidden != run.settings.hidden:
        sizes = " ".join(map(str, hidden))
        raise ValueError(f"start: {file} is a whole controller with hidden layers {sizes}; give --hidden {sizes}")
    actor, training = run.ppo.actor, contract["training"]
    weights, biases = parts[::2], parts[1::2]
    # The file's last layer is twice what a layer of pairs has.
    weights[-1] = weights[-1] / 2
    with torch.no_grad():
        for own, given in zip((*actor.mlp.weights, *actor.mlp.biases), (*weights, *biases)):
            own.copy_(given)
        actor.distribution.log_std_param.fill_(math.log(DEVIATION))
    normalizer = actor.obs_normalizer
    normalizer._std.fill_(1.0 - normalizer.eps)
    seen = type(normalizer)(normalizer._mean.shape[1]).to(run.device)
    with torch.inference_mode():
        for _ in range(LOOKS):
            numbers = run.worlds.observation["policy"]
            seen.update(torch.cat((numbers, actor.mlp.inputs(numbers))))
            run.worlds.step(actor(run.worlds.observation, stochastic_output=True))
    first, bias = actor.mlp.weights[0].data, actor.mlp.biases[0].data
    bias += first @ seen.mean
    first *= seen.std + seen.eps
    normalizer.load_state_dict(seen.state_dict())
    # As settled as at the end of that training.
    normalizer.count.fill_(max(2 * training["samples"], 1))
    run.samples, run.seconds = training["samples"], 60 * training["minutes"]
