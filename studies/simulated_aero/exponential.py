"""Coefficients of the fourth-order exponential Runge-Kutta method for blocks of two states.

For u' = A u + N(u, t) with A constant: Cox & Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. 26-29. The stiff,
linear part (the armature circuit) is exact at any step; the step only has to resolve what is not linear.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from math import factorial

Matrix = tuple[float, float, float, float]


@dataclass(frozen=True)
class Block:
    """Matrices (row-major 2 x 2) of one step of one block: propagators over the whole and half step, weights."""

    whole: Matrix
    half: Matrix
    stage: Matrix
    first: Matrix
    middle: Matrix
    last: Matrix


def phi(z: complex) -> tuple[complex, complex, complex, complex]:
    """Compute exp(z) and phi_k(z) = (phi_(k-1)(z) - 1/(k-1)!) / z for k = 1, 2, 3."""
    if abs(z) > 1.0:
        p0 = cmath.exp(z)
        p1 = (p0 - 1.0) / z
        p2 = (p1 - 1.0) / z
        return p0, p1, p2, (p2 - 0.5) / z
    term, p3 = 1.0 / 6.0 + 0j, 0j
    for k in range(4, 22):
        p3 += term
        term *= z / k
    p2 = p3 * z + 0.5
    p1 = p2 * z + 1.0
    return p1 * z + 1.0, p1, p2, p3


def block(a: Matrix, h: float) -> Block:
    """Compute the coefficients for u' = a u + N over a step of ``h`` s."""
    p0, p1, p2, p3 = _functions(a, h)
    q0, q1, _, _ = _functions(a, 0.5 * h)
    return Block(
        whole=p0,
        half=q0,
        stage=_sum((0.5 * h, q1)),
        first=_sum((h, p1), (-3.0 * h, p2), (4.0 * h, p3)),
        middle=_sum((2.0 * h, p2), (-4.0 * h, p3)),
        last=_sum((-h, p2), (4.0 * h, p3)),
    )


def _sum(*terms: tuple[float, Matrix]) -> Matrix:
    a, b, c, d = (sum(factor * matrix[k] for factor, matrix in terms) for k in range(4))
    return a, b, c, d


def _functions(a: Matrix, h: float) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Compute exp(ah) and phi_1..3(ah): f(A) = f(x) I + f[x, y] (A - x I), or by series where that cancels."""
    mean, half_gap = 0.5 * (a[0] + a[3]), cmath.sqrt(0.25 * (a[0] - a[3]) ** 2 + a[1] * a[2])
    x, y = mean + half_gap, mean - half_gap
    if abs(x - y) * h < 1e-4 or max(map(abs, a)) * h < 0.5:
        return _series((a[0] * h, a[1] * h, a[2] * h, a[3] * h))
    values = phi(x * h)
    out = []
    for value, other in zip(values, phi(y * h), strict=True):
        slope = (value - other) / (x - y)
        base = value - slope * x
        out.append(((base + slope * a[0]).real, (slope * a[1]).real, (slope * a[2]).real, (base + slope * a[3]).real))
    return out[0], out[1], out[2], out[3]


def _series(z: Matrix) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Compute exp(z), phi_1..3(z): phi_3(z) = sum of z^k / (k + 3)!, phi_(k-1)(z) = z phi_k(z) + I / (k - 1)!."""
    p3: Matrix = (0.0, 0.0, 0.0, 0.0)
    for k in range(24, 2, -1):
        p3 = _next(z, p3, 1.0 / factorial(k))
    p2 = _next(z, p3, 0.5)
    p1 = _next(z, p2, 1.0)
    return _next(z, p1, 1.0), p1, p2, p3


def _next(z: Matrix, f: Matrix, unit: float) -> Matrix:
    """Compute z f + unit I."""
    return (
        z[0] * f[0] + z[1] * f[2] + unit,
        z[0] * f[1] + z[1] * f[3],
        z[2] * f[0] + z[3] * f[2],
        z[2] * f[1] + z[3] * f[3] + unit,
    )
