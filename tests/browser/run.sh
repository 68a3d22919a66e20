#!/usr/bin/env bash
# Looks at replays and at the leaderboard with a real browser: desktop and telephone, light and dark, served and as a file. Drives the
# robot from the page of teleoperation, and checks the takes.
#
#   tests/browser/run.sh [SCREENSHOTS]
#
# Needs Node 20 or newer with npm, and Debian's chromium (or CHROMIUM=/path/to/it); no graphics card. FIATLUX, SCORER and
# SIM_SERVER name the programs, which are built otherwise; FIATLUX_BAGS a folder with two bags or more, which are played
# otherwise. ONLY=replay, ONLY=leaderboard or ONLY=teleop leaves the others out; two are none of them: with ONLY=grab an emulated
# headset takes the bulb of S08 in real time, and ONLY=book looks at the pages in the folder BOOK, which `mkdocs build` made.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
root="$(cd "$here/../.." && pwd)"
work="$(mktemp -d)"
shots="${1:-$work/screenshots}"
# macOS has no `realpath -m`, and its bash 3.2 no empty arrays under `set -u`.
case "$shots" in /*) ;; *) shots="$PWD/$shots" ;; esac
servers=()
finish() {
    for server in ${servers[@]+"${servers[@]}"}; do kill "$server" 2>/dev/null || true; done
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
    "$fiatlux" evaluate --policy random --tasks all --seeds 0..3 --out "$work/random" >/dev/null 2>&1
    "$fiatlux" evaluate --policy zero --tasks all --seeds 0..3 --out "$work/zero" >/dev/null 2>&1
    "$fiatlux" evaluate --policy walk --tasks S05 --seeds 0..3 --out "$work/walk" >/dev/null 2>&1
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

# Drives a task in a room (its first one where none is named) by a test, and checks that its takes are kept, whole, of their own kind, and verified.
drive() {
    local test="$1" task="$2" seed="$3" count="$4" takes="$work/takes-$1" driven port bag
    "$fiatlux" teleop --task "$task" ${seed:+--seed "$seed"} --out "$takes" --no-open >"$takes.address" 2>"$takes.log" &
    driven=$!
    servers+=("$driven")
    node "$work/teleop.mjs" "$test" "$(first_line "$takes.address")" "$shots"
    kill -INT "$driven"
    wait "$driven"
    "$scorer" grade --takes "$takes" --json >"$takes.json"
    node -e '
        const { episodes, excluded, conditions } = JSON.parse(require("fs").readFileSync(process.argv[1]));
        const succeeded = episodes.filter(({ strict_success: success, end }) => success && end === "success").length;
        if (succeeded !== Number(process.argv[2]) || excluded.length > 0 || conditions.ranked) throw new Error(JSON.stringify({ episodes, excluded }));
    ' "$takes.json" "$count"
    if "$scorer" grade "$takes" --json >"$takes.excluded"; then
        echo "FAILED takes are graded as episodes of a policy"
        return 1
    fi
    grep -q '"reason": "kind"' "$takes.excluded"
    port=$((20000 + RANDOM % 20000))
    "$sim" -l "tcp/127.0.0.1:$port" >"$work/verifier.log" 2>&1 &
    servers+=($!)
    bag="$(find "$takes" -name '*.mcap' | sort | head -n 1)"
    "$scorer" verify "$bag" -e "tcp/127.0.0.1:$port"
}

case "${ONLY:-all}" in
    replay) replays ;;
    leaderboard) leaderboard ;;
    teleop)
        drive first S07 "" 1
        drive walk S07 65 2
        drive older S07 65 0
        drive headset S08 65 0
        ;;
    grab) drive grab S08 65 1 ;;
    book) node "$work/book.mjs" "${BOOK:?the folder that mkdocs build made}" "$shots" ;;
    *)
        replays
        leaderboard
        drive first S07 "" 1
        drive walk S07 65 2
        drive older S07 65 0
        drive headset S08 65 0
        ;;
esac
