"""The paper's Table 1 and Fig. 6, replayed on a simulated recording."""

from paper_replay.models import paper_recording
from paper_replay.page import write_run
from paper_replay.paper import replay_paper
from paper_replay.result import Replay, ReplayRow

__all__ = ["Replay", "ReplayRow", "paper_recording", "replay_paper", "write_run"]
