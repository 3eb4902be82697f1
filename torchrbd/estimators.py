"""Estimators of inertial parameters by name: what a user may ask for, without what computes them."""

from __future__ import annotations

from collections.abc import Iterable

from torchrbd.errors import OptionError, closest

ESTIMATORS = {
    "auto": "the default: smoother where the recordings' position noise matters, physical where not",
    "physical": "weighted least squares with the entropic prior around the URDF, always physical",
    "smoother": "states and parameters together, always physical: position noise does not bias it",
    "moments": "physical, of one pass over each recording, as statistics files have it; looks at nothing else",
    "ols": "ordinary least squares on base parameters",
    "wls": "least squares with joints weighted by their noise",
    "irls": "the same, with samples that do not fit weighted down",
    "iv": "instrumental variables; needs recorded set-points q_ref",
    "svd": "truncated singular values",
    "ridge": "ridge towards the URDF",
    "tls": "total least squares",
    "lasso": "sparse changes of the URDF, by an absolute penalty",
    "stepwise": "sparse changes of the URDF, selected by BIC",
    "pls": "partial least squares",
    "pcr": "principal component regression",
    "eiv-ard": "errors in variables with automatic relevance determination",
    "noisy-input": "the Bayesian factor model of Ting et al. (2006)",
    "best": "the best of several by cross-validation corrected for input noise",
}
"""Estimators by name, each in a few words."""

OF_RECORDINGS = ("auto", "physical", "smoother")
"""Estimators with uncertainties that work on the recordings: what a search for effects needs."""

WITH_INTERVALS = (*OF_RECORDINGS, "moments")
"""Estimators with uncertainties."""

COMPARABLE = tuple(name for name in ESTIMATORS if name not in ("auto", "moments"))
"""What can be compared: "auto" is a choice between "physical" and "smoother", "moments" sees less than "physical"."""


def check_estimators(names: Iterable[str], known: tuple[str, ...]) -> None:
    """Raise OptionError for a name that is not known, with the closest one that is."""
    for name in names:
        if name not in known:
            hint = closest(name, known) or f"known: {', '.join(known)}"
            raise OptionError(f"unknown estimator '{name}'; {hint}")
