"""Reflection at the robot's median plane, and networks that obey it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import nn

POLAR, AXIAL = (1, -1, 1), (-1, 1, -1)
"""Signs of a vector's parts under the reflection, and of an axial vector's."""
LEG, WAIST, ARM = (1, -1, -1, 1, 1, -1), (-1, -1, 1), (1, -1, -1, 1, -1, 1, -1)
"""Signs of joints: turns about the lateral axis stay, others change."""

Mirror = tuple[list[int], list[float]]
"""Where each number of the reflection comes from, and its sign."""


def _plain(signs: Sequence[float]) -> Mirror:
    return list(range(len(signs))), list(signs)


def _pair(signs: Sequence[float]) -> Mirror:
    """Left, then right."""
    count = len(signs)
    return [*range(count, 2 * count), *range(count)], [*signs, *signs]


def _join(*parts: Mirror) -> Mirror:
    index: list[int] = []
    sign: list[float] = []
    for part, signs in parts:
        start = len(index)
        index += [start + number for number in part]
        sign += signs
    return index, sign


MOVED = _join(_pair(LEG), _plain(WAIST))
"""Legs and waist, as in an action."""
FIELDS: dict[str, Mirror] = {
    "base_angular_velocity": _plain(AXIAL),
    "projected_gravity": _plain(POLAR),
    "base_linear_velocity": _plain(POLAR),
    "base_height": _plain((1,)),
    "command": _plain((1, -1, -1, 1, -1, 1, -1)),
    "clock": _pair((1, 1)),
    "joint_position": MOVED,
    "joint_velocity": MOVED,
    "last_action": MOVED,
    "arm_position": _pair(ARM),
    "privileged.velocity": _join(_plain(POLAR), _plain(AXIAL)),
    "privileged.slow_velocity": _plain((1, -1, -1)),
    "privileged.foot_position": _pair(POLAR),
    "privileged.foot_velocity": _pair(POLAR),
    "privileged.foot_load": _pair((1,)),
    "privileged.upright": _plain(POLAR),
    "privileged.height": _plain((1,)),
    "privileged.torso": _plain(AXIAL),
    "privileged.joint_position": _join(MOVED, _pair(ARM)),
    "privileged.joint_velocity": _join(MOVED, _pair(ARM)),
    "privileged.hand_force": _pair(POLAR),
}
"""Reflection of each field of the walking task's observation, in one frame."""


def columns(fields: Mapping[str, tuple[slice, tuple[int, ...]]]) -> dict[str, tuple[np.ndarray, Mirror]]:
    """Columns of the policy's and of the critic's observation, and their reflections.

    The policy has all frames of what a robot senses; the critic the newest of what has no noise, and the privileged fields.
    """
    groups: dict[str, tuple[list[int], list[Mirror]]] = {"policy": ([], []), "critic": ([], [])}
    for name, (place, shape) in fields.items():
        is_privileged = name.startswith("privileged.")
        frames = 1 if is_privileged else shape[0]
        numbers = list(range(place.start, place.stop))
        if not is_privileged:
            groups["policy"][0].extend(numbers)
            groups["policy"][1].extend([FIELDS[name]] * frames)
        if is_privileged or name in ("command", "clock", "last_action"):
            groups["critic"][0].extend(numbers[-len(FIELDS[name][0]) :])
            groups["critic"][1].append(FIELDS[name])
    return {group: (np.array(index), _join(*mirrors)) for group, (index, mirrors) in groups.items()}


class Reflection(nn.Module):
    """Reflects vectors."""

    def __init__(self, mirror: Mirror) -> None:
        super().__init__()
        self.register_buffer("index", torch.tensor(mirror[0], dtype=torch.long), persistent=False)
        self.register_buffer("sign", torch.tensor(mirror[1], dtype=torch.float32), persistent=False)

    def forward(self, numbers: torch.Tensor) -> torch.Tensor:
        return numbers[..., self.index] * self.sign


class Symmetric(nn.Module):
    """A network whose reflected inputs give reflected outputs exactly, for the price of any network of its size.

    The units of a hidden layer come in pairs, of which the second sees what the first would see in the mirror. So half of the
    weights are free, and the others are those again, in another place.
    """

    def __init__(self, network: nn.Sequential, inputs: Mirror, outputs: Mirror) -> None:
        super().__init__()
        self.inputs, self.outputs = Reflection(inputs), Reflection(outputs)
        linear = [layer for layer in network if isinstance(layer, nn.Linear)]
        if any(layer.out_features % 2 for layer in linear[:-1]):
            raise ValueError("hidden layers have pairs of units: give even sizes")
        parts = [(layer.weight[: len(layer.weight) // 2], layer.bias[: len(layer.bias) // 2]) for layer in linear[:-1]]
        parts.append((linear[-1].weight[:, : linear[-1].in_features // 2], linear[-1].bias))
        self.weights = nn.ParameterList(weight.detach().clone() for weight, _ in parts)
        self.biases = nn.ParameterList(bias.detach().clone() for _, bias in parts)

    def layers(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Weight (outputs x inputs) and bias of each layer, as of a network without symmetry."""
        first, *hidden, last = self.weights
        weights = [torch.cat((first, self.inputs(first)))]
        weights += [torch.cat((weight, weight.roll(weight.shape[1] // 2, dims=1))) for weight in hidden]
        weights.append(torch.cat((last, self.outputs(last.T).T), dim=1))
        biases = [torch.cat((bias, bias)) for bias in self.biases[:-1]]
        biases.append(0.5 * (self.biases[-1] + self.outputs(self.biases[-1])))
        return list(zip(weights, biases))

    def forward(self, numbers: torch.Tensor) -> torch.Tensor:
        *hidden, (weight, bias) = self.layers()
        for hidden_weight, hidden_bias in hidden:
            numbers = nn.functional.elu(nn.functional.linear(numbers, hidden_weight, hidden_bias))
        return nn.functional.linear(numbers, weight, bias)


class SymmetricModel(MLPModel):
    """RSL-RL's model with the symmetry built in. Its normaliser learns from both halves, so that it obeys it too."""

    def __init__(self, *args: Any, inputs: Mirror, outputs: Mirror, **settings: Any) -> None:
        super().__init__(*args, obs_normalization=True, **settings)
        plain: nn.Sequential = self.mlp
        self.mlp: Symmetric = Symmetric(plain, inputs, outputs)

    def update_normalization(self, obs: TensorDict) -> None:
        numbers = torch.cat([obs[group] for group in self.obs_groups], dim=-1)
        self.obs_normalizer.update(torch.cat((numbers, self.mlp.inputs(numbers))))
