"""Starting points that are looked for once, also in a loop that was interrupted and resumed."""

from __future__ import annotations

from aero_bayes.checkpoint import Arrays, pack_all, unpack_all
from aero_bayes.estimate.climb import Optimum
from aero_bayes.loop import starting
from aero_bayes.loop.stand import Stand
from aero_bayes.physics.kin import Candidate


def starting_points(stand: Stand, base: Optimum, candidate: Candidate) -> list[starting.Start]:
    """See :func:`.starting.starting_points`."""

    def look() -> Arrays:
        return pack_all(starting.starting_points(stand, base, candidate))

    asked = (base.coordinates, base.free, base.noise, candidate)
    return unpack_all(starting.Start, stand.study.once("starts", asked, look))
