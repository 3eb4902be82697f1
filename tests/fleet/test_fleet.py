"""Who differs from its sisters: false alarms, what is planted, and the page."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t as student
from shortened import slow_but
from simulated_fleet import ACCURACY, PI, K, fleet, member

from torchrbd import InputError
from torchrbd.comparison.results import Change, Load, difference
from torchrbd.diagnosis.results import Quantity
from torchrbd.export.json_files import write_fleet
from torchrbd.fleet.compare import compare_fleet
from torchrbd.fleet.reading import read_member
from torchrbd.fleet.results import Deviation, Member, MemberResult
from torchrbd.fleet.sisters import LEAST_SISTERS, deviations, median_inertia, sisters
from torchrbd.report.fleet import write_fleet_report
from torchrbd.report.text.fleet import parameter_name


@pytest.mark.parametrize(
    ("n", "scatter", "fewer"),
    slow_but(
        [(6, 0.0, 4), (6, 0.1, 9), (30, 0.1, 4)], [(6, 0.0, 4), (30, 0.0, 4), (6, 0.1, 9), (8, 0.1, 4), (30, 0.1, 4)]
    ),
)
def test_fleets_of_equal_robots_raise_no_alarm(n: int, scatter: float, fewer: int) -> None:
    """Guard against regressions: the bound is what these seeds have had, and some more, not the rate.

    How often fleets of equal robots raise an alarm, `benchmarks/fleet_alarms.py` measures (docs/guide/fleets.md).
    """
    assert sum(any(deviations(fleet(n, seed, scatter)).values()) for seed in range(100)) < fewer


@pytest.mark.parametrize("n", [6, 40])
def test_a_link_that_is_heavier_by_a_tenth_is_told(n: int) -> None:
    pi = PI.copy()
    pi[-10:] *= 1.1
    found = deviations([*fleet(n, 1), member(n, np.random.default_rng(7), pi=pi)])
    assert [one for one, own in found.items() if own] == [f"arm{n}"]
    assert {d.kind for d in found[f"arm{n}"]} == {"inertia"}


@pytest.mark.parametrize(("n", "scatter"), [(6, 0.0), (40, 0.0), (40, 0.1)])
def test_friction_that_is_doubled_is_told_at_its_joint(n: int, scatter: float) -> None:
    odd = member(n, np.random.default_rng(7), scatter=scatter, friction=2.0)
    found = deviations([*fleet(n, 1, scatter), odd])
    assert [one for one, own in found.items() if own] == [f"arm{n}"]
    told = {d.parameter for d in found[f"arm{n}"]}
    assert told == {"viscous_friction_joint2.viscous", "coulomb_friction_joint2.coulomb"}


def test_numbers_are_those_of_the_formula() -> None:
    group = fleet(20, 2)
    odd = dataclasses.replace(
        group[3], terms={**group[3].terms, "viscous_friction_joint1.viscous": Quantity(0.7, 0.01, "N m")}
    )
    group[3] = odd
    (d,) = deviations(group)["arm3"]
    x = np.array([one.terms[d.parameter].value for one in group])
    s = np.array([one.terms[d.parameter].std for one in group])
    u = np.sqrt(s**2 + np.pi / 2 * np.median(s**2) / 20)

    def scatter(key: str) -> float:
        values = np.array([[one.terms[key].value, one.terms[key].std] for one in group])
        errors = values[:, 1] ** 2 + np.pi / 2 * np.median(values[:, 1] ** 2) / 20
        off = values[:, 0] - np.median(values[:, 0])
        return math.sqrt(max((1.4826 * 20 / 19.2 * np.median(np.abs(off))) ** 2 - np.median(errors), 0.0))

    keys = [key for key in odd.terms if key.endswith(".viscous")]
    sizes = {key: abs(np.median([one.terms[key].value for one in group])) for key in keys}
    t = max(scatter(d.parameter), sizes[d.parameter] * np.median([scatter(key) / sizes[key] for key in keys]))
    spread = math.sqrt(u[3] ** 2 + t**2)
    tests = 20 * (len(K) + len(odd.terms))
    assert d.median == np.median(x)
    np.testing.assert_allclose([d.spread, d.z], [spread, (0.7 - np.median(x)) / spread], rtol=1e-12)
    freedom = 0.37 * 19 * len(keys) / max((t / spread) ** 4, 1e-9)
    np.testing.assert_allclose(d.chance, tests * 2.0 * student.sf(abs(d.z), freedom), rtol=1e-6)


def test_a_trifle_is_none_however_sure() -> None:
    rng = np.random.default_rng(0)
    group = [member(k, rng) for k in range(20)]
    sure = [
        dataclasses.replace(one, terms={"viscous_friction_joint1.viscous": Quantity(0.5, 1e-6, "N m")}) for one in group
    ]
    for value, told in ((0.505, False), (0.52, True)):
        off = dataclasses.replace(sure[0], terms={"viscous_friction_joint1.viscous": Quantity(value, 1e-6, "N m")})
        assert any(d.kind == "viscous" for d in deviations([off, *sure[1:]])["arm0"]) == told


def test_what_only_the_urdf_tells_is_not_compared() -> None:
    group = fleet(10, 0)
    beta, share = group[0].inertia.beta.copy(), np.zeros(len(K))
    beta[0] *= 10.0
    assert deviations([_with(group[0], beta=beta), *group[1:]])["arm0"]
    share[0] = 0.9
    assert not deviations([_with(group[0], beta=beta, share=share), *group[1:]])["arm0"]


def _with(one: Member, **changes: np.ndarray) -> Member:
    return dataclasses.replace(one, inertia=dataclasses.replace(one.inertia, **changes))


def test_only_sisters_are_compared_and_few_are_not() -> None:
    group = fleet(LEAST_SISTERS + 1, 0)
    strangers = [dataclasses.replace(one, name=f"other{one.name}", robot="other") for one in fleet(3, 1)]
    assert [[one.name for one in own] for own in sisters([*group, *strangers])] == [
        [one.name for one in group],
        [one.name for one in strangers],
    ]
    odd = member(9, np.random.default_rng(7), friction=2.0)
    assert not any(deviations([*group[: LEAST_SISTERS - 2], odd]).values())
    assert any(deviations([*group[: LEAST_SISTERS - 1], odd]).values())


def test_the_median_robot_is_as_sure_as_its_sisters_make_it() -> None:
    group = fleet(25, 0)
    median = median_inertia(group)
    std = np.sqrt(np.diag(median.covariance))
    assert np.abs((median.beta - K @ PI) / std).max() < 4.0
    np.testing.assert_allclose(std, ACCURACY * 1.25 * np.abs(K) @ np.abs(PI) * np.sqrt(np.pi / 2) / 5, rtol=0.3)


def written(folder: Path, group: list[Member]) -> list[str]:
    """Write what ``read_member`` reads of each robot."""
    for one in group:
        i = one.inertia
        rows = zip(i.expressions, i.units, i.beta, i.share, strict=True)
        base = [{"expression": e, "unit": u, "value": float(b), "prior_share": float(p)} for e, u, b, p in rows]
        own = [
            {"name": n, "owner": owner, "value": float(v), "std": 0.0, "unit": "", "status": "identified"}
            for n, owner, v in zip(i.columns, one.bodies, i.pi, strict=True)
        ]
        terms = [
            {"name": n, "owner": "", "value": q.value, "std": q.std, "unit": q.unit, "status": "term"}
            for n, q in one.terms.items()
        ]
        content = {
            "robot": one.robot,
            "verdict": one.verdict,
            "fit": {"urdf": {"nmse": {"joint1": 1.0}}, "extended": {"nmse": {"joint1": one.nmse}}},
            "doubts": list(one.doubts),
            "parameters": [*own, *terms],
            "base_parameters": base,
            "base_combination": {"columns": list(i.columns), "matrix": i.K.tolist()},
            "base_covariance": i.covariance.tolist(),
        }
        (folder / one.name).mkdir(parents=True)
        (folder / one.name / "parameters.json").write_text(json.dumps(content))
    return [one.name for one in group]


def test_a_page_says_who_differs_what_changed_and_escapes_every_name(tmp_path: Path) -> None:
    pi = PI.copy()
    pi[-10:] *= 1.2
    rng = np.random.default_rng(7)
    bad = "<b>&amp;"
    now = [*fleet(8, 1)[:6], member(6, rng, pi=pi), member(7, rng, friction=2.0)]
    now[0] = dataclasses.replace(now[0], doubts=(bad,), name="arm<0>")
    names = [*written(tmp_path / "now", now), bad]
    written(tmp_path / "then", fleet(8, 2))
    result = compare_fleet(tmp_path / "now", names, before=tmp_path / "then", failed={bad: f"torn {bad}"})
    found = {one.name: one for one in result.members}
    assert [one for one, own in found.items() if own.deviations] == ["arm6", "arm7"]
    assert found["arm6"].load is not None
    assert "as if" in found["arm6"].statement
    assert set(found["arm7"].changes or ()) == {f"{key}_friction_joint2.{key}" for key in ("viscous", "coulomb")}
    assert found["arm1"].changes == {}
    assert found["arm<0>"].changes is None
    assert "no earlier results of it exist" in found["arm<0>"].statement
    assert found[bad].verdict == "failed"
    assert result.statement.startswith("2 of 9 robots differ from their sisters, 2 changed, 1 could not be identified")
    write_fleet_report(result, tmp_path / "fleet.html")
    page = (tmp_path / "fleet.html").read_text()
    assert bad not in page
    assert "arm<0>" not in page
    for word in ("http://", "https://", "<script"):
        assert word not in page
    write_fleet(result, tmp_path / "fleet.json")
    read = json.loads((tmp_path / "fleet.json").read_text())
    assert [one["name"] for one in read["members"]] == names
    assert read["members"][7]["deviations"][0]["chance"] < 0.01


@pytest.mark.parametrize(("mass", "words"), [(0.5, "had 0.50 ± 0.04 kg more"), (-0.5, "had 0.50 ± 0.04 kg less")])
def test_a_link_has_more_or_less_but_never_minus_more(mass: float, words: str) -> None:
    load, one = Load(("link2", "link3"), mass, 0.02), Quantity(1.0, 0.1, "kg")
    off = (Deviation("m_link2", "inertia", one, 1.5, 0.1, -5.0, 1e-6),)
    member = MemberResult("arm", "identified", 0.1, "", 8, off, load, None, ())
    parameters = {"m_link2": difference(one, one, 1.0, among=1)}
    change = Change("inertia", "", (), (), (), "both", "changed", 0.99, parameters, load=load)
    for said in (member.statement, change.statement):
        assert f"as if link2 or link3 {words}" in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot": "other"}, "not compared with the earlier time: it was robot 'other' then"),
        (
            {"inertia": {"K": 2.0 * K}},
            "nothing that was compared has changed; inertial parameters are not compared, as bodies or kinematics "
            "differ",
        ),
        (
            {"inertia": {"K": 2.0 * K}, "terms": {}},
            "not compared with the earlier time: bodies or kinematics differ, and the two have no term in common",
        ),
        (
            {"inertia": {"share": np.ones(len(K))}, "terms": {}},
            "not compared with the earlier time: the two data sets identify no parameter in common",
        ),
        ({}, "nothing has changed"),
    ],
)
def test_what_was_not_compared_is_not_called_unchanged(tmp_path: Path, change: dict, words: str) -> None:
    (now,) = fleet(1, 1)
    then = dataclasses.replace(
        now, **{**change, "inertia": dataclasses.replace(now.inertia, **change.get("inertia", {}))}
    )
    written(tmp_path / "now", [now])
    written(tmp_path / "then", [then])
    (found,) = compare_fleet(tmp_path / "now", [now.name], before=tmp_path / "then").members
    assert found.statement == f"has no sisters, too few to compare with; {words}"
    assert (found.changes is None) == words.startswith("not compared")


@pytest.mark.parametrize("torn", ["{", "[]", '{"base_covariance": 1}'])
def test_a_member_that_cannot_be_read_leaves_the_others(tmp_path: Path, torn: str) -> None:
    names = written(tmp_path, fleet(8, 1))
    (tmp_path / "arm2" / "parameters.json").write_text(torn)
    (tmp_path / "arm5" / "parameters.json").unlink()
    result = compare_fleet(tmp_path, names)
    errors = {one.name: one.error for one in result.members if one.error}
    assert list(errors) == ["arm2", "arm5"]
    assert "arm2/parameters.json: " in errors["arm2"]
    assert "arm5/parameters.json: is missing" in errors["arm5"]
    assert {one.sisters for one in result.members} == {0, 6}
    file = tmp_path / "arm0" / "parameters.json"
    content = json.loads(file.read_text())
    content["base_covariance"][0][0] = None
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"arm0/parameters.json: .*not finite"):
        read_member(tmp_path / "arm0", "arm0")


def test_members_without_intervals_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"parameters.json: is missing or has no intervals.* identify 'arm0' again"):
        read_member(tmp_path, "arm0")
    (name,) = written(tmp_path, fleet(1, 0))
    file = tmp_path / name / "parameters.json"
    file.write_text(file.read_text().replace('"fit"', '"fits"'))
    with pytest.raises(InputError, match=r"is no parameters.json as 'torchrbd fleet' writes it \(KeyError: 'fit'\)"):
        read_member(tmp_path / name, name)


@pytest.mark.parametrize(
    ("parameter", "words"),
    [
        ("viscous_friction_joint1.viscous", "viscous friction joint1"),
        ("asymmetric_coulomb_friction_joint1.coulomb_plus", "asymmetric coulomb friction joint1, coulomb plus"),
        ("mcz_link2 + 0.53 m_link3", "mcz_link2 + 0.53 m_link3"),
        ("mcx_link3", "mcx_link3"),
    ],
)
def test_parameters_are_named_for_people(parameter: str, words: str) -> None:
    assert parameter_name(parameter) == words
