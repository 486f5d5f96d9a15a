"""The two-input programs by brute force in rational arithmetic: every face, no geometry shared."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import combinations

import pytest


def root(square: Fraction) -> Fraction:
    """Square root to 80 digits; exact where it is rational with few digits."""
    scaled = math.isqrt(square.numerator * square.denominator * 10**160)
    value = Fraction(scaled, square.denominator * 10**80)
    exact = Fraction(math.isqrt(square.numerator), math.isqrt(square.denominator))
    return exact if exact * exact == square else value


def solve3(rows):
    """Cramer's rule; None where the three planes have no single point."""
    (a, b, c, r), (d, e, f, s), (g, h, i, t) = rows
    det = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if det == 0:
        return None
    x = r * (e * i - f * h) - b * (s * i - f * t) + c * (s * h - e * t)
    y = a * (s * i - f * t) - r * (d * i - f * g) + c * (d * t - s * g)
    z = a * (e * t - s * h) - b * (d * t - s * g) + r * (d * h - e * g)
    return x / det, y / det, z / det


class Reference:
    """Exact answers by enumeration of the candidate points."""

    @staticmethod
    def sides(box):
        v_lo, v_hi, w_lo, w_hi = map(Fraction, box)
        one, zero = Fraction(1), Fraction(0)
        return [(one, zero, v_hi), (-one, zero, -v_lo), (zero, one, w_hi), (zero, -one, -w_lo)]

    @staticmethod
    def cost(weight, nominal, u, penalty=0, soft=(0, 0, 0)):
        q11, q12, q22 = map(Fraction, weight)
        x, y = u[0] - Fraction(nominal[0]), u[1] - Fraction(nominal[1])
        excess = Fraction(soft[0]) * u[0] + Fraction(soft[1]) * u[1] - Fraction(soft[2])
        delta = max(Fraction(0), excess)
        return q11 * x * x + 2 * q12 * x * y + q22 * y * y + Fraction(penalty) * delta * delta

    @classmethod
    def project(cls, weight, nominal, rows):
        """Nearest point in the weight's norm with all rows holding, or None."""
        q11, q12, q22 = map(Fraction, weight)
        n_v, n_w = map(Fraction, nominal)
        candidates = [(n_v, n_w)]
        for a, c, b in rows:
            g, h = q22 * a - q12 * c, q11 * c - q12 * a
            k = (a * n_v + c * n_w - b) / (a * g + c * h)
            candidates.append((n_v - k * g, n_w - k * h))
        for (a, c, b), (d, e, f) in combinations(rows, 2):
            det = a * e - c * d
            if det:
                candidates.append(((b * e - f * c) / det, (a * f - d * b) / det))
        inside = [u for u in candidates if all(a * u[0] + c * u[1] <= b for a, c, b in rows)]
        return min(inside, key=lambda u: cls.cost(weight, nominal, u), default=None)

    @staticmethod
    def least_slack(taken, rows):
        """min s >= 0 with a.u - b <= s |a| for rows and a.u <= b for those taken."""
        zero = Fraction(0)
        planes = [(a, c, -root(a * a + c * c), b) for a, c, b in rows]
        planes += [(a, c, zero, b) for a, c, b in taken] + [(zero, zero, Fraction(-1), zero)]
        best = None
        for three in combinations(planes, 3):
            point = solve3(three)
            if point is None or (best is not None and point[2] >= best):
                continue
            if all(a * point[0] + c * point[1] + d * point[2] <= b for a, c, d, b in planes):
                best = point[2]
        return best

    @classmethod
    def lexicographic(cls, weight, nominal, box, levels):
        """Point and slacks; lengths of rows should be rational for the point to be exact."""
        taken = cls.sides(box)
        slacks = []
        for level in levels:
            rows = [tuple(map(Fraction, row)) for row in level if row[0] or row[1]]
            slack = Fraction(0)
            if cls.project(weight, nominal, taken + rows) is None:
                slack = cls.least_slack(taken, rows)
            taken = taken + [(a, c, b + slack * root(a * a + c * c)) for a, c, b in rows]
            slacks.append(slack)
        return cls.project(weight, nominal, taken), slacks

    @classmethod
    def paper(cls, weight, nominal, box, hard, soft, penalty):
        """Point of the one-shot program, or None; both sides of delta's kink are enumerated."""
        rows = cls.sides(box) + [tuple(map(Fraction, row)) for row in hard]
        a, c, b = map(Fraction, soft)
        q11, q12, q22 = map(Fraction, weight)
        n_v, n_w, k = Fraction(nominal[0]), Fraction(nominal[1]), Fraction(penalty)
        p11, p12, p22 = q11 + k * a * a, q12 + k * a * c, q22 + k * c * c
        r_v = q11 * n_v + q12 * n_w + k * a * b
        r_w = q12 * n_v + q22 * n_w + k * c * b
        det = p11 * p22 - p12 * p12
        centre = ((p22 * r_v - p12 * r_w) / det, (p11 * r_w - p12 * r_v) / det)
        found = [cls.project(weight, nominal, rows), cls.project((p11, p12, p22), centre, rows)]
        return min(
            (u for u in found if u is not None),
            key=lambda u: cls.cost(weight, nominal, u, penalty, soft),
            default=None,
        )


@pytest.fixture(scope="session")
def reference():
    return Reference
