"""What acts while only the fit's own recordings see it is proven on blocks of its time that are left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from likelihood.arms import recorded
from likelihood.fits import BEGIN_S, MASS, OPTIONS, URDF, candidate, payload, with_friction
from simulated import with_wrong_inertials

from torchrbd.diagnosis import ranking
from torchrbd.diagnosis.decisions import DECISIONS
from torchrbd.diagnosis.final_model import FinalModel, fit_final_model
from torchrbd.diagnosis.hypotheses import Hypothesis
from torchrbd.diagnosis.outcome import SearchOutcome, Term
from torchrbd.diagnosis.refitted_models import RefittedModels
from torchrbd.diagnosis.results import OWN_TIME, Finding, Where
from torchrbd.effects import Site, Window
from torchrbd.inference.ordinary import with_friction as friction_of
from torchrbd.inference.ordinary import with_machine
from torchrbd.inference.preparation import prepare
from torchrbd.inference.settings import Settings
from torchrbd.robot import RobotModel

MAY = ("viscous_friction", "coulomb_friction", "payload")
LOAD = Finding("payload", (), ("link",), 0.99, 30.0, {}, Where(("first",)), (), {}, {})


def quiet(*_: object) -> None:
    """Tell nobody how far the work is."""


def searched(
    torque: Callable | None, *others: Callable | None
) -> tuple[SearchOutcome, Callable[[SearchOutcome], FinalModel]]:
    """Return what is found in a recording, and others, one held out, and what makes a model of an explanation."""
    first = recorded(URDF, 2, with_friction(torque), name="first", **OPTIONS)
    second = recorded(URDF, 3, with_friction(), name="second", **{**OPTIONS, "duration_s": 10.0})
    more = [recorded(URDF, 4 + k, with_friction(t), name=f"more {k}", **OPTIONS) for k, t in enumerate(others)]
    settings = Settings.from_mapping({"effects": MAY, "holdout": [second]}, "test")
    prepared = prepare(RobotModel.from_urdf(with_wrong_inertials(URDF, 1, 0.1)), [first, *more], settings, ())
    ranked = ranking.run_search(prepared.reading, settings, prepared.kept_back, quiet)
    prepared = with_machine(prepared, settings, friction_of(settings), quiet, ranked.clocks)
    return ranked.explanation, lambda found: fit_final_model(prepared, found, MAY, quiet)


def told(found: SearchOutcome, window: Window) -> SearchOutcome:
    """Return the same with a load in a window, believed to be as heavy as a load may be."""
    c = candidate(found.rows, "payload", Site(body=1, window=window))
    one = Hypothesis(c, 30.0, np.zeros(10), np.ones(10), 1.0, 1)
    fit = found.base.extended([one.extra(found.base, found.rows)])
    return replace(found, fit=fit, terms=(Term(one, ()),))


@pytest.mark.parametrize("loaded", [True, False])
def test_load_is_shown_by_blocks_of_its_time_where_it_is_carried(loaded: bool) -> None:
    found, model_of = searched(payload if loaded else None)
    model = model_of(told(found, Window("first", BEGIN_S)))
    (term,) = model.terms
    fits = RefittedModels(model)
    one = fits.in_its_time(term, LOAD)
    assert one.judged_on == OWN_TIME
    assert not fits.held_out_sees(term)
    assert (one.share > DECISIONS.no_change) is loaded
    assert one.nmse_before.keys() == one.nmse_after.keys() == set(model.prepared.robot.joint_names)
    assert all(0 < x < 1.5 for each in (one.nmse_before, one.nmse_after) for x in each.values())
    if loaded:
        w, _ = model.model.coefficients(term)
        assert float(w[0]) == pytest.approx(MASS, rel=0.2)


def test_what_held_out_blocks_see_or_is_too_short_is_not_judged_by_its_own_time() -> None:
    found, model_of = searched(None)
    brief = model_of(told(found, Window("first", 5.1, 5.4)))
    one = RefittedModels(brief).in_its_time(brief.terms[0], LOAD)
    assert (one.judged_on, one.nmse_before, one.nmse_after) == ("", {}, {})
    assert not RefittedModels(brief).held_out_sees(brief.terms[0])
    model = model_of(told(found, Window("first", BEGIN_S)))
    (term,) = model.terms
    held_out = model.prepared.held_out.clone()
    inside = [b.recording == "first" and b.start_s > BEGIN_S for b in model.prepared.statistics.blocks]
    held_out[torch.nonzero(torch.tensor(inside))[0]] = True
    seen = replace(model, prepared=replace(model.prepared, held_out=held_out))
    assert not RefittedModels(model).held_out_sees(term)
    assert RefittedModels(seen).held_out_sees(term)
    # What acts always is judged by what is held out.
    assert all(RefittedModels(model).held_out_sees(friction.candidate) for friction in model.friction)
