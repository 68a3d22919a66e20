#!/usr/bin/env bash
# One wheel with everything: the Python package, and the programs fiatlux, sim-server, recorder, policy-client and scorer as
# commands of the environment it is installed into. Needs Rust, a C compiler and Python 3.10 or newer.
#
#   python/wheel.sh [DIR]     writes DIR/fiatlux-VERSION-....whl [default: wheels]
set -euo pipefail
out="${1:-wheels}"
# macOS has no `realpath -m`.
case "$out" in /*) ;; *) out="$PWD/$out" ;; esac
cd "$(dirname "$0")/.."
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
programs=(fiatlux sim-server recorder policy-client scorer)

# One build for both, in the same target folder: the wheel shares nearly all of it with the programs.
cargo build --release --locked --features network -p fiatlux -p sim-server -p policy-client -p scorer --bins
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "maturin>=1.9.4,<2" "wheel>=0.45"
"$work/venv/bin/maturin" build --release --locked --quiet -m python/Cargo.toml --out "$work"

# What stands in NAME.data/scripts of a wheel is installed as a command.
cd "$work"
venv/bin/wheel unpack --dest tree fiatlux-*.whl >/dev/null
package=(tree/fiatlux-*)
scripts="${package[0]}/$(basename "${package[0]}").data/scripts"
mkdir -p "$scripts"
target="$(cd "$OLDPWD" && cargo metadata --no-deps --format-version 1 | python3 -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')"
for program in "${programs[@]}"; do
    strip -o "$scripts/$program" "$target/release/$program"
    chmod 755 "$scripts/$program"
done
mkdir -p "$out"
venv/bin/wheel pack --dest-dir "$out" "${package[0]}" >/dev/null
echo "$out/$(basename fiatlux-*.whl)"
