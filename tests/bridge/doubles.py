"""Doubles of model servers, on the libraries that real ones use: pyzmq, msgpack, numpy, websockets, openpi-client.

    python doubles.py serve --dialect gr00t [--embodiment unitree_g1] [--delay 0.145] [--fault nan] ...
    python doubles.py arrays

`serve` prints `listening PORT` and answers until it is ended. It refuses requests that a real server would refuse: types of
elements, dimensions, batch, keys; and requests whose bytes are not those that the real library makes of the same content.
The answer holds the posture that the request has. `arrays` prints arrays as both encodings have them, one JSON line each.
Written from the published protocols; no code of a model server is in here.
"""

import argparse
import io
import json
import sys
import threading
import time

import msgpack
import numpy as np

ARM, HAND = 7, 7
LEGS = {"left_leg": 6, "right_leg": 6}
HANDS = {"left_hand": HAND, "right_hand": HAND}
ARMS = {"left_arm": ARM, "right_arm": ARM}
WRISTS = {"left_wrist_eef_9d": 9, "right_wrist_eef_9d": 9}
BODY = {"base_height_command": 1, "navigate_command": 3}
LANGUAGE = "annotation.human.task_description"
EMBODIMENTS = {
    "unitree_g1": {
        "delta": [0],
        "state": LEGS | {"waist": 3} | ARMS | HANDS,
        "action": ARMS | HANDS | {"waist": 3} | BODY,
        "relative": set(ARMS),
        "horizon": 30,
    },
    "real_g1": {
        "delta": [-20, 0],
        "state": WRISTS | HANDS | ARMS | {"waist": 3},
        "action": WRISTS | HANDS | ARMS | {"waist": 3} | BODY,
        "relative": set(WRISTS) | set(ARMS),
        "horizon": 40,
    },
    "unitree_g1_sonic": {
        "delta": [0],
        "state": LEGS | {"waist": 3} | ARMS | HANDS | {"projected_gravity": 3},
        "action": {"motion_token": 64, "left_hand_joints": HAND, "right_hand_joints": HAND},
        "relative": set(),
        "horizon": 40,
    },
}


class Refused(Exception):
    """A request that a real server would refuse."""


def require(holds, message):
    if not holds:
        raise Refused(message)


# GR00T's serialisation.


def gr00t_default(value):
    if isinstance(value, np.ndarray):
        file = io.BytesIO()
        np.save(file, value, allow_pickle=False)
        return {"__ndarray_class__": True, "as_npy": file.getvalue()}
    raise TypeError(type(value))


def gr00t_hook(value):
    if "__ndarray_class__" in value:
        return np.load(io.BytesIO(value["as_npy"]), allow_pickle=False)
    return value


def gr00t_pack(value):
    return msgpack.packb(value, default=gr00t_default)


def gr00t_unpack(data):
    return msgpack.unpackb(data, object_hook=gr00t_hook)


class Model:
    """Shared by all dialects: delay, faults, and the share of time that it was busy."""

    def __init__(self, args):
        self.args = args
        self.lock = threading.Lock()
        self.busy_s, self.first, self.last, self.count = 0.0, None, None, 0

    def infer(self, make):
        """Answers one request at a time."""
        with self.lock:
            start = time.monotonic()
            self.first = self.first or start
            time.sleep(self.args.delay)
            self.count += 1
            if self.args.fault == "die" and self.count > self.args.after:
                sys.stdout.flush()
                import os

                os._exit(1)
            answer = make()
            self.last = time.monotonic()
            self.busy_s += self.last - start
            if self.args.stats:
                whole = self.last - self.first
                line = {"requests": self.count, "busy_s": self.busy_s, "whole_s": whole, "busy": self.busy_s / whole}
                with open(self.args.stats, "w") as file:
                    json.dump(line, file)
            return answer

    def is_faulty(self, fault):
        return self.args.fault == fault and self.count > self.args.after

    def spoil(self, actions):
        """Faults of the numbers."""
        if self.is_faulty("nan"):
            actions.flat[actions.size // 2] = np.nan
        if self.is_faulty("shape"):
            actions = actions[..., :-1]
        return actions

    def keep_frame(self, frame):
        if self.args.save_frame and self.count == 0:
            height, width, _ = frame.shape
            with open(self.args.save_frame, "wb") as file:
                file.write(b"P6 %d %d 255\n" % (width, height) + frame.tobytes())


# GR00T.


def check_gr00t(observation, embodiment, size):
    require(set(observation) == {"video", "state", "language"}, f"groups are {sorted(observation)}")
    frames = len(embodiment["delta"])
    require("ego_view" in observation["video"], "video has no 'ego_view'")
    video = observation["video"]["ego_view"]
    require(video.dtype == np.uint8, f"video is {video.dtype}")
    require(video.ndim == 5, f"video has {video.ndim} dimensions")
    require(video.shape == (1, frames, size[1], size[0], 3), f"video has shape {video.shape}")
    for key, width in embodiment["state"].items():
        require(key in observation["state"], f"state has no '{key}'")
        state = observation["state"][key]
        require(state.dtype == np.float32, f"{key} is {state.dtype}")
        require(state.ndim == 3, f"{key} has {state.ndim} dimensions")
        require(state.shape == (1, 1, width), f"{key} has shape {state.shape}")
        require(np.isfinite(state).all(), f"{key} is not finite")
    words = observation["language"].get(LANGUAGE)
    is_nested = isinstance(words, list) and len(words) == 1 and isinstance(words[0], list) and len(words[0]) == 1
    require(is_nested and isinstance(words[0][0], str), f"language is {words!r}")


def nested(flat):
    """The flat keys of the sim wrapper as nested ones."""
    observation = {"video": {}, "state": {}, "language": {}}
    for key, value in flat.items():
        group, _, rest = key.partition(".")
        if group in ("video", "state"):
            observation[group][rest] = value
        else:
            require(isinstance(value, list) and isinstance(value[0], str), f"{key} is {value!r}")
            observation["language"][key] = [value]
    return observation


def motion_tokens(count, horizon, width):
    """Tokens within their limits that differ from row to row and from chunk to chunk."""
    return 0.9 * np.sin(0.4 * np.arange(width) + 0.05 * np.arange(horizon)[:, None] + count)


def gr00t_actions(model, observation, embodiment, args):
    horizon = embodiment["horizon"]
    actions = {}
    for key, width in embodiment["action"].items():
        source = key.removesuffix("_joints")
        if source in observation["state"]:
            row = observation["state"][source][0, 0]
        elif key == "base_height_command":
            row = np.array([0.75])
        elif key == "navigate_command":
            row = np.array(args.navigate)
        elif key == "motion_token":
            actions[key] = motion_tokens(model.count, horizon, width)[None].astype(np.float32)
            if model.is_faulty("token"):
                actions[key][0, 3, 5] = 1.3
            continue
        else:
            row = np.zeros(width)
        actions[key] = np.repeat(row[None, None].astype(np.float32), horizon, axis=1)
        if key == "left_arm":
            by_row, by_chunk = args.ramp
            ramp = (-1) ** model.count * (by_chunk + by_row * np.arange(horizon))
            actions[key] += ramp[None, :, None].astype(np.float32)
    first = next(iter(actions))
    actions[first] = model.spoil(actions[first])
    return actions


def modality(embodiment):
    def config(deltas, keys, **more):
        form = {"delta_indices": deltas, "modality_keys": list(keys), **more}
        return {"__ModalityConfig_class__": True, "as_dict": form}

    def action(key):
        is_eef = key.endswith("eef_9d")
        return {
            "rep": "RELATIVE" if key in embodiment["relative"] else "ABSOLUTE",
            "type": "EEF" if is_eef else "NON_EEF",
            "format": "XYZ_ROT6D" if is_eef else "DEFAULT",
            "state_key": None,
        }

    keys = list(embodiment["action"])
    return {
        "video": config(embodiment["delta"], ["ego_view"]),
        "state": config([0], embodiment["state"]),
        "action": config(list(range(embodiment["horizon"])), keys, action_configs=[action(key) for key in keys]),
        "language": config([0], [LANGUAGE]),
    }


def serve_gr00t(args):
    import zmq

    model, embodiment = Model(args), EMBODIMENTS[args.embodiment]
    is_flat = args.dialect == "gr00t-flat"
    socket = zmq.Context().socket(zmq.REP)
    socket.setsockopt(zmq.MAXMSGSIZE, 64 << 20)
    port = socket.bind_to_random_port("tcp://127.0.0.1") if args.port == 0 else args.port
    if args.port:
        socket.bind(f"tcp://127.0.0.1:{args.port}")
    print(f"listening {port}", flush=True)

    def answer(data):
        request = gr00t_unpack(data)
        require(gr00t_pack(request) == data, "the bytes are not those of msgpack and numpy")
        if args.token:
            require(request.get("api_token") == args.token, "Unauthorized: Invalid API token")
        endpoint = request.get("endpoint", "get_action")
        if endpoint == "ping":
            return {"status": "ok", "message": "Server is running"}
        if endpoint == "get_modality_config":
            return modality(embodiment)
        if endpoint == "reset":
            require(request["data"] == {"options": None}, f"reset has {request['data']!r}")
            return {}
        require(endpoint == "get_action", f"Unknown endpoint: {endpoint}")
        observation = request["data"]["observation"]
        observation = nested(observation) if is_flat else observation
        check_gr00t(observation, embodiment, args.size)
        model.keep_frame(observation["video"]["ego_view"][0, -1])

        def make():
            if model.is_faulty("error"):
                raise Refused("CUDA error: device-side assert triggered")
            actions = gr00t_actions(model, observation, embodiment, args)
            if is_flat:
                actions = {f"action.{key}": value for key, value in actions.items()}
            if model.is_faulty("huge"):
                actions["huge"] = np.zeros(2 << 20, dtype=np.float32)
            return [actions, {}]

        return model.infer(make)

    while True:
        data = socket.recv()
        try:
            reply = gr00t_pack(answer(data))
        except Refused as error:
            reply = gr00t_pack({"error": str(error)})
        socket.send(reply)


# openpi and what is made of it.


def flat_layout(dialect, size):
    """Keys of images and state, the instruction's key, width and rows of the actions."""
    if dialect == "openpi":
        return {"observation/image": (224, 224)}, {"observation/state": 20}, "prompt", 23, 50
    if dialect == "behavior":
        camera = "robot_r1::robot_r1:zed_link:Camera:0::rgb"
        return {camera: (224, 224)}, {"robot_r1::proprio": 23}, None, 23, 16
    cameras = {"observation/exterior_image_0_left": (224, 224), "observation/wrist_image_left": (224, 224)}
    return cameras, {"observation/joint_position": 7, "observation/gripper_position": 1}, "prompt", 8, 10


def flat_actions(dialect, observation, navigate, width, rows):
    if dialect == "openpi":
        row = np.concatenate([observation["observation/state"], navigate])
    elif dialect == "behavior":
        row = observation["robot_r1::proprio"].copy()
        row[:3] = navigate
    else:
        row = np.concatenate([observation["observation/joint_position"], observation["observation/gripper_position"]])
    return np.repeat(row[None].astype(np.float32), rows, axis=0)


def serve_flat(args):
    from openpi_client import msgpack_numpy
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import serve

    model = Model(args)
    images, states, language, width, rows = flat_layout(args.dialect, args.size)

    def check(observation):
        extra = {"openpi": set(), "behavior": {"__action_chunk_size__"}, "roboarena": {"session_id", "endpoint"}}
        expected = set(images) | set(states) | ({language} if language else set()) | extra[args.dialect]
        require(set(observation) == expected, f"keys are {sorted(observation)}")
        for key, (wide, high) in images.items():
            image = observation[key]
            require(image.dtype == np.uint8, f"{key} is {image.dtype}")
            require(image.shape == (high, wide, 3), f"{key} has shape {image.shape}")
        for key, count in states.items():
            state = observation[key]
            require(state.dtype == np.float32, f"{key} is {state.dtype}")
            require(state.shape == (count,), f"{key} has shape {state.shape}")
            require(np.isfinite(state).all(), f"{key} is not finite")
        if language:
            require(isinstance(observation[language], str), f"{language} is {observation[language]!r}")

    def infer(observation):
        def make():
            if model.is_faulty("error"):
                raise Refused("Traceback (most recent call last): RuntimeError: CUDA out of memory")
            actions = model.spoil(flat_actions(args.dialect, observation, args.navigate, width, rows))
            if model.is_faulty("huge"):
                actions = np.zeros((1 << 18, width), dtype=np.float32)
            if args.dialect == "openpi":
                return {"actions": actions, "server_timing": {"infer_ms": 1000 * args.delay}}
            if args.dialect == "behavior":
                require(observation["__action_chunk_size__"] == rows, "another chunk is asked for")
                return {"action": actions[0], "action_chunk": actions, "server_timing": {"infer_ms": 1.0}}
            return actions

        return model.infer(make)

    def handler(socket):
        packer = msgpack_numpy.Packer()
        if args.key and socket.request.headers.get("Authorization") != f"Api-Key {args.key}":
            return socket.close(4401, "who are you")
        metadata = {}
        if args.dialect == "roboarena":
            metadata = {
                "image_resolution": (224, 224),
                "n_external_cameras": 1,
                "needs_wrist_camera": True,
                "needs_stereo_camera": False,
                "needs_session_id": True,
                "action_space": "joint_position",
            }
        socket.send(packer.pack(metadata))
        while True:
            try:
                data = socket.recv()
            except ConnectionClosed:
                return None
            try:
                observation = msgpack_numpy.unpackb(data)
                require(msgpack_numpy.Packer().pack(observation) == data, "the bytes are not those of openpi-client")
                if args.dialect == "behavior" and observation == {"reset": True}:
                    continue
                if args.dialect == "roboarena" and observation == {"endpoint": "reset"}:
                    socket.send("reset successful")
                    continue
                check(observation)
                model.keep_frame(observation[next(iter(images))])
                socket.send(packer.pack(infer(observation)))
            except Refused as error:
                socket.send(str(error))
                return socket.close(1011, "Internal server error. Traceback included in previous frame.")

    with serve(handler, "127.0.0.1", args.port, compression=None, max_size=None) as server:
        print(f"listening {server.socket.getsockname()[1]}", flush=True)
        server.serve_forever()


def arrays():
    """Arrays in both encodings, as the real libraries write them."""
    from openpi_client import msgpack_numpy

    random = np.random.default_rng(0)
    shapes = [(), (1,), (7,), (1, 1, 2), (3, 4), (1, 30, 7), (0, 3), (12345,), (2, 2, 2, 2, 2)]
    for dtype in ["|b1", "|u1", "<i4", "<i8", "<f2", "<f4", "<f8"]:
        for shape in shapes:
            array = np.asarray(random.normal(size=shape) * 100).astype(dtype)
            line = {"dtype": dtype, "shape": list(shape), "gr00t": gr00t_pack(array).hex()}
            # openpi's packer has no form of its own for empty shapes: they are single numbers.
            line["openpi"] = msgpack_numpy.Packer().pack(array).hex()
            line["sum"] = float(np.nansum(array.astype(np.float64)))
            print(json.dumps(line))
    turned = np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3))
    line = {"dtype": "<f4", "shape": [2, 3], "gr00t": gr00t_pack(turned).hex(), "fortran": True, "sum": 15.0}
    print(json.dumps(line))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    command = parser.add_subparsers(dest="command", required=True)
    command.add_parser("arrays")
    serve = command.add_parser("serve")
    serve.add_argument("--dialect", required=True)
    serve.add_argument("--embodiment", default="unitree_g1", choices=EMBODIMENTS)
    serve.add_argument("--port", type=int, default=0)
    serve.add_argument("--delay", type=float, default=0.0)
    serve.add_argument("--fault", default="", choices=["", "nan", "shape", "error", "huge", "die", "token"])
    serve.add_argument("--after", type=int, default=0, help="answers that are good before the fault")
    serve.add_argument("--size", type=lambda text: [int(side) for side in text.split("x")], default=[640, 480])
    serve.add_argument("--navigate", type=lambda text: [float(part) for part in text.split(",")], default=[0.0] * 3)
    serve.add_argument(
        "--ramp",
        type=lambda text: [float(part) for part in text.split(",")],
        default=[0.0] * 2,
        help="what GR00T's left arm moves from row to row, and at once, forth and back from chunk to chunk, rad",
    )
    serve.add_argument("--token", help="refuse GR00T requests without this API token")
    serve.add_argument("--key", help="refuse WebSocket clients without this API key")
    serve.add_argument("--stats", help="file for the share of time that the model was busy")
    serve.add_argument("--save-frame", help="file for the first picture, as PPM")
    args = parser.parse_args()
    if args.command == "arrays":
        return arrays()
    if args.dialect.startswith("gr00t"):
        return serve_gr00t(args)
    return serve_flat(args)


if __name__ == "__main__":
    sys.exit(main())
