#!/usr/bin/env python3
"""Fails where a script uses what macOS lacks: its bash is 3.2, and its tools are those of BSD.

Scripts that say in their first lines that they need Linux are left out.
"""

import re
import subprocess
import sys

# A pattern, and the way that works everywhere.
RULES = [
    (r"\brealpath\b|\breadlink -f\b", 'use "$(cd DIR && pwd)"'),
    (r"\bnproc\b", "use getconf _NPROCESSORS_ONLN"),
    (r"\b(mapfile|readarray|coproc)\b|\bdeclare -[A-Za-z]*[An]|\blocal -n\b|\bwait -n\b", "bash 3.2 lacks it"),
    (r"\$\{[a-z_]+\[-\d+\]\}", "bash 3.2 has no negative index"),
    (r"\$\{[A-Za-z_0-9]+(\[[^]]*\])?(\^|,){1,2}\}|\$\{[A-Za-z_]+@[A-Z]\}", "bash 3.2 lacks it: use tr"),
    (r"&>>|\|&", "bash 3.2 lacks it: use >>FILE 2>&1"),
    (r"\bsed (-[a-z]*i|--in-place)|\bsed -[a-z]*r\b", "BSD's sed takes a suffix after -i, and -E"),
    (
        r"\bgrep -[a-zA-Z]*P|\bstat -c|\bdate (-d|--date|\+%s%N)|\bcp -[a-z]*l|\bxargs -[a-z]*r\b|\bbase64 -w|\bln -sr\b",
        "BSD's lacks the option",
    ),
    (
        r"\bfind\b[^|;]*(-printf|-executable)\b|\bsort -V\b|\bhead -n? ?-\d|\btac\b|\bmktemp --|\binstall -D\b|\bsplit -d\b",
        "BSD's lacks the option",
    ),
    (r"(^|[;&|(]\s*)(timeout|sha256sum|md5sum|setsid|ionice)\s", "macOS lacks the program"),
]
# An array that may be empty: under `set -u` bash 3.2 takes it for one that is not set.
EMPTY = re.compile(r"^\s*(?:\w+=\S*\s+)*(\w+)=\(\)")


def problems(text):
    """Line numbers and texts of what macOS lacks."""
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        code = re.sub(r"(^|\s)#.*", "", line)
        for pattern, remedy in RULES:
            if found := re.search(pattern, code):
                yield number, f"{found.group().strip()}: {remedy}"
    for name in {found.group(1) for line in lines for found in [EMPTY.match(line)] if found}:
        guarded = re.compile(rf"\$\{{#{name}\[@\]\}}")
        for number, line in enumerate(lines, 1):
            if re.search(rf'(?<!\+)"\$\{{{name}\[@\]\}}"', line) and not any(
                map(guarded.search, lines[max(0, number - 30) : number])
            ):
                yield (
                    number,
                    f'{name} may be empty: write ${{{name}[@]+"${{{name}[@]}}"}}, or ask ${{#{name}[@]}} before',
                )


def main():
    """Looks at every script, and first at itself."""
    bad = 'a=()\nb="$(realpath x)"\necho "${a[@]}" "${c[-1]}" "${d,,}"\n'
    assert len(list(problems(bad))) == 4, list(problems(bad))
    assert not list(problems('a=()\necho ${a[@]+"${a[@]}"} # nproc\n[ ${#a[@]} -eq 0 ] || kill "${a[@]}"\n'))
    files = subprocess.run(["git", "ls-files"], check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()
    count = failures = 0
    for name in files:
        with open(name, "rb") as file:
            if not re.match(rb"#!.*\b(?:bash|sh)\b", file.readline(100)):
                continue
        with open(name, encoding="utf-8") as file:
            text = file.read()
        if "iproute2" in text[:600]:
            continue
        count += 1
        for number, problem in problems(text):
            failures += 1
            print(f"{name}:{number}: {problem}", file=sys.stderr)
    print(f"{count} scripts keep to what macOS has" if failures == 0 else f"{failures} lines do not run on macOS")
    sys.exit(failures > 0)


main()
