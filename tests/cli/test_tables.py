"""What the terminal shows of a diagnosis: whole names, special findings first, friction in one table."""

from dataclasses import replace

import pytest
from report.fabricated import diagnosis, with_friction

from torchrbd.cli.tables import print_diagnosis
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import Alternative, Where

LONG = tuple(f"l_very_long_name_of_a_joint_{i}" for i in range(1, 6))


def shown(result: Diagnosis, capsys: pytest.CaptureFixture[str]) -> list[str]:
    print_diagnosis(result)
    return [" ".join(line.strip(" │").split()) for line in capsys.readouterr().out.splitlines()]


def test_friction_has_its_table_behind_the_special_findings(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(with_friction(diagnosis(("joint1", "joint2", "joint3"))), capsys)
    rows = [line for line in lines if "│" in line or "┃" in line]
    assert next(i for i, x in enumerate(rows) if "torque ripple" in x) < next(
        i for i, x in enumerate(rows) if "Coulomb" in x and "viscous" in x
    )
    assert "joint1 │ 0.50 ± 0.04 │ 0.50 ± 0.04" in lines
    assert "joint3 │ 0.50 ± 0.04 (90 %) │ 0.50 ± 0.04 (90 %)" in lines


def test_names_are_not_cut(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(with_friction(diagnosis(LONG)), capsys)
    assert not any("…" in line for line in lines)
    for name in LONG:
        assert sum(name in line for line in lines) >= 3


def test_links_the_whole_robot_and_recordings_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    result = diagnosis(("joint1", "joint2"))
    load = replace(
        result.findings[0], effect="payload", joints=(), links=("tool",), where=Where(("a.csv",), ((2.0, 8.0),))
    )
    coupled = replace(result.findings[0], effect="joint_coupling", depends_on=("q_joint1",), where=Where())
    tilt = replace(load, effect="base_tilt", links=(), where=Where())
    text = "\n".join(shown(replace(result, findings=(load, tilt, coupled)), capsys))
    for part in ("tool", "in a.csv, 2.0 to 8.0 s", "whole robot", "tilted base", "joint1's position", "98 %"):
        assert part in text


def test_many_recordings_are_counted_and_long_names_folded(capsys: pytest.CaptureFixture[str]) -> None:
    result = diagnosis(("joint1", "joint2"))
    names = tuple(f"2022-08-12_run_{k}_without_compensation_and_with_load.csv" for k in range(7))
    result = replace(result, identification=replace(result.identification, recordings=names))
    some = replace(result.findings[0], effect="joint_spring", where=Where(names[:4]))
    part = replace(some, effect="payload", joints=(), links=("tool",), where=Where(names[:1], ((2.0, 8.0),)))
    print_diagnosis(replace(result, findings=(some, part)))
    text = capsys.readouterr().out
    assert "│ in 4 of 7 recordings" in text
    assert names[1] not in text
    for whole in ("joint spring", "payload", "1.000", "98 %"):
        assert whole in text
    cells = [line[1:].partition("│")[0].strip() for line in text.splitlines() if line.startswith("│")]
    assert names[0] in "".join(cells)


def test_a_guess_is_called_so_and_is_none_of_the_table_of_friction(capsys: pytest.CaptureFixture[str]) -> None:
    result = with_friction(diagnosis(("joint1", "joint2", "joint3")))
    doubtful = replace(
        result.findings[0], probability=0.3, indistinguishable_from=(Alternative("backlash", ("joint1",)),)
    )
    lines = shown(replace(result, findings=(*result.findings[1:], doubtful)), capsys)
    assert any(line.startswith("joint1 │ backlash or") and line.endswith("│ 30 %") for line in lines)
    assert "joint1 │ │ 0.50 ± 0.04" in lines
