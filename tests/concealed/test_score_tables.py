"""Rates, intervals, tables and the order in which truth may be read."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from concealed import run
from concealed.figures import mean, median, rate, share, wilson
from concealed.rival_scores import range_errors, rivals_markdown, score_rivals
from concealed.score import CaseScore, EffectScore, Judged
from concealed.tables import (
    calibration,
    case_figures,
    effect_figures,
    imitated,
    markdown,
    must_hold,
    right_by_gain,
    sure_and_right,
)
from scipy.stats import binomtest

from torchrbd.errors import InputError

HIT = EffectScore("joint_spring", 0.08, True, True, 0.99, True, None, None, False, errors=(0.01,), covered=(True,))
MISS = EffectScore("torque_ripple", 0.08, False, False, None, False, None, None, False)
CASE = CaseScore("1", "field", "arm", (HIT,), (True, True), (Judged(0.99, True, 400.0),), (), 0, 6, 0.9, 4.0)
WRONG = CaseScore(
    "2", "field", "arm", (MISS,), (True, False), (Judged(0.95, False, 35.0), Judged(0.8, True, 38.0)),
    (("torque_scale", "a", 0.95),), 1, 6, 0.5, 6.0,
)  # fmt: skip
NULL = CaseScore("3", "null", "arm", (), (True,), (Judged(0.6, True, None),), (), 0, 6, None, 5.0)


@pytest.mark.parametrize(("hits", "n"), [(0, 7), (3, 11), (97, 100), (5, 5)])
def test_wilson_is_scipys(hits: int, n: int) -> None:
    told = binomtest(hits, n).proportion_ci(method="wilson")
    assert wilson(hits / n, n) == pytest.approx((told.low, told.high), abs=1e-4)
    assert rate([True] * hits + [False] * (n - hits) + [None]).n == n


def test_wilson_contains_the_rate_to_the_last_bit() -> None:
    for n in range(1, 2000):
        assert wilson(0.0, n)[0] == 0.0
        assert wilson(1.0, n)[1] == 1.0


def test_share_over_cases_is_less_sure_where_cases_differ() -> None:
    alike = share([1] * 40, [2] * 40)
    apart = share([0, 2] * 20, [2, 2] * 20)
    assert alike.value == apart.value == 0.5
    # All or nothing a case: forty independent ones, not eighty.
    assert (apart.low, apart.high) == pytest.approx(wilson(0.5, 40))
    assert share([0] * 40, [2] * 40).high == pytest.approx(wilson(0.0, 40)[1])


def test_median_interval_covers() -> None:
    rng, inside = np.random.default_rng(0), 0
    for _ in range(400):
        m = median(rng.exponential(size=31).tolist())
        inside += m.low <= math.log(2) <= m.high
    assert 0.93 <= inside / 400 <= 0.995


def test_median_of_misses_is_infinite() -> None:
    assert math.isinf(median([0.1, math.inf, math.inf, None]).value)
    assert median([0.1, 0.2, math.inf]).value == 0.2
    assert str(median([])) == "–"


def test_mean_of_counts() -> None:
    told = mean([0, 0, 1, 3])
    assert told.value == 1.0
    assert told.low < 1.0 < told.high


def test_figures_of_known_cases() -> None:
    cases = [CASE, WRONG, NULL]
    effects = effect_figures([HIT, MISS])
    assert effects["named exactly"].value == effects["joint"].value == 0.5
    assert effects["link"].n == 0
    assert effects["95 % intervals cover"].value == 1.0
    told = case_figures(cases)
    assert told["false findings a case"].value == pytest.approx(1 / 3)
    assert told["findings false"].value == 0.25
    assert told["joints with an alarm"].value == pytest.approx(1 / 18)
    assert told["other friction found"].value == 0.8
    assert told["gain share"].value == pytest.approx(0.7)
    assert told["seconds"].value == 5.0
    sure, right = sure_and_right(cases)
    assert (sure.value, right.value) == (0.5, pytest.approx(1 / 3))
    by_bin = {(low, high): (p, figure.value) for low, high, p, figure in calibration(cases) if figure.n}
    assert by_bin[0.9, 0.95] == (0.95, 0.0)
    assert by_bin[0.95, 1.0] == (0.99, 1.0)
    by_gain = {low: (figure.n, figure.value) for low, _, _, figure in right_by_gain(cases) if figure.n}
    assert by_gain == {30.0: (2, 0.5), 300.0: (1, 1.0)}


@pytest.mark.slow
def test_most_likely_odds_of_names_that_imitate() -> None:
    rng = np.random.default_rng(3)
    gains = rng.uniform(30.0, 300.0, 4000)
    told = [Judged(0.9, bool(rng.random() < 1 / (1 + 20 / gain)), gain) for gain in gains]
    cases = [replace(NULL, judgements=(*told, Judged(0.1, False, None)))]
    assert imitated(cases) == pytest.approx(20, rel=0.1)
    for low, high, expected, right in right_by_gain(cases):
        inside = [1 / (1 + imitated(cases) / gain) for gain in gains if low <= gain < high]
        assert right.n == len(inside)
        if inside:
            assert expected == pytest.approx(np.mean(inside))
            assert expected == pytest.approx(right.value, abs=0.06)
    assert math.isnan(imitated([NULL]))


def test_must_hold_says_what_holds() -> None:
    held = {words: holds for words, _, _, holds in must_hold([CASE, WRONG, NULL])}
    assert held["field, 8 %: in class"] is False
    assert held["nulls: cases with a false finding"] is True
    assert held["clean, 8 % and more: in class"] is None
    assert held["seconds a case, median"] is True


def test_markdown_has_every_tier_and_size() -> None:
    small = replace(CASE, case="4", effects=(replace(HIT, size=0.04),))
    text = markdown([CASE, WRONG, NULL, small])
    for words in ("| field, 8 % |", "| field, 4 % |", "| null |", "| torque_scale | field | 1 |", "## Calibration"):
        assert words in text
    widths = {block.count("|") for block in text.split("## Cases")[1].split("## ")[0].strip().splitlines()}
    assert len(widths) == 1


def test_errors_inside_and_outside_of_the_range() -> None:
    states = np.array([[0.0], [1.0], [0.5], [2.0]])
    held_out = np.array([False, False, True, True])
    error, measured = np.array([[9.0], [9.0], [1.0], [3.0]]), np.array([[0.0], [0.0], [1.0], [-1.0]])
    assert range_errors(error, measured, states, held_out) == {"inside": [1.0], "outside": [9.0]}
    assert range_errors(error, measured, np.ones((4, 1)), held_out)["outside"] is None
    unmeasured = range_errors(error, np.full((4, 1), np.nan), states, held_out)
    assert np.isnan(unmeasured["inside"]).all()


def test_rivals_terms_are_counted_by_joint() -> None:
    entry = {"joints": ["a"], "links": [], "indistinguishable": []}
    true = {
        "id": "1", "tier": "field", "robot": {"joints": ["a", "b"]}, "effects": [{**entry, "effect": "torque_ripple"}],
        "background": [{**entry, "effect": "asymmetric_coulomb_friction", "joints": ["b"]}],
    }  # fmt: skip
    errors = {"inside": [0.2, 0.2], "outside": None}
    terms = {
        "a": [["torque_ripple"], ["torque_ripple"], ["coulomb_friction"]],
        "b": [["coulomb_friction", "stribeck_friction"], ["torque_ripple"], ["torque_ripple"]],
    }
    series = {"held_out": np.array([False, True, True]), **{k: np.ones((3, 2)) for k in ("q", "qd", "extended")}}
    series["measured"] = np.array([[1.0, 1.0], [2.0, 2.0], [0.0, 0.0]])
    rivals = {
        "errors": {"rigid body": {"inside": [0.4, 0.4], "outside": None}, "lasso": errors},
        "terms": {"lasso": terms},
    }
    found = score_rivals(true, rivals, {"findings": []}, series)
    assert found["methods"]["lasso"] == {"errors": errors, "hits": 1, "false": 2}
    assert found["methods"]["torchrbd"]["errors"]["inside"] == pytest.approx([1.0, 1.0])
    text = rivals_markdown([found])
    assert "| field | lasso | 0.5 (0.5 to 0.5) | – | 1 " in text


def case_folder(folder: Path, names: tuple[str, ...]) -> tuple[Path, Path]:
    for name in names:
        (folder / "cases" / name).mkdir(parents=True)
        (folder / "out" / name).mkdir(parents=True)
    (folder / "truth").mkdir()
    return folder, folder / "out"


def test_truth_is_not_read_before_all_outputs_are_there(tmp_path: Path) -> None:
    folder, out = case_folder(tmp_path, ("one", "two"))
    (out / "one" / run.DIAGNOSIS).write_text("{}")
    # What is not JSON would fail if it were read.
    (folder / "truth" / "one.json").write_text("secret")
    with pytest.raises(InputError, match=r"1 of 2 cases have no diagnosis\.json yet, the first is two"):
        run.score_folder(folder, out)
    (out / "two" / run.DIAGNOSIS).write_text("{}")
    with pytest.raises(InputError, match="no truth of 1 cases, the first is two"):
        run.score_folder(folder, out)


def test_only_what_is_not_done_is_run(tmp_path: Path) -> None:
    folder, out = case_folder(tmp_path, ("one", "two"))
    (out / "one" / "done.json").write_text("{}")
    seen = []
    run.for_each_case(folder, out, "done.json", lambda case, own: seen.append((case.name, own.name)))
    assert seen == [("two", "two")]


def test_failures_are_counted_not_raised(tmp_path: Path) -> None:
    folder, out = case_folder(tmp_path, ("one",))
    (folder / "cases" / "one" / "robot.urdf").write_text("<robot/>")
    run.for_each_case(folder, out, run.DIAGNOSIS, run.diagnose_case)
    robot = {"name": "arm", "joints": ["a"], "links": ["l"]}
    true = {"id": "one", "tier": "null", "robot": robot, "effects": [], "background": [], "companions": []}
    (folder / "truth" / "one.json").write_text(json.dumps(true))
    (score,) = run.score_folder(folder, out)
    assert score.error is not None
    assert case_figures([score])["failed"].value == 1.0


def test_missing_cases_are_told(tmp_path: Path) -> None:
    assert run.main(["score", str(tmp_path), "-o", str(tmp_path)]) == 2


def test_scores_are_written_with_a_picture_of_the_calibration(tmp_path: Path) -> None:
    folder, out = case_folder(tmp_path, ("one",))
    robot = {"name": "arm", "joints": ["a"], "links": ["l"]}
    true = {"id": "one", "tier": "null", "robot": robot, "effects": [], "background": [], "companions": []}
    (folder / "truth" / "one.json").write_text(json.dumps(true))
    found = {"effect": "joint_spring", "joints": ["a"], "links": [], "probability": 0.8, "indistinguishable_from": []}
    found["log_evidence_gain"] = 45.0
    (out / "one" / run.DIAGNOSIS).write_text(json.dumps({"findings": [found]}))
    (out / "one" / run.SECONDS).write_text('{"seconds": 1.0}')
    assert run.main(["score", str(folder), "-o", str(out)]) == 0
    assert json.loads((out / "scores.json").read_text())["cases"][0]["false"] == [["joint_spring", "a", 0.8]]
    assert "| 0.7 to 0.8 | 1 | 0.80 | 0 " in (out / "scores.md").read_text()
    assert ">1<" in (out / "calibration.svg").read_text()
