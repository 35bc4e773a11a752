"""ODEBench as tasks of the closed loop: published systems from each of which one additive term is deleted."""

from odebench_tasks.peers import peers
from odebench_tasks.recordings import can_be_simulated, noisy_runs, times, trajectory, visibility
from odebench_tasks.systems import System, Task, Term, read_systems, tasks_of
from odebench_tasks.verdict import verdict

__all__ = [
    "System", "Task", "Term", "can_be_simulated", "noisy_runs", "peers", "read_systems", "tasks_of", "times",
    "trajectory", "verdict", "visibility",
]  # fmt: skip
