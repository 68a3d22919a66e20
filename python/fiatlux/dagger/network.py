"""The network of the policy ``see``, and its file."""

import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn

from .._files import regular
from ..settings import ROBOTS, Robot
from ..whole_body import LEGS_AND_WAIST

FORMAT = "fiatlux-see/1"
"""Name and version of the contract's layout, as ``crates/policies/src/see/network.rs`` reads it."""
CENTRE, SPREAD = 127.5, 64.0
"""A byte of a picture counts as (byte - CENTRE) / SPREAD."""
BODY = 10
"""Numbers of the pelvis that it reads: turning, rad/s, direction of gravity, velocity, m/s, all in the pelvis frame, and height, m."""
MOVED = 4
"""Numbers that say where the robot was when it took an old picture."""
SPEEDS = (0.3, 0.2, 0.4)
"""Velocities that count as 1: ahead and to the left, m/s, and about the vertical, rad/s."""
WALKS = 4
"""Numbers that come out first: the velocity, and above 0 where it rather stands."""
POSTURE = 4
"""Those of one that has hands come next: height, m, roll, pitch and yaw, rad; then the targets of arms and hands, rad."""
CLOCKS = (25, 75, 200, 500)
"""Times up to which the time in a phase is read, control steps: each becomes a number from 0 to 1."""
MIN_DEVIATION = 0.02
DROPPED = 0.1
"""Share of the numbers between layers that training leaves out at random; none where hands must be exact."""
MIN_MOVE = 0.05
"""Least deviation of what it moves, m or rad, so that what hardly moves does not count more than it is worth."""


@dataclass(frozen=True)
class Shape:
    """Sizes of a network, as its contract has them."""

    tasks: tuple[str, ...]
    cameras: tuple[str, ...] = ("camera", "chest_camera")
    picture: tuple[int, int] = (128, 128)
    """Width and height, pixels."""
    every: int = 5
    """Control steps from one decision to the next."""
    ages: tuple[int, ...] = (0, 50, 150)
    """Ages of the pictures that it sees, control steps, multiples of :attr:`every`."""
    convolutions: tuple[tuple[int, int, int], ...] = ((32, 5, 2), (64, 3, 2), (96, 3, 2), (128, 3, 2), (32, 1, 1))
    """Output channels, window and stride of each."""
    embedding: int = 128
    hidden: tuple[int, ...] = (256, 256)
    blind: bool = False
    """It sees grey instead of pictures: a twin that shows what they are worth."""
    robot: Robot = ROBOTS[0]
    """The robot that it learns on."""
    joints: tuple[str, ...] = ()
    """Of a network that has hands: all joints of the robot, whose angles it reads, in each control step where it works with its hands. It moves
    arms and hands there."""
    touched: int = 0
    """Bodies of the hands whose force it feels."""
    phases: tuple[str, ...] = ()
    """Of a network that keeps in mind what it does: the expert's phases. It chooses one in each decision, and reads in the next one which
    that was, and for how long."""

    finds: tuple[str, ...] = ()
    """Of a network that says where things are: names of the numbers. One without phases says nothing else; of one with phases they come out
    last."""

    @property
    def acts(self) -> bool:
        """True if it says what to do."""
        return not self.finds or bool(self.phases)

    @property
    def sensed(self) -> int:
        """Numbers of the body that it reads."""
        return BODY + len(self.joints) + self.touched

    @property
    def state(self) -> int:
        """Numbers that the head reads beside embeddings."""
        if not self.acts:
            return self.measured
        return self.measured + (len(self.phases) + len(CLOCKS) if self.phases else 0) + len(self.tasks)

    @property
    def measured(self) -> int:
        """The first of them, whose scales come from data."""
        return self.sensed + MOVED * (len(self.ages) - 1)

    @property
    def moves(self) -> int:
        """Numbers that say what posture, arms and hands do."""
        return POSTURE + len(self.joints) - LEGS_AND_WAIST if self.joints else 0

    @property
    def outputs(self) -> int:
        """Numbers that come out."""
        acted = WALKS + self.moves + len(self.phases) if self.acts else 0
        return acted + len(self.finds)

    @property
    def reads(self) -> list[tuple[Any, ...]]:
        """A name for each number that the head reads."""
        seen = itertools.product(self.ages, self.cameras, range(self.embedding))
        names = [*seen, *zip(["sensed"] * self.sensed, range(self.sensed))]
        names += itertools.product(["moved"], self.ages[1:], range(MOVED))
        if not self.acts:
            return names
        names += [("phase", name) for name in self.phases] + [("clock", most) for most in CLOCKS if self.phases]
        return names + [("task", name) for name in self.tasks]

    @property
    def says(self) -> list[tuple[Any, ...]]:
        """A name for each number that comes out."""
        acted = [("acts", index) for index in range(WALKS + self.moves)] + [("phase", name) for name in self.phases]
        return (acted if self.acts else []) + [("finds", name) for name in self.finds]


class Eye(nn.Module):
    """The encoder of a camera."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        layers, channels, (width, height) = [], 3, shape.picture
        for outputs, kernel, stride in shape.convolutions:
            layers.append(nn.Conv2d(channels, outputs, kernel, stride, kernel // 2))
            channels, width, height = outputs, -(-width // stride), -(-height // stride)
        self.convolutions = nn.ModuleList(layers)
        self.embedding = nn.Linear(channels * width * height, shape.embedding)

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """Embeddings of pictures, which are normalised, count x 3 x height x width."""
        for layer in self.convolutions:
            pictures = torch.relu(layer(pictures))
        # Channels innermost, as the policy has them.
        return nn.functional.elu(self.embedding(pictures.permute(0, 2, 3, 1).flatten(1)))


class Network(nn.Module):
    """An encoder for each camera, and a head that reads what they made of a few pictures, and where the robot was then."""

    mean: torch.Tensor
    deviation: torch.Tensor
    centre: torch.Tensor
    scale: torch.Tensor

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.shape = shape
        self.eyes = nn.ModuleList(Eye(shape) for _ in shape.cameras)
        sizes = [shape.embedding * len(shape.cameras) * len(shape.ages) + shape.state, *shape.hidden]
        self.head = nn.ModuleList(nn.Linear(*pair) for pair in zip(sizes, sizes[1:]))
        self.last = nn.Linear(sizes[-1], shape.outputs)
        self.goal = nn.Linear(sizes[-1], 2)
        self.register_buffer("mean", torch.zeros(shape.state))
        self.register_buffer("deviation", torch.ones(shape.state))
        # An answer is centre + scale x number.
        self.register_buffer("centre", torch.zeros(shape.outputs))
        self.register_buffer("scale", torch.ones(shape.outputs))

    def normalise(self, states: torch.Tensor, moves: torch.Tensor, keeps_answers: bool = False) -> None:
        """Takes the scales of the measured part of the state from data, and those of posture and joints; of a network that has been
        trained, so that its answers stay as they are."""
        numbers = self.shape.measured
        mean, deviation, centre, scale = (each.clone() for each in (self.mean, self.deviation, self.centre, self.scale))
        mean[:numbers] = states[:, :numbers].mean(0)
        deviation[:numbers] = states[:, :numbers].std(0).clamp(min=MIN_DEVIATION)
        scale[: len(SPEEDS)] = scale.new_tensor(SPEEDS)
        if self.shape.joints:
            centre[WALKS : WALKS + self.shape.moves] = moves.mean(0)
            scale[WALKS : WALKS + self.shape.moves] = moves.std(0).clamp(min=MIN_MOVE)
        if keeps_answers:
            first, last, seen = self.head[0], self.last, self.head[0].in_features - self.shape.state
            with torch.no_grad():
                weight = first.weight[:, seen:] / self.deviation
                first.bias += weight @ (mean - self.mean)
                first.weight[:, seen:] = weight * deviation
                last.weight *= (self.scale / scale)[:, None]
                last.bias.copy_((self.centre + self.scale * last.bias - centre) / scale)
        self.mean, self.deviation, self.centre, self.scale = mean, deviation, centre, scale

    def encode(self, pictures: torch.Tensor) -> torch.Tensor:
        """Embeddings of pictures, which are normalised: count x cameras x 3 x height x width becomes count x numbers."""
        if self.shape.blind:
            pictures = torch.zeros_like(pictures)
        return torch.cat([eye(pictures[:, camera]) for camera, eye in enumerate(self.eyes)], dim=1)

    def decide(self, seen: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The answer in units of :attr:`scale`, and where the goal is, from embeddings (count x ages x numbers) and state."""
        dropped = 0.0 if self.shape.joints else DROPPED
        seen = nn.functional.dropout(seen.flatten(1), dropped, self.training)
        numbers = torch.cat([seen, (state - self.mean) / self.deviation], dim=1)
        for layer in self.head:
            numbers = nn.functional.dropout(nn.functional.elu(layer(numbers)), dropped, self.training)
        return self.last(numbers), self.goal(numbers)

    def keep(self, checkpoint: Path, record: dict[str, Any]) -> None:
        """Writes a checkpoint, whole or not at all: a run that is ended here goes on before it."""
        part_file = checkpoint.with_suffix(".part")
        torch.save({"shape": asdict(self.shape), "network": self.state_dict(), "record": record}, part_file)
        os.replace(part_file, checkpoint)

    def answer(self, output: torch.Tensor) -> torch.Tensor:
        """Numbers of :meth:`decide` in m/s, rad/s, m and rad."""
        return self.centre + self.scale * output


def normalised(pictures: torch.Tensor) -> torch.Tensor:
    """Pictures of bytes, ... x height x width x 3, as the network reads them, ... x 3 x height x width."""
    return ((pictures.float() - CENTRE) / SPREAD).movedim(-1, -3)


def varied(pictures: torch.Tensor, generator: torch.Generator, shifted: int) -> torch.Tensor:
    """Normalised pictures with another contrast, brightness and tint for each decision, all shifted alike by some pixels; count x ages x
    cameras x 3 x height x width."""

    def drawn(most: float, *shape: int) -> torch.Tensor:
        number = torch.rand((len(pictures), 1, 1, *shape, 1, 1), device=pictures.device, generator=generator)
        return most * (2 * number - 1)

    if shifted:
        down, right = torch.randint(-shifted, shifted + 1, (2,), device=pictures.device, generator=generator).tolist()
        pictures = torch.roll(pictures, (down, right), dims=(-2, -1))
    return pictures * (1 + drawn(0.2, 1)) + drawn(0.4, 1) + drawn(0.2, 3)


def learning_rate(highest: float, step: int, steps: int) -> float:
    """The learning rate of a step of training: it rises in the first 200, then falls along a cosine to a fiftieth."""
    return highest * min(1, step / 200) * (0.02 + 0.49 * (1 + math.cos(math.pi * step / steps)))


def on_device(lessons: Sequence[Any], device: str) -> torch.Tensor:
    """The pictures of lessons, one after the other, in the memory of a device."""
    count, first = sum(len(lesson.pictures) for lesson in lessons), 0
    pictures = torch.empty((count, *lessons[0].pictures.shape[1:]), dtype=torch.uint8, device=device)
    for lesson in lessons:
        for part in range(0, len(lesson.pictures), 4096):
            some = torch.from_numpy(np.array(lesson.pictures[part : part + 4096]))
            pictures[first : first + len(some)] = some.to(device)
            first += len(some)
    return pictures


def export(network: Network, file: Path, training: dict[str, Any], stands_from: float = 0.0) -> None:
    """Writes the file of a network, in half precision; ``stands_from`` is the number from which it stands, which is 0 in the file."""
    shape = network.shape
    if stands_from and not shape.acts:
        raise ValueError("--stands-from: a network that finds a place does not say whether to stand")
    layers = {name: tensor.double().cpu() for name, tensor in network.state_dict().items()}
    tensors: dict[str, torch.Tensor] = {}
    for own, name in _eyes(shape):
        unseen = 0.0 if shape.blind and name.endswith(".0") else 1.0
        tensors[f"{name}.weight"] = unseen * layers[f"{own}.weight"]
        tensors[f"{name}.bias"] = layers[f"{own}.bias"]
    head = [[layers[f"{own}.weight"], layers[f"{own}.bias"]] for own, _ in _head(shape)]
    # The scales of the state go into the first layer, those of the answer into the last one.
    weight, bias = head[0]
    seen = weight.shape[1] - shape.state
    scaled = weight[:, seen:] / layers["deviation"]
    head[0] = [torch.cat([weight[:, :seen], scaled], dim=1), bias - scaled @ layers["mean"]]
    (weight, bias), centre = head[-1], layers["centre"].clone()
    centre[WALKS - 1] -= stands_from
    head[-1] = [weight * layers["scale"][:, None], bias * layers["scale"] + centre]
    for (_, name), (weight, bias) in zip(_head(shape), head):
        tensors[f"{name}.weight"], tensors[f"{name}.bias"] = weight, bias
    tensors = {name: tensor.half().contiguous() for name, tensor in tensors.items()}
    if not all(tensor.isfinite().all() for tensor in tensors.values()):
        raise ValueError(
            f"{file}: the network has numbers that are not finite in half precision; take an earlier round"
        )
    random = torch.Generator().manual_seed(0)
    width, height = shape.picture
    pictures = torch.randint(0, 256, (len(shape.cameras), height, width, 3), generator=random)
    state = layers["mean"] + layers["deviation"] * torch.randn(shape.state, generator=random, dtype=torch.float64)
    tensors |= {f"check.{camera}": picture.float() for camera, picture in zip(shape.cameras, pictures)}
    tensors |= {"check.state": state.float(), "check.output": _answer(shape, tensors, pictures, state).float()}
    contract = {"format": FORMAT, **asdict(shape), "training": training}
    part_file = file.with_suffix(".part")
    save_file(tensors, part_file, metadata={"contract": json.dumps(contract)})
    os.replace(part_file, file)


def grown(small: Network, shape: Shape) -> Network:
    """A network of a larger shape that answers what a smaller one does: it reads and says more, and its layers may be wider. What is new
    counts nothing for what is old.

    Raises:
        ValueError: The shape lacks something that the small network has.
    """
    of, large = small.shape, Network(shape)
    equal = ("cameras", "picture", "every", "convolutions", "blind", "joints", "touched")
    others = [f"{name} {getattr(of, name)}" for name in equal if getattr(of, name) != getattr(shape, name)]
    others += [
        f"{name} {', '.join(map(str, more))}"
        for name in ("tasks", "ages", "phases", "finds")
        if (more := [each for each in getattr(of, name) if each not in getattr(shape, name)])
    ]
    wide = [(*each.hidden, each.embedding) for each in (of, shape)]
    if len(wide[0]) != len(wide[1]) or any(one > other for one, other in zip(*wide)):
        others.append(f"layers of {wide[0]} numbers")
    if others:
        raise ValueError(
            f"the network has what the new one lacks: {'; '.join(others)}; name its --tasks, --ages and --picture, too"
        )
    reads, says = (
        [theirs.index(name) for name in own] for own, theirs in ((of.reads, shape.reads), (of.says, shape.says))
    )
    state = [place - len(shape.reads) + shape.state for place in reads[-of.state :]]
    with torch.no_grad():
        for old, new in zip(small.eyes, large.eyes):
            new.convolutions.load_state_dict(old.convolutions.state_dict())
            new.embedding.weight[: of.embedding] = old.embedding.weight
            new.embedding.bias[: of.embedding] = old.embedding.bias
        olds, news = ((*network.head, network.last, network.goal) for network in (small, large))
        for old, new in zip(olds, news):
            rows = says if old is small.last else list(range(old.out_features))
            columns = reads if old is small.head[0] else list(range(old.in_features))
            new.weight[rows] = 0.0
            new.weight[np.ix_(rows, columns)] = old.weight
            new.bias[rows] = old.bias
        large.mean[state], large.deviation[state] = small.mean, small.deviation
        large.centre[says], large.scale[says] = small.centre, small.scale
    return large


def read(file: Path) -> tuple[Network, dict[str, Any]]:
    """The network of a file that :func:`export` wrote, and the record of its training. What training alone uses begins anew.

    Raises:
        ValueError: The file was not written so.
    """
    try:
        with safe_open(file, "pt") as opened:
            contract = json.loads((opened.metadata() or {}).get("contract", "{}"))
            tensors = {name: opened.get_tensor(name).float() for name in opened.keys()}
    except (SafetensorError, json.JSONDecodeError) as error:
        raise ValueError(f"{file} is not the file of a network: {error}") from error
    made = contract.pop("format", None) if isinstance(contract, dict) else None
    if made != FORMAT:
        raise ValueError(f"{file} has the format {made!r}; {FORMAT!r} is read")
    record = contract.pop("training", {})
    try:
        network = Network(Shape(**{name: _fixed(value) for name, value in contract.items()}))
        layers = dict(network.state_dict())
        for own, name in (*_eyes(network.shape), *_head(network.shape)):
            for part in ("weight", "bias"):
                layers[f"{own}.{part}"] = tensors[f"{name}.{part}"]
        network.load_state_dict(layers)
    except (TypeError, KeyError, RuntimeError) as error:
        raise ValueError(f"{file} does not fit its own contract: {error}") from error
    return network, record


def load(checkpoint: Path, device: str) -> tuple[Network, dict[str, Any]]:
    """The network of a checkpoint, or of a file that `see` plays, and the record of its training."""
    if checkpoint.suffix == ".safetensors":
        network, record = read(regular(checkpoint))
        return network.to(device).eval(), record
    state = torch.load(regular(checkpoint), map_location=device, weights_only=True)
    network = Network(Shape(**state["shape"])).to(device).eval()
    network.load_state_dict(state["network"])
    return network, state["record"]


def _eyes(shape: Shape) -> Iterator[tuple[str, str]]:
    """Names of an encoder's layers in the network, and in the file."""
    for number, camera in enumerate(shape.cameras):
        for index in range(len(shape.convolutions)):
            yield f"eyes.{number}.convolutions.{index}", f"{camera}.{index}"
        yield f"eyes.{number}.embedding", f"{camera}.embedding"


def _head(shape: Shape) -> Iterator[tuple[str, str]]:
    """The same of the layers behind the encoders."""
    layers = len(shape.hidden)
    for index in range(layers):
        yield f"head.{index}", f"head.{index}"
    yield "last", f"head.{layers}"


def _fixed(value: Any) -> Any:
    """A list of JSON, and the lists in it, as tuples."""
    return tuple(map(_fixed, value)) if isinstance(value, list) else value


def _answer(
    shape: Shape, tensors: Mapping[str, torch.Tensor], pictures: torch.Tensor, state: torch.Tensor
) -> torch.Tensor:
    """The answer of a file's network where each camera saw one picture at all ages."""

    def layer(name: str) -> tuple[torch.Tensor, torch.Tensor]:
        return tensors[f"{name}.weight"].double(), tensors[f"{name}.bias"].double()

    seen = []
    for camera, picture in zip(shape.cameras, normalised(pictures).double()):
        for index, (_, kernel, stride) in enumerate(shape.convolutions):
            weight, bias = layer(f"{camera}.{index}")
            picture = torch.relu(nn.functional.conv2d(picture[None], weight, bias, stride, kernel // 2))[0]
        weight, bias = layer(f"{camera}.embedding")
        seen.append(nn.functional.elu(weight @ picture.permute(1, 2, 0).flatten() + bias))
    numbers = torch.cat([*seen * len(shape.ages), state])
    for index in range(len(shape.hidden) + 1):
        weight, bias = layer(f"head.{index}")
        numbers = weight @ numbers + bias
        numbers = nn.functional.elu(numbers) if index < len(shape.hidden) else numbers
    return numbers
