"""Results of a made-up robot: two recordings, the second held out; friction at every joint."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.ranked import Ranked, Ranking
from torchrbd.diagnosis.results import Alternative, Curve, Finding, Quantity, Region, Unexplained, Where
from torchrbd.display import Remark
from torchrbd.inference.identification import Identification
from torchrbd.inference.results import BaseParameterEstimate, JointNoise, NoiseRegime, ParameterEstimate, TorqueSeries
from torchrbd.inference.torque_error import Fit
from torchrbd.inference.verdict import verdict_of
from torchrbd.likelihood.misfit import Misfit

HEADLINE = "The URDF lacks Coulomb friction at joint2 (in hold.csv, 4.0 to 7.0 s)."


def identification(
    joints: tuple[str, ...],
    *,
    name: str = "arm",
    unmeasured: int | None = None,
    extended: bool = False,
    remarks: tuple[Remark, ...] = (),
):
    """Fabricate two recordings, the second held out; the last joint is prismatic; friction at every joint."""
    rng, n, m = np.random.default_rng(0), len(joints), 1200
    t = np.tile(np.arange(m // 2) / 25, 2)
    phase = rng.uniform(0, 6, n)
    q, qd = np.sin(t[:, None] + phase), np.cos(t[:, None] + phase)
    predicted = {"urdf": 9 * q, "baseline": 10 * q + 0.5 * np.sign(qd), "rigid_body": 10 * q}
    if extended:
        predicted["extended"] = 10 * q + np.sign(qd)
    measured = 10 * q + np.sign(qd) + 0.05 * rng.standard_normal(q.shape)
    if unmeasured is not None:
        measured[:, unmeasured] = np.nan
    held_out = np.arange(m) >= m // 2
    series = TorqueSeries(
        joints, ("fit.csv", "hold.csv"), held_out.astype(int), t, held_out, q, qd, -q, measured, predicted
    )
    rmse = {k: dict(zip(joints, np.sqrt((series.residual(k)[held_out] ** 2).mean(0)), strict=True)) for k in predicted}
    fits = {k: Fit({j: e**2 / 50 for j, e in errors.items()}, errors) for k, errors in rmse.items()}
    parameters = (
        ParameterEstimate("m_link1", "link1", "kg", 2.0, 2.1, 0.05, 0.1, "identified"),
        ParameterEstimate("mcx_link1", "link1", "kg m", 0.0, 0.0, 0.1, 1.0, "not identifiable"),
        ParameterEstimate("coulomb", joints[0], "N m", 0.0, 1.0, 0.0123, 0.0, "term"),
    )
    robot = SimpleNamespace(
        name=name,
        joint_names=joints,
        prismatic=np.arange(n) == n - 1,
        damping=np.where(np.arange(n) == 0, 0.25, 0.0),
        friction=np.zeros(n),
    )
    return Identification(
        robot=cast(Any, robot),
        recordings=("fit.csv",),
        held_out="hold.csv",
        cutoff_hz=5.0,
        fits=fits,
        verdict=verdict_of(fits, remarks),
        parameters=parameters,
        combinations=(Remark("only combination", {"expression": "Izz_link1 + Iyy_link2"}),),
        base=(BaseParameterEstimate("Izz_link1 + Iyy_link2", "kg m^2", 0.31, 0.3, 0.01, 0.02),),
        base_combination=np.eye(1, 20),
        base_covariance=np.eye(1),
        covariance=np.eye(20),
        noise=dict.fromkeys(joints, JointNoise(1e-4, 0.02, 0.05)),
        regime=NoiseRegime("auto", "filtered", matters=False, excess=1.04),
        series=series,
        model=cast(Any, None),
        posterior=None,
        remarks=remarks,
        facts=(Remark("unused columns", {"columns": ["mode"]}, "a.csv"),),
    )


def diagnosis(joints: tuple[str, ...], **options: Any) -> Diagnosis:
    result = identification(joints, extended=True, **options)
    joint = joints[min(1, len(joints) - 1)]
    finding = Finding(
        "coulomb_friction", (joint,), (), 0.983, 41.2, {"coulomb": Quantity(1.0, 0.0123, "N m")},
        Where(("hold.csv",), ((4.0, 7.0),), None), (Alternative("stribeck_friction", (joint,)),),
        {joint: 0.02}, {joint: 5e-5},
    )  # fmt: skip
    region = Where(region=(Region(f"q_{joints[0]}", -0.1, 0.3),))
    left = Unexplained((joint,), (f"q_{joints[0]}",), region, 0.42)
    return Diagnosis(result, "missing_physics", (finding,), (left,))


def with_friction(result: Diagnosis) -> Diagnosis:
    """Add viscous and Coulomb friction at every joint, after what was found; the last one could be something else."""
    (first,) = result.findings
    names = result.identification.series.joints
    plain = [
        replace(
            first,
            effect=effect,
            joints=(joint,),
            parameters={effect.partition("_")[0]: Quantity(0.5, 0.02, unit, urdf=0.25 if joint == names[0] else 0.0)},
            where=Where(),
            indistinguishable_from=first.indistinguishable_from if joint == names[-1] else (),
            probability=0.9 if joint == names[-1] else 0.99,
        )
        for effect, unit in (("viscous_friction", "N m s/rad"), ("coulomb_friction", "N m"))
        for joint in names
    ]
    special = replace(first, effect="torque_ripple", curve=curve(f"q_{first.joints[0]}"))
    return replace(result, findings=(*plain, special))


def ranking(joints: tuple[str, ...], adopted: tuple[Ranked, ...] = ()) -> Ranking:
    """Rank a payload for a time, a coupling and forty springs; friction at every joint."""
    names = {"viscous_friction": ("viscous",), "asymmetric_coulomb_friction": ("coulomb_plus", "coulomb_minus")}
    ordinary = tuple(
        Ranked(effect, (joint,), (), 120.0 - 130.0 * (joint == joints[-1]), dict.fromkeys(values, 0.5),
               shape={"width": 0.01} if len(values) > 1 else {})
        for joint in joints for effect, values in names.items()
    )  # fmt: skip
    mass = {"mass": 0.5, "x": 0.1, "y": np.nan, "z": 0.0, "Ixx": 0.01, "Ixy": 0.0}
    load = Ranked("payload", (), ("hand",), 41.25, mass, window=("fit.csv", 2.0, 8.0))
    coupling = Ranked("joint_coupling", joints[-1:], (), 6.0, {"stiffness": 3.0, "offset": -1.0}, other=joints[0])
    springs = [Ranked("joint_spring", joints[:1], (), -0.1 * k, {"stiffness": 1.0 + k}) for k in range(28)]
    first = (load, coupling, *springs)
    delay = {"fit.csv": (-0.0012, 0.0001), "hold.csv": (0.0, 0.024)}
    misfit = {
        joint: Misfit(2.0 + 40.0 * (joint == joints[-1]), 3, 4e-9 if joint == joints[-1] else 0.57) for joint in joints
    }
    return Ranking(15.0, ordinary, delay, first, adopted, first, 42, misfit, cast(Any, None))


def curve(signal: str) -> Curve:
    """Return a parabola from -1 to 1 with a band."""
    x = np.linspace(-1.0, 1.0, 50)
    return Curve(signal, tuple(x), tuple(x**2), (0.1,) * 50)
