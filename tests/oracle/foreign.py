"""Controllers of others, computed in Python: random networks built as the published ones, and the targets they give.

    FIATLUX_PYTHON tests/oracle/foreign.py FOLDER [--small] [--seed N]

Writes Balance.onnx, Walk.onnx, model_decoder.onnx, model_encoder.onnx and targets.safetensors to FOLDER. Observations are written out with
numpy from the published descriptions (docs/controllers.md), the networks run in onnxruntime. What is sensed and commanded in
each step follows from `sequence`, which the Rust test (crates/foreign/tests/it/oracle.rs) has too. `--small` gives networks
of a few kB; those of seed 1 are committed in crates/foreign/tests/fixtures:

    FIATLUX_PYTHON tests/oracle/foreign.py crates/foreign/tests/fixtures --small --seed 1

With `--play gear.nvidia`, `gear.lerobot` or `sonic` it writes no networks but plays those in FOLDER on what a JSON on standard
input says of each step (the keys of `sequence`; a waist's angles `waist` in place of a torso), and prints the targets as JSON.

Needs numpy, onnx and onnxruntime (foreign.requirements.txt).
"""

import argparse
import json
import sys
from collections import deque
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

STEPS = 240
# Widths of the published networks, and small ones: GEAR's estimator and actor, SONIC's decoder.
SIZES = {
    False: ([516, 256, 256, 35], [121, 512, 256, 256, 15], [994, 2048, 2048, 1024, 1024, 512, 512, 29]),
    True: ([516, 4, 35], [121, 4, 15], [994, 4, 29]),
}

# Standing posture of the session's robot: positions are relative to it.
Q0 = np.zeros(29)
Q0[[0, 6]], Q0[[3, 9]], Q0[[4, 10]] = -0.05, 0.2, -0.15


def sequence():
    """Observation, command and token of each step: a formula in integers, so that Rust has the same bits."""
    state = 1

    def draw(count, scale):
        nonlocal state
        numbers = np.empty(count)
        for i in range(count):
            state = (state * 1664525 + 1013904223) % 2**32
            numbers[i] = ((state >> 8) / 2**23 - 1.0) * scale
        return numbers

    commands = [(0.0, 0.0, 0.0), (0.4, -0.1, 0.2), (0.03, 0.02, -0.01), (-0.2, 0.3, -0.6)]
    for step in range(STEPS):
        yield {
            "angular_velocity": draw(3, 1.0),
            "gravity": np.array([0.0, 0.0, -1.0]) + draw(3, 0.25),
            "position": draw(29, 0.5),
            "velocity": draw(29, 4.0),
            "token": draw(64, 1.0),
            "command": np.array(commands[step // 60]),
            "height": 0.74 - 0.001 * (step % 60),
            "torso": np.array([0.1, -0.2, 0.3]) * (step % 7),
        }


class Gear:
    """NVlabs/GR00T-WholeBodyControl, decoupled_wbc, and the same in huggingface/lerobot."""

    DEFAULT = np.zeros(29)
    DEFAULT[[0, 6]], DEFAULT[[3, 9]], DEFAULT[[4, 10]] = -0.1, 0.3, -0.2
    READINGS = {"nvidia": (0.5, [2.0, 2.0, 0.5]), "lerobot": (0.25, [2.0, 2.0, 0.25])}

    def __init__(self, folder, reading):
        self.balance, self.walk = session(folder / "Balance.onnx"), session(folder / "Walk.onnx")
        self.angular, self.command = self.READINGS[reading]
        self.frames = deque([np.zeros(86, np.float32)] * 6, maxlen=6)
        self.action = np.zeros(15, np.float32)

    def step(self, seen):
        frame = np.zeros(86, np.float32)
        frame[0:3] = seen["command"] * self.command
        frame[3] = seen["height"]
        frame[4:7] = seen["torso"]
        frame[7:10] = seen["angular_velocity"] * self.angular
        frame[10:13] = seen["gravity"]
        frame[13:42] = (Q0 + seen["position"]) - self.DEFAULT
        frame[42:71] = seen["velocity"] * 0.05
        frame[71:86] = self.action
        self.frames.append(frame)
        network = self.balance if np.linalg.norm(seen["command"]) < 0.05 else self.walk
        self.action = run(network, np.concatenate(self.frames))
        return self.DEFAULT[:15] + 0.25 * self.action


class Sonic:
    """The decoder of GEAR-SONIC: NVlabs/GR00T-WholeBodyControl, gear_sonic_deploy."""

    # Joints by name, in the order of Isaac Lab and in that of the SDK.
    SIDES = ["left", "right"]
    LEG = ["hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll"]
    ARM = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw"]
    WAIST = ["waist_yaw", "waist_roll", "waist_pitch"]
    BODY = (
        [f"left_{j}" for j in LEG]
        + [f"right_{j}" for j in LEG]
        + WAIST
        + [f"left_{j}" for j in ARM]
        + [f"right_{j}" for j in ARM]
    )
    ISAAC = (
        "hip_pitch waist_yaw hip_roll waist_roll hip_yaw waist_pitch knee shoulder_pitch ankle_pitch shoulder_roll "
        "ankle_roll shoulder_yaw elbow wrist_roll wrist_pitch wrist_yaw"
    )
    MOTORS = {
        "7520_22": (139.0, 0.025101925),
        "7520_14": (88.0, 0.010177520),
        "5020": (25.0, 0.003609725),
        "4010": (5.0, 0.00425),
    }

    def __init__(self, folder):
        self.decoder = session(folder / "model_decoder.onnx")
        both = [[j] if j.startswith("waist") else [f"left_{j}", f"right_{j}"] for j in self.ISAAC.split()]
        isaac = [joint for joints in both for joint in joints]
        self.order = [self.BODY.index(joint) for joint in isaac]
        self.default = np.array([self.angle(joint) for joint in isaac])
        self.scale = np.array([self.action_scale(joint) for joint in isaac])
        self.past = {
            name: deque([np.zeros(n, np.float32)] * 10, maxlen=10)
            for name, n in [("angular_velocity", 3), ("position", 29), ("velocity", 29), ("action", 29)]
        }
        self.past["gravity"] = deque([np.array([0, 0, -1], np.float32)] * 10, maxlen=10)
        self.action = np.zeros(29, np.float32)

    @staticmethod
    def angle(joint):
        if joint.endswith("shoulder_roll"):
            return 0.2 if joint.startswith("left") else -0.2
        angles = {"hip_pitch": -0.312, "knee": 0.669, "ankle_pitch": -0.363, "shoulder_pitch": 0.2, "elbow": 0.6}
        return angles.get(joint.removeprefix("left_").removeprefix("right_"), 0.0)

    def action_scale(self, joint):
        motors = {
            "hip_pitch": "7520_22",
            "hip_roll": "7520_22",
            "knee": "7520_22",
            "hip_yaw": "7520_14",
            "waist_yaw": "7520_14",
            "wrist_pitch": "4010",
            "wrist_yaw": "4010",
        }
        effort, armature = self.MOTORS[motors.get(joint.removeprefix("left_").removeprefix("right_"), "5020")]
        return 0.25 * effort / (armature * (2 * np.pi * 10) ** 2)

    def step(self, seen):
        now = {
            "angular_velocity": seen["angular_velocity"],
            "position": (Q0 + seen["position"])[self.order] - self.default,
            "velocity": seen["velocity"][self.order],
            "action": self.action,
            "gravity": seen["gravity"],
        }
        for name, numbers in now.items():
            self.past[name].append(numbers.astype(np.float32))
        blocks = [np.concatenate(self.past[name]) for name in now]
        self.action = run(self.decoder, np.concatenate([seen["token"].astype(np.float32), *blocks]))
        targets = np.empty(29)
        targets[self.order] = self.default + self.scale * self.action
        return targets


def session(path):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def run(network, observation):
    return network.run(None, {network.get_inputs()[0].name: observation[None]})[0][0]


class Network:
    """An ONNX file under construction."""

    def __init__(self, random):
        self.random, self.nodes, self.tensors = random, [], []

    def node(self, operator, inputs, **attributes):
        """Adds a node; an input that is a list becomes a tensor."""
        inputs = [name if isinstance(name, str) else self.tensor(np.array(name, np.int64)) for name in inputs]
        made = f"{operator}{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, inputs, [made], **attributes))
        return made

    def tensor(self, numbers):
        name = f"tensor{len(self.tensors)}"
        self.tensors.append(numpy_helper.from_array(np.ascontiguousarray(numbers), name))
        return name

    def layers(self, at, sizes, activation, as_gemm):
        """Dense layers as PyTorch exports them: with Gemm, or with MatMul and Add."""
        for layer, (inputs, outputs) in enumerate(zip(sizes, sizes[1:])):
            if layer:
                at = activation(at)
            weight = (self.random.standard_normal((outputs, inputs)) / np.sqrt(inputs)).astype(np.float32)
            bias = self.tensor((0.1 * self.random.standard_normal(outputs)).astype(np.float32))
            if as_gemm:
                at = self.node("Gemm", [at, self.tensor(weight), bias], transB=1)
            else:
                at = self.node("Add", [bias, self.node("MatMul", [at, self.tensor(weight.T)])])
        return at

    def elu(self, at):
        return self.node("Elu", [at])

    def silu(self, at):
        return self.node("Mul", [at, self.node("Sigmoid", [at])])

    def save(self, path, inputs, at, outputs, batch, opset):
        self.nodes.append(helper.make_node("Identity", [at], ["actions"]))
        ports = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch, width])
            for name, width in [("obs", inputs), ("actions", outputs)]
        ]
        graph = helper.make_graph(self.nodes, "policy", ports[:1], ports[1:], self.tensors)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
        onnx.checker.check_model(model)
        onnx.save(model, path)


def write_gear(path, estimator, actor, random, batch, as_gemm):
    """An estimator makes a velocity and a code of unit length from the history; the actor gets them and the last frame."""
    net = Network(random)
    estimate = net.layers("obs", estimator, net.elu, as_gemm)
    velocity, code = (net.node("Slice", [estimate, [first], [last], [1]]) for first, last in [(0, 3), (3, 2**63 - 1)])
    length = net.node("Clip", [net.node("ReduceL2", [code], axes=[-1], keepdims=1), net.tensor(np.float32(1e-12))])
    code = net.node("Div", [code, net.node("Expand", [length, net.node("Shape", [code])])])
    frame = net.node("Slice", ["obs", [-86], [2**63 - 1], [1]])
    action = net.layers(net.node("Concat", [frame, velocity, code], axis=1), actor, net.elu, as_gemm)
    net.save(path, estimator[0], action, actor[-1], batch, 17)


def write_sonic(path, sizes, random):
    """Token and proprioception pass the decoder as a sequence of one."""
    net = Network(random)
    parts = [net.node("Slice", ["obs", [first], [last], [-1], [1]]) for first, last in [(0, 64), (-930, 2**63 - 1)]]
    sequence = net.node("Concat", [net.node("Unsqueeze", [part, [1]]) for part in parts], axis=-1)
    action = net.node("Slice", [net.layers(sequence, sizes, net.silu, as_gemm=False), [0], [29], [2], [1]])
    net.save(path, sizes[0], net.node("Squeeze", [action, [1]]), sizes[-1], 1, 13)


ENCODED = [0, *range(911, 929), *range(1559, 1577), *range(1631, 1637), *range(1685, 1697), *range(1745, 1751), 4, 5, 6]
"""Inputs of SONIC's encoder, release 1.1, that the one for tests halves: its mode, six joints of the first and of the last frame,
orientations and wrists of both, and three inputs of another mode."""


def write_encoder(path):
    nodes = [helper.make_node("Gather", ["obs_dict", "which"], ["chosen"], axis=1)]
    nodes.append(helper.make_node("Mul", ["chosen", "half"], ["token"]))
    constants = [numpy_helper.from_array(np.array(ENCODED, np.int64), "which")]
    constants.append(numpy_helper.from_array(np.array([0.5], np.float32), "half"))
    ends = [helper.make_tensor_value_info("obs_dict", TensorProto.FLOAT, [1, 1751])]
    ends.append(helper.make_tensor_value_info("token", TensorProto.FLOAT, [1, len(ENCODED)]))
    graph = helper.make_graph(nodes, "encoder", ends[:1], ends[1:], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())


def write_safetensors(path, tensors, metadata=None):
    header, data = {"__metadata__": metadata} if metadata else {}, b""
    for name, numbers in tensors.items():
        begin = len(data)
        data += numbers.astype("<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": list(numbers.shape), "data_offsets": [begin, len(data)]}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(len(text).to_bytes(8, "little") + text + data)


def torso(waist):
    """Roll, pitch and yaw of a torso on a waist of yaw, roll and pitch."""
    (cy, cr, cp), (sy, sr, sp) = np.cos(waist), np.sin(waist)
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    turn = yaw @ roll @ pitch
    return np.array([np.arctan2(turn[2, 1], turn[2, 2]), -np.arcsin(turn[2, 0]), np.arctan2(turn[1, 0], turn[0, 0])])


def play(folder, name):
    """Targets of what standard input says, as a list a step."""
    player = Sonic(folder) if name == "sonic" else Gear(folder, name.removeprefix("gear."))
    targets = []
    for seen in json.load(sys.stdin):
        seen = {key: np.array(numbers) for key, numbers in seen.items()}
        if "waist" in seen:
            seen["torso"] = torso(seen["waist"])
        targets.append(player.step(seen).tolist())
    json.dump(targets, sys.stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--play", choices=["gear.nvidia", "gear.lerobot", "sonic"])
    arguments = parser.parse_args()
    if arguments.play:
        return play(arguments.folder, arguments.play)
    folder, (estimator, actor, decoder) = arguments.folder, SIZES[arguments.small]
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(arguments.seed)
    write_gear(folder / "Balance.onnx", estimator, actor, random, 1, as_gemm=True)
    write_gear(folder / "Walk.onnx", estimator, actor, random, "batch", as_gemm=False)
    write_sonic(folder / "model_decoder.onnx", decoder, random)
    write_encoder(folder / "model_encoder.onnx")
    players = {f"gear.{reading}": Gear(folder, reading) for reading in Gear.READINGS}
    players["sonic"] = Sonic(folder)
    targets = {name: np.array([player.step(seen) for seen in sequence()]) for name, player in players.items()}
    write_safetensors(folder / "targets.safetensors", targets)
    for name, numbers in targets.items():
        print(f"{name}: {numbers.shape[0]} steps, targets from {numbers.min():.3f} to {numbers.max():.3f} rad")


if __name__ == "__main__":
    main()
