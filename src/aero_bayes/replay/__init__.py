"""The paper's Table 1 and Fig. 6, replayed on the simulated bench."""

from aero_bayes.replay.paper import replay_paper
from aero_bayes.replay.result import Replay, Row

__all__ = ["Replay", "Row", "replay_paper"]
