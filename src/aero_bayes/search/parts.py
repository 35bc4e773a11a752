"""The parts of a search that a user may add to, or leave out to see what each is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from aero_bayes.errors import InputError
from aero_bayes.search.edits import EDITS, Edit
from aero_bayes.search.restarts import DeclaredValues, GrowingHorizon, Restart
from aero_bayes.search.starts import START_RULES, StartRule

#: The restarts of a search, with how many of the best structures of a level each one serves.
RESTARTS: tuple[tuple[Restart, int], ...] = ((GrowingHorizon(), 3), (DeclaredValues(), 1))
#: Names of everything that can be left out.
PARTS: tuple[str, ...] = (
    *(type(e).__name__ for e in EDITS if type(e).__name__ != "AddTerm"),
    *(type(r).__name__ for r in START_RULES if type(r).__name__ != "NominalValues"),
    "KnownTerms", "GrowingHorizon", "DeclaredValues", "Validation",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Parts:
    """Edits, start rules and restarts of a search.

    ``restarts`` come with how many of the best structures of a level each one serves; ``known_terms`` is whether terms
    start as they were in other fits, too.
    """

    edits: tuple[Edit, ...] = EDITS
    start_rules: tuple[StartRule, ...] = START_RULES
    restarts: tuple[tuple[Restart, int], ...] = RESTARTS
    known_terms: bool = True

    @classmethod
    def of(cls, leave_out: Sequence[str] = ()) -> Parts:
        """Return the standard parts but for those left out.

        Raises
        ------
        InputError
            For a name that is no part.
        """
        unknown = [name for name in leave_out if name not in PARTS]
        if unknown:
            raise InputError(f"[loop] leave_out: unknown part {unknown[0]!r}; expected one of {', '.join(PARTS)}")
        return cls(
            tuple(e for e in EDITS if type(e).__name__ not in leave_out),
            tuple(r for r in START_RULES if type(r).__name__ not in leave_out),
            tuple(one for one in RESTARTS if type(one[0]).__name__ not in leave_out),
            "KnownTerms" not in leave_out,
        )

    def with_restart(self, restart: Restart, top: int = 1) -> Parts:
        """Return the parts with a further restart, of so many of the best structures of a level."""
        return replace(self, restarts=(*self.restarts, (restart, top)))

    def with_edit(self, edit: Edit) -> Parts:
        """Return the parts with a further edit."""
        return replace(self, edits=(*self.edits, edit))

    def with_start_rule(self, rule: StartRule) -> Parts:
        """Return the parts with a further start rule."""
        return replace(self, start_rules=(*self.start_rules, rule))
