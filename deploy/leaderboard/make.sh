#!/usr/bin/env bash
# Makes a leaderboard with real entries from nothing: plays the built-in policies, submits their bags, has every episode simulated again, and
# serves the pages until Ctrl-C.
#
#   deploy/leaderboard/make.sh [--out DIR] [--seeds LIST] [--policies LIST] [--hosted LIST] [--rooms N] [--act CHECKPOINT]
#                              [--ppo TASK=FILE] [--http HOST:PORT] [--exit]
#
#   --out DIR         folder for runs and board [default: results/leaderboard]; what is there is kept, and played no second time
#   --seeds LIST      rooms, as of `fiatlux evaluate` [default: 0..3]; one room is enough for a try
#   --policies LIST   [default: zero,random,stand,expert]; a board refuses walk next to expert, which plays S05, S07 and
#                     S09 by it: equal rows have one policy
#   --hosted LIST     also plays these policies, such as see,carry, in rooms that the server draws, and signs their bags
#   --rooms N         rooms for each task of --hosted [default: 4]; fewer are not ranked
#   --act CHECKPOINT  also plays a checkpoint of python -m fiatlux.train_lerobot, in S06
#   --ppo TASK=FILE   also plays the exported file of a run of `python -m fiatlux.train ppo` or `hand`, in its task
#   --http HOST:PORT  address of the pages [default: 127.0.0.1:8080]; port 0 takes a free one
#   --exit            end when every entry is verified, and print a line for each, with its badge
#
# FIATLUX, SIM_SERVER, SCORER and POLICY_CLIENT name the programs [default: those in target/release, which are built if they are
# missing]. PYTHON names the Python with the wheel [default: python3]: --ppo needs it, and --act needs its extra lerobot.
set -euo pipefail
root="$(cd "$(dirname "$0")/../.." && pwd)"
out=results/leaderboard seeds=0..3 policies=zero,random,stand,expert http=127.0.0.1:8080
exits='' act='' ppo='' hosted='' rooms=4
usage() { sed -n '2,20s/^# \{0,1\}//p' "$0"; }
while [ $# -gt 0 ]; do
    case "$1" in
        --exit) exits=1 && shift && continue ;;
        --help | -h) usage && exit 0 ;;
        --out | --seeds | --policies | --hosted | --rooms | --act | --ppo | --http)
            [ $# -ge 2 ] || { echo "make.sh: $1 needs a value" >&2 && exit 2; }
            ;;
        *)
            echo "make.sh: unknown option '$1'; known ones are --out, --seeds, --policies, --hosted, --rooms, --act, --ppo, --http, --exit" >&2
            exit 2
            ;;
    esac
    printf -v "${1#--}" %s "$2"
    shift 2
done
[ -z "$act" ] || [ -f "$act/config.json" ] || { echo "make.sh: --act: no checkpoint at '$act'" >&2 && exit 2; }
case "$ppo" in "" | S[01][0-9]=?*) ;; *) echo "make.sh: --ppo is '$ppo'; give TASK=FILE, such as S02=s02.safetensors" >&2 && exit 2 ;; esac
[ -z "$ppo" ] || [ -f "${ppo#*=}" ] || { echo "make.sh: --ppo: no file '${ppo#*=}'" >&2 && exit 2; }
case "$rooms" in "" | 0* | *[!0-9]*) echo "make.sh: --rooms is '$rooms'; give a number of rooms, such as 4" >&2 && exit 2 ;; esac
# The files of a policy, whose name may have the path of a file.
file_of() { echo "${1//\//_}"; }
for name in ${hosted//,/ }; do
    # A board counts the first hosted run of a policy.
    run="$out/hosted-$(file_of "$name").toml"
    [ ! -s "$run" ] || grep -qx "hosted_seeds = $rooms" "$run" || {
        echo "make.sh: $run is a run of $name in another number of rooms; give the same --rooms, or another --out" >&2 && exit 2
    }
done
if [ -z "${FIATLUX:-}" ] || [ -z "${SIM_SERVER:-}" ] || [ -z "${SCORER:-}" ] || [ -z "${POLICY_CLIENT:-}" ]; then
    (cd "$root" && cargo build --release --locked -p fiatlux -p sim-server -p scorer -p policy-client --bins)
fi
programs="${CARGO_TARGET_DIR:-$root/target}/release"
fiatlux="${FIATLUX:-$programs/fiatlux}" sim="${SIM_SERVER:-$programs/sim-server}" scorer="${SCORER:-$programs/scorer}"
client="${POLICY_CLIENT:-$programs/policy-client}" python="${PYTHON:-python3}"
for program in "$fiatlux" "$sim" "$scorer" "$client"; do
    command -v "$program" >/dev/null || { echo "make.sh: no program '$program'" >&2 && exit 1; }
done
mkdir -p "$out"

servers=() player=''
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
    player=''
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
[ -s "$out/keys/known_servers" ] || "$fiatlux" keys --out "$out/keys" >/dev/null
: >"$out/server"
"$sim" -l tcp/127.0.0.1:0 --identity "$out/keys/server_identity" --record "$out/hosted" --bags thin >"$out/server" 2>"$out/sim-server.log" &
newest=$!
servers+=("$newest")
speaks 30 "$out/server" "$out/sim-server.log" "the server did not start"
endpoint="$(grep -oE 'tcp/[^ ]+' "$out/server")"
: >"$out/address"
"$scorer" serve --folder "$out/board" -e "$endpoint" --signers "$out/keys/known_servers" --runs "$out/hosted" --http "$http" \
    >"$out/address" 2>"$out/scorer.log" &
newest=$!
servers+=("$newest")
board=$newest
speaks 30 "$out/address" "$out/scorer.log" "the leaderboard did not start"
address="$(grep -oE 'http://[^ ]+' "$out/address" | head -n 1)"

# Those of the twelve tasks that a policy plays, by its name in the list; who plays fewer than all is ranked in those.
tasks_of() {
    local tasks
    tasks="$("$client" list --policies --json | tr -d ' \n' | grep -oE "\"policy\":\"${1%%:*}[\":[][^}]*" | grep -oE '"S[0-9]+"' | tr -d '"' | paste -sd, -)" ||
        { echo "make.sh: $client lists no tasks of a policy '$1'" >&2 && return 1; }
    echo "$tasks"
}
folders=()
for name in ${policies//,/ }; do
    tasks="$(tasks_of "$name")"
    echo "== $name plays $tasks in rooms $seeds" >&2
    file="$(file_of "$name")"
    play "$fiatlux" evaluate --policy "$name" --tasks "$tasks" --seeds "$seeds" --out "$out/runs/$file" >"$out/$file.txt"
    folders+=("$out/runs/$file")
done

for name in ${hosted//,/ }; do
    tasks="$(tasks_of "$name")"
    file="hosted-$(file_of "$name")"
    run="$out/$file.toml"
    echo "== $name plays $tasks in hosted rooms, $rooms each" >&2
    play "$client" evaluate --policy "$name" --tasks "$tasks" --hosted "$rooms" --run-file "$run" -e "$endpoint" >"$out/$file.txt"
    folders+=("$out/hosted/$(sed -n 's/^run = "\(.*\)"$/\1/p' "$run")")
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
    folders+=("$out/runs/ppo")
fi
if [ -n "$act" ]; then
    echo "== act plays S06 in rooms $seeds" >&2
    "$python" -m fiatlux.serve_lerobot "$act" --port 0 >"$out/model" 2>"$out/model.log" &
    newest=$!
    servers+=("$newest")
    speaks 120 "$out/model" "$out/model.log" "the checkpoint is not served"
    : >"$out/act.server"
    "$sim" -l tcp/127.0.0.1:0 --record "$out/runs/act" >"$out/act.server" 2>"$out/act.log" &
    newest=$!
    servers+=("$newest")
    speaks 30 "$out/act.server" "$out/act.log" "the server of the checkpoint's run did not start"
    map=lerobot_g1_hand
    [ ! -f "$act/mapping.toml" ] || map="$act/mapping.toml"
    [ -e "$out/act.done" ] || play "$client" evaluate --policy vla --dialect gr00t --model "$(grep -oE 'tcp://[^ ]+' "$out/model")" \
        --map "$map" --tasks S06 --seeds "$seeds" --run-file "$out/act.toml" -e "$(grep -oE 'tcp/[^ ]+' "$out/act.server")" \
        >"$out/act.txt"
    touch "$out/act.done"
    folders+=("$(dirname "$(find "$out/runs/act" -name '*.run.jsonl' | head -n 1)")")
fi
for folder in ${folders[@]+"${folders[@]}"}; do
    echo "== $folder is submitted and verified" >&2
    play "$scorer" submit "$folder" --to "$address" --token "$out/token" --author Fiatlux --wait
done
echo "$address shows them"
trap 'exit 0' INT TERM
if [ -n "$exits" ]; then
    "$scorer" admin --folder "$out/board" submissions
else
    wait "$board"
fi
