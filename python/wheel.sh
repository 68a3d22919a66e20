#!/usr/bin/env bash
# One wheel with everything: the Python package, and the programs fiatlux, sim-server, recorder, policy-client and scorer as
# commands of the environment it is installed into. The programs are in the package's library, so simulator and transport are there once.
# Needs Rust, a C compiler and Python 3.10 or newer.
#
#   python/wheel.sh [--compatible] [DIR]     writes DIR/fiatlux-VERSION-....whl [default: wheels]
#
# The wheel asks for a C library as new as this machine's. With --compatible it asks for glibc 2.28, which Enterprise Linux 8 has, or for
# the one that FIATLUX_GLIBC names: the library is linked by Zig, from PyPI, and the script fails if anything asks for a newer one.
# FIATLUX_PROFILE names another profile of Cargo's than `release`, such as the quick `dev` of the tests.
set -euo pipefail
older=""
if [ "${1:-}" = --compatible ]; then
    older="${FIATLUX_GLIBC:-2.28}"
    shift
fi
out="${1:-wheels}"
case "$out" in
    -*)
        echo "wheel.sh: unknown option $out; the usage is in the head of this file" >&2
        exit 2
        ;;
    /*) ;;
    # macOS has no `realpath -m`.
    *) out="$PWD/$out" ;;
esac
cd "$(dirname "$0")/.."
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT

python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "maturin>=1.9.4,<2" "wheel>=0.45"
options=()
linking=()
if [ -n "$older" ]; then
    "$work/venv/bin/pip" install --quiet --disable-pip-version-check ziglang
    .ci/linker.sh "$work/venv/bin/python" "$older" "$work/linker"
    options=(--compatibility "manylinux_${older/./_}")
    linking=(-- -C "linker=$work/linker")
fi
"$work/venv/bin/maturin" build --profile "${FIATLUX_PROFILE:-release}" --locked --quiet --strip --features programs \
    -m python/Cargo.toml --out "$work" ${options[@]+"${options[@]}"} ${linking[@]+"${linking[@]}"}

# A file in NAME.data/scripts of a wheel is installed as a command, with the environment's Python in its first line.
"$work/venv/bin/wheel" unpack --dest "$work/tree" "$work"/fiatlux-*.whl >/dev/null
package=("$work"/tree/fiatlux-*)
scripts="${package[0]}/$(basename "${package[0]}").data/scripts"
mkdir -p "$scripts"
for program in fiatlux sim-server recorder policy-client scorer; do
    { echo "#!python" && cat python/fiatlux/_program.py; } >"$scripts/$program"
done
chmod 755 "$scripts"/*
if [ -n "$older" ]; then
    newest="$(objdump -T "${package[0]}"/fiatlux/*.so | grep -oE 'GLIBC_2\.[0-9]+' | cut -d. -f2 | sort -n | tail -1)"
    if [ "$newest" -gt "${older#2.}" ]; then
        echo "wheel.sh: the library asks for glibc 2.$newest" >&2
        exit 1
    fi
fi
mkdir -p "$out"
"$work/venv/bin/wheel" pack --dest-dir "$out" "${package[0]}" >/dev/null
echo "$out/$(basename "$work"/fiatlux-*.whl)"
