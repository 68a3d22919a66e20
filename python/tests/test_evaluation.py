"""Tests the benchmark in this process.

`FIATLUX_TEST_RUN` names the folder of `fiatlux evaluate --policy zero --tasks S05 --seeds 0`.
"""

import json
import os
import pathlib
import subprocess

import fiatlux
import numpy as np
import pytest

RUN = os.environ.get("FIATLUX_TEST_RUN")
RECORDED = {"rows_digest", "bag", "failure", "notes", "signed_by"}
"""Fields of an episode of `results.json` that do not follow from its rows."""


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
    table = evaluation.table()
    assert "S05 Carry Bulb to Disposal" in table and table.count("over 2 of 12 subtasks: not comparable") == 2
    again = fiatlux.evaluate(policy, ["S05"], [1])
    assert again.episodes[0] == seen[1]


@pytest.mark.skipif(RUN is None, reason="FIATLUX_TEST_RUN is not set")
def test_scores_and_episodes_are_those_of_the_programs():
    theirs = json.loads((pathlib.Path(RUN) / "results.json").read_text())
    ours = fiatlux.evaluate(Zero, ["S05"], [0])
    (episode,), (recorded,) = ours.episodes, theirs["episodes"]
    assert episode == {name: value for name, value in recorded.items() if name not in RECORDED}
    assert ours.scores == {name: theirs[name] for name in fiatlux.evaluation.SCORES}
    # The published judge does not count the blow that breaks the bulb for the strict one.
    (row,) = ours.scores["subtasks"]
    assert not episode["broken"] and f"{row['broken_rate']:.2f} {row['dropped_rate']:>8.2f}" in ours.table()


def test_a_policy_plays_a_part_of_the_errand(tmp_path):
    policy = Zero()
    evaluation = fiatlux.evaluate(policy, seeds=[0], part="S01", name="mine", out=tmp_path / "part")
    results = json.loads((tmp_path / "part" / "results.json").read_text())
    assert policy.begun == [("S01", 0)] and [episode["task"] for episode in evaluation.episodes] == ["replace"]
    assert (results["policy"], results["conditions"]["relay"]) == ("expert with S01=mine", ["S01=mine"])
    assert not results["conditions"]["ranked"]
    first, second = results["parts"][:2]
    assert (first["id"], first["reached"], first["successes"], first["policy"]) == ("S01", 1, 0, "mine")
    assert (second["reached"], second["policy"]) == (0, "expert")
    for wrong, reason in [
        ({"part": "S13", "out": tmp_path / "other"}, "S13"),
        ({"part": "S01", "tasks": ["S05"], "out": tmp_path / "other"}, "in the task replace"),
        ({"part": "S01"}, "only a recorded evaluation"),
    ]:
        with pytest.raises(ValueError, match=reason):
            fiatlux.evaluate(Zero, **{"seeds": [0], **wrong})


def test_a_recorded_evaluation_has_what_its_results_say(tmp_path):
    evaluation = fiatlux.evaluate(Zero, ["S05"], [0, 1], out=tmp_path)
    results = json.loads((tmp_path / "results.json").read_text())
    assert evaluation.episodes == results["episodes"]
    assert evaluation.scores == {name: results[name] for name in fiatlux.evaluation.SCORES}
    table = evaluation.table()
    assert "score S, strict" in table and "score S, published" in table
    # In a run all count.
    assert evaluation.scores["score"]["subtasks"] == 12
    assert table.count("over 12 of 12 subtasks, 11 of them not registered and 0") == 2


def test_published_episodes_have_no_strict_scores(tmp_path):
    for settings in ({}, {"out": tmp_path}):
        evaluation = fiatlux.evaluate(Zero, ["S05"], [0], protocol="published", **settings)
        assert evaluation.episodes[0]["strict_success"] is None and evaluation.scores["score_strict"] is None
        assert "strict" not in evaluation.table()


def test_shards_join_one_run(tmp_path):
    """Guards shards: each plays its part of one run, goes on alone, and says nothing of the others' part."""
    run_file, tasks, seeds = tmp_path / "RUN.toml", ["S05", "S09"], [0, 1, 2]
    whole = fiatlux.evaluate(Zero, tasks, seeds, out=tmp_path / "whole", run_file=run_file)
    parts = [tmp_path / f"part-{part}" for part in (1, 2)]
    for part, out in enumerate(parts, 1):
        shard = fiatlux.evaluate(Zero, tasks, seeds, out=out, shard=f"{part}/2", run_file=run_file)
        assert shard.lost == () and sum(bool(row["bag"]) for row in shard.episodes) == 3
        with pytest.warns(UserWarning, match="had all episodes already"):
            again = fiatlux.evaluate(Zero, tasks, seeds, out=out, shard=f"{part}/2", run_file=run_file)
        assert again.episodes == shard.episodes
    played = [row for out in parts for row in json.loads((out / "results.json").read_text())["episodes"] if row["bag"]]
    expected = {(row["task"], row["seed"]): row["rows_digest"] for row in whole.episodes}
    assert {(row["task"], row["seed"]): row["rows_digest"] for row in played} == expected and len(played) == 6
    assert len({journal.parent.name for journal in tmp_path.glob("*/runs/*/*.run.jsonl")}) == 1
    if scorer := os.environ.get("FIATLUX_TEST_SCORER"):
        merged = tmp_path / "merged"
        subprocess.run([scorer, "merge", merged, *parts], check=True, stdout=subprocess.DEVNULL)
        results, one = (json.loads((folder / "results.json").read_text()) for folder in (merged, tmp_path / "whole"))
        # Servers have other names, and so have their bags.
        for result in (results, one):
            result["run"]["servers"] = [row.pop("bag") is None for row in result["episodes"]]
        assert results == one
    for wrong, reason in [
        ({"shard": "1/2"}, "one run_file"),
        ({"shard": "3/2", "run_file": run_file}, "is not a shard"),
        ({"shard": "7/7", "run_file": run_file}, "none of the 6 episodes"),
        ({"shard": "1/3", "run_file": run_file, "out": parts[0]}, "it has shard 1/2"),
        ({"shard": "1/2", "out": None}, "only a recorded evaluation"),
    ]:
        with pytest.raises((ValueError, OSError), match=reason):
            fiatlux.evaluate(Zero, tasks, seeds, **{"out": tmp_path / "wrong", **wrong})
    with pytest.raises(ValueError, match="rooms of its own"):
        fiatlux.evaluate(Zero, tasks, "fresh:4", out=tmp_path / "wrong", shard="1/2", run_file=run_file)


def test_a_task_in_place_of_tasks_is_refused_by_name():
    with pytest.raises(TypeError, match=r"unexpected argument 'task' \(did you mean 'tasks'\?\)"):
        fiatlux.evaluate(lambda observation: np.zeros(53), task=["S05"])
