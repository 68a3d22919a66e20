"""A model server for a policy that LeRobot trained: ``python -m fiatlux.serve_lerobot CHECKPOINT``.

It speaks the protocol of Isaac GR00T's servers (MessagePack over ZeroMQ), so that the policy ``vla`` with ``--dialect gr00t``
can use it. The contract that it announces follows from the policy's features: ``observation.images.NAME`` is the camera NAME, or
views side by side, as :mod:`fiatlux.train_lerobot` names them: ``camera@-10+camera`` is the head camera ten rows ago and now.
``observation.state`` is the state ``state``, ``action`` the action ``action``, and a chunk has the policy's ``chunk_size`` rows.
The mapping ``lerobot_g1`` fits data sets of :func:`fiatlux.export_lerobot` with ``action="command"``. The reply to a bad request
says what is wrong. No pickle is read or written.

It needs the extra ``lerobot``.
"""

import argparse
import contextlib
import io
import sys
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from ._extras import check, missing
from ._inputs import views

LONGEST_REQUEST = 16 << 20
"""Longest request, bytes; ZeroMQ closes connections that send more."""

_IMAGES = "observation.images."
_STATE = "observation.state"
_LANGUAGE = "task"


class Refused(Exception):
    """A request that cannot be answered; its message goes back to the sender."""


class Model:
    """A LeRobot checkpoint.

    Args:
        checkpoint: The folder ``pretrained_model`` of a training run.
        device: Device of PyTorch, such as ``cuda``.

    Raises:
        ImportError: ``lerobot`` is not installed.
        FileNotFoundError: The folder holds no checkpoint.
        ValueError: This server cannot serve the policy; the message names the feature.
    """

    def __init__(self, checkpoint: Union[str, "PathLike[str]"], device: str = "cpu") -> None:
        folder = Path(checkpoint)
        if not (folder / "config.json").is_file():
            raise FileNotFoundError(f"no checkpoint at '{folder}'; name a folder pretrained_model with its config.json")
        try:
            import torch
            from lerobot.configs.policies import PreTrainedConfig
            from lerobot.policies.factory import get_policy_class, make_pre_post_processors
        except ImportError as error:
            raise missing("serve_lerobot", "lerobot", error) from error
        self._torch = torch
        config = PreTrainedConfig.from_pretrained(folder)
        config.device = device
        if config.n_obs_steps != 1:
            raise ValueError(f"the policy needs {config.n_obs_steps} observation steps; train one with n_obs_steps=1")
        shapes = {key: tuple(feature.shape) for key, feature in config.image_features.items()}
        self._views = {key: views(key.removeprefix(_IMAGES)) for key in shapes}
        self.images, self.deltas = _cameras(self._views, shapes)
        """Channels, height and width of each camera's pictures; and of which rows they are, the oldest first, 0 for now."""
        self.rows = len(config.action_delta_indices)
        """Number of rows in a chunk."""
        unknown = sorted(set(config.input_features) - set(shapes) - {_STATE})
        if unknown or _STATE not in config.input_features:
            raise ValueError(
                f"the policy's inputs are {sorted(config.input_features)}; serve one of {_STATE} and {_IMAGES}NAME"
            )
        self.width = int(config.input_features[_STATE].shape[0])
        """Length of the state."""
        self._policy = get_policy_class(config.type).from_pretrained(folder, config=config).eval()
        self._before, self._after = make_pre_post_processors(
            config, str(folder), preprocessor_overrides={"device_processor": {"device": device}}
        )

    def contract(self) -> dict[str, Any]:
        """GR00T's modality config."""

        def config(deltas: Sequence[int], keys: Sequence[str], **more: Any) -> dict[str, Any]:
            form = {"delta_indices": list(deltas), "modality_keys": list(keys), **more}
            return {"__ModalityConfig_class__": True, "as_dict": form}

        absolute = {"rep": "ABSOLUTE", "type": "NON_EEF", "format": "DEFAULT", "state_key": None}
        return {
            "video": config(self.deltas, list(self.images)),
            "state": config([0], ["state"]),
            "action": config(range(self.rows), ["action"], action_configs=[absolute]),
            "language": config([0], [_LANGUAGE]),
        }

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Returns a chunk, rows x numbers, for an observation with ``video``, ``state`` and ``language``.

        Raises:
            Refused: A key is missing, or its numbers have a wrong type or shape or are not finite.
        """
        torch = self._torch
        state = _array(observation, "state", "state", np.float32, (1, 1, self.width))
        if not np.isfinite(state).all():
            raise Refused("state 'state' is not finite")
        batch: dict[str, Any] = {_STATE: torch.from_numpy(state[:, 0].copy())}
        frames = {
            name: _array(observation, "video", name, np.uint8, (1, len(self.deltas), height, width, channels))
            for name, (channels, height, width) in self.images.items()
        }
        for key, seen in self._views.items():
            image = np.concatenate([frames[name][:, self.deltas.index(delta)] for name, delta in seen], axis=2)
            batch[key] = torch.from_numpy(image).permute(0, 3, 1, 2).float() / 255.0
        batch["task"] = [_words(observation)]
        with torch.inference_mode():
            chunk = self._policy.predict_action_chunk(self._before(batch))
            # The postprocessor expects one row at a time.
            actions = torch.cat([self._after(row[None]) for row in chunk[0]])
        return actions.to(torch.float32).cpu().numpy()


def _cameras(
    pictures: Mapping[str, list[tuple[str, int]]], shapes: Mapping[str, tuple[int, ...]]
) -> tuple[dict[str, tuple[int, ...]], list[int]]:
    """Shape of each camera's pictures, and the rows that all of them need, of a policy's pictures and their shapes."""
    cameras: dict[str, tuple[int, ...]] = {}
    rows: dict[str, list[int]] = {}
    for key, seen in pictures.items():
        channels, height, width = shapes[key]
        for name, delta in seen:
            shape = (channels, height, width // len(seen))
            if width % len(seen) or cameras.setdefault(name, shape) != shape or delta in rows.setdefault(name, []):
                raise ValueError(
                    f"the policy's input {key} of {list(shapes[key])} does not divide into its {len(seen)} views"
                )
            rows[name].append(delta)
    deltas = sorted({delta for of in rows.values() for delta in of}) or [0]
    if any(sorted(of) != deltas for of in rows.values()):
        raise ValueError(
            f"the policy's pictures are of other times for each camera ({rows}); GR00T's contract has one list"
        )
    return cameras, deltas


def _array(observation: Any, group: str, key: str, dtype: type, shape: tuple[int, ...]) -> NDArray[Any]:
    found = observation.get(group) if isinstance(observation, Mapping) else None
    array = found.get(key) if isinstance(found, Mapping) else None
    if not isinstance(array, np.ndarray):
        raise Refused(f"{group} has no '{key}'")
    if array.dtype != dtype or array.shape != shape:
        raise Refused(
            f"{group} '{key}' is {array.dtype} {list(array.shape)}; the model takes {np.dtype(dtype)} {list(shape)}"
        )
    return array


def _words(observation: Mapping[str, Any]) -> str:
    language = observation.get("language")
    words = language.get(_LANGUAGE) if isinstance(language, Mapping) else None
    for _ in range(2):
        words = words[0] if isinstance(words, list) and len(words) == 1 else None
    if not isinstance(words, str):
        raise Refused(f"language has no '{_LANGUAGE}' of the form [[WORDS]]")
    return words


def _packed(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        file = io.BytesIO()
        np.save(file, value, allow_pickle=False)
        return {"__ndarray_class__": True, "as_npy": file.getvalue()}
    raise TypeError(f"{type(value)} cannot be sent")


def _unpacked(value: dict[Any, Any]) -> Any:
    # GR00T's clients send arrays as a .npy file or, since N1.7, as the maps of msgpack-numpy.
    if "__ndarray_class__" in value:
        return np.load(io.BytesIO(value["as_npy"]), allow_pickle=False)
    if b"nd" in value:
        if value.get(b"kind"):
            raise Refused("an array is not of plain numbers")
        return np.frombuffer(value[b"data"], np.dtype(value[b"type"])).reshape(value.get(b"shape", ()))
    return value


def answer(model: Model, data: bytes) -> bytes:
    """The reply to a request. If it cannot be answered, the reply is a map with ``error``."""
    try:
        import msgpack
    except ImportError as error:
        raise missing("serve_lerobot", "lerobot", error) from error

    try:
        try:
            request = msgpack.unpackb(data, object_hook=_unpacked)
        except Exception as error:
            raise Refused(f"the request cannot be read: {error}") from error
        if not isinstance(request, dict):
            raise Refused("the request is not a map")
        endpoint = request.get("endpoint", "get_action")
        reply: Any
        if endpoint == "ping":
            reply = {"status": "ok", "message": "Server is running"}
        elif endpoint == "get_modality_config":
            reply = model.contract()
        elif endpoint == "reset":
            # A chunk depends on one observation only, so there is no state to reset.
            reply = {}
        elif endpoint == "get_action":
            given = request.get("data")
            chunk = model.act(given.get("observation") if isinstance(given, dict) else None)
            reply = [{"action": chunk[None]}, {}]
        else:
            raise Refused(f"Unknown endpoint: {endpoint!r}")
    except Refused as error:
        reply = {"error": str(error)}
    packed: bytes = msgpack.packb(reply, default=_packed)
    return packed


def serve(model: Model, host: str = "127.0.0.1", port: int = 5555) -> None:
    """Answers one request at a time until interrupted; prints ``listening tcp://HOST:PORT`` when ready.

    Args:
        model: The policy to serve.
        host: Address to listen on; ``0.0.0.0`` for all, which lets everybody on the network send requests.
        port: Port to listen on; 0 picks a free one.
    """
    check("serve_lerobot", "lerobot", "zmq", "msgpack")
    import zmq

    with zmq.Context() as context, context.socket(zmq.REP) as socket:
        socket.setsockopt(zmq.MAXMSGSIZE, LONGEST_REQUEST)
        socket.setsockopt(zmq.LINGER, 0)
        socket.bind(f"tcp://{host}:{port or '*'}")
        print(f"listening {socket.getsockopt_string(zmq.LAST_ENDPOINT)}", flush=True)
        while True:
            socket.send(answer(model, socket.recv()))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line, and returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m fiatlux.serve_lerobot", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("checkpoint", help="folder pretrained_model of a LeRobot training run")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on; 0.0.0.0 for the whole network")
    parser.add_argument("--port", type=int, default=5555, help="port to listen on; 0 picks a free one [default: 5555]")
    parser.add_argument("--threads", type=int, default=1, help="threads of PyTorch [default: 1]")
    parser.add_argument("--device", default="cpu", help="device of PyTorch, such as cuda [default: cpu]")
    given = parser.parse_args(arguments)
    try:
        # LeRobot prints while it loads.
        with contextlib.redirect_stdout(sys.stderr):
            model = Model(given.checkpoint, given.device)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        print(f"serve_lerobot: {error}", file=sys.stderr)
        return 1
    model._torch.set_num_threads(max(1, given.threads))
    try:
        serve(model, given.host, given.port)
    except ImportError as error:
        print(f"serve_lerobot: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
