"""The posterior of one experiment as the prior of the next: normal on the axes of the search, with its correlation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.parameters import JointPrior, ParameterSet
from aero_bayes.estimate.priors import LogNormal, Normal

#: Draws for each parameter that a covariance needs at least.
MIN_DRAWS_EACH = 10


def with_joint_prior(parameters: ParameterSet, draws: Mapping[str, FloatArray]) -> ParameterSet:
    """Return the parameters with a common normal prior for those of which draws (n,) of a posterior are given (SI).

    Mean and covariance are those of the logarithms where the axis of the search is logarithmic."""
    shared = [p for p in parameters if p.name in draws]
    if not shared:
        there = ", ".join(draws)
        raise InputError(f"the posterior has none of the parameters {', '.join(parameters.names)}; it has {there}")
    values = np.stack([np.asarray(draws[p.name], dtype=float).ravel() for p in shared])
    if values.shape[1] < MIN_DRAWS_EACH * len(shared):
        raise InputError(f"the posterior has {values.shape[1]} draws, expected {MIN_DRAWS_EACH * len(shared)} or more")
    log = np.array([p.scale == "log" for p in shared])
    if (values[log] <= 0.0).any():
        raise InputError("the posterior has draws at or below zero of a parameter that is positive here")
    axes = np.where(log[:, None], np.log(np.where(log[:, None], values, 1.0)), values)
    mean, covariance = axes.mean(axis=1), np.atleast_2d(np.cov(axes))
    joint = JointPrior(tuple(p.name for p in shared), tuple(mean.tolist()), tuple(map(tuple, covariance.tolist())))
    found = []
    for p in parameters:
        if p.name in joint.names:
            k = joint.names.index(p.name)
            sd = float(np.sqrt(covariance[k, k]))
            prior = LogNormal(float(np.exp(mean[k])), sd) if p.scale == "log" else Normal(float(mean[k]), sd)
            start = float(np.clip(np.exp(mean[k]) if p.scale == "log" else mean[k], p.lower, p.upper))
            p = replace(p, prior=prior, start=start, joint=joint)
        found.append(p)
    return ParameterSet(tuple(found))
