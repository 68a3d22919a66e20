#!/usr/bin/env bash
# Makes a leaderboard with real entries from nothing: plays the built-in policies, submits their bags, has every episode simulated again, and
# serves the pages until Ctrl-C.
#
#   deploy/leaderboard/make.sh [--out DIR] [--seeds LIST] [--policies LIST] [--http HOST:PORT] [--exit]
#
#   --out DIR         folder for runs and board [default: results/leaderboard]; what is there is kept, and played no second time
#   --seeds LIST      rooms, as of `fiatlux evaluate` [default: 0..3]; one room is enough for a try
#   --policies LIST   [default: zero,random,stand,walk,expert]
#   --http HOST:PORT  address of the pages [default: 127.0.0.1:8080]; port 0 takes a free one
#   --exit            end when every entry is verified, and print the table
#
# FIATLUX, SIM_SERVER and SCORER name the programs [default: those in target/release, which are built if they are missing].
set -euo pipefail
root="$(cd "$(dirname "$0")/../.." && pwd)"
out=results/leaderboard seeds=0..3 policies=zero,random,stand,walk,expert http=127.0.0.1:8080 exits=
usage() { sed -n '2,13s/^# \{0,1\}//p' "$0"; }
while [ $# -gt 0 ]; do
    case "$1" in
        --exit) exits=1 && shift && continue ;;
        --help | -h) usage && exit 0 ;;
        --out | --seeds | --policies | --http) [ $# -ge 2 ] || { echo "make.sh: $1 needs a value" >&2 && exit 2; } ;;
        *) echo "make.sh: unknown option '$1'; known ones are --out, --seeds, --policies, --http, --exit" >&2 && exit 2 ;;
    esac
    printf -v "${1#--}" %s "$2"
    shift 2
done
if [ -z "${FIATLUX:-}" ] || [ -z "${SIM_SERVER:-}" ] || [ -z "${SCORER:-}" ]; then
    (cd "$root" && cargo build --release --locked -p fiatlux -p sim-server -p scorer --bins)
fi
programs="${CARGO_TARGET_DIR:-$root/target}/release"
fiatlux="${FIATLUX:-$programs/fiatlux}" sim="${SIM_SERVER:-$programs/sim-server}" scorer="${SCORER:-$programs/scorer}"
mkdir -p "$out"

# `walk` plays three tasks, and is ranked in those; the others are ranked in the table.
IFS=, read -ra names <<<"$policies"
for name in "${names[@]}"; do
    tasks=all
    [ "$name" != walk ] || tasks=S05,S07,S09
    echo "== $name plays $tasks in rooms $seeds" >&2
    "$fiatlux" evaluate --policy "$name" --tasks "$tasks" --seeds "$seeds" --out "$out/runs/$name" >"$out/$name.txt"
done

servers=()
finish() {
    [ ${#servers[@]} -eq 0 ] || kill "${servers[@]}" 2>/dev/null || true
    wait
}
trap finish EXIT
"$scorer" admin --folder "$out/board" init >/dev/null
if [ ! -s "$out/token" ]; then
    "$scorer" admin --folder "$out/board" account fiatlux >/dev/null
    (umask 077 && "$scorer" admin --folder "$out/board" token fiatlux >"$out/token")
fi
port=$((20000 + RANDOM % 20000))
"$sim" -l "tcp/127.0.0.1:$port" >"$out/sim-server.log" 2>&1 &
servers+=($!)
: >"$out/address"
"$scorer" serve --folder "$out/board" -e "tcp/127.0.0.1:$port" --http "$http" >"$out/address" 2>"$out/scorer.log" &
servers+=($!)
for _ in $(seq 300); do
    [ -s "$out/address" ] && break
    kill -0 "${servers[1]}" 2>/dev/null || { echo "make.sh: the leaderboard did not start:" >&2 && cat "$out/scorer.log" >&2 && exit 1; }
    sleep 0.1
done
address="$(grep -oE 'http://[^ ]+' "$out/address" | head -n 1)"
for name in "${names[@]}"; do
    echo "== $name is submitted and verified" >&2
    "$scorer" submit "$out/runs/$name" --to "$address" --token "$out/token" --author Fiatlux --wait
done
echo "$address shows them"
[ -n "$exits" ] || wait "${servers[1]}"
