#!/usr/bin/env bash
# Looks at replays with a real browser: desktop and telephone, light and dark, served and as a file.
#
#   tests/browser/run.sh [SCREENSHOTS]
#
# Needs Node 20 or newer with npm, and Debian's chromium (or CHROMIUM=/path/to/it); no graphics card. FIATLUX names the program,
# which is built otherwise; FIATLUX_BAGS a folder with two bags or more, which are played otherwise.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
root="$(cd "$here/../.." && pwd)"
work="$(mktemp -d)"
shots="$(realpath -m "${1:-$work/screenshots}")"
viewer=""
finish() {
    [ -z "$viewer" ] || kill "$viewer" 2>/dev/null || true
    rm -rf "$work"
}
trap finish EXIT

cp "$here/package.json" "$here/package-lock.json" "$here/replay.mjs" "$work/"
npm ci --prefix "$work" --no-audit --no-fund --silent

fiatlux="${FIATLUX:-}"
if [ -z "$fiatlux" ]; then
    (cd "$root" && cargo build --locked --quiet --bin fiatlux)
    fiatlux="${CARGO_TARGET_DIR:-$root/target}/debug/fiatlux"
fi
bags="${FIATLUX_BAGS:-}"
if [ -z "$bags" ]; then
    bags="$work/run"
    "$fiatlux" evaluate --policy walk --tasks S05,S09 --seeds 64 --out "$bags" >/dev/null 2>&1
fi
first="$(find "$bags" -name '*.mcap' | sort | head -n 1)"
"$fiatlux" view "$first" --out "$work/replay.html" >/dev/null

"$fiatlux" view "$bags" --no-open >"$work/address" 2>/dev/null &
viewer=$!
for _ in $(seq 100); do
    [ -s "$work/address" ] && break
    sleep 0.1
done
node "$work/replay.mjs" "$(head -n 1 "$work/address")" "$work/replay.html" "$shots"
