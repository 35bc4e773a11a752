"""The library's laws as simulated rigs have them: textbook formulas, exact and, where the physics is, not smooth.

A law of size zero is absent. Sizes are relative to what happens at the place without the law (:class:`Scale`), so that
one table serves every rig.
"""

from simulated_rigs.laws.balance_laws import BALANCE_LAWS
from simulated_rigs.laws.kind import LawKind, Parameters, Scale
from simulated_rigs.laws.signal_laws import SIGNAL_LAWS

#: (kind of place, law) -> the law; the kinds of place of balances are their families.
LAWS: dict[tuple[str, str], LawKind] = {(family, law.id): law for family, law in (*SIGNAL_LAWS, *BALANCE_LAWS)}

__all__ = ["LAWS", "LawKind", "Parameters", "Scale"]
