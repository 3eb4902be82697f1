"""Whether recordings can show what a user names."""

from __future__ import annotations

from collections.abc import Sequence

from torchrbd.dataset.columns import Columns
from torchrbd.effects.requested import RequestedEffect
from torchrbd.errors import OptionError


def check_seen(wanted: Sequence[RequestedEffect], columns: Columns) -> None:
    """Check that every requested effect can show in the recordings, at its place if one is named.

    Raises:
        OptionError: one cannot.
    """
    seen = {(c.effect.id, c.site) for c in columns.candidates}
    for one in wanted:
        sites = one.sites(columns.robot, columns.windows)
        if not any((one.effect.id, site) in seen for site in sites):
            where = "any place" if one.place is None else one.place
            needs = f"it needs {one.effect.needs}; " if one.effect.needs else ""
            raise OptionError(
                f"'{one.effect.id}' cannot show at {where} in the range of these recordings; "
                f"{needs}record more motion there, or leave it out"
            )
