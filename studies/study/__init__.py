"""Studies of the method: tasks with a known answer, one row for each, and a summary as JSON."""
