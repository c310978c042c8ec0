"""Campaigns as users live them: order, seeds, shards, stopping and going on, refusals, tables, report."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from cell.decision.policy import shipped
from cell.errors import CellError, ConfigError
from cell.trials import report, tables
from cell.trials.campaign import ROUNDS, Campaign, read
from cell.trials.contenders import contender
from cell.trials.one_round import job_from_json
from cell.trials.schedule import schedule, shard
from cell.trials.settings import people
from tests.trials.made import Made, settings


def nothing(record: object) -> None:
    del record


def finished(folder: Path, workers: Made | None = None, **changes: object) -> Path:
    """A campaign of which every round is made up."""
    chosen = settings(**changes)
    Campaign(folder, chosen).run(schedule(chosen), workers or Made(), False, nothing)
    return folder


# -- the plan -------------------------------------------------------------------------------------------


def test_the_published_design_five_people_three_rounds_with_each_policy() -> None:
    specs = schedule(settings())
    assert len(specs) == 30 and len({s.id for s in specs}) == 30
    assert Counter((s.person, s.contender) for s in specs) == {(p, c): 3 for p in range(1, 6) for c in (0, 1)}
    firsts = Counter(s.contender for s in specs if s.order % 2 == 1)
    assert abs(firsts[0] - firsts[1]) <= 1, "no policy is always first"
    assert [s.persona for s in specs[::6]] == ["ana", "bo", "chen", "dana", "efe"]


def test_rounds_of_a_pair_share_their_seed_and_no_others_do() -> None:
    specs = schedule(settings())
    seeds = Counter((s.person, s.block, s.seed) for s in specs)
    assert set(seeds.values()) == {2} and len({s.seed for s in specs}) == 15


@given(st.integers(2, 7), st.integers(1, 5))
@examples(max_examples=20, deadline=None)
def test_seeds_depend_on_campaign_person_and_block_alone(who: int, blocks: int) -> None:
    """More people or rounds leave the seeds of the first ones as they are."""
    small = {(s.person, s.block): s.seed for s in schedule(settings(who="2", rounds=2))}
    large = {(s.person, s.block): s.seed for s in schedule(settings(who=str(who), rounds=2 * blocks))}
    assert all(large[key] == seed for key, seed in small.items() if key in large)


def test_shards_are_a_partition() -> None:
    specs = schedule(settings())
    parts = [shard(specs, f"{i}/4") for i in range(1, 5)]
    assert sorted(s.id for part in parts for s in part) == sorted(s.id for s in specs)
    for wrong in ("0/4", "5/4", "a/b", "3", "1/0"):
        with pytest.raises(ConfigError, match="--shard"):
            shard(specs, wrong)


def test_people_by_number_and_by_name() -> None:
    assert people("7")[5:] == ("ana", "bo") and people("efe,ana") == ("efe", "ana")
    with pytest.raises(ConfigError, match="legal values: ana, bo"):
        settings(who="zoe")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rounds": 5}, "multiple of the number of policies"),
        ({"onions": 16}, "--onions"),
        ({"policies": "tb,tb"}, "each once"),
        ({"who": "0"}, "--people"),
        ({"seed": -1}, "--seed"),
    ],
)
def test_impossible_settings_are_refused_by_the_option_s_name(changes: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        settings(**changes)


def test_policies_by_short_name_belief_and_file(tmp_path: Path) -> None:
    assert contender("tb", "full").policy == "tb-decairl"
    assert contender("tb@last-gesture", "full").belief == "last-gesture"
    assert contender("oracle", "truth").belief == "oracle"
    own = tmp_path / "mine@home.csv"
    own.write_text(shipped()["expert"].read_text())
    assert contender(str(own), "full").policy == "mine@home"
    assert contender(f"{own}@none", "full").belief == "none"
    for name, said in (
        ("oracle", "truth"),
        ("tb@guess", "legal values: gru"),
        ("nosuch", "shipped policies"),
    ):
        with pytest.raises(CellError, match=said):
            contender(name, "full")


# -- the folder -----------------------------------------------------------------------------------------


def test_a_stopped_campaign_goes_on_where_it_stopped_and_gives_the_same_table(tmp_path: Path) -> None:
    whole = finished(tmp_path / "whole")
    chosen = settings()
    campaign = Campaign(tmp_path / "parts", chosen)
    first, second = Made(most=11, backwards=True), Made()
    with pytest.raises(KeyboardInterrupt):
        campaign.run(schedule(chosen), first, False, nothing)
    (tmp_path / "parts" / ROUNDS / ".p01-r01-tb.json.half").write_text("{")  # died while it wrote
    again = Campaign(tmp_path / "parts", chosen)
    again.run(schedule(chosen), second, False, nothing)
    assert len(first.asked) == 11 and len(second.asked) == 19 and not set(first.asked) & set(second.asked)
    for folder in (whole, tmp_path / "parts"):
        tables.write(read(folder))
    assert (whole / tables.TABLE).read_bytes() == (tmp_path / "parts" / tables.TABLE).read_bytes()


def test_other_settings_in_the_same_folder_are_refused_by_name(tmp_path: Path) -> None:
    finished(tmp_path, rounds=2, who="1")
    with pytest.raises(ConfigError, match=r"other settings \(onions, seed\)"):
        Campaign(tmp_path, settings(rounds=2, who="1", onions=3, seed=9))
    Campaign(tmp_path, settings(rounds=2, who="1"))


def test_a_folder_that_is_none_and_a_broken_manifest_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no campaign"):
        read(tmp_path)
    (tmp_path / "campaign.json").write_text("{}")
    with pytest.raises(ConfigError, match="no manifest"):
        read(tmp_path)
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(ConfigError, match="--out"):
        Campaign(file, settings())


def test_a_job_is_plain_data(tmp_path: Path) -> None:
    chosen = settings(rounds=2, who="1")
    job = Campaign(tmp_path, chosen)._job(schedule(chosen)[0], record=True)
    assert job_from_json(job.to_json()) == job
    assert job.record.endswith(f"{job.spec.id}.mcap")


# -- tables and report ----------------------------------------------------------------------------------


def test_the_summary_finds_the_difference_that_was_put_in(tmp_path: Path) -> None:
    summary = tables.write(read(finished(tmp_path)))
    found = summary["comparisons"][0]
    assert (found["first"], found["second"], found["pairs"], found["persons"]) == ("tb", "dec", 15, 5)
    assert found["share"] == pytest.approx(-0.25, abs=0.001)
    assert found["p_permutation"] == pytest.approx(2 / 2**15, rel=0.01)
    assert summary["totals"]["dropped"] == 0 and summary["rounds"] == {"finished": 30, "expected": 30}
    assert found["power"]["goal_20_percent_alpha_0.01"] > 0.99


def test_rounds_that_failed_are_counted_but_not_compared(tmp_path: Path) -> None:
    summary = tables.write(read(finished(tmp_path, Made(failure="the arm was stopped"), who="2", rounds=2)))
    assert summary["totals"]["completed"] == 0 and summary["comparisons"][0]["note"].startswith(
        "too few pairs"
    )


def test_the_report_is_one_file_with_pictures_and_limits(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    report.build(read(finished(tmp_path, who="2", rounds=4)))
    page = (tmp_path / report.REPORT).read_text()
    assert page.count("data:image/png;base64,") == 4
    assert not re.search(r"(src|href)=['\"](?!data:)", page), "nothing is loaded from elsewhere"
    for words in ("tb against dec", "Limits of the claim", "persons as random effects"):
        assert words in page
    for picture in ("sort-time.png", "fluency.png", "timeline-tb.png", "timeline-dec.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


def test_an_unfinished_campaign_says_so_in_its_report(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    chosen = settings(who="1", rounds=4)
    with pytest.raises(KeyboardInterrupt):
        Campaign(tmp_path, chosen).run(schedule(chosen), Made(most=3), False, nothing)
    report.build(read(tmp_path))
    assert "Incomplete: 3 of 4 rounds" in (tmp_path / report.REPORT).read_text()
    assert json.loads((tmp_path / "summary.json").read_text())["rounds"]["finished"] == 3
