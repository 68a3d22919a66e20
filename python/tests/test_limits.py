"""Tests that limits of containers and clusters are honoured, by doubles of the kernel's files."""

import fiatlux
import fiatlux._memory
import fiatlux.vector
import numpy as np
import pytest

GIB = 1 << 30
MEMINFO = "MemTotal: 33554432 kB\nMemAvailable: 16777216 kB\nSwapFree: 0 kB\n"
V1 = {
    "memory.limit_in_bytes": 3 * GIB,
    "memory.usage_in_bytes": GIB,
    "memory.stat": f"cache 5\ntotal_inactive_file {GIB // 2}",
}
V2 = {"memory.max": 3 * GIB, "memory.current": GIB, "memory.stat": f"anon 5\ninactive_file {GIB // 2}"}
FREE = {"memory.max": "max", "memory.current": GIB, "memory.stat": "anon 5"}
FREE_V1 = {"memory.limit_in_bytes": 0x7FFFFFFFFFFFF000, "memory.usage_in_bytes": GIB, "memory.stat": "cache 5"}


def machine(root, groups, folders, meminfo=MEMINFO):
    for name, text in (("proc/self/cgroup", groups), ("proc/meminfo", meminfo)):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    for folder, files in folders.items():
        (root / "sys/fs/cgroup" / folder).mkdir(parents=True, exist_ok=True)
        for name, value in files.items():
            (root / "sys/fs/cgroup" / folder / name).write_text(f"{value}\n")
    return root


@pytest.mark.parametrize(
    "groups, folders, left, by",
    [
        ("", {}, 16 * GIB, "proc/meminfo"),
        ("0::/\n", {"": V2}, 2.5 * GIB, "cgroup/memory.max"),  # Docker with a private namespace
        ("0::/kubepods/pod7/c1\n", {"": V2}, 2.5 * GIB, "cgroup/memory.max"),  # the machine's path, seen from inside
        (
            "0::/user/job\n",
            {"": FREE, "user": V2, "user/job": FREE},
            2.5 * GIB,
            "user/memory.max",
        ),  # Slurm: an outer group
        ("0::/user/job\n", {"": FREE, "user/job": FREE}, 16 * GIB, "proc/meminfo"),
        ("9:cpu,cpuacct:/x\n8:memory:/x\n", {"memory/x": V1, "memory": FREE_V1}, 2.5 * GIB, "x/memory.limit_in_bytes"),
        ("8:memory:/docker/c1\n0::/\n", {"memory": V1}, 2.5 * GIB, "memory/memory.limit_in_bytes"),
        ("8:memory:/x\n", {"memory/x": FREE_V1}, 16 * GIB, "proc/meminfo"),
        ("0::/x\n", {"x": {**V2, "memory.max": "odd"}}, 16 * GIB, "proc/meminfo"),
    ],
)
def test_the_tightest_limit_counts(tmp_path, groups, folders, left, by):
    found = fiatlux._memory.available(machine(tmp_path, groups, folders))
    assert found is not None and found[0] == left and found[1].endswith(by), found


def test_a_system_without_these_files_has_no_limit(tmp_path):
    assert fiatlux._memory.available(tmp_path) is None


def test_worlds_beyond_the_limit_are_refused_and_others_made(monkeypatch):
    monkeypatch.setattr(fiatlux._memory, "available", lambda: (100 << 20, "/sys/fs/cgroup/memory.max"))
    with pytest.raises(
        MemoryError, match="no memory for 200000 worlds: .* 0.1 GiB are left by /sys/fs/cgroup/memory.max"
    ):
        fiatlux.VectorEnv("S07", 200_000, seeds=[1000])
    with pytest.raises(MemoryError, match="no memory for 128 worlds"):
        fiatlux.VectorEnv("S07", 128, seeds=[1000], sensors=["camera"], image_size=(640, 480))
    fiatlux.VectorEnv("S07", 2, seeds=[1000]).reset(seed=0)


def test_contacts_of_many_states_are_counted_first(monkeypatch):
    kinematics = fiatlux.Kinematics("S05", seed=1000)
    states = np.tile(kinematics.reference, (20_000, 1))
    few = kinematics.contacts(states[:300], margin=1.0)
    assert len(few.distance) % 300 == 0 and len(few.distance) > 3000
    monkeypatch.setattr(fiatlux._memory, "available", lambda: (100 << 20, "/sys/fs/cgroup/memory.max"))
    points = len(few.distance) // 300 * 20_000
    with pytest.raises(MemoryError, match=f"no memory for about {points} contact points"):
        kinematics.contacts(states, margin=1.0)
