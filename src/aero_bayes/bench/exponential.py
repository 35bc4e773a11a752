"""Coefficients of the fourth-order exponential Runge-Kutta method for blocks of two states.

For u' = A u + N(u, t) with A constant: Cox & Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. 26-29. The stiff,
linear part (the armature circuit) is exact at any step; the step only has to resolve what is not linear.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass

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
    """exp(z) and phi_k(z) = (phi_(k-1)(z) - 1/(k-1)!) / z for k = 1, 2, 3."""
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
    """Coefficients for u' = a u + N over a step of ``h`` s."""
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
    """exp(ah) and phi_1..3(ah) by the spectral form f(A) = f(x) I + f[x, y] (A - x I)."""
    mean, half_gap = 0.5 * (a[0] + a[3]), cmath.sqrt(0.25 * (a[0] - a[3]) ** 2 + a[1] * a[2])
    x, y = mean + half_gap, mean - half_gap
    if abs(x - y) * h < 1e-4:
        # Close eigenvalues: move one, which changes the result by less than the difference quotient would lose.
        shift = 1e-4 / h
        slopes = [(f - g) / (2.0 * shift * h) for f, g in zip(phi((x + shift) * h), phi((x - shift) * h), strict=True)]
        values = phi(x * h)
    else:
        values = phi(x * h)
        slopes = [(f - g) / ((x - y) * h) for f, g in zip(values, phi(y * h), strict=True)]
    out = []
    for value, slope in zip(values, slopes, strict=True):
        base = value - slope * x * h
        out.append(
            (
                (base + slope * h * a[0]).real,
                (slope * h * a[1]).real,
                (slope * h * a[2]).real,
                (base + slope * h * a[3]).real,
            )
        )
    return out[0], out[1], out[2], out[3]
