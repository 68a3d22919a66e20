#!/usr/bin/env bash
# Draws the pictures of the tasks in docs/tasks.md with the programs of this checkout: the start of each task in one room.
#
#   deploy/pictures.sh [FIATLUX]
#
# TASKS="S07 S08" draws these alone. Needs Python with Pillow (PYTHON=python3), for JPEG.
set -euo pipefail
root="$(cd "$(dirname "$0")/.." && pwd)"
fiatlux="${1:-$root/target/release/fiatlux}"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
seed=0

for task in ${TASKS:-S01 S02 S03 S04 S05 S06 S07 S08 S09 S10 S11 S12 replace climb}; do
    # The start is all that is drawn: a robot that does nothing is the quickest to play.
    "$fiatlux" evaluate --policy zero --tasks "$task" --seeds "$seed" --out "$work/$task" >/dev/null 2>&1 || true
    bag="$(find "$work/$task" -name '*.mcap' | head -n 1)"
    # Where robot and goal are far apart.
    case "$task" in S01 | S07 | replace) view=room ;; *) view=follow ;; esac
    "$fiatlux" render "${bag:?no bag of $task}" --at 0 --view "$view" --size 640x480 -o "$work/$task.png" >/dev/null 2>&1
    "${PYTHON:-python3}" - "$work/$task.png" "$root/docs/pictures/tasks/$task.jpg" <<'PYTHON'
import sys
from PIL import Image
Image.open(sys.argv[1]).convert("RGB").save(sys.argv[2], quality=85, optimize=True)
PYTHON
    echo "docs/pictures/tasks/$task.jpg"
done
