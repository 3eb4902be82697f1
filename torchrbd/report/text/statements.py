"""The statement of each kind of result."""

from __future__ import annotations

from functools import singledispatch

from torchrbd.comparison.results import Change, Comparison
from torchrbd.diagnosis.diagnosis import Diagnosis
from torchrbd.diagnosis.results import Deflection, Finding, Location, Unexplained
from torchrbd.display import Remark
from torchrbd.fleet.results import FleetComparison, MemberResult
from torchrbd.inference.posterior.identifiability import Identifiability
from torchrbd.inference.results import NoiseRegime
from torchrbd.inference.suspicions.results import Remedy, Suspicion
from torchrbd.report.text.comparison import change_statement, comparison_statement
from torchrbd.report.text.findings import deflection_statement, finding_statement
from torchrbd.report.text.fleet import fleet_statement, member_statement
from torchrbd.report.text.identification import regime_statement
from torchrbd.report.text.locations import location_statement
from torchrbd.report.text.motions import identifiability_statement
from torchrbd.report.text.remarks import remark_statement
from torchrbd.report.text.suspicions import remedy_statement, suspicion_statement
from torchrbd.report.text.unexplained import unexplained_statement
from torchrbd.report.text.verdict import diagnosis_statement


@singledispatch
def in_words(result: object) -> str:
    """Return what a result says, in sentences for a person."""
    raise TypeError(f"nothing says what a {type(result).__name__} is; register it in report/text/statements.py")


in_words.register(Diagnosis, diagnosis_statement)
in_words.register(Finding, finding_statement)
in_words.register(Deflection, deflection_statement)
in_words.register(Unexplained, unexplained_statement)
in_words.register(Location, location_statement)
in_words.register(Change, change_statement)
in_words.register(Comparison, comparison_statement)
in_words.register(MemberResult, member_statement)
in_words.register(FleetComparison, fleet_statement)
in_words.register(Remark, remark_statement)
in_words.register(NoiseRegime, regime_statement)
in_words.register(Identifiability, identifiability_statement)
in_words.register(Suspicion, suspicion_statement)
in_words.register(Remedy, remedy_statement)
