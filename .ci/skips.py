#!/usr/bin/env python3
"""Fails where a Rust test looks for what it needs and then passes without it: such a test is `#[ignore]`d with a reason that `tests/run`
knows, so that its runner counts it as ignored. Fails, too, where a test stands in a program or library with `test = false`."""

import json
import re
import subprocess
import sys
from pathlib import Path

import hands

# What the machine has, or what the user set.
LOOKS = r"\b(?:bind|connect|var|var_os|exists|try_exists|is_file|is_dir|which)\(|\bCommand::new\("
LEAVES = r"\b(?:return(?: Ok\(\(\)\))?|continue);?\s*\}"
FAULTS = [
    # if TcpListener::bind(..).is_err() { .. return; }     let Ok(..) = TcpListener::bind(..) else { continue };
    (re.compile(rf"^ *(?:if|let|\}} else if)\b[^;{{}}]*?(?:{LOOKS})[^;{{}}]*\{{[^{{}}]*{LEAVES}", re.M), "passes without what it looks for", False),
    # match env::var(..) { Ok(..) => .., Err(_) => return }
    (re.compile(rf"\bmatch\b[^;{{}}]*?(?:{LOOKS})[^;{{}}]*\{{(?:[^{{}}]|\{{[^{{}}]*\}})*=>\s*\{{?\s*(?:return|continue)\b", re.M), "passes without what it looks for", False),
    # let found = env::var_os(..); .. let Some(..) = found else { return };
    (
        re.compile(
            rf"^ *let (\w+)\b[^;=]*=(?!=)[^;{{}}]*?(?:{LOOKS})[^;{{}}]*;(?:(?!#\[test\])[\s\S]){{0,400}}?"
            rf"^ *(?:if|let)\b[^;{{}}]*\b\1\b[^;{{}}]*\{{[^{{}}]*{LEAVES}",
            re.M,
        ),
        "passes without what it looks for",
        False,
    ),
    # eprintln!("no camera"); return;
    (re.compile(rf"\be?print(?:ln)?!\([^;]*\);\s*{LEAVES}", re.M), "says something and passes", False),
    (re.compile(r'^ *"skip|print(?:ln)?!\("skip', re.M), "says that it skips", True),
    (re.compile(r"#\[cfg_attr\([^\]]*\bignore\b[^\]]*\]"), "is ignored for a reason that tests/run does not know", True),
    (re.compile(r"#\[ignore(?! = \"needs (?:Python's libraries|IPv6|PostgreSQL): tests/run\"\])[^\]]*\]"), "is ignored for a reason that tests/run does not know", True),
]
# A test that starts itself as another process: that one answers.
CHILD = re.compile(r"\bCHILD\b")


def without_strings(text):
    """The same with the letters of its strings as dots: lines and columns stay."""
    return re.sub(r'"(?:[^"\\\n]|\\.)*"', lambda string: '"' + "." * (len(string[0]) - 2) + '"', text)


def faults(path, text):
    """Each place of a file of tests that passes without having run."""
    own = hands.OWN_TESTS.search(text)
    start = 0 if hands.TESTS.fullmatch(path) else own.start() if own else len(text)
    for pattern, what, in_strings in FAULTS:
        for found in pattern.finditer(text if in_strings else without_strings(text), start):
            before = text[: found.start()]
            if not CHILD.search(found[0]) and not CHILD.search(before.rstrip().rpartition("\n")[2]):
                yield f"{path}:{before.count(chr(10)) + 1}: {what}"


def untested(target, text):
    """A test in a target that Cargo makes no tests of. Of a program that is its one file; it may have no other."""
    is_program = "bin" in target["kind"]
    if not target["test"] and re.search(r"#\[(?:\w+::)?test\b" + (r"|^ *(?:pub )?mod \w+;" if is_program else ""), text, re.M):
        yield f"{target['src_path']}: may have a test, but has `test = false` in its Cargo.toml"


def main():
    metadata = ["cargo", "metadata", "--locked", "--no-deps", "--format-version", "1"]
    packages = json.loads(subprocess.run(metadata, check=True, stdout=subprocess.PIPE).stdout)["packages"]
    targets = [target for package in packages for target in package["targets"] if {"bin", "lib", "cdylib"} & set(target["kind"])]
    listed = subprocess.run(["git", "ls-files", "-z", "*.rs"], check=True, stdout=subprocess.PIPE, text=True).stdout
    paths = [Path(path) for path in listed.split("\0")[:-1]]
    found = [fault for path in paths if path.is_file() for fault in faults(str(path), path.read_text())]
    for target in targets:
        own = Path(target["src_path"])
        files = [own] if "bin" in target["kind"] else sorted(own.parent.rglob("*.rs"))
        found += [fault for file in files for fault in untested({**target, "src_path": str(file)}, file.read_text())]
    print(f"{len(found)} tests that pass without having run")
    if found:
        sys.exit("\n".join([*found, "give tests that cannot run #[ignore], which CONTRIBUTING.md explains"]))


if __name__ == "__main__":
    main()
