"""What people read keeps to the field's terms and to short sentences: see the table *Words* of the design.

Scanned are all strings of the package but docstrings, its templates, every --help, the names of effects, and everything
that is rendered of made-up results.
"""

import ast
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
from report.fabricated import diagnosis, identification, ranking, with_friction
from report.rendered import Text, render

import torchrbd
from torchrbd.cli import main
from torchrbd.cli.app import app
from torchrbd.cli.tables import print_diagnosis, print_identification
from torchrbd.diagnosis.results import (
    OWN_TIME,
    Alternative,
    Attack,
    Deflection,
    Diagnosis,
    Finding,
    HeldOutCheck,
    Location,
    NextEffect,
    Quantity,
    Ratio,
    Region,
    Unexplained,
    Variant,
    Where,
)
from torchrbd.display import Remark, Stated
from torchrbd.effects import known_effects
from torchrbd.inference.results import NoiseRegime
from torchrbd.report.text.remarks import kinds
from torchrbd.report.text.verdict import VERDICTS, headline

PACKAGE = Path(torchrbd.__file__).parent
BANNED = re.compile(
    r"\b(told|tells?|beside|set apart|stands? (in )?for|passes for|held-out time|time that no fit|what rests hold"
    r"|at a glance|leftovers?|left over|what is left|what has no name|ordinary (physics|friction)|every machine has"
    r"|stretch(es)?|trifling|trifles?|unpredicted part)\b",
    re.IGNORECASE,
)
# Argument names of functions and keys that stand in strings; the list only shrinks.
ALLOWED: set[str] = set()
MOST_WORDS = 25
JOINTS = ("joint1", "joint2", "joint3")


def literals(code: str) -> Iterator[str]:
    """Yield the strings of a file that are sentences, f-strings with {} for values; no docstrings."""
    tree = ast.parse(code)
    described = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    first = [node.body[0] for node in ast.walk(tree) if isinstance(node, described) and node.body]
    known = {id(one.value) for one in ast.walk(tree) if isinstance(one, ast.Expr)}
    assert all(not isinstance(one, ast.Expr) or id(one.value) in known for one in first)
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in known:
            yield node.value


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_strings_of_the_package_are_plain(path: Path) -> None:
    said = {one for one in literals(path.read_text()) if " " in one.strip() and BANNED.search(one)}
    assert said - ALLOWED == set()


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.j2")), ids=lambda path: path.name)
def test_templates_are_plain(path: Path) -> None:
    text = re.sub(r"\{[%#{].*?[%#}]\}|<style>.*?</style>", "", path.read_text(), flags=re.DOTALL)
    assert BANNED.findall(text) == []


def test_banned_words_are_seen() -> None:
    """The scan would find a sentence that an error message, or an f-string, has."""
    code = 'def f(x):\n    """It tells."""\n    raise ValueError(f"what is left of {x} is told")'
    assert [one for one in literals(code) if BANNED.search(one)][:1] == ["what is left of {} is told"]


@pytest.mark.parametrize("command", sorted(name for name in app() if not name.startswith("-")))
def test_help_is_plain(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with suppress(SystemExit):
        main([command, "--help"])
    said = capsys.readouterr().out
    assert len(said) > 100
    assert BANNED.findall(said) == []


def test_effects_and_verdicts_are_plain() -> None:
    said = [*(f"{e.words} {e.equation}" for e in known_effects().values()), *VERDICTS.values()]
    assert [found[0] for text in said if (found := BANNED.search(text))] == []


def findings() -> list[Finding]:
    """Return a finding of every kind, with everything that a sentence of it may say."""
    half, ratio = {"joint1": 0.5}, Ratio(0.9, 0.8, 1.0)
    rivals = tuple(Alternative(name, ("joint2",)) for name in (*known_effects(),))
    size = {"size": Quantity(1.6, 0.004, "N m")}
    base = Finding(
        "backlash", ("joint1",), (), 0.9, 9.0, size, Where(), rivals, half, {"joint1": 0.1}, held_out_ratio=ratio
    )
    load = Where(("load.csv",), ((2.0, 8.0),))
    found = [replace(base, effect=name) for name in known_effects()]
    found += [replace(base, probability=0.3), replace(base, adds_to_all=True, where=load)]
    found += [replace(base, nmse_after=half), replace(base, held_out_ratio=Ratio(0.1, -0.2, 0.4))]
    found += [replace(base, judged_on=OWN_TIME), replace(base, nmse_before={}, nmse_after={}, judged_on="")]
    found += [replace(base, parameters={"p": Quantity(0.1, 9.0, "kg"), "r": Quantity(0.1, 9.0, "kg")})]
    found += [replace(base, effect="geometry_error", variant=Variant("upper", 0.42, 0.3))]
    return [*found, replace(base, effect="joint_elasticity", deflection=deflection())]


def deflection(**changes: object) -> Deflection:
    some = Deflection(
        "joint2", Quantity(8000.0, 90.0, "N m/rad"), 7000.0, Quantity(0.001, 1e-5, "rad"), Quantity(0.002, 1e-5, "s"),
        0.7, 1e-3, 0.99, 40.0, 0.9, 0.1, (0.0, 1.0), (0.0, 1e-3), (1e-4, 1e-4),
    )  # fmt: skip
    return replace(some, **changes)


def unexplained() -> list[Unexplained]:
    at, where = ("joint1",), Where(region=(Region("q_joint1", -0.1, 0.3),))
    torque = {"torque_rms": 0.3}
    return [
        Unexplained(at, ("q_joint1",), where, 0.4, sizes=torque),
        Unexplained(at, ("q_joint1",), Where(("a.csv", "b.csv")), 0.0, sizes=torque),
        Unexplained(at, ("t",), Where(), 0.4, kind="drift", sizes=torque),
        Unexplained(at, ("t",), Where(("a.csv",)), 0.4, kind="tone", sizes={"low": 1.0, "high": 2.0, "frequency": 3.0}),
        Unexplained(at, (), Where(), 1.0, kind="error", sizes={"nmse": 0.2}),
        Unexplained(at, ("t",), Where(), 0.4, kind="drift", sizes={**torque, "nmse": 0.2, "ratio": 2.0}),
        Unexplained(at, (), Where(), 0.5, kind="larger error", sizes={"ratio": 2.0}),
        Unexplained(at, (), Where(), 0.5, kind="not confirmed"),
    ]


def locations() -> list[Location]:
    force = Attack((0.0, 0.0, -9.0), (0.1, 0.1, 0.1), (0.1, 0.2, 0.3), (0.01, 0.01, 0.01))
    spans = Where(("a.csv",), ((1.0, 2.0), (3.0, 4.0)))
    plain = Location(
        "extended", JOINTS, (), spans, ("t",), "level", "abrupt", 9.0, {"joint1": 0.5}, {}, None, None, "N"
    )
    region = Where(region=(Region("q_joint2", 0.0, 1.0),))
    return [
        plain,
        replace(plain, course="slow", form="friction", where=Where()),
        replace(plain, depends_on=("q_joint2",), course="", where=region),
        replace(plain, form="payload", links=("hand",), attack=force),
    ]


def diagnoses() -> list[Diagnosis]:
    """Return a diagnosis of every verdict, with everything that its statement may say."""
    whole = diagnosis(JOINTS)
    over = {"rigid_body": Ratio(1.2, 1.1, 1.3), "urdf": Ratio(0.1, 0.05, 0.2)}
    memory = dict.fromkeys(("urdf", "rigid_body", "extended"), 0.1)
    full = replace(
        whole, findings=tuple(findings()), unexplained=tuple(unexplained()), locations=tuple(locations()),
        held_out_checks=(HeldOutCheck("joint1", over, memory, 0.1),), held_out_ratio=Ratio(0.5, 0.4, 0.6), refuted=True,
        next_effect=NextEffect(12, "torque_ripple", ("joint1",), recording="a.csv"), ranking=ranking(JOINTS),
        not_confirmed=tuple(findings()[:3]), joint_deflections=(deflection(), deflection(stiffness=None)),
    )  # fmt: skip
    one = [replace(full, findings=(f,), held_out_checks=()) for f in full.findings]
    others = ("consistent", "parameters", "unexplained", "suspect")
    return [full, with_friction(whole), *one, *(replace(full, verdict=v, findings=()) for v in others)]


def remarks() -> list[Remark]:
    """Return a remark of every kind, with everything that it may say."""
    sizes = {"joint1": 0.95, "joint2": 1.2}
    units = {"joint1": "rad", "joint2": "m"}
    pairs = {joint: [1e-3, 1e-5] for joint in sizes}
    noise = {"stated_and_seen": pairs, "smoothed": {}, "units": units}
    found = [
        Remark("little explained", {"fitted": sizes, "held_out": {"joint1": 0.97}}),
        Remark("URDF far off", {"joints": list(sizes)}),
        Remark("URDF better", {"fitted": sizes, "urdf": sizes}),
        Remark("implausible masses", {"ratios": {"link1": 5.2}}),
        Remark("implausible masses", {"ratios": {"link1": 5.2, "link2": 0.1}}),
        Remark("fit stopped early"),
        Remark("too fast", {"recording": "a.csv", "velocities": pairs, "units": units}),
        Remark("misstated position noise", noise),
        Remark("misstated position noise", noise | {"smoothed": sizes}),
        Remark("other simulated motion", {"simulated": "sim.csv", "recording": "a.csv", "differences": sizes}),
        Remark("base taken as fixed", {"base": "trunk", "limbs": 4, "world": "world", "root": "base"}),
        Remark("same recordings", {"recordings": ["a.csv"]}),
        Remark("other cutoff", {"before_hz": 5.0, "after_hz": 6.0}),
    ]
    return [*found, *(Remark(kind) for kind in ("one simulated", "inertia not compared", "no detection limits"))]


def regimes() -> list[NoiseRegime]:
    """Return what there is to say of position noise."""
    names = ("auto", "physical", "smoother", "moments")
    cases = product(names, ("filtered", "smoothed"), ((True, 4.0), (True, 40.0), (False, 1.001), (False, 1.3)))
    return [NoiseRegime(name, states, *noise) for name, states, noise in cases]


def test_remarks_of_every_kind_are_here() -> None:
    assert {one.kind for one in remarks()} == kinds().keys()


def stated() -> list[Stated]:
    deflected = [deflection(), deflection(stiffness=None), deflection(nmse_after=0.9)]
    return [*remarks(), *regimes(), *findings(), *unexplained(), *locations(), *deflected, *diagnoses()]


def sentences(text: str) -> list[str]:
    """Return the sentences of a text: they end with a stop before a blank and a capital, or with a question mark."""
    return re.split(r"(?<=[.?!])\s+(?=[A-Z0-9(])", text)


def length(sentence: str) -> int:
    """Return the number of words; numbers, units and signs are none."""
    return sum(bool(re.search(r"[A-Za-z]{2,}", token)) for token in sentence.split())


@pytest.mark.parametrize("result", stated(), ids=lambda one: type(one).__name__)
def test_statements_are_plain_and_short(result: Stated) -> None:
    assert BANNED.findall(result.statement) == []
    assert [(length(s), s) for s in sentences(result.statement) if length(s) > MOST_WORDS] == []


@pytest.mark.parametrize("result", diagnoses())
def test_headlines_have_25_words(result: Diagnosis) -> None:
    assert len(headline(result)[0].split()) <= MOST_WORDS


def test_what_is_rendered_is_plain(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    full, *_ = diagnoses()
    said = [" ".join(Text(render(one, tmp_path)).words) for one in (full, identification(JOINTS))]
    said += [full._repr_html_()]
    print_diagnosis(full)
    print_identification(full.identification)
    said.append(" ".join(capsys.readouterr().out.split()))
    for text in said:
        assert [found[0] for found in BANNED.finditer(text)] == []


def test_a_remark_says_itself() -> None:
    assert str(Remark("one simulated")) == Remark("one simulated").statement
