"""Tests that the digest of a policy follows every part of its code, and nothing else: small modules, each with edits that change what it plays."""

import functools
import importlib
import os
import pathlib
import shutil
import subprocess
import sys
import textwrap

import fiatlux
import numpy as np
import pytest
from fiatlux.fingerprint import digest_of

# Code, the expression for the policy, edits that must count, edits that must not.
CASES = {
    "a class's own class": (
        """
        class Meta(type):
            bias = 0.5
            def __new__(meta, name, bases, space):
                space["scale"] = 3.0
                return super().__new__(meta, name, bases, space)
            def __call__(cls, *given):
                made = super().__call__(*given)
                made.gain = 2.0  # of each object
                return made
        class Base(metaclass=Meta):
            pass
        class Mine(Base):
            def __call__(self, observation):
                return self.gain * self.scale * type(self).bias
        """,
        "Mine",
        [("made.gain = 2.0", "made.gain = 2.5"), ("bias = 0.5", "bias = 0.6"), ('"] = 3.0', '"] = 4.0')],
        [("# of each object", "# of every object")],
    ),
    "functions": (
        """
        import numpy as np
        GAINS = [1.0, 2.0]
        TABLE = {"hip": 0.5}
        def scale(x): return x * 0.0
        def shift(x): return x + 0.0
        def policy(observation): return shift(scale(np.ones(2))) * GAINS[0] * TABLE["hip"]
        """,
        "policy",
        [
            ("x * 0.0", "x * 0.7"),
            ("x + 0.0", "x + 0.2"),
            ("[1.0, 2.0]", "[1.0, 3.0]"),
            ("0.5", "0.6"),
            ("shift(scale(", "scale(shift("),
        ],
        [
            ("x * 0.0", "x * 0.0  # slower"),
            ("def scale(x): return", "\n\ndef scale(x):\n    return"),
            ("np.ones(2)", "np.ones( 2 )"),
        ],
    ),
    "nested": (
        """
        def helper(x): return x + 1
        def other(x): return x + 2
        def policy(observation):
            def inner(x):
                return [helper(y) for y in x]
            return inner(observation) + list(map(lambda x: other(x), observation))
        """,
        "policy",
        [
            ("x + 1", "x + 3"),
            ("x + 2", "x + 3"),
            ("helper(y)", "other(y)"),
            ("lambda x: other(x)", "lambda x: helper(x)"),
        ],
        [],
    ),
    "closures": (
        """
        def make(gain, step=0.1):
            def policy(observation, bias=0.5, *, k=2): return observation * gain * step + bias * k
            return policy
        policy = make(1.0)
        """,
        "policy",
        [("make(1.0)", "make(2.0)"), ("step=0.1", "step=0.2"), ("bias=0.5", "bias=0.6"), ("k=2", "k=3")],
        [],
    ),
    "lambdas": (
        """
        first, second = lambda o: o * 1.0, lambda o: o * 2.0
        policies = [lambda o: first(o), lambda o: second(o)]
        policy = policies[0]
        """,
        "policy",
        [("o * 1.0", "o * 3.0"), ("policies[0]", "policies[1]")],
        [],
    ),
    "partials": (
        """
        import functools
        def play(gain, observation, *, k=1): return gain * observation * k
        policy = functools.partial(functools.partial(play, k=3), 2.0)
        """,
        "policy",
        [
            ("k=3", "k=4"),
            ("2.0", "2.5"),
            ("gain * observation", "gain + observation"),
            ("play, k", "lambda g, o, k: g, k"),
        ],
        [],
    ),
    "dataclass": (
        """
        import dataclasses
        @dataclasses.dataclass
        class Policy:
            gain: float = 1.0
            names: list = dataclasses.field(default_factory=lambda: ["a"])
            def __call__(self, observation): return self.gain * observation
        """,
        "Policy",
        [("= 1.0", "= 2.0"), ('["a"]', '["b"]'), ("self.gain *", "self.gain +")],
        [],
    ),
    "named tuple": (
        """
        from typing import NamedTuple
        class Gains(NamedTuple):
            hip: float = 1.0
            def doubled(self): return 2 * self.hip
        class Policy:
            def __call__(self, observation): return Gains().doubled()
        """,
        "Policy()",
        [("= 1.0", "= 2.0"), ("2 * self", "3 * self")],
        [],
    ),
    "methods": (
        """
        import functools
        class Base:
            offset = 0.5
            def plan(self, x): return x + self.offset
        class Policy(Base):
            def __init__(self, gain=1.0): self.gain = gain
            @property
            def k(self): return self.gain * 2
            @k.setter
            def k(self, value): self.gain = value + 1
            @staticmethod
            def turn(x): return x * 3
            @classmethod
            def bend(cls, x): return x * 4
            @functools.cached_property
            def table(self): return [5]
            @functools.lru_cache
            def slow(self, x): return x * 6
            def act(self, x): return self.plan(x) * self.k + self.turn(x) + self.bend(x) + self.table[0] + self.slow(x)
        policy = Policy().act
        """,
        "policy",
        [
            ("offset = 0.5", "offset = 0.6"),
            ("x + self.offset", "x - self.offset"),
            ("gain * 2", "gain * 7"),
            ("value + 1", "value + 2"),
            ("x * 3", "x * 7"),
            ("x * 4", "x * 7"),
            ("[5]", "[7]"),
            ("x * 6", "x * 7"),
            ("Policy().act", "Policy(2.0).act"),
            ("Policy().act", "Policy().plan"),
        ],
        [],
    ),
    "weights in helpers": (
        """
        import numpy as np
        class Net:
            __slots__ = ("w",)
            def forward(self, x): return x * self.w
        class Policy:
            def __init__(self): self.load(1.0)
            def load(self, scale):
                self.net = Net()
                self.net.w = np.full(3, scale)
            @classmethod
            def of(cls, bias):
                made = cls()
                made.bias = bias
                return made
            def reset(self, info): self.hidden = 0
            def __call__(self, observation):
                self.hidden += 1
                return self.net.forward(observation) + self.bias
        policy = Policy.of(0.5)
        """,
        "policy",
        [
            ("load(1.0)", "load(2.0)"),
            ("of(0.5)", "of(0.6)"),
            ("x * self.w", "x + self.w"),
            ("hidden = 0", "hidden = 9"),
        ],
        [],
    ),
    "recursion": (
        """
        def even(n): return True if n == 0 else odd(n - 1)
        def odd(n): return False if n == 0 else even(n - 1)
        def policy(observation): return even(4)
        """,
        "policy",
        [("return True", "return None"), ("return False", "return None"), ("even(4)", "odd(4)")],
        [],
    ),
    "one name, two classes": (
        """
        import sys
        if sys.maxsize > 0:
            class Policy:
                def __call__(self, observation): return 1.0
        else:
            class Policy:
                def __call__(self, observation): return 2.0
        """,
        "Policy",
        [("return 1.0", "return 3.0")],
        [("return 2.0", "return 3.0")],
    ),
    "modules of the user's": (
        """
        import helpers
        from helpers import scale as size
        def policy(observation):
            from late import more
            return helpers.shift(size(observation)) + more(observation)
        """,
        "policy",
        [("scale as size", "shift as size"), ("helpers.shift", "helpers.scale")],
        [],
    ),
    "libraries": (
        """
        from math import sin as f
        import numpy as np
        def policy(observation): return np.cos(f(1.0)) * np.float64(2.0)
        """,
        "policy",
        [("sin as f", "cos as f"), ("np.cos", "np.sin"), ("float64(2.0)", "float32(2.0)")],
        [],
    ),
    "found by name": (
        """
        OTHER = 1.0
        def late(x): return x * 3.0
        class Policy:
            def play_S05(self, x): return x + 1.0
            def play_S06(self, x): return x + 2.0
            def reset(self, info): self.play = getattr(self, f"play_{info['task']}")
            def __call__(self, observation): return self.play(globals()["la" + "te"](observation))
        """,
        "Policy",
        [("x + 1.0", "x + 1.5"), ("x + 2.0", "x + 2.5"), ("x * 3.0", "x * 3.5"), ('"play_', '"plan_')],
        [("x + 1.0", "x + 1.0  # slower")],
    ),
    "values of the standard library": (
        """
        import collections, contextvars, datetime, decimal, fractions
        PART, SHARE = fractions.Fraction(1, 3), decimal.Decimal("0.1")
        WAIT, FIRST = datetime.timedelta(seconds=2), datetime.date(2026, 1, 1)
        TABLE = collections.defaultdict(lambda: 0.5, {"a": 1.0})
        LAST = collections.deque([1, 2], maxlen=5)
        GAIN = contextvars.ContextVar("gain", default=0.25)
        def policy(observation): return [PART, SHARE, WAIT, FIRST, TABLE["b"], LAST, GAIN.get()]
        """,
        "policy",
        [
            ("Fraction(1, 3)", "Fraction(2, 3)"),
            ('"0.1"', '"0.2"'),
            ("seconds=2", "seconds=3"),
            ("2026, 1, 1", "2026, 1, 2"),
            ("0.5, {", "0.6, {"),
            ('"a": 1.0', '"a": 1.5'),
            ("maxlen=5", "maxlen=4"),
            ("default=0.25", "default=0.75"),
        ],
        [],
    ),
    "texts": (
        '''
        def policy(observation):
            """A prompt."""
            return len(f"go {observation!r:>{10}} to" " the lamp")
        ''',
        "policy",
        [("A prompt", "Another prompt"), ("!r", "!s"), (">{10}", ">{11}"), ("the lamp", "a lamp")],
        [],
    ),
    "functions in objects of C": (
        """
        import functools, operator
        import numpy as np
        def clip(x): return min(x, 0.5)
        def later(a, b): return b - a
        def scaled(x): return 2.0 * x
        def noted(x): return 3.0 * x
        CLIP = np.frompyfunc(clip, 1, 1)
        ORDER = functools.cmp_to_key(later)
        DRAWS = map(scaled, iter(int, 1))
        CALL = operator.methodcaller("map", noted)
        def policy(observation): return CLIP(sorted(observation, key=ORDER)), next(DRAWS), CALL(observation)
        """,
        "policy",
        [("min(x, 0.5)", "max(x, 0.5)"), ("b - a", "a - b"), ("2.0 * x", "2.5 * x"), ("3.0 * x", "3.5 * x")],
        [("min(x, 0.5)", "min(x,  0.5)  # half")],
    ),
    "a property that is assigned": (
        """
        class Gain:
            def __init__(self, value): self._value = value
            @property
            def value(self): return self._value * 1.5
            @value.setter
            def value(self, new): self._value = new * 2.5
        def policy(observation):
            gain = Gain(observation)
            gain.value = 4.5
            return gain.value
        """,
        "policy",
        [("* 1.5", "* 1.75"), ("* 2.5", "* 2.75"), ("4.5", "4.75")],
        [("@property", "@property  # read")],
    ),
    "classes that enter themselves in a list": (
        """
        class Base:
            known = {}
            def __init_subclass__(cls, **given): Base.known[cls.__name__] = cls
        class Left(Base):
            def act(self): return 1.5
        class Right(Base):
            def act(self): return 2.5
        def policy(observation): return Base.known["Left"]().act() + Base.known["Right"]().act()
        """,
        "policy",
        [("1.5", "1.75"), ("2.5", "2.75")],
        [],
    ),
    "weak references": (
        """
        import weakref
        class Arm:
            def reach(self, observation): return self.gain * 1.5
            def __init__(self): self.gain = 2.5
        KEPT = Arm()
        ARM, REACH, PROXY = weakref.ref(KEPT), weakref.WeakMethod(KEPT.reach), weakref.proxy(KEPT)
        def policy(observation): return ARM().reach(observation), REACH()(observation), PROXY.reach(observation)
        """,
        "policy",
        [("* 1.5", "* 1.75"), ("gain = 2.5", "gain = 2.75")],
        [],
    ),
    "lists in objects of a library": (
        """
        import collections
        class Missing(collections.UserDict):
            def __missing__(self, name): return 1.5
        TABLE = collections.ChainMap({"hip": 2.5}, Missing())
        def policy(observation): return TABLE["hip"] + TABLE.maps[1]["knee"]
        """,
        "policy",
        [("1.5", "1.75"), ("2.5", "2.75")],
        [],
    ),
}

# Of the cases, in every version of Python; another value refuses the runs that policies have begun.
PINNED = {
    "a class's own class": "808c866686d3727a",
    "functions": "7a195ea39ec954d1",
    "nested": "c8e49b14b2596afe",
    "closures": "7a341ef49cf85543",
    "lambdas": "5c4531f5174b9f6c",
    "partials": "a06f5ccdbc0ed378",
    "dataclass": "a60ab2d246d4ed67",
    "named tuple": "79625d1d10955fe5",
    "methods": "b8cd8188b04c6ac6",
    "weights in helpers": "409ae1a74cc0b1c5",
    "recursion": "21ca60ec74cb79a4",
    "one name, two classes": "e81e35a309852ccb",
    "modules of the user's": "13e37f62f4483cd3",
    "libraries": "7b2ed0a831d490e4",
    "found by name": "5c93eef228208209",
    "values of the standard library": "1eb532c6b26b0715",
    "texts": "9def5921b031b138",
    "functions in objects of C": "7774723be285ddaa",
    "a property that is assigned": "54b69b0c57ea147d",
    "classes that enter themselves in a list": "86b672f2487bf328",
    "weak references": "5e77a19b79846de0",
    "lists in objects of a library": "bbeff679170e8fa8",
}

HELPERS = {
    "helpers": "FACTOR = 2.0\ndef scale(x): return x * FACTOR\ndef shift(x): return x + 1.0\n",
    "late": "def more(x): return x * 5.0\n",
}


def imported(folder, code, policy, helpers=HELPERS):
    """The policy of a module that is imported from a folder."""
    folder.mkdir()
    for name, text in {**helpers, "mine": textwrap.dedent(code)}.items():
        (folder / f"{name}.py").write_text(text)
        sys.modules.pop(name, None)
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    try:
        mine = importlib.import_module("mine")
        return eval(policy, vars(mine))
    finally:
        sys.path.remove(str(folder))
        sys.dont_write_bytecode = before


def digest_in(folder, code, policy, helpers=HELPERS):
    # Also what a function imports as it is called is found only next to it.
    sys.path.insert(0, str(folder))
    try:
        return digest_of(imported(folder, code, policy, helpers))
    finally:
        sys.path.remove(str(folder))


@pytest.mark.parametrize("case", CASES)
def test_it_follows_what_the_user_wrote(case, tmp_path):
    code, policy, counts, does_not = CASES[case]
    base = digest_in(tmp_path / "base", code, policy)
    assert digest_in(tmp_path / "again", code, policy) == base
    for number, (old, new) in enumerate(counts):
        assert old in code
        assert digest_in(tmp_path / f"edit {number}", code.replace(old, new), policy) != base, f"{old} -> {new}"
    for number, (old, new) in enumerate(does_not):
        assert old in code
        edited = textwrap.dedent(code).replace(old, new)
        assert digest_in(tmp_path / f"blank {number}", edited, policy) == base, f"{old} -> {new}"


def test_it_follows_the_users_other_modules(tmp_path):
    code, policy, *_ = CASES["modules of the user's"]
    base = digest_in(tmp_path / "base", code, policy)
    for number, (name, old, new) in enumerate(
        [
            ("helpers", "= 2.0", "= 3.0"),
            ("helpers", "x * F", "x / F"),
            ("helpers", "+ 1.0", "+ 2.0"),
            ("late", "5.0", "6.0"),
        ]
    ):
        edited = {**HELPERS, name: HELPERS[name].replace(old, new)}
        assert digest_in(tmp_path / str(number), code, policy, edited) != base, f"{old} -> {new}"


def test_it_is_the_same_in_every_process(tmp_path):
    for number, (case, (code, policy, *_)) in enumerate(CASES.items()):
        folder = tmp_path / str(number)
        here = digest_in(folder, code, policy)
        script = f"import mine; from fiatlux.fingerprint import digest_of; print(digest_of(mine.{policy}))"
        run = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=True)
        assert run.stdout.split() == [here], case


@pytest.mark.parametrize("case", CASES)
def test_it_is_the_same_in_every_version(case, tmp_path):
    code, policy, *_ = CASES[case]
    assert digest_in(tmp_path / "here", code, policy) == PINNED[case]


OTHERS = [
    path for minor in range(10, 20) if (path := shutil.which(f"python3.{minor}")) and minor != sys.version_info[1]
]


def test_another_python_has_the_same_digests(tmp_path):
    """One that has numpy and gymnasium itself: the package works in every version."""
    (tmp_path / "path").mkdir()
    (tmp_path / "path" / "fiatlux").symlink_to(pathlib.Path(fiatlux.__file__).parent)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "path")}
    run = functools.partial(subprocess.run, capture_output=True, text=True, env=environment)
    having = [path for path in OTHERS if run([path, "-c", "import fiatlux"]).returncode == 0]
    if not having:
        pytest.skip("needs another Python on the path, with numpy and gymnasium")
    for number, (case, (code, policy, *_)) in enumerate(CASES.items()):
        folder = tmp_path / str(number)
        imported(folder, code, policy)
        script = f"import mine; from fiatlux.fingerprint import digest_of; print(digest_of(mine.{policy}))"
        for path in having:
            assert run([path, "-c", script], cwd=folder).stdout.split() == [PINNED[case]], (path, case)


PLAYED = """
import numpy as np
calls = 0
LOG = []
class Memory:
    def __init__(self): self.seen = []
    def keep(self, x): self.seen.append(x)
class Policy:
    made = 0
    def __init__(self, weight=1.0):
        self.weights = {"w": np.full(3, weight)}
        self.hidden = np.zeros(3)
        self.memory = Memory()
        self.cache = {}
    def reset(self, info):
        self.hidden[:] = 0.0
        self._begin(info)
    def _begin(self, info): self.seed = info["seed"]
    def __call__(self, observation):
        global calls
        calls += 1
        LOG.append(calls)
        self.hidden = self.hidden + observation
        self.cache[calls] = observation
        self.memory.keep(observation)
        return self.weights["w"] * self.hidden
def counter():
    count = 0
    seen = []
    def policy(observation):
        nonlocal count
        count += 1
        seen.append(observation)
        return np.zeros(3) + count
    return policy
"""


@pytest.mark.parametrize("made", ["Policy()", "counter()"])
def test_what_playing_changes_does_not_count(made, tmp_path):
    policy = imported(tmp_path / "code", PLAYED, made)
    before = digest_of(policy)
    for seed in range(3):
        if hasattr(policy, "reset"):
            policy.reset({"seed": seed})
        policy(np.ones(3))
    assert digest_of(policy) == before


def test_an_edit_after_the_import_is_not_what_runs(tmp_path):
    policy = imported(tmp_path / "code", "def policy(o): return 1.0", "policy")
    before = digest_of(policy)
    (tmp_path / "code" / "mine.py").write_text("def policy(o): return 2.0  # not imported yet")
    assert digest_of(policy) == digest_of(policy) != before
    assert digest_of(policy) != digest_in(tmp_path / "new", "def policy(o): return 2.0", "policy")


def test_without_source_the_byte_code_counts():
    made = []
    for text in (
        "def policy(o): return helper(o)\ndef helper(o): return 1",
        "def policy(o): return helper(o)\ndef helper(o): return 2",
    ):
        space = {"__name__": "__main__"}
        exec(text, space)
        made.append(digest_of(space["policy"]))
    assert made[0] != made[1]
