"""PyTorch's features of the head camera: writes fixtures/features.json and times one thread.

    cargo run --release -p fiatlux-features --example write_weights -- target/resnet18.safetensors
    python3 tests/oracle/features.py target/resnet18.safetensors [--time-only [--json]]

The network is written out with torch.nn.functional. It runs twice: with the weights of the file, and with batch norms of
the formula in `with_norms`, since those of seeded weights do nothing. Makes its own virtual environment in target/ on the
first run; PyTorch needs several GB there.
"""

import argparse
import hashlib
import json
import time
from pathlib import Path

import environment

HERE = Path(__file__).resolve().parent
VENV = HERE.parents[1] / "target" / "features-venv"

SIDE = 256
MEAN = [0.485, 0.456, 0.406]
STD = [0.229, 0.224, 0.225]
DIGITS = 9
REPEATS = 60


environment.enter(__file__, VENV, HERE / "features.requirements.txt")

import torch  # noqa: E402
import torch.nn.functional as F  # noqa: E402
from safetensors.torch import load_file  # noqa: E402


def images():
    """The three test images, which the Rust test makes by the same integer formulas."""
    ramp = bytes(v for y in range(SIDE) for x in range(SIDE) for v in (x, y, (x + y) // 2))
    noise, state = bytearray(), 1
    for _ in range(3 * SIDE * SIDE):
        state = (state * 1664525 + 1013904223) % 2**32
        noise.append(state >> 24)
    boxes = bytes(
        200 * ((x // 32 + y // 32 + c) % 2) + (x * y + 17 * c) % 56
        for y in range(SIDE)
        for x in range(SIDE)
        for c in range(3)
    )
    return {"ramp": ramp, "noise": bytes(noise), "boxes": boxes}


def with_norms(weights):
    """The same convolutions with batch norms that are not the identity; channel i's numbers are exact in f32."""
    changed = dict(weights)
    for name in weights:
        if name.endswith(".running_var"):
            norm = name.removesuffix("running_var")
            i = torch.arange(len(weights[name]))
            changed[norm + "weight"] = 0.5 + (i % 7) / 8.0
            changed[norm + "bias"] = (i % 5 - 2) / 4.0
            changed[norm + "running_mean"] = (i % 3 - 1) / 2.0
            changed[norm + "running_var"] = 0.25 + (i % 11) / 4.0
    return changed


def normalised(rgb, dtype):
    image = torch.frombuffer(bytearray(rgb), dtype=torch.uint8).reshape(1, SIDE, SIDE, 3).permute(0, 3, 1, 2)
    mean, std = (torch.tensor(v, dtype=dtype).reshape(1, 3, 1, 1) for v in (MEAN, STD))
    return (image.to(dtype) / 255 - mean) / std


def network(weights, x):
    """ResNet-18 up to the average; `weights` with batch norms, or with those folded into NAME.bias of the convolutions."""

    def conv(x, name, norm, stride=1):
        w = weights[name + ".weight"]
        x = F.conv2d(x, w, weights.get(name + ".bias"), stride=stride, padding=w.shape[-1] // 2)
        if norm + ".running_mean" not in weights:
            return x
        mean, var = weights[norm + ".running_mean"], weights[norm + ".running_var"]
        return F.batch_norm(x, mean, var, weights[norm + ".weight"], weights[norm + ".bias"], eps=1e-5)

    x = F.max_pool2d(F.relu(conv(x, "conv1", "bn1", 2)), 3, stride=2, padding=1)
    for layer in range(1, 5):
        for block in range(2):
            at = f"layer{layer}.{block}."
            stride = 2 if layer > 1 and block == 0 else 1
            y = F.relu(conv(x, at + "conv1", at + "bn1", stride))
            y = conv(y, at + "conv2", at + "bn2")
            x = F.relu(y + (conv(x, at + "downsample.0", at + "downsample.1", stride) if stride == 2 else x))
    return x.mean(dim=(2, 3))[0]


def folded(weights):
    """Without batch norm, for the fastest form of PyTorch."""
    out = {}
    for name, w in weights.items():
        if w.dim() != 4:
            continue
        name = name.removesuffix(".weight")
        norm = name.replace("conv", "bn").replace("downsample.0", "downsample.1")
        scale = weights[norm + ".weight"] / torch.sqrt(weights[norm + ".running_var"] + 1e-5)
        out[name + ".weight"] = w * scale.reshape(-1, 1, 1, 1)
        out[name + ".bias"] = weights[norm + ".bias"] - weights[norm + ".running_mean"] * scale
    return out


def timing(weights, as_json):
    """Median and least milliseconds of a frame on one thread, in the forms that PyTorch offers."""
    medians = []
    image = normalised(images()["noise"], torch.float32)
    last = dict(memory_format=torch.channels_last)
    flat = folded(weights)
    forms = {
        "batch norm": (weights, image),
        "folded": (flat, image),
        "folded, channels last": ({k: v.to(**last) if v.dim() == 4 else v for k, v in flat.items()}, image.to(**last)),
    }
    for form, (w, x) in forms.items():
        times = []
        for _ in range(REPEATS):
            started = time.perf_counter()
            network(w, x)
            times.append(1e3 * (time.perf_counter() - started))
        times.sort()
        medians.append(times[REPEATS // 2])
        if as_json:
            continue
        print(f"PyTorch {torch.__version__}, {form}: least {times[0]:.1f}, median {times[REPEATS // 2]:.1f} ms a frame")
    if as_json:
        print(json.dumps({"torch": torch.__version__, "fastest_median_ms": min(medians)}))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path)
    parser.add_argument("--time-only", action="store_true")
    parser.add_argument("--json", action="store_true", help="with --time-only: the fastest form's median")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    weights = load_file(arguments.weights)
    with torch.inference_mode():
        timing(weights, arguments.json)
        if arguments.time_only:
            return
        cases = {}
        for case, w in {"seeded": weights, "norms": with_norms(weights)}.items():
            w64 = {name: tensor.double() for name, tensor in w.items()}
            cases[case] = {}
            for image, rgb in images().items():
                features = network(w, normalised(rgb, torch.float32))
                exact = network(w64, normalised(rgb, torch.float64))
                off = (features.double() - exact).abs().max() / exact.max()
                print(f"{case}, {image}: largest {exact.max():.4g}, PyTorch's f32 against its f64 {off:.1e}")
                cases[case][image] = [float(f"{value:.{DIGITS}g}") for value in features.tolist()]
    fixture = {
        "what": "ResNet-18 features by PyTorch in f32: case, image, channel",
        "torch": torch.__version__,
        "weights_sha256": hashlib.sha256(arguments.weights.read_bytes()).hexdigest(),
        "cases": cases,
    }
    path = HERE / "fixtures" / "features.json"
    path.write_text(json.dumps(fixture, separators=(",", ":")).replace("],", "],\n") + "\n")
    print(f"wrote {path}")


main()
