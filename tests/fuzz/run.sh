#!/usr/bin/env bash
# Fuzzes what strangers can send: bags, requests to the leaderboard, submissions of forged bags, messages, objects, meshes, frames of the
# page that drives the robot, and files of objects as Python reads them. Ends with an error at the first crash, hang or request for more than
# 1 GiB of memory; the input that did it is in target/fuzz/NAME.
#
#   tests/fuzz/run.sh [SECONDS] [TARGET...]        60 seconds for each of the targets below, where nothing is said
#
# Needs a C++ compiler for libFuzzer, and no nightly Rust; intake needs Python with numpy (FIATLUX_PYTHON, else python3). What was learnt is kept in target/fuzz/NAME/corpus. FIATLUX names the
# program that plays the first bag, which is built otherwise.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
root="$(cd "$here/../.." && pwd)"
seconds="${1:-60}"
shift $(($# > 0 ? 1 : 0))
targets=("$@")
[ "${#targets[@]}" -gt 0 ] || targets=(bag submission forged messages object meshes websocket intake)
target="${CARGO_TARGET_DIR:-$root/target}"

# Coverage by a pass that stable compilers have too.
RUSTC_WRAPPER="$here/instrument.sh" CARGO_TARGET_DIR="$target/fuzz/build" \
    cargo build --release --locked --manifest-path "$here/Cargo.toml"

bag="$target/fuzz/seed/S06.mcap"
if [ ! -f "$bag" ]; then
    if [ -z "${FIATLUX:-}" ]; then
        (cd "$root" && cargo build --release --locked --workspace --bin fiatlux)
        FIATLUX="$target/release/fiatlux"
    fi
    run="$(mktemp -d)"
    "$FIATLUX" evaluate --policy random --tasks S06 --seeds 0 --out "$run/run" >/dev/null
    mkdir -p "$target/fuzz/seed"
    cp "$(find "$run" -name '*.mcap' | head -n 1)" "$bag"
    rm -rf "$run"
fi

for name in "${targets[@]}"; do
    echo "== $name"
    if [ "$name" = intake ]; then
        "${FIATLUX_PYTHON:-python3}" "$here/intake.py" --seconds "$seconds" --out "$target/fuzz/intake"
        continue
    fi
    program="$target/fuzz/build/release/$name"
    corpus="$target/fuzz/$name/corpus"
    mkdir -p "$corpus"
    FIATLUX_FUZZ_SEEDS="$corpus" FIATLUX_FUZZ_BAG="$bag" "$program"
    "$program" -max_total_time="$seconds" -rss_limit_mb=1024 -malloc_limit_mb=1024 -timeout=10 -max_len=200000 \
        -print_final_stats=1 -artifact_prefix="$target/fuzz/$name/" "$corpus"
    rm -rf /dev/shm/fiatlux-fuzz-"$name"-*
done
