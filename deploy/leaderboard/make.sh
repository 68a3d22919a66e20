#!/usr/bin/env bash
# Makes a leaderboard with real entries from nothing: plays the built-in policies, submits their bags, has every episode simulated again, and
# serves the pages until Ctrl-C.
#
#   deploy/leaderboard/make.sh [--out DIR] [--seeds LIST] [--policies LIST] [--act CHECKPOINT] [--ppo TASK=FILE] [--http HOST:PORT] [--exit]
#
#   --out DIR         folder for runs and board [default: results/leaderboard]; what is there is kept, and played no second time
#   --seeds LIST      rooms, as of `fiatlux evaluate` [default: 0..3]; one room is enough for a try
#   --policies LIST   [default: zero,random,stand,expert]; a board refuses walk next to expert, which plays S05, S07 and
#                     S09 by it: equal rows have one policy
#   --act CHECKPOINT  also plays a checkpoint of python -m fiatlux.train_lerobot, in S06
#   --ppo TASK=FILE   also plays the exported file of a run of `python -m fiatlux.train ppo` or `hand`, in its task
#   --http HOST:PORT  address of the pages [default: 127.0.0.1:8080]; port 0 takes a free one
#   --exit            end when every entry is verified, and print the table
#
# FIATLUX, SIM_SERVER, SCORER and, for --act, POLICY_CLIENT name the programs [default: those in target/release, which are built if they
# are missing]. PYTHON names the Python with the wheel [default: python3]: --ppo needs it, and --act needs its extra lerobot.
set -euo pipefail
root="$(cd "$(dirname "$0")/../.." && pwd)"
out=results/leaderboard seeds=0..3 policies=zero,random,stand,expert http=127.0.0.1:8080 exits= act= ppo=
usage() { sed -n '2,18s/^# \{0,1\}//p' "$0"; }
while [ $# -gt 0 ]; do
    case "$1" in
        --exit) exits=1 && shift && continue ;;
        --help | -h) usage && exit 0 ;;
        --out | --seeds | --policies | --act | --ppo | --http) [ $# -ge 2 ] || { echo "make.sh: $1 needs a value" >&2 && exit 2; } ;;
        *) echo "make.sh: unknown option '$1'; known ones are --out, --seeds, --policies, --act, --ppo, --http, --exit" >&2 && exit 2 ;;
    esac
    printf -v "${1#--}" %s "$2"
    shift 2
done
[ -z "$act" ] || [ -f "$act/config.json" ] || { echo "make.sh: --act: no checkpoint at '$act'" >&2 && exit 2; }
case "$ppo" in "" | S[01][0-9]=?*) ;; *) echo "make.sh: --ppo is '$ppo'; give TASK=FILE, such as S02=s02.safetensors" >&2 && exit 2 ;; esac
[ -z "$ppo" ] || [ -f "${ppo#*=}" ] || { echo "make.sh: --ppo: no file '${ppo#*=}'" >&2 && exit 2; }
if [ -z "${FIATLUX:-}" ] || [ -z "${SIM_SERVER:-}" ] || [ -z "${SCORER:-}" ]; then
    (cd "$root" && cargo build --release --locked -p fiatlux -p sim-server -p scorer --bins)
fi
if [ -n "$act" ] && [ -z "${POLICY_CLIENT:-}" ]; then
    (cd "$root" && cargo build --release --locked -p policy-client --bins)
fi
programs="${CARGO_TARGET_DIR:-$root/target}/release"
fiatlux="${FIATLUX:-$programs/fiatlux}" sim="${SIM_SERVER:-$programs/sim-server}" scorer="${SCORER:-$programs/scorer}"
client="${POLICY_CLIENT:-$programs/policy-client}" python="${PYTHON:-python3}"
mkdir -p "$out"

servers=() player=
finish() {
    [ ${#servers[@]} -eq 0 ] || kill "${servers[@]}" 2>/dev/null || true
    wait
}
trap finish EXIT
# A signal may reach this script alone: it ends what it has started, which ignores SIGINT in the background.
stop() {
    trap - INT TERM
    [ -z "$player" ] || kill "$player" 2>/dev/null || true
    echo "make.sh: interrupted; the same command goes on from here" >&2
    exit 130
}
trap stop INT TERM
# Runs a program in a way that a signal interrupts, and fails as it does.
play() {
    "$@" &
    player=$!
    local ended=0
    wait "$player" || ended=$?
    player=
    return "$ended"
}

# Waits until the newest server has written its address: speaks SECONDS FILE LOG PROBLEM.
speaks() {
    for _ in $(seq "${1}0"); do
        [ -s "$2" ] && break
        kill -0 "$newest" 2>/dev/null || { echo "make.sh: $4:" >&2 && cat "$3" >&2 && exit 1; }
        sleep 0.1
    done
}

# The board's server comes first: a port that is taken is said before anything is played.
"$scorer" admin --folder "$out/board" init >/dev/null
if [ ! -s "$out/token" ]; then
    "$scorer" admin --folder "$out/board" account fiatlux >/dev/null
    (umask 077 && "$scorer" admin --folder "$out/board" token fiatlux >"$out/token")
fi
port=$((20000 + RANDOM % 20000))
"$sim" -l "tcp/127.0.0.1:$port" >"$out/sim-server.log" 2>&1 &
newest=$!
servers+=("$newest")
: >"$out/address"
"$scorer" serve --folder "$out/board" -e "tcp/127.0.0.1:$port" --http "$http" >"$out/address" 2>"$out/scorer.log" &
newest=$!
servers+=("$newest")
board=$newest
speaks 30 "$out/address" "$out/scorer.log" "the leaderboard did not start"
address="$(grep -oE 'http://[^ ]+' "$out/address" | head -n 1)"

# `walk` plays three tasks, and is ranked in those; the others are ranked in the table.
IFS=, read -ra names <<<"$policies"
for name in "${names[@]}"; do
    tasks=all
    [ "$name" != walk ] || tasks=S05,S07,S09
    echo "== $name plays $tasks in rooms $seeds" >&2
    play "$fiatlux" evaluate --policy "$name" --tasks "$tasks" --seeds "$seeds" --out "$out/runs/$name" >"$out/$name.txt"
done

if [ -n "$ppo" ]; then
    echo "== ppo plays ${ppo%%=*} in rooms $seeds" >&2
    cat >"$out/ppo.py" <<'END'
import sys

import fiatlux

(task, file), seeds, out = sys.argv[1].split("=", 1), sys.argv[2], sys.argv[3]
rooms = []
for part in seeds.split(","):
    first, _, last = part.partition("..")
    rooms += range(int(first), int(last or first) + 1)
print(fiatlux.evaluate(fiatlux.load_policy(file), tasks=[task], seeds=rooms, out=out))
END
    play "$python" "$out/ppo.py" "$ppo" "$seeds" "$out/runs/ppo" >"$out/ppo.txt"
    names+=(ppo)
fi
if [ -n "$act" ]; then
    echo "== act plays S06 in rooms $seeds" >&2
    "$python" -m fiatlux.serve_lerobot "$act" --port 0 >"$out/model" 2>"$out/model.log" &
    newest=$!
    servers+=("$newest")
    speaks 120 "$out/model" "$out/model.log" "the checkpoint is not served"
    endpoint="tcp/127.0.0.1:$((20000 + RANDOM % 20000))"
    "$sim" -l "$endpoint" --record "$out/runs/act" >"$out/act.log" 2>&1 &
    newest=$!
    servers+=("$newest")
    [ -e "$out/act.done" ] || play "$client" evaluate --policy vla --dialect gr00t --model "$(grep -oE 'tcp://[^ ]+' "$out/model")" \
        --map lerobot_g1_hand --tasks S06 --seeds "$seeds" --run-file "$out/act.toml" -e "$endpoint" >"$out/act.txt"
    touch "$out/act.done"
    names+=(act)
fi
for name in "${names[@]}"; do
    echo "== $name is submitted and verified" >&2
    folder="$out/runs/$name"
    [ "$name" != act ] || folder="$(dirname "$(find "$folder" -name '*.run.jsonl' | head -n 1)")"
    play "$scorer" submit "$folder" --to "$address" --token "$out/token" --author Fiatlux --wait
done
echo "$address shows them"
trap 'exit 0' INT TERM
[ -n "$exits" ] || wait "$board"
