#!/usr/bin/env bash
# One wheel with everything: the Python package, and the programs fiatlux, sim-server, recorder, policy-client and scorer as
# commands of the environment it is installed into. All five are one file, `fiatlux`, which a short script starts by each of the other
# names. Needs Rust, a C compiler and Python 3.10 or newer.
#
#   python/wheel.sh [DIR]     writes DIR/fiatlux-VERSION-....whl [default: wheels]
#
# The wheel asks for a C library as new as this machine's. FIATLUX_GLIBC=2.28 python/wheel.sh links everything for that older one, which
# Enterprise Linux 8 has, by Zig from PyPI (x86_64 alone), in a target folder of its own, and fails if a program asks for a newer one.
set -euo pipefail
out="${1:-wheels}"
# macOS has no `realpath -m`.
case "$out" in /*) ;; *) out="$PWD/$out" ;; esac
cd "$(dirname "$0")/.."
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
others=(sim-server recorder policy-client scorer)

python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "maturin>=1.9.4,<2" "wheel>=0.45"
older=()
if [ -n "${FIATLUX_GLIBC:-}" ]; then
    "$work/venv/bin/pip" install --quiet ziglang
    # Zig has the stubs of every glibc, and its own libunwind in place of libgcc_s.
    cat >"$work/zigcc" <<END
#!/usr/bin/env bash
arguments=()
for argument in "\$@"; do
    case "\$argument" in -m64 | -lgcc_s | -Wl,--as-needed) ;; *) arguments+=("\$argument") ;; esac
done
exec "$work/venv/bin/python" -m ziglang cc -target x86_64-linux-gnu.$FIATLUX_GLIBC "\${arguments[@]}" -lunwind
END
    chmod +x "$work/zigcc"
    export CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_LINKER="$work/zigcc"
    mkdir -p "${CARGO_TARGET_DIR:-target}/glibc-$FIATLUX_GLIBC"
    CARGO_TARGET_DIR="$(cd "${CARGO_TARGET_DIR:-target}/glibc-$FIATLUX_GLIBC" && pwd)"
    export CARGO_TARGET_DIR
    older=(--compatibility "manylinux_${FIATLUX_GLIBC/./_}")
fi

# One build for both, in the same target folder: the wheel shares nearly all of it with the programs.
cargo build --release --locked --features programs -p fiatlux --bins
"$work/venv/bin/maturin" build --release --locked --quiet -m python/Cargo.toml --out "$work" ${older[@]+"${older[@]}"}

# What stands in NAME.data/scripts of a wheel is installed as a command.
cd "$work"
venv/bin/wheel unpack --dest tree fiatlux-*.whl >/dev/null
package=(tree/fiatlux-*)
scripts="${package[0]}/$(basename "${package[0]}").data/scripts"
mkdir -p "$scripts"
target="$(cd "$OLDPWD" && cargo metadata --no-deps --format-version 1 | python3 -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')"
strip -o "$scripts/fiatlux" "$target/release/fiatlux"
strip "${package[0]}"/fiatlux/*.so
# Whoever installs the wheel puts its Python into the first line.
for program in "${others[@]}"; do
    cat >"$scripts/$program" <<END
#!python
"""Starts fiatlux, which stands next to this file, as $program."""

import os
import pathlib
import sys

os.execv(pathlib.Path(__file__).resolve().with_name("fiatlux"), ["$program", *sys.argv[1:]])
END
done
chmod 755 "$scripts"/*
if [ -n "${FIATLUX_GLIBC:-}" ]; then
    for file in "$scripts/fiatlux" "${package[0]}"/fiatlux/*.so; do
        newest="$(objdump -T "$file" | grep -oE 'GLIBC_2\.[0-9]+' | cut -d. -f2 | sort -n | tail -1)"
        if [ "$newest" -gt "${FIATLUX_GLIBC#2.}" ]; then
            echo "wheel.sh: $(basename "$file") asks for glibc 2.$newest" >&2
            exit 1
        fi
    done
fi
mkdir -p "$out"
venv/bin/wheel pack --dest-dir "$out" "${package[0]}" >/dev/null
echo "$out/$(basename fiatlux-*.whl)"
