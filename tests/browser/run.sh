#!/usr/bin/env bash
# Looks at replays and at the leaderboard with a real browser: desktop and telephone, light and dark, served and as a file.
#
#   tests/browser/run.sh [SCREENSHOTS]
#
# Needs Node 20 or newer with npm, and Debian's chromium (or CHROMIUM=/path/to/it); no graphics card. FIATLUX, SCORER and
# SIM_SERVER name the programs, which are built otherwise; FIATLUX_BAGS a folder with two bags or more, which are played
# otherwise. ONLY=replay or ONLY=leaderboard leaves the other one out.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
root="$(cd "$here/../.." && pwd)"
work="$(mktemp -d)"
shots="$(realpath -m "${1:-$work/screenshots}")"
servers=()
finish() {
    for server in "${servers[@]}"; do kill "$server" 2>/dev/null || true; done
    wait 2>/dev/null || true
    rm -rf "$work"
}
trap finish EXIT

cp "$here"/package.json "$here"/package-lock.json "$here"/*.mjs "$work/"
npm ci --prefix "$work" --no-audit --no-fund --silent

programs="${CARGO_TARGET_DIR:-$root/target}/debug"
if [ -z "${FIATLUX:-}" ] || [ -z "${SCORER:-}" ] || [ -z "${SIM_SERVER:-}" ]; then
    (cd "$root" && cargo build --locked --quiet -p fiatlux -p scorer -p sim-server --bin fiatlux --bin scorer --bin sim-server)
fi
fiatlux="${FIATLUX:-$programs/fiatlux}"
scorer="${SCORER:-$programs/scorer}"
sim="${SIM_SERVER:-$programs/sim-server}"

# Waits until a file has a line, for half a minute at most.
first_line() {
    for _ in $(seq 300); do
        [ -s "$1" ] && break
        sleep 0.1
    done
    head -n 1 "$1"
}

replays() {
    local bags="${FIATLUX_BAGS:-}" first
    if [ -z "$bags" ]; then
        bags="$work/run"
        "$fiatlux" evaluate --policy walk --tasks S05,S09 --seeds 64 --record camera@5 --out "$bags" >/dev/null 2>&1
    fi
    first="$(find "$bags" -name '*.mcap' | sort | head -n 1)"
    "$fiatlux" view "$first" --out "$work/replay.html" >/dev/null
    "$fiatlux" view "$bags" --no-open >"$work/address" 2>/dev/null &
    servers+=($!)
    "$scorer" grade "$bags" --html "$work/report.html" >/dev/null
    node "$work/replay.mjs" "$(first_line "$work/address")" "$work/replay.html" "$work/report.html" "$shots"
}

leaderboard() {
    local address port
    # Two that are ranked, in the same rooms, and one that is not.
    "$fiatlux" evaluate --policy random --tasks all --seeds 64,65 --out "$work/random" >/dev/null 2>&1
    "$fiatlux" evaluate --policy zero --tasks all --seeds 64,65 --out "$work/zero" >/dev/null 2>&1
    "$fiatlux" evaluate --policy walk --tasks S05 --seeds 64 --out "$work/walk" >/dev/null 2>&1
    "$scorer" admin --folder "$work/board" init >/dev/null
    "$scorer" admin --folder "$work/board" account browser >/dev/null
    (umask 077 && "$scorer" admin --folder "$work/board" token browser >"$work/token")
    port=$((20000 + RANDOM % 20000))
    "$sim" -l "tcp/127.0.0.1:$port" >"$work/sim.log" 2>&1 &
    servers+=($!)
    "$scorer" serve --folder "$work/board" -e "tcp/127.0.0.1:$port" --http 127.0.0.1:0 >"$work/board.address" 2>"$work/board.log" &
    servers+=($!)
    address="$(first_line "$work/board.address" | sed 's/^serving //')"
    for run in random zero walk; do
        "$scorer" submit "$work/$run" --to "$address" --token "$work/token" --author "A. Person" --licence MIT >/dev/null
    done
    node "$work/leaderboard.mjs" "$address" "$shots"
}

case "${ONLY:-both}" in
    replay) replays ;;
    leaderboard) leaderboard ;;
    *)
        replays
        leaderboard
        ;;
esac
