"""FMU + inputs + parameters -> trajectories, sensitivities and likelihoods."""
