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
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import (
    OWN_TIME,
    Alternative,
    Attack,
    Deflection,
    Elpd,
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
from torchrbd.excitation.conditioning import ConditionNumbers
from torchrbd.inference.posterior.experiments import Motion
from torchrbd.inference.posterior.identifiability import Identifiability
from torchrbd.inference.results import NoiseRegime
from torchrbd.likelihood.misfit import Misfit
from torchrbd.report.text.console import (
    AS_RECORDED,
    FAVOURED,
    LACKING,
    MAPPING_HINT,
    PHYSICAL,
    check_words,
    clearance_words,
    combinations_words,
    condition_words,
    ends_words,
    estimator_words,
    measure_words,
    more_words,
    motion_words,
    simulated_words,
    wrote,
    wrote_fleet,
)
from torchrbd.report.text.findings import CERTAINLY_MISSING, SHARED
from torchrbd.report.text.hypotheses import WITHOUT_EFFECTS, clock_words, given_words, misfit_sentence
from torchrbd.report.text.locations import excerpt_words
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


def test_strings_of_the_package_are_plain() -> None:
    paths = sorted(PACKAGE.rglob("*.py"))
    texts = {path: {t for t in literals(path.read_text()) if " " in t.strip() and BANNED.search(t)} for path in paths}
    assert {path: said - ALLOWED for path, said in texts.items() if said - ALLOWED} == {}


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
    shares = (
        Elpd(40.0, 5.0, 12.0, 0.8, 0.3),
        Elpd(2.0, 5.0, 0.4, 0.8, 0.3),
        Elpd(0.0, 0.0, 0.0, 0.0, 0.0),
        Elpd(9.0, 5.0, 3.0, 0.01, 0.003),
    )
    found += [replace(base, elpd=one, probability=p) for one in shares for p in (0.2, 0.9)]
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
    over = {"baseline": Ratio(1.2, 1.1, 1.3), "rigid_body": Ratio(0.9, 0.8, 1.1), "urdf": Ratio(0.1, 0.05, 0.2)}
    memory = dict.fromkeys(("urdf", "baseline", "rigid_body", "extended"), 0.1)
    full = replace(
        whole, findings=tuple(findings()), unexplained=tuple(unexplained()), locations=tuple(locations()),
        held_out_checks=(HeldOutCheck("joint1", over, memory, 0.1),), held_out_ratio=Ratio(0.5, 0.4, 0.6),
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
    found += [Remark(kind) for kind in ("one simulated", "inertia not compared", "no detection limits")]
    return [*found, *recording_remarks(), *input_remarks(), *motion_remarks(), *export_remarks()]


def recording_remarks() -> list[Remark]:
    joint, joints, column = {"joint": "joint1"}, {"joints": ["joint1", "joint2"]}, {"column": "q_joint1"}
    found = [
        Remark("no torque", joints),
        Remark("signal of some joints", {"signal": "qd"}),
        Remark("unused columns", {"columns": ["mode"]}),
        Remark("current as torque", {"joints": [f"joint{k}" for k in range(30)]}),
        Remark("position jumps", {**joint, "speed": 30.0, "ratio": 40.0}),
        Remark("torque peaks", {**joint, "torque": 30.0, "ratio": 40.0}),
        Remark("velocity differs from dq/dt", {**joint, "ratio": 57.3}),
        Remark("q_link equals q", joint),
        Remark("q_link differs from q", {**joint, "ratio": 0.1}),
        Remark("torque constant in motion", {**joint, "torque": 0.0, "begin_s": 1.0, "end_s": 3.0}),
        Remark("repeated times", {"dropped": 2, "rows": 90}),
        Remark("missing values", {"dropped": 2, "rows": 90, "empty": ["tau_joint1"]}),
        Remark("gaps in time", {"pieces": 2}),
        Remark("full turns unwrapped", joints),
        Remark("accelerations not used"),
        Remark("constant torque", joint, "a.csv"),
        Remark("left out", {"begin_s": 1.0, "end_s": 3.0}, "a.csv"),
        Remark("other unit", {**column, "unit": "deg"}),
        Remark("cut off", {**column, "ends": [-1.0, 1.0]}),
        Remark("coarse steps", {**column, "step": 0.1, "steps": 9.7}),
        Remark("slow source", {**column, "rows": 3.0, "rate_hz": 50.0}),
        Remark("constant column", column),
        Remark("short recording", {"seconds": 2.0, "least_s": 10.0}),
        Remark("uneven times"),
    ]
    return found


def input_remarks() -> list[Remark]:
    joint, some = {"joint": "joint1"}, {"recordings": ["a.csv"]}
    intervals = {"estimator": "ols", "was_physical": False, "with_intervals": ["physical", "smoother", "moments"]}
    gain = {"joint": "joint1", "kind": "kp", "value": 20.0, "low": 15.0, "high": 31.0}
    return [
        Remark("no changing torque", joint),
        Remark("no temperature", {"joints": ["joint1"]}, "a.csv"),
        Remark("unphysical URDF inertia", {"body": "hand"}),
        Remark("gravity", {"gravity": [0.0, 9.81, 0.0]}),
        Remark("known rotors or springs", {"parts": ["rotors", "springs"], "source": "arm.urdf"}),
        Remark("massless body", {"body": "hand"}),
        Remark("joint at rest", joint),
        Remark("compared with a simulation", {"pairs": [["sim.csv", "a.csv"]]}),
        Remark("simulation's clock moved", {"recording": "a.csv", "shift_s": 0.1}, "sim.csv"),
        Remark("states not smoothed", some),
        *(Remark(kind, {"limit_s": limit}) for kind in ("unfinished", "not tried") for limit in (None, 60.0)),
        Remark("estimator failed", {"error": "singular matrix"}),
        Remark("no intervals", intervals),
        Remark("combinations of the URDF", {"kept": 3, "of": 40}),
        Remark("estimated gains", {"gains": [gain, gain | {"kind": "torque_constant"}], "units": ["N m/rad", "N m/A"]}),
        *(Remark("passes", {"passes": 4, "settled": settled}) for settled in (True, False)),
        Remark("identified by set-points", {"identified": 38, "of": 40}),
        *(Remark("motion not simulated", values) for values in ({}, {"error": "no torque"})),
        Remark("terms along the recorded motion", {"terms": [["time_delay", "joint1"]]}),
        Remark("later start", {"begin_s": 1.0, "asked_s": 0.0}),
        Remark("torques low-passed", {"half_hz": 1.7, "order": 4}),
        *(Remark("late torque moved", {"delay_s": delay}) for delay in (0.1, -0.1)),
        Remark("torque is a command", {"lag_s": 0.1}),
    ]


def motion_remarks() -> list[Remark]:
    moved = {"joint": "joint1", "unit": "rad", "speed": 2.0, "acceleration": 3.0, "others": 2}
    varied = ([], ["joint2"], ["joint2", "joint3"])
    found = [
        Remark("motion", {"kind": k, **moved, "varied": v}) for k in ("slow", "accelerate", "fast") for v in varied
    ]
    return [
        *found,
        Remark("motion", {"kind": "all"}),
        Remark("only combination", {"expression": "mcx_l1 - 0.5 m_l2"}),
        Remark("never identified", {"parameters": ["m_l1", "mcy_l1"]}),
        Remark("nothing open"),
        Remark("rivals stay open", {"one": "payload on hand", "other": "backlash", "log_bayes_factor": 1.0}),
        Remark("rivals without parameters", {"finding": "joint spring at joint2"}),
    ]


def export_remarks() -> list[Remark]:
    joints, pair = {"joints": ["joint1", "joint2"]}, ["joint1", "joint2"]
    term = {"name": "joint spring", "place": "joint1", "values": {"stiffness": [2.0, "N m/rad"], "rest": [0.1, "1"]}}
    notes = sorted({note for e in known_effects().values() for note in (e.export_note, e.urdf_note) if note})
    recordings = {"recordings": ["a.csv"]}
    return [
        Remark("what the file lacks"),
        *(Remark("not exported", {"term": term, "reason": r}) for r in ("not always", "not finite", "MJCF", "URDF")),
        *(
            Remark("not exported", {"term": term, "note": note, "by_hand": ['MJCF: <joint damping="1">']})
            for note in notes
        ),
        Remark("not compared", {"term": term}),
        Remark("motor of two joints", joints),
        Remark("coupling by speeds", {**joints, "damping": 0.7}),
        Remark("coupling", {"joints": pair, "kind": "stiffness", "size": 1.0, "at_each": [1.0, 0.0]}),
        Remark("dry friction near rest", joints),
        Remark("delays", {**joints, "step_s": 5e-4}),
        Remark("damping of three numbers", joints),
        Remark("following joints", joints),
        *(Remark("limits", {**joints, "fault": fault}) for fault in ("one side", "empty", "effort")),
        Remark("velocity limits"),
        Remark("lag of a drive", joints),
        Remark("joints without drive", joints),
        Remark("file for Isaac Lab", {"robot": "arm"}),
        Remark("step of the physics"),
        Remark("shapes"),
        Remark("massless link", {"link": "hand", "least": 1e-12}),
        Remark("link without width", {"link": "hand", "lift": 1e-12}),
        Remark("gravity not in URDF", {"gravity": [0.0, 9.81, 0.0]}),
        *(Remark("condition of recordings", {**recordings, "delay_s": delay}) for delay in (0.1, -0.1)),
        Remark("condition of recordings", {**recordings, "lag_s": 0.1, "by_hand": "<general/>"}),
        Remark("condition of recordings", {**recordings, "load": 2.0}),
        Remark("condition of recordings", {**recordings, "simulation": "sim.csv"}),
    ]


def identifiable() -> list[Identifiability]:
    """Return a parameter of every status, with everything that its statement may say."""
    pair = (Remark("only combination", {"expression": "m_l1 + m_l2"}),)
    motion, advice = Motion("all", None, ()), Remark("motion", {"kind": "all"})
    plain = Identifiability("m_l1", "l1", 0.5, 0.2, "identified", (), None, None, 0.5)
    open_ = replace(plain, status="unexcited")
    return [
        plain,
        replace(plain, status="held"),
        replace(plain, status="not identifiable"),
        replace(plain, status="combination", combinations=pair),
        replace(plain, status="combination", combinations=pair * 3),
        open_,
        replace(open_, motion=motion, suggested=advice, prior_share_after=0.3),
        replace(open_, motion=motion, suggested=advice, combinations=pair),
    ]


def console() -> list[str]:
    """Return what the command line says around its tables."""
    few, many = (ConditionNumbers(n, 9.0, 90.0, 20.0) for n in (1, 40))
    return [
        PHYSICAL, FAVOURED, LACKING, MAPPING_HINT, AS_RECORDED, measure_words("25 % of the time", 5.0),
        combinations_words(40, 90.0), *(estimator_words("iv", "no set-points", failed=f) for f in (True, False)),
        check_words(900, 5.0), simulated_words(0.0, 9.0), motion_words(3, 10.0, 100.0), condition_words(few),
        condition_words(many), clearance_words(0.01), ends_words({"joint1": 0.1}), wrote("a.csv"), wrote("a", "out"),
        wrote_fleet(Path("out")), more_words(3, "fleet.json"), SHARED, CERTAINLY_MISSING,
        excerpt_words("a.csv", 0.0, 15.0), WITHOUT_EFFECTS, clock_words(1e-3, 1e-4),
        *(given_words(ranking(JOINTS).first[:n]) for n in (1, 2)),
        misfit_sentence({"a": Misfit(2.0, 3, 0.57)}), misfit_sentence({"a": Misfit(2.0, 3, 1e-9)}),
    ]  # fmt: skip


def regimes() -> list[NoiseRegime]:
    """Return what there is to say of position noise."""
    names = ("auto", "physical", "smoother", "moments")
    cases = product(names, ("filtered", "smoothed"), ((True, 4.0), (True, 40.0), (False, 1.001), (False, 1.3)))
    return [NoiseRegime(name, states, *noise) for name, states, noise in cases]


def test_remarks_of_every_kind_are_here() -> None:
    assert {one.kind for one in remarks()} == kinds().keys()


def stated() -> list[Stated]:
    deflected = [deflection(), deflection(stiffness=None), deflection(nmse_after=0.9)]
    return [
        *remarks(),
        *regimes(),
        *identifiable(),
        *findings(),
        *unexplained(),
        *locations(),
        *deflected,
        *diagnoses(),
    ]


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


@pytest.mark.parametrize("text", console())
def test_the_command_line_is_plain_and_short(text: str) -> None:
    assert BANNED.findall(text) == []
    assert [(length(s), s) for s in sentences(text) if length(s) > MOST_WORDS] == []


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
