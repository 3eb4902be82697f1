"""Sets of terms: what one takes the place of, and what is the same at the same place."""

from __future__ import annotations

from torchrbd.likelihood.columns import Candidate

Terms = tuple[Candidate, ...]


def with_term(terms: Terms, added: Candidate) -> Terms:
    """Add a term; it takes the place of those whose features it contains, and of the same law with another shape."""
    own = set(added.labels)

    def replaced(c: Candidate) -> bool:
        same = c.effect is added.effect and c.site == added.site and not c.effect.of_several_shapes
        return same or (c.place == added.place and set(c.labels) <= own)

    return (*(c for c in terms if not replaced(c)), added)


def without(terms: Terms, left_out: Candidate) -> Terms:
    """Return the other terms."""
    return tuple(c for c in terms if c is not left_out)


def names(terms: Terms) -> list[tuple[str, object]]:
    """Return effects and sites."""
    return [(c.effect.id, c.site) for c in terms]


def place(term: Candidate) -> tuple[object, ...]:
    """Return an effect and its place, whenever it acts, and whether that is in some recordings only."""
    site = term.site
    return term.effect.id, site.joint, site.other, site.body, site.recordings is not None
