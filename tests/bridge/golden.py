"""Messages of model servers in every form that published servers have sent, for `crates/bridge/src/dialect/golden.jsonl`.

    python golden.py > crates/bridge/src/dialect/golden.jsonl

The bytes are those of the real packages (`requirements.txt`; the file was made with msgpack 1.2.4, msgpack-numpy 0.4.8,
openpi-client 0.1.2 and NumPy 1.26.4). Only the classes of GR00T, which is no package, are written here as its servers pack them.
"""

import io
import json

import msgpack
import msgpack_numpy
import numpy as np
from openpi_client import msgpack_numpy as openpi


def npy(value):
    """Arrays as GR00T N1.5, N1.6 and early N1.7 pack them."""
    file = io.BytesIO()
    np.save(file, value, allow_pickle=False)
    return {"__ndarray_class__": True, "as_npy": file.getvalue()}


def pack_npy(value):
    return msgpack.packb(value, default=npy)


def pack_numpy(value):
    """Arrays as GR00T N1.7 packs them."""
    return msgpack.packb(value, default=msgpack_numpy.encode)


def pack_old(value):
    """As packers without the type for bytes write it: keys and data are texts."""
    return msgpack.packb(value, default=msgpack_numpy.encode, use_bin_type=False)


ROWS = np.arange(6, dtype=np.float32).reshape(1, 3, 2) - 1
ARRAYS = {
    "float32": ROWS,
    "float64": ROWS.astype(np.float64),
    "float16": ROWS.astype(np.float16),
    "big-endian float32": ROWS.astype(">f4"),
    "big-endian int64": ROWS.astype(">i8"),
    "int8": ROWS.astype(np.int8),
    "int16": ROWS.astype(np.int16),
    "int32": ROWS.astype(np.int32),
    "int64": ROWS.astype(np.int64),
    "uint8": (ROWS + 1).astype(np.uint8),
    "uint16": (ROWS + 1).astype(np.uint16),
    "uint32": (ROWS + 1).astype(np.uint32),
    "uint64": (ROWS + 1).astype(np.uint64),
    "bool": ROWS > 1,
    "Fortran": np.asfortranarray(ROWS),
    "strided": np.arange(24, dtype=np.float32).reshape(2, 6, 2)[:1, ::2] / 2 - 1,
    "backwards": ROWS[:, ::-1],
    "0-d": np.array(2.5, dtype=np.float32),
    "scalar": np.float32(2.5),
    "bool scalar": np.bool_(True),
    "int scalar": np.int64(-3),
}


def config(keys, deltas, **more):
    return {"delta_indices": deltas, "modality_keys": keys, **more}


N15 = {"sin_cos_embedding_keys": None, "mean_std_embedding_keys": None}
ACTIONS = [
    {"rep": "RELATIVE", "type": "NON_EEF", "format": "DEFAULT", "state_key": None},
    {"rep": "ABSOLUTE", "type": "NON_EEF", "format": "DEFAULT", "state_key": None},
]


def contracts():
    """The same modality config in each form."""

    def forms(wrap, prefix="", actions=ACTIONS, deltas=list):
        return {
            "video": wrap(config([f"{prefix and 'video.'}ego_view"], deltas([-20, 0]))),
            "state": wrap(config([f"{prefix and 'state.'}waist"], deltas([0]))),
            "action": wrap(config([f"{prefix and 'action.'}left_arm", f"{prefix and 'action.'}waist"], deltas([0, 1, 2]), action_configs=actions)),
            "language": wrap(config(["annotation.human.task_description"], deltas([0]))),
        }

    def marked(marker, form, change=lambda config: config):
        return lambda config: {marker: True, form: change(config)}

    old, new = "__ModalityConfig_class__", "__ModalityConfig__"
    yield "N1.5: JSON, keys with their modality", pack_npy(forms(marked(old, "as_json", json.dumps), "long", None))
    yield "N1.6: JSON", pack_npy(forms(marked(old, "as_json", json.dumps)))
    yield "N1.6: JSON as bytes", pack_npy(forms(marked(old, "as_json", lambda config: json.dumps(config).encode())))
    yield "N1.7 early: a map", pack_npy(forms(marked(old, "as_json")))
    yield "N1.7 client copy: as_dict", pack_npy(forms(marked(old, "as_dict")))
    yield "N1.7: a map, msgpack-numpy", pack_numpy(forms(marked(new, "as_json")))
    yield "N1.7 with byte keys", pack_numpy(forms(marked(new.encode(), b"as_json")))
    yield "N1.7 with deltas as arrays", pack_numpy(forms(marked(new, "as_json"), deltas=np.array))
    yield "early N1.7 with deltas as arrays", pack_npy(forms(marked(old, "as_json"), deltas=np.array))
    yield "a plain map", pack_npy(forms(lambda config: config))
    enums = [{"rep": {"__enum__": "ActionRepresentation", "value": action["rep"].lower()}} for action in ACTIONS]
    wrapped = forms(lambda config: {"__dataclass__": "ModalityConfig", "fields": config}, actions=enums)
    yield "dataclasses and enums of other relatives", pack_numpy(wrapped)


def chunks():
    """The same chunk as servers of each dialect answer it: `left_arm` 2 numbers, or one unnamed table."""
    actions = {"left_arm": ROWS}
    flat = {"action.left_arm": ROWS}
    yield "gr00t", "N1.6: a list of actions and info", pack_npy((actions, {}))
    yield "gr00t", "N1.7: msgpack-numpy", pack_numpy((actions, {}))
    yield "gr00t", "N1.7: msgpack-numpy without the type for bytes", pack_old((actions, {}))
    yield "gr00t", "nested lists", msgpack.packb(({"left_arm": ROWS.tolist()}, {}))
    yield "gr00t", "lists of arrays", pack_numpy(({"left_arm": [list(ROWS[0])]}, {}))
    yield "gr00t", "N1.5: a map, no batch", pack_npy({"action.left_arm": ROWS[0]})
    yield "gr00t-flat", "sim wrapper", pack_npy((flat, {}))
    yield "gr00t-flat", "sim wrapper, msgpack-numpy", pack_numpy((flat, {}))
    timing = {"server_timing": {"infer_ms": 12.5}}
    yield "openpi", "openpi-client", openpi.packb({"actions": ROWS[0], **timing})
    yield "openpi", "openpi-client, with a batch", openpi.packb({"actions": ROWS, **timing})
    yield "openpi", "msgpack-numpy", pack_numpy({"actions": ROWS[0], **timing})
    yield "openpi", "nested lists", msgpack.packb({"actions": ROWS[0].tolist(), **timing})
    yield "openpi", "one key action", openpi.packb({"action": ROWS[0]})
    yield "openpi", "StarVLA: wrapped", openpi.packb({"status": "ok", "ok": True, "request_id": "default", "data": {"actions": ROWS}})
    yield "behavior", "openpi-client", openpi.packb({"action": ROWS[0, 0], "action_chunk": ROWS[0], **timing})
    yield "behavior", "openpi-client, with a batch", openpi.packb({"action": ROWS[:, 0], "action_chunk": ROWS, **timing})
    yield "roboarena", "a bare array", openpi.packb(ROWS[0])
    yield "roboarena", "a bare array of msgpack-numpy", pack_numpy(ROWS[0])
    yield "roboarena", "bare lists", msgpack.packb(ROWS[0].tolist())
    yield "roboarena", "a map", openpi.packb({"actions": ROWS[0]})


def main():
    def line(kind, name, data, **more):
        print(json.dumps({"kind": kind, "name": name, "hex": data.hex(), **more}))

    packers = {"npy": pack_npy, "msgpack-numpy": pack_numpy, "old msgpack-numpy": pack_old, "openpi": openpi.packb}
    for form, pack in packers.items():
        for name, array in ARRAYS.items():
            if form == "npy" and not isinstance(array, np.ndarray):
                continue
            numbers = np.asarray(array, dtype=np.float64)
            line("array", f"{form}, {name}", pack(array), shape=list(numbers.shape), numbers=numbers.ravel().tolist())
    for name, data in contracts():
        line("contract", name, data)
    for dialect, name, data in chunks():
        line("chunk", name, data, dialect=dialect)


if __name__ == "__main__":
    main()
