"""The paper's Table 1 and Fig. 6, replayed on a simulated recording."""

from paper_replay.models import paper_recording
from paper_replay.paper import Replay, ReplayRow, replay_paper, write_run

__all__ = ["Replay", "ReplayRow", "paper_recording", "replay_paper", "write_run"]
