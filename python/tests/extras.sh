#!/usr/bin/env bash
# The checks of the package that need its extras, each in a fresh environment with the wheel and that extra:
#
#     python/tests/extras.sh [train] [ray] [lerobot] [mujoco] [assets]     (all without names)
#
# Each gets what today's pip resolves. PyTorch is downloaded twice, since the trainers and lerobot ask for versions that differ.
# FIATLUX_WHEEL names a wheel that is built already, FIATLUX_TEST_PROGRAM the program fiatlux, without which lerobot's tests of
# delays and commands are skipped, and FIATLUX_TEST_RUN a folder of bags for the benchmarks.
set -euo pipefail
cd "$(dirname "$0")/../.."
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
extras=("$@")
failed=()
[ ${#extras[@]} -gt 0 ] || extras=(train ray lerobot mujoco assets)

wheel="${FIATLUX_WHEEL:-}"
if [ -z "$wheel" ]; then
    python3 -m venv "$work/build"
    "$work/build/bin/pip" install --quiet "maturin>=1.9.4,<2"
    "$work/build/bin/maturin" build --release --locked --quiet -m python/Cargo.toml --out "$work/wheels"
    wheel="$(echo "$work"/wheels/fiatlux-*.whl)"
fi

for extra in "${extras[@]}"; do
    echo "== $extra"
    python3 -m venv "$work/$extra"
    "$work/$extra/bin/pip" install --quiet --upgrade pip
    "$work/$extra/bin/pip" install --quiet "fiatlux[$extra] @ file://$(cd "$(dirname "$wheel")" && pwd)/$(basename "$wheel")" "pytest>=8"
    case "$extra" in
        train) tests=(extras/test_rsl_rl.py extras/test_stable_baselines3.py extras/test_train.py extras/test_dagger.py test_fingerprint.py) ;;
        ray) tests=(extras/test_ray.py) ;;
        lerobot) tests=(extras/test_lerobot.py) ;;
        mujoco) tests=(test_benchmarks.py test_planning.py test_examples.py) ;;
        assets) tests=(extras/test_assets.py extras/test_formats.py) ;;
        *)
            echo "extras.sh: unknown extra '$extra'; known ones are train, ray, lerobot, mujoco, assets" >&2
            exit 2
            ;;
    esac
    # A missing package is a failure here, not a reason to skip.
    FIATLUX_EXTRAS=1 "$work/$extra/bin/python" -m pytest -q "${tests[@]/#/python/tests/}" || failed+=("$extra")
    rm -rf "${work:?}/$extra"
done
if [ ${#failed[@]} -gt 0 ]; then
    echo "extras.sh: failed: ${failed[*]}" >&2
    exit 1
fi
