"""Tests the benchmark in this process."""

import fiatlux
import numpy as np


class Zero:
    def __init__(self):
        self.begun = []

    def reset(self, info):
        self.begun.append((info["task"], info["seed"]))

    def __call__(self, observation):
        return np.zeros(53)


def test_a_policy_is_scored():
    policy, seen = Zero(), []
    evaluation = fiatlux.evaluate(policy, ["S05", "S07"], [0, 1], progress=seen.append)
    assert policy.begun == [("S05", 0), ("S05", 1), ("S07", 0), ("S07", 1)]
    assert seen == evaluation.episodes and len(seen) == 4
    assert all(len(episode["state_digest"]) == 64 for episode in seen)
    assert [row["id"] for row in evaluation.scores["subtasks"]] == ["S05", "S07"]
    assert "S01" in evaluation.scores["missing"]
    assert "S05 Carry Bulb to Disposal" in evaluation.table()
    again = fiatlux.evaluate(policy, ["S05"], [1])
    assert again.episodes[0] == seen[1]
