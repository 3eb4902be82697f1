"""Input that can be read but cannot be right is doubted aloud."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from robot.random_robots import random_urdf
from shortened import fit_alone, without_simulation
from simulated import joint_names, record

from torchrbd.cli import main
from torchrbd.diagnosis import diagnose
from torchrbd.errors import RobotError
from torchrbd.inference import Fit, compare_estimators, identify
from torchrbd.inference.data.bodies import fixed_base
from torchrbd.inference.identification import Identification
from torchrbd.inference.many import identify_many
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.inference.verdict import verdict_of
from torchrbd.recordings import Recording
from torchrbd.report.text.numbers import number
from torchrbd.report.text.verdict import CHECK_INPUT, headline
from torchrbd.robot import RobotModel

pytestmark = pytest.mark.usefixtures("without_simulation")

BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
URDF = random_urdf(31, 3, kinds=("revolute",), branching=0.0, massless=0.0)


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    chunk = next(iter(record(URDF, 31).chunks(10**6)))
    return {"t": chunk.t, "q": chunk.q, "tau": chunk.tau}


def notes(arrays: dict[str, np.ndarray], **changes: np.ndarray) -> str:
    found = identify(URDF, Recording.from_arrays("day", joint_names(URDF), **{**arrays, **changes}), effects=[])
    assert found.verdict == ("suspect" if found.suspicions.settles else "doubtful" if found.doubts else "identified")
    return "\n".join((*found.doubts, *found.notes))


def test_right_input_is_not_doubted(arrays: dict[str, np.ndarray]) -> None:
    assert notes(arrays, qd=np.gradient(arrays["q"], arrays["t"], axis=0)) == ""


@pytest.fixture(scope="module")
def degrees(arrays: dict[str, np.ndarray]) -> Identification:
    with without_simulation():
        table = {**arrays, "q": np.rad2deg(arrays["q"])}
        return identify(URDF, Recording.from_arrays("day", joint_names(URDF), **table), effects=[])


def test_degrees(degrees: Identification) -> None:
    told = "\n".join((*degrees.doubts, *degrees.notes))
    assert re.search(
        r"day is faster than the URDF allows: .*joint3 134 rad/s \(limit 5\S*\)\. Check the units of q and t", told
    )
    assert re.search(r"more than ten times off at joint\d.*\. Check the units", told)


@pytest.mark.usefixtures("fit_alone")
def test_velocity_that_is_not_the_derivative(arrays: dict[str, np.ndarray]) -> None:
    qd = np.gradient(arrays["q"], arrays["t"], axis=0)
    qd[:, 1] = np.rad2deg(qd[:, 1])
    assert "qd_joint2 is 57.3 times dq/dt and not used" in notes(arrays, qd=qd)


@pytest.mark.usefixtures("fit_alone")
def test_bad_samples(arrays: dict[str, np.ndarray]) -> None:
    q, tau = arrays["q"].copy(), arrays["tau"].copy()
    q[3000, 0] += 40.0
    tau[2000, 2] = 1e6
    found = identify(URDF, Recording.from_arrays("day", joint_names(URDF), arrays["t"], q, tau), effects=[])
    told = "\n".join((*found.doubts, *found.notes))
    assert found.verdict == "suspect"
    assert "q_joint1 jumps" in told
    assert "tau_joint3 peaks at 1e+06" in told


def test_torque_that_never_changes(arrays: dict[str, np.ndarray]) -> None:
    tau = arrays["tau"].copy()
    tau[:, 1] = 0.0
    assert "the torque of joint2 never changes and is not used" in notes(arrays, tau=tau)


def test_a_temperature_that_some_recordings_lack(arrays: dict[str, np.ndarray]) -> None:
    names, warm = joint_names(URDF), 20.0 + np.ones_like(arrays["q"])
    warm[:, 0] = np.nan
    days = [
        Recording.from_arrays("day", names, **arrays),
        Recording.from_arrays("night", names, temperature=warm, **arrays),
    ]
    prepared = prepare(RobotModel.from_urdf(URDF), days, Settings(), ())
    assert not any(scale.temperature for scale in prepared.columns.scales)
    assert [note for note in map(str, prepared.facts) if "temperature" in note] == [
        f"day: no temperature of {', '.join(names[1:])}, so that of others is not used there"
    ]


def test_held_out_data_that_are_predicted_worse(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Fitted to torques of the wrong sign, judged on right ones."""
    names = joint_names(URDF)
    fitted = Recording.from_arrays("flipped", names, arrays["t"], arrays["q"], -arrays["tau"])
    np.savez(tmp_path / "right.npz", joints=np.array(names), **arrays)
    found = identify(URDF, fitted, holdout=[tmp_path / "right.npz"])
    assert found.verdict == "suspect"
    assert list(found.fits.values())[-1].mean_nmse > 1.2 * found.fits["urdf"].mean_nmse
    (told,) = (doubt for doubt in found.doubts if "the URDF as given predicts better" in doubt)
    assert all(name in told for name in names)


@pytest.mark.usefixtures("fit_alone")
def test_masses_that_no_link_has(arrays: dict[str, np.ndarray]) -> None:
    assert "fitted masses are far from the URDF's: link" in notes(arrays, tau=30.0 * arrays["tau"])


@pytest.mark.usefixtures("fit_alone")
def test_masses_of_several_links_may_be_those_of_another_variant(arrays: dict[str, np.ndarray]) -> None:
    """Of one link alone they are not."""
    recording = Recording.from_arrays("day", joint_names(URDF), **arrays)
    far = {}
    for count in (1, 3):
        heavy = re.sub(r'<mass value="([^"]+)"', lambda m: f'<mass value="{12.0 * float(m[1])}"', URDF, count=count)
        (far[count],) = (doubt for doubt in identify(heavy, recording, effects=[]).doubts if "masses are far" in doubt)
    assert far[3].endswith("or the URDF of another variant of the robot")
    assert "variant" not in far[1]


def fit(*nmse: float) -> Fit:
    return Fit(dict(zip("ab", nmse, strict=True)), {})


@pytest.mark.parametrize(
    ("urdf", "last", "doubts", "expected"),
    [
        ((0.5, 0.1), (0.1, 0.1), (), "identified"),
        ((0.5, 0.1), (0.1, 0.1), ("units",), "doubtful"),
        ((0.5, 0.1), (0.35, 0.36), (), "identified"),  # 18 % worse
        ((0.5, 0.1), (0.35, 0.40), (), "worse"),  # 25 % worse
        ((0.5, 0.1), (0.35, 0.40), ("units",), "worse"),
    ],
)
def test_verdict(urdf: tuple[float, ...], last: tuple[float, ...], doubts: tuple[str, ...], expected: str) -> None:
    """The last model counts, whatever those before it do."""
    fits = {"urdf": fit(*urdf), "rigid_body": fit(9.0, 9.0), "extended": fit(*last)}
    assert verdict_of(fits, doubts) == expected
    assert verdict_of(fits, doubts, suspect=True) == "suspect"


def test_a_gain_over_an_absurd_urdf_is_no_praise(arrays: dict[str, np.ndarray], degrees: Identification) -> None:
    """The verdict comes first: a table in degrees lowers the error by more than 99 % and means nothing."""
    first, more = headline(degrees)
    assert degrees.verdict == "suspect"
    assert degrees.fits["urdf"].mean_nmse > 100 * list(degrees.fits.values())[-1].mean_nmse
    assert first == CHECK_INPUT
    assert "in degrees" in more
    with fit_alone():
        right = identify(URDF, Recording.from_arrays("day", joint_names(URDF), **arrays), effects=[])
    assert "lowers" in " ".join(headline(replace(right, fits={"urdf": fit(0.5, 0.5), "rigid_body": fit(0.1, 0.1)})))
    for urdf, last, words in (
        ((300.0, 0.5), (0.1, 0.1), "Check the units: the URDF's torque is more than ten times off at a."),
        (
            (9.0, 9.0),
            (1.2, 0.9),
            "predicts torque no better than a constant. It has a mean NMSE of 1.05 on held-out data.",
        ),
    ):
        told = " ".join(headline(replace(right, fits={"urdf": fit(*urdf), "rigid_body": fit(*last)})))
        assert words in told
        assert "lowers" not in told


@pytest.mark.usefixtures("fit_alone")
def test_a_fit_that_is_no_better_than_a_constant_is_suspect(arrays: dict[str, np.ndarray]) -> None:
    tau = np.random.default_rng(5).permutation(arrays["tau"])
    found = identify(URDF, Recording.from_arrays("day", joint_names(URDF), **{**arrays, "tau": tau}), effects=[])
    assert found.verdict == "suspect"
    assert "no better than a constant" in headline(found)[0]
    assert found.doubts


MASSLESS = re.sub(r"<inertial>.*?</inertial>", "", URDF, flags=re.DOTALL)


@pytest.mark.parametrize("call", [identify, diagnose, compare_estimators, partial(identify, estimator="moments")])
def test_a_urdf_without_masses_is_refused(call: Callable[..., object], arrays: dict[str, np.ndarray]) -> None:
    recording = Recording.from_arrays("day", joint_names(URDF), **arrays)
    with pytest.raises(RobotError, match=r"no moving link of robot 'random31' has a mass: .*link2, .*<inertial>"):
        call(MASSLESS.encode(), recording)
    with pytest.raises(RobotError, match="no moving link"):
        identify_many(MASSLESS.encode(), [recording, recording])


def test_a_urdf_without_masses_ends_with_exit_code_two(
    arrays: dict[str, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.urdf").write_text(MASSLESS)
    np.savez(tmp_path / "day.npz", joints=np.array(joint_names(URDF)), **arrays)
    given = [str(tmp_path / name) for name in ("arm.urdf", "day.npz")]
    assert main(["identify", *given, "-o", str(tmp_path / "out")]) == 2
    assert "arm.urdf: no moving link" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("fit_alone")
def test_a_link_without_mass_is_a_note(arrays: dict[str, np.ndarray]) -> None:
    one = re.sub(r"(<link name=\"link3\">)\s*<inertial>.*?</inertial>", r"\1", URDF, flags=re.DOTALL)
    found = identify(one, Recording.from_arrays("day", joint_names(URDF), **arrays))
    assert any("link3 has no mass in the URDF" in note and "give it a rough one" in note for note in found.notes)


def legs(trunk: str = BODY, *, root: str = "", count: int = 2) -> bytes:
    """A trunk with so many legs of two joints each; ``root`` is the name of a massless root link above it."""
    text = f'<link name="trunk">{trunk}</link>'
    if root:
        text += f'<link name="{root}"/><joint name="mount" type="fixed"><parent link="{root}"/>'
        text += '<child link="trunk"/></joint>'
    for side in range(count):
        for above, part, y in (("trunk", "thigh", 0.2 * side), (f"thigh{side}", "calf", 0.0)):
            text += (
                f'<link name="{part}{side}">{BODY}</link><joint name="{part}_joint{side}" type="revolute">'
                f'<origin xyz="0 {y} -0.2"/><parent link="{above}"/><child link="{part}{side}"/><axis xyz="0 1 0"/>'
                '<limit lower="-2" upper="2" velocity="9" effort="99"/></joint>'
            )
    return f'<robot name="dog">{text}</robot>'.encode()


@pytest.mark.parametrize(
    ("urdf", "told"),
    [
        (legs(), True),
        (legs(root="base"), True),  # as several makers write it: some readers refuse a root link with a mass
        (legs(root="world"), False),
        (legs(trunk=""), False),
        (legs(count=1), False),
        (URDF.encode(), False),
    ],
)
def test_a_trunk_on_legs_is_taken_as_fixed_and_that_is_told(urdf: bytes, told: bool) -> None:
    words = fixed_base(RobotModel.from_urdf(urdf))
    assert bool(words) == told
    assert all("the base 'trunk' is taken as fixed to the world, and 2 limbs move on it" in str(one) for one in words)


@pytest.mark.usefixtures("fit_alone")
def test_a_base_is_doubted_where_the_torques_do_not_fit() -> None:
    urdf = legs().decode()
    (chunk,) = record(urdf, 7, duration_s=20.0).chunks(10**6)
    names, (told,) = joint_names(urdf), fixed_base(RobotModel.from_urdf(urdf.encode()))
    still = identify(urdf.encode(), Recording.from_arrays("still", names, chunk.t, chunk.q, chunk.tau))
    assert still.notes[0] == told.statement
    assert told not in still.remarks
    weight = 30.0 * np.sin(1.7 * chunk.t)[:, np.newaxis] * np.array([1.0, -1.0, 1.0, -1.0])
    walks = identify(urdf.encode(), Recording.from_arrays("walks", names, chunk.t, chunk.q, chunk.tau + weight))
    assert told in walks.remarks
    assert told.statement in walks.doubts


@pytest.mark.usefixtures("fit_alone")
def test_little_explained_on_held_out_data_alone(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    """The held-out torque of one joint is another's: the fit is fine, what it predicts is not."""
    names = joint_names(URDF)
    tau = arrays["tau"].copy()
    tau[:, 2] = 0.3 * np.random.default_rng(0).permutation(tau[:, 2])
    np.savez(tmp_path / "spoilt.npz", joints=np.array(names), **{**arrays, "tau": tau})
    found = identify(URDF, Recording.from_arrays("day", names, **arrays), holdout=[tmp_path / "spoilt.npz"])
    (told,) = found.doubts
    assert re.search(
        r"explains little of the torque of joint3 \(NMSE \S+ on fitted data, \d\S* on held-out data\)", told
    )
    assert found.verdict == "doubtful"


@pytest.mark.usefixtures("fit_alone")
def test_stated_position_noise_that_the_recording_does_not_show(arrays: dict[str, np.ndarray]) -> None:
    q = arrays["q"] + 1e-4 * np.random.default_rng(1).standard_normal(arrays["q"].shape)
    recording = Recording.from_arrays("day", joint_names(URDF), **{**arrays, "q": q})
    stated = {"joint1": 1e-2, "joint2": 1.5e-4, "joint3": 1e-5}
    found = identify(URDF, recording, encoder_noise=stated, estimator="physical")
    (one,) = (remark for remark in found.remarks if remark.kind == "misstated position noise")
    sizes = one.values["stated_and_seen"]
    assert {joint: size[0] for joint, size in sizes.items()} == {"joint1": 1e-2, "joint3": 1e-5}
    assert [seen for _, seen in sizes.values()] == pytest.approx([1e-4, 1e-4], rel=0.2)
    assert re.search(r"joint1 0\.0100 rad \(recordings \S+ rad, \d\S* times less\)", one.statement)
    assert re.search(r"joint3 \S+ rad \(recordings \S+ rad, \d\S* times more\)\. It is used as stated$", one.statement)
    assert one.statement in found.doubts
    assert identify(URDF, recording, encoder_noise=1.5e-4).doubts == ()


@pytest.mark.usefixtures("fit_alone")
def test_smoothing_finds_the_position_noise_itself(arrays: dict[str, np.ndarray]) -> None:
    q = arrays["q"] + 3e-3 * np.random.default_rng(2).standard_normal(arrays["q"].shape)
    recording = Recording.from_arrays("day", joint_names(URDF), **{**arrays, "q": q})
    found = identify(URDF, recording, encoder_noise=1e-2)
    assert found.states == "smoothed"
    (told,) = found.doubts
    assert "Smoothing estimates its own" in told
    for joint, noise in found.noise.items():
        assert noise.position == pytest.approx(3e-3, rel=0.2)
        assert re.search(
            rf"{joint} 0\.0100 rad \(recordings [\d.]+ rad, [\d.]+ times less, smoothed {number(noise.position)} rad",
            told,
        )


@pytest.mark.slow
def test_the_regime_says_what_auto_would_do(arrays: dict[str, np.ndarray]) -> None:
    loud = arrays["q"] + 3e-3 * np.random.default_rng(2).standard_normal(arrays["q"].shape)
    for q, estimator, words in (
        (loud, "wls", "The estimator 'wls' was asked for; 'auto' would smooth states and parameters together"),
        (loud, "physical", "The estimator 'physical' was asked for; 'auto' would smooth"),
        (loud, "auto", "States and parameters are smoothed together"),
        (arrays["q"], "smoother", "The estimator 'smoother' was asked for; 'auto' would filter the states"),
        (arrays["q"], "wls", "States are filtered"),
    ):
        recording = Recording.from_arrays("day", joint_names(URDF), **{**arrays, "q": q})
        found = identify(URDF, recording, estimator=estimator)
        told = found.regime.statement
        assert words in told
        # Where noise biases the fit, the same sentence is a doubt.
        assert (told in found.doubts) == (found.states == "filtered" and q is loud)
        assert ("'auto' would" in told) == ("'auto'" in words)
