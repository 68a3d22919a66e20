"""Tests of the checks in this folder: each one fails on what it is there to find. `.ci/run` runs them."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import circles
import features
import figures
import hands
import homes
import licences
import room
import sbom
import sizes
import skips
import words

RULES = {
    "licenses": {"allow": ["MIT", "Apache-2.0", "Apache-2.0 WITH LLVM-exception"]},
    "bans": {"deny": [{"crate": "openssl-sys", "reason": "use rustls"}], "wildcards": "deny"},
    "sources": {"unknown-registry": "deny", "unknown-git": "deny"},
}


def package(**fields):
    package = {"name": "a", "version": "1.0.0", "license": "MIT", "source": licences.REGISTRY, "dependencies": []}
    return {**package, **fields}


class Cases(unittest.TestCase):
    ROOT = Path(__file__).parent.parent
    FORMS = {
        ".rs": r"#\[test\]\s*(?:#\[(?!ignore)[^\]]*\]\s*)*fn {}\(",
        ".py": r"(?m)^def {}\(",
        ".mjs": r'\b(?:check|lost)\([^;]*"{}"',
    }

    def is_test(self, suffix, name, text):
        return re.search(self.FORMS[suffix].format(re.escape(name)), text) is not None

    def test_the_test_of_each_case_is_one_that_runs(self):
        extras, cases = (self.ROOT / "python/tests/extras.sh").read_text(), tomllib.loads((self.ROOT / "tests/cases.toml").read_text())
        for case, (file, name) in cases["cases"].items():
            with self.subTest(case):
                path = self.ROOT / file
                self.assertTrue(self.is_test(path.suffix, name, path.read_text()), f"{file} has no test {name}")
                if "/extras/" in file:
                    self.assertIn(f"extras/{path.name}", extras)

    def test_a_test_is_told_from_its_name(self):
        for suffix, text, holds in [
            (".rs", "#[test]\nfn a() {", True),
            (".rs", "#[test]\n#[allow(x)]\nfn a() {", True),
            (".rs", '#[test]\n#[ignore = "needs IPv6"]\nfn a() {', False),
            (".rs", "// a\nfn a() {", False),
            (".py", "def a(x):", True),
            (".py", "    a(x)", False),
            (".mjs", 'check(x.length === 0, "a", x);', True),
            (".mjs", '// "a"', False),
        ]:
            with self.subTest(text):
                self.assertEqual(self.is_test(suffix, "a", text), holds)


class Licences(unittest.TestCase):
    def test_expressions(self):
        for expression, expected in [
            ("MIT", True),
            ("GPL-3.0", False),
            ("GPL-3.0 OR MIT", True),
            ("GPL-3.0 AND MIT", False),
            ("GPL-3.0/MIT", True),
            ("(MIT OR GPL-3.0) AND Apache-2.0", True),
            ("MIT OR GPL-3.0 AND GPL-2.0", True),
            ("(MIT OR GPL-3.0) AND GPL-2.0", False),
            ("Apache-2.0 WITH LLVM-exception", True),
            ("MIT WITH LLVM-exception", False),
            ("GPL-3.0 WITH LLVM-exception OR MIT", True),
        ]:
            with self.subTest(expression):
                self.assertEqual(licences.is_allowed(expression, RULES["licenses"]["allow"]), expected)
        for expression in ["", "MIT OR", "(MIT", "MIT)", "AND MIT", "MIT MIT"]:
            with self.subTest(expression), self.assertRaises(ValueError):
                licences.is_allowed(expression, RULES["licenses"]["allow"])

    def test_each_rule_finds_what_breaks_it(self):
        self.assertEqual(list(licences.faults(RULES, [package()])), [])
        for broken, fault in [
            (package(license="GPL-3.0"), "licence GPL-3.0 is not allowed"),
            (package(license=None), "licence None is not an SPDX expression"),
            (package(name="openssl-sys"), "banned: use rustls"),
            (package(source="git+https://example.com/a"), "source git+https://example.com/a is not crates.io"),
            (package(source=None, dependencies=[{"name": "b", "req": "*"}]), 'b = "*" accepts every version'),
        ]:
            with self.subTest(fault):
                [found] = licences.faults(RULES, [package(name="good"), broken])
                self.assertIn(fault, found)

    def test_an_exception_is_for_one_crate(self):
        rules = {**RULES, "licenses": {**RULES["licenses"], "exceptions": [{"crate": "a", "allow": ["MPL-2.0"]}]}}
        packages = [package(license="MPL-2.0"), package(license="MPL-2.0", name="b")]
        self.assertEqual(list(licences.faults(rules, packages)), ["b 1.0.0: licence MPL-2.0 is not allowed"])

    def test_a_rule_that_is_not_applied_is_refused(self):
        self.assertEqual(list(licences.unapplied(RULES)), [])
        unknown = {**RULES, "licenses": {**RULES["licenses"], "clarify": []}}
        self.assertIn("licenses.clarify", next(licences.unapplied(unknown)))
        weaker = {**RULES, "sources": {**RULES["sources"], "unknown-git": "allow"}}
        self.assertIn("sources.unknown-git", next(licences.unapplied(weaker)))


class Features(unittest.TestCase):
    def test_a_crate_with_other_features_is_named(self):
        key = ("registry#syn@3.0.0", ("syn", "lib", "build"), "{}")
        full, bare = {key: {frozenset(["fold", "visit"])}}, {key: {frozenset(["visit"])}}
        self.assertEqual(features.differences(full, full), ([], 1))
        self.assertEqual(features.differences(bare, full), (["registry#syn@3.0.0: without ['fold'], with []"], 1))
        self.assertEqual(features.differences({}, full), ([], 0))


class Hands(unittest.TestCase):
    def test_names_are_those_of_the_robots(self):
        self.assertEqual(hands.hands(['name = "b"\nhand = "hook"\n', 'base = "b"\nhand = "bare"\n', 'hand = "claw"\n']), ["claw", "hook"])

    def test_a_file_that_names_a_hand(self):
        own = '#[cfg(test)]\n#[allow(clippy::unwrap_used)]\nmod tests {\n    fn f() { by_name("g1_hook"); }\n}\n'
        for path, text, lines in [
            ("a/src/b.rs", 'fn f() {}\nfn g() { by_name("g1_hook"); }\n', ["a/src/b.rs:2: hook"]),
            ("a/src/b.rs", f"{own}// A Hook.\n", ["a/src/b.rs:6: Hook"]),
            ("a/src/b.rs", own, []),
            ("a/src/hook.rs", "", ["a/src/hook.rs: its name says hook"]),
            ("a/tests/it/b.rs", "hook", []),
            ("a/weights/b.json", "hook", []),
            ("crates/robot/robots/g1_hook.toml", "hook", []),
            ("docs/robots.md", "hook", []),
        ]:
            with self.subTest(path=path, text=text):
                self.assertEqual(list(hands.faults(["claw", "hook"], path, text)), lines)


class Figures(unittest.TestCase):
    DATA = {"a": {"successes": 45, "episodes": 48}, "b": {"tasks": {"S01": 64, "S02": 61}, "episodes": 64}}

    def test_forms(self):
        # Wilson's interval of 45 of 48 as statsmodels has it: 0.8317 to 0.9785.
        for name, form, expected in [("a", "full", "45 of 48 = 0.94 (0.83 to 0.98)"), ("b", "of", "125 of 128"), ("b.S02", "n", "61")]:
            with self.subTest(name):
                self.assertEqual(figures.text(self.DATA, name, form), expected)

    def test_a_page_that_says_otherwise(self):
        right = "so <!--= a of -->45 of 48<!--/--> of them"
        self.assertEqual(figures.check("p", right, self.DATA), (right, []))
        for page, fault in [
            (right.replace("45 of 48", "46 of 48"), "the page says 46 of 48"),
            (right.replace("= a", "= c"), "has no figure c"),
            (right.replace(" of -->", " share -->"), "share is not a form"),
            (right.replace("<!--/-->", ""), "cannot be read"),
            (right.replace("so ", "so\n"), "begins a line"),
        ]:
            with self.subTest(fault):
                [found] = figures.check("p", page, self.DATA)[1]
                self.assertIn(fault, found)

    def test_a_result_that_a_page_quotes(self):
        data = {"expert_first_rooms": {"successes": 48, "episodes": 48}}
        for page, faults in [
            ("expert: 48/48 strict, S 1.000", 0),
            ("so `expert: 47/48 strict`", 0),
            ("expert: 47/48 strict, S 0.990", 1),
            ("other: 1/1 strict, S 1.000", 1),
        ]:
            with self.subTest(page):
                self.assertEqual(len(figures.quoted("p", f"\n{page}\n", data)), faults)

    def test_a_picture_that_shows_something_else(self):
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            (folder / "board.png").write_bytes(b"picture")
            digest, version = hashlib.sha256(b"picture").hexdigest(), figures.version()
            for told, said, sha256, faults in [
                (version, "45 of 48", digest, []),
                (version, "44 of 48", digest, ["it shows 44 of 48 for a, which is 45 of 48"]),
                (version - 1, "45 of 48", digest, [f"it is of version {version - 1} "]),
                (version, "45 of 48", "0", ["it is not the picture"]),
            ]:
                lines = ['["board.png"]', 'part = "board"', f"version = {told}", f'sha256 = "{sha256}"', f'figures.a = "{said}"']
                (folder / "figures.toml").write_text("\n".join(lines))
                found = figures.pictured(folder, self.DATA)
                self.assertEqual(len(found), len(faults), found)
                for line, fault in zip(found, faults):
                    self.assertIn(f"deploy/pictures.py board: {fault}", line)


class Bill(unittest.TestCase):
    def test_what_a_release_is_made_of(self):
        def node(name, *needs):
            deps = [{"pkg": need, "dep_kinds": [{"kind": kind}]} for need, kind in needs]
            return {"id": name, "deps": deps}

        packages = [
            package(id="a", name="a", source=None),
            package(id="b", name="b", license="MIT/Apache-2.0"),
            package(id="c", name="c"),
            package(id="d", name="d"),
        ]
        nodes = [node("a", ("b", None), ("d", "dev")), node("b", ("c", "build")), node("c"), node("d")]
        lock = {"package": [{"name": "a", "version": "1.0.0"}, {"name": "b", "version": "1.0.0", "checksum": "ab"}]}
        bill = sbom.bill({"packages": packages, "resolve": {"nodes": nodes}}, lock, "a")
        self.assertEqual(bill["metadata"]["component"]["bom-ref"], "a@1.0.0")
        # What tests alone need is not in a release.
        self.assertEqual([part["name"] for part in bill["components"]], ["b", "c"])
        self.assertEqual(bill["components"][0]["licenses"], [{"expression": "MIT OR Apache-2.0"}])
        self.assertEqual(bill["components"][0]["hashes"], [{"alg": "SHA-256", "content": "ab"}])
        needs = {entry["ref"]: entry["dependsOn"] for entry in bill["dependencies"]}
        self.assertEqual(needs, {"a@1.0.0": ["b@1.0.0"], "b@1.0.0": ["c@1.0.0"], "c@1.0.0": []})


class Room(unittest.TestCase):
    SCENE = {"bulb": {"seat_z": 0.036259, "mass": 0.035, "rings": [[0.0, 0.0202]]}, "ladder": {"top": [0.0, 0.1, 1.18]}, "start": {"carry": {"grip": {"R_thumb": 0.7468}, "glass_tilt": [0.2863, -0.1539]}, "turn": 0.08726646259971647}}

    def test_numbers_that_count(self):
        numbers = {"bulb.seat_z": 0.036259, "bulb.rings[0]": 0.0202, "ladder.top": (0.0, 0.1, 1.18), "start.carry.grip.R_thumb": 0.7468}
        found = {name: value for name, value in room.named(self.SCENE) if value != (0.0, 0.0202)}
        self.assertEqual(found, numbers)

    def test_a_file_with_a_copy(self):
        numbers = {value: name for name, value in room.named(self.SCENE)}
        for path, text, lines in [
            ("a/src/b.rs", "const A: f64 = 0.036_259;\n", ["a/src/b.rs:1: 0.036_259 is bulb.seat_z"]),
            ("a/src/b.rs", "\nconst A: [f64; 3] = [0.0, 0.10, 1.18];\n", ["a/src/b.rs:2: [0.0, 0.10, 1.18] is ladder.top"]),
            ("a/src/b.rs", "const A: f64 = -2.5; // not 0.036259\n", []),
            ("a/src/b.rs", "const A: f64 = 10.036259 + x0.036259;\n", []),
            ("a/b.toml", "seat = 0.0362590\n", ["a/b.toml:1: 0.0362590 is bulb.seat_z"]),
            ("a/tests/it/b.rs", "0.036259", []),
            ("docs/b.md", "0.036259", []),
            (room.HOME, "seat_z = 0.036259", []),
        ]:
            with self.subTest(path=path, text=text):
                self.assertEqual(list(room.faults(numbers, path, text)), lines)


class Homes(unittest.TestCase):
    def test_a_second_home_is_found(self):
        for path, text, fault in [
            ("crates/a/src/b.rs", "let delay = delay_steps(&varied);", "delay_steps( is an episode"),
            ("crates/a/src/b.rs", "x\nlet kept = Recorder::start(a, b)?;", ":2: Recorder::start( is a server"),
            ("crates/a/src/b.rs", "    const JOINTS: usize = 29;", "is the joints"),
            ("crates/teleop/src/b.rs", "InverseKinematics::new(&model)", "is an arm"),
            ("crates/policies/src/b.rs", "    phase: Phase,", "is the phases"),
            ("crates/policies/src/b.rs", "    fn is_over(&self) -> bool;", "is the phases"),
            ("crates/policies/src/b.rs", "const GAIN: f64 = 1.5;", "is a walk"),
            ("crates/teleop/src/b.rs", "fn steps_to(pelvis: &Pose) -> Steps {", "is a walk"),
            ("crates/policies/src/b.rs", "const MAX_RETRIES: u32 = 3;", "is how often"),
            ("crates/teleop/src/b.rs", "const FINGERS: [&str; 2] = [\"thumb\", \"index\"];", "is fingers"),
            ("scorer/src/b.rs", "println!(\"{all}\");", "is writing to stdout"),
            ("crates/a/src/b.rs", "eprint!(\"{all}\")", "is writing to stdout"),
            ("fiatlux/src/b.rs", "std::io::stdout().lock()", "is writing to stdout"),
        ]:
            with self.subTest(text):
                found = list(homes.faults(path, text))
                self.assertTrue(len(found) == 1 and fault in found[0], found)
        for path, text in [
            ("crates/play/src/play.rs", "delay_steps(&varied)"),
            ("crates/a/tests/it/b.rs", "Recorder::start(a, b)"),
            ("crates/a/src/b.rs", "// Recorder::start(a, b)"),
            ("crates/a/examples/b.rs", "println!(\"{all}\");"),
            ("python/src/batch.rs", "settings::delay_steps(least)"),
        ]:
            with self.subTest(text):
                self.assertEqual(list(homes.faults(path, text)), [])


class Sizes(unittest.TestCase):
    def test_functions_and_their_lengths(self):
        text = "fn a() {}\ntrait T {\n    fn b(\n        x: u8,\n    ) -> u8;\n    fn c(&self) {\n        if x {\n        }\n    }\n}\npub(crate) async fn d()\nwhere\n    T: U,\n{\n}\n"
        self.assertEqual(list(sizes.functions(text)), [("c", 6, 4), ("d", 11, 5)])

    def test_what_is_too_long(self):
        long = "fn a() {\n" + "    x;\n" * 99 + "}\n"
        own = "#[cfg(test)]\nmod tests {\n    fn a() {\n" + "        x;\n" * 99 + "    }\n}\n"
        for path, text, fault in [
            ("a/src/b.rs", long, "a/src/b.rs:1: a has 101 lines, at most 100"),
            ("a/src/b.rs", long.replace("    x;\n", "", 1), None),
            ("a/src/b.rs", "\n" * 501, "a/src/b.rs: 501 lines, at most 500"),
            ("a/tests/it/b.rs", "\n" * 501, "a/tests/it/b.rs: 501 lines, at most 500"),
            ("a/tests/it/b.rs", long, None),
            ("a/src/b.rs", own, None),
            ("crates/policies/src/ladder.rs", "\n" * 501, None),
        ]:
            with self.subTest(path=path, fault=fault):
                self.assertEqual(list(sizes.faults(path, text)), [fault] if fault else [])

    def test_what_may_be_larger_is_there(self):
        for path, (most, longest) in sizes.LARGER.items():
            text = (Cases.ROOT / path).read_text()
            is_larger = len(text.splitlines()) > sizes.MAX_FILE or any(length > sizes.MAX_FUNCTION for _, _, length in sizes.functions(text))
            self.assertTrue(is_larger, f"{path} is small: take it out of .ci/sizes.py")


class Words(unittest.TestCase):
    def test_comments_and_limits(self):
        for text, count in [
            ("/// What" + " it does.\nfn a() {}\n", 1),
            ("x = 1\n\"\"\"How" + " it does it.\"\"\"\n", 1),
            ("const MOST" + "_ROOMS: u32 = 1;\n", 1),
            ("/// The room.\nconst MAX_ROOMS: u32 = 1; // What it holds.\n", 0),
        ]:
            with self.subTest(text=text):
                self.assertEqual(len(words.faults("a.rs", text)), count)

    def test_readme(self):
        first = "# A title of six words here\n![a picture](a.png)\n" + "word " * 60
        self.assertEqual(words.readme_faults(first + "\n```sh\n" + "word " * 900), [])
        self.assertEqual(len(words.readme_faults(first + "<!--= a rate -->more\n```sh\nrun\n```\n")), 1)
        self.assertEqual(len(words.readme_faults("a\n```sh\n" + "word " * 1100)), 1)


class Skips(unittest.TestCase):
    def test_a_test_that_nothing_runs(self):
        for kind, test, text, count in [
            ("bin", False, "mod tests {\n    #[test]\n    fn f() {}\n}\n", 1),
            ("bin", False, "    #[tokio::test]\n    async fn f() {}\n", 1),
            ("bin", False, "mod more;\nfn main() {}\n", 1),
            ("cdylib", False, "mod more;\n#[test]\nfn f() {}\n", 1),
            ("cdylib", False, "mod more;\n", 0),
            ("bin", False, "fn main() {}\n", 0),
            ("bin", True, "#[test]\nfn f() {}\n", 0),
        ]:
            with self.subTest(kind=kind, test=test, text=text):
                found = list(skips.untested({"kind": [kind], "test": test, "src_path": "a.rs"}, text))
                self.assertEqual(len(found), count, found)

    def test_a_test_that_passes_without_having_run(self):
        for text, what in [
            ('    if TcpListener::bind("[::1]:0").is_err() {\n        return;\n    }\n', "passes without"),
            ('    let Ok(at) = TcpListener::bind(format!("{address}:0")) else {\n        eprintln!("{address}; no");\n        continue;\n    };', "passes without"),
            ('    let Some(python) = std::env::var_os("P") else { return };', "passes without"),
            ('    eprintln!("no camera; {why}");\n        return;\n    }', "says something"),
            ('    "skipped: no ffmpeg"', "says that it skips"),
            ('#[ignore]', "is ignored for a reason"),
            ('#[ignore = "slow"]', "is ignored for a reason"),
            ('#[cfg_attr(not(target_os = "linux"), ignore)]', "is ignored for a reason"),
            ('    let camera = match std::env::var("P") {\n        Ok(camera) => camera,\n        Err(_) => return,\n    };', "passes without"),
            ('    match TcpStream::connect(at) {\n        Ok(_) => { run(); }\n        Err(_) => { return; }\n    }', "passes without"),
            ('    let found = std::env::var_os("P");\n    let more = 1;\n    let Some(python) = found else { return };', "passes without"),
            ('    let there = path.try_exists().unwrap();\n    if !there {\n        return;\n    }', "passes without"),
            ('    if which("ffmpeg").is_none() {\n        return;\n    }', "passes without"),
        ]:
            with self.subTest(text):
                self.assertIn(what, "\n".join(skips.faults("a/tests/it/b.rs", text)))
                self.assertIn(what, "\n".join(skips.faults("a/src/b.rs", "fn f() {}\n#[cfg(test)]\nmod tests {\n" + text)))
                self.assertEqual(list(skips.faults("a/src/b.rs", text)), [])
        for text in [
            '    if std::env::var_os(CHILD).is_some() {\n        println!("digest {alone}");\n        return;\n    }',
            '#[ignore = "needs IPv6: tests/run"]',
            '    let Ok(line) = line else { return };',
            '    let line = read(var);\n    let Ok(line) = line else { return };',
            '    let found = std::env::var_os("P");\n    use_it(found);\n}\n#[test]\nfn b() {\n    let Some(found) = found else { return };',
        ]:
            with self.subTest(text):
                self.assertEqual(list(skips.faults("a/tests/it/b.rs", text)), [])


class Circles(unittest.TestCase):
    def found(self, files, needs, root=""):
        """The circles among files, which are given by path and text; modules of names joined by dots."""
        with tempfile.TemporaryDirectory() as folder:
            for path, text in files.items():
                file = Path(folder) / path
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text)
            graph = needs(Path(folder) / root)
        return [[".".join(module) for module in group] for group in circles.circles(graph)]

    def rust(self, **files):
        """Files by their module, such as `a__b` for `a/b.rs`, of a crate whose root names a and b."""
        named = {f"{name.replace('__', '/')}.rs": text for name, text in files.items()}
        files = {"lib.rs": "mod a;\nmod b;\nmod c;\npub use a::*;\npub use b::{B, make};\npub use c::*;\n", "a.rs": "", "b.rs": "", "c.rs": "", **named}
        return self.found(files, lambda root: circles.Crate(root).needs(), "lib.rs")

    def test_two_files_that_need_each_other(self):
        b = "pub struct B;\npub fn make() {}\n"
        self.assertEqual(self.rust(a="use crate::B;\nstruct A(B);", b=b), [])
        for back in [
            "use crate::a::A;",
            "use super::{a::A, self};",
            "use crate::{\n    a::{self as other},\n};",
            "use crate::A;",
            "fn f(a: &crate::a::A) {}",
        ]:
            with self.subTest(back):
                self.assertEqual(self.rust(a="use crate::B;\npub struct A(B);", b=b + back), [["a", "b"]])

    def test_comments_strings_and_tests_are_no_need(self):
        b = "pub struct B;\npub fn make() {}\n"
        for other in [
            "// use crate::a::A;",
            "/* crate::a::A */",
            'const S: &str = "crate::a::A \\" crate::a::A";',
            "#[cfg(test)]\nmod tests {\n    use crate::a::A;\n    fn f() { let c = '}'; }\n}",
            "#[cfg(test)]\nmod tests;",
        ]:
            with self.subTest(other):
                self.assertEqual(self.rust(a="use crate::B;\npub struct A(B);", b=b + other, b__tests="use crate::A;"), [])

    def test_a_submodule_may_take_types_of_its_parent_and_not_functions(self):
        a = "mod c;\npub struct A;\npub const N: u8 = 1;\npub fn f() { c::g() }\n"
        self.assertEqual(self.rust(a=a, a__c="use super::{A, N};\npub fn g() {}\nimpl A {}"), [])
        self.assertEqual(self.rust(a=a, a__c="pub fn g() { super::f() }"), [["a", "a.c"]])

    def test_a_folder_that_a_build_script_lists(self):
        a = 'include!(concat!(env!("OUT_DIR"), "/modules.rs"));\n'
        self.assertEqual(self.rust(a=a, a__c="pub struct C;", b="use crate::a;\npub struct B;"), [])
        self.assertEqual(self.rust(a=a, a__c="use crate::B;", b="use crate::a;\npub struct B;"), [["a", "a.c", "b"]])

    def test_python(self):
        def python(**files):
            named = {f"p/{name.replace('__', '/')}.py": text for name, text in files.items()}
            return self.found({"p/__init__.py": "from .a import A\nfrom .b import B\n", **named}, circles.python_needs, "p")

        self.assertEqual(python(a="from .b import B", b="import json"), [])
        self.assertEqual(python(a="from . import b", b="def f():\n    from .a import A"), [["p.a", "p.b"]])
        self.assertEqual(python(a="from p import B", b="import p.a"), [["p.a", "p.b"]])


class Run(unittest.TestCase):
    def run_without(self, **environment):
        script = Path(__file__).parent / "run"
        return subprocess.run([script], capture_output=True, text=True, env={**os.environ, **environment})

    def test_an_unknown_name_is_refused(self):
        done = self.run_without(FIATLUX_CI_WITHOUT="node chrome")
        self.assertEqual(done.returncode, 2)
        self.assertIn("'chrome' is unknown", done.stderr)

    def test_an_unknown_part_of_the_tests_is_refused(self):
        done = subprocess.run([Path(__file__).parent / "../tests/run", "everything"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 2)
        self.assertIn("'everything' is unknown; parts are rust, python, browser", done.stderr)

    def run_tests(self, *parts, **environment):
        """`tests/run` with a cargo that compiles nothing and counts as tests do: all that the script printed, and the calls of cargo."""
        with tempfile.TemporaryDirectory() as folder:
            cargo = Path(folder, "cargo")
            cargo.write_text(
                f'#!/bin/sh\necho "$*" >>{folder}/calls\n'
                'case "$*" in nextest*) exit 1 ;;\n'
                '*"--ignored by_ipv6") echo "test result: ok. 2 passed; 0 failed; 0 ignored" ;;\n'
                '*--doc*) echo "test result: ok. 5 passed; 0 failed; 1 ignored" ;;\n'
                '*--lib*) echo "test lab::by_python ... ignored, needs Python"\n'
                'echo "test result: ok. 7 passed; 0 failed; 3 ignored"; esac\n'
            )
            cargo.chmod(0o755)
            Path(folder, "calls").touch()
            Path(folder, "inet6").write_text(environment.pop("inet6", ""))
            settings = {
                "PATH": f"{folder}:{os.environ['PATH']}",
                "CARGO_TARGET_DIR": folder,
                "FIATLUX_IF_INET6": f"{folder}/inet6",
                "FIATLUX_PROGRAMS": folder,
                "FIATLUX_CI_WITHOUT": "python node chromium",
            }
            kept = {name: value for name, value in os.environ.items() if not name.startswith("FIATLUX_")}
            script = Path(__file__).parent.parent / "tests/run"
            done = subprocess.run([script, *parts], capture_output=True, text=True, env={**kept, **settings, **environment})
            return done, Path(folder, "calls").read_text()

    def test_a_clone_without_python_says_what_ran_and_what_did_not(self):
        done, calls = self.run_tests(inet6="0" * 31 + "1 01 80 10 80       lo\n")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        end = done.stdout[done.stdout.rindex("\nran\n") :]
        for said in [
            "rust: 7 passed, 0 failed, 3 ignored (",
            "rust with IPv6: 2 passed, 0 failed (",
            "examples in the documentation: 5 passed, 0 failed, 1 ignored (",
            "left out",
            "rust: the ignored tests, which need Python 3.11 with venv, and PyPI or a FIATLUX_PYTHON that has the packages",
            "      lab::by_python\n",
            "python: all of python/tests, which needs Python 3.11",
            "browser: tests/browser/run.sh, which needs Node 20 with npm, and chromium",
            "FIATLUX_SLOW_TESTS=1 tests/run has them at full length",
        ]:
            with self.subTest(said):
                self.assertIn(said, end)
        self.assertNotIn("--include-ignored", calls)

    @unittest.skipUnless(Path("/proc/net").is_dir(), "only Linux can be without it")
    def test_a_machine_without_ipv6_says_so(self):
        said = "the tests with by_ipv6 in their names, which need IPv6"
        for python in ({}, {"FIATLUX_PYTHON": sys.executable, "FIATLUX_CI_WITHOUT": ""}):
            with self.subTest(python):
                done, calls = self.run_tests("rust", **python)
                self.assertIn(said, done.stdout)
                self.assertNotIn("--ignored by_ipv6", calls)
                self.assertEqual("--include-ignored --skip by_ipv6" in calls, bool(python))

    def test_a_failure_is_in_the_end_and_in_the_exit_code(self):
        with tempfile.TemporaryDirectory() as folder:
            python = Path(folder, "python")
            python.write_text("#!/bin/sh\nexit 1\n")
            python.chmod(0o755)
            done, _ = self.run_tests("python", FIATLUX_PYTHON=str(python), FIATLUX_CI_WITHOUT="node chromium")
        self.assertIn("failed\n  Python package", done.stdout)
        self.assertEqual(done.returncode, 1, done.stdout + done.stderr)

    def test_a_missing_tool_fails_before_anything_runs(self):
        with tempfile.TemporaryDirectory() as folder:
            for tool in ("bash", "dirname", "id"):
                os.symlink(shutil.which(tool), f"{folder}/{tool}")
            done = self.run_without(PATH=folder, FIATLUX_CI_WITHOUT="node chromium")
        self.assertEqual((done.returncode, done.stdout), (1, ""))
        self.assertIn("python is missing", done.stderr)


if __name__ == "__main__":
    unittest.main()
