#!/usr/bin/env python3
"""Fits the probability that a model is right to the table that collect.py made.

    fit.py TABLE [--ridge WEIGHT]

Logistic regression on half A of the captures alone, models that are right and wrong ones with the
same total weight (the constant is then moved to PRIOR_ODDS), a ridge on all coefficients but the
constant, and signs as the features mean them. Poor models (relative rotations off by 2 to 5 degrees
in the median) count with the wrong ones: to be doubted is what is asked of them. A second solution
is asked where the poses follow no law of motion; a law counts as one that agrees exactly. What is
unknown adds nothing. Models of two parts
that no points tie are left out: the program gives them no probability at all.

Prints the terms as they stand in sfm/src/plausibility/probability.rs, and how both halves come out.
"""
import argparse
import csv
import math
import sys

import numpy as np
from scipy.optimize import minimize

DOUBTFUL = 0.9  # as in sfm/src/plausibility/mod.rs
PRIOR_ODDS = 5.0  # right models for each that is not; Source: docs/decisions/20
LEAST_TIE = 0.02  # as in sfm/src/plausibility/graph.rs
POOR_DEG = 2.0  # median error of relative rotations from which a model that is not wrong is poor

# Column, scale (as in probability.rs), and the sign of the coefficient.
FEATURES = [
    ("camera-surprise", "Cauchy", -1),
    ("least-explained", "Odds", 1),
    ("point-angle", "Log", 1),
    ("held-out-agreement", "Odds", 1),
    ("second-difference", "Log", -1),
]
SECOND = ("second-difference",)
LAWS = ("single-axis", "torque-free")  # motions of a dozen numbers, or of one a photo
SCALES = {
    "Cauchy": lambda v: math.log(1 + v * v),
    "Odds": lambda v: math.log((v + 0.02) / (1.02 - v)),
    "Log": lambda v: math.log(v + 0.05),
}


def number(text):
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan


def label(row):
    """right, poor, or wrong; none where there is no model."""
    if row["model"] == "right" and number(row["pairs_median_deg"]) > POOR_DEG:
        return "poor"
    return row["model"]


def read(path):
    with open(path) as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if row["motion"] in LAWS:
            row.update(dict.fromkeys(SECOND, "0"))
    tied = [r for r in rows if not number(r.get("weakest-link")) < LEAST_TIE]
    return [r for r in tied if label(r) != "none" and r.get("agreeing-pairs")]


def matrix(rows):
    """[n, features] on their scales; no number where it is unknown."""
    return np.array([[SCALES[scale](v) if not math.isnan(v := number(r.get(c))) else math.nan for c, scale, _ in FEATURES] for r in rows])


def fit(Z, right, ridge):
    """Coefficients [features + 1] of least penalised cost, the constant last."""
    X = np.column_stack([Z, np.ones(len(Z))])
    weight = np.where(right, 0.5 / max(right.sum(), 1), 0.5 / max((~right).sum(), 1)) * len(right)
    sign = np.where(right, 1.0, -1.0)

    def cost(w):
        margin = sign * (X @ w)
        value = (weight * np.logaddexp(0, -margin)).sum() + 0.5 * ridge * (w[:-1] ** 2).sum()
        gradient = X.T @ (-weight * sign / (1 + np.exp(np.clip(margin, -500, 500))))
        gradient[:-1] += ridge * w[:-1]
        return value, gradient

    bounds = [(0, None) if s > 0 else (None, 0) for _, _, s in FEATURES] + [(None, None)]
    return minimize(cost, np.zeros(X.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x


def probability(Z, w):
    return 1 / (1 + np.exp(-(Z @ w[:-1] + w[-1])))


def standardised_fit(X, training, right, ridge):
    """(coefficients, usual values, spreads, probabilities)."""
    middle, spread = np.nanmean(X[training], axis=0), np.maximum(np.nanstd(X[training], axis=0), 1e-9)
    Z = np.nan_to_num((X - middle) / spread)
    w = fit(Z[training], right[training], ridge)
    w[-1] += math.log(PRIOR_ODDS)
    return w, middle, spread, probability(Z, w)


def report(half, rows, labels, p):
    """How a half comes out."""
    print(f"half {half}")
    for kind in ("right", "poor", "wrong"):
        of_kind = labels == kind
        print(f"  {kind:6} {of_kind.sum():3} models, {(of_kind & (p < DOUBTFUL)).sum():3} of them called doubtful")
    for row, kind, q in sorted(zip(rows, labels, p), key=lambda x: x[2]):
        mark = "  <<<" if (kind == "right") != (q >= DOUBTFUL) and kind != "poor" else ""
        print(f"    {row['capture']:34} {kind:6} {q:.3f}{mark}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table")
    parser.add_argument("--ridge", type=float, default=0.1)
    args = parser.parse_args()
    rows = read(args.table)
    half, labels = np.array([r["half"] for r in rows]), np.array([label(r) for r in rows])
    X = matrix(rows)
    w, middle, spread, p = standardised_fit(X, half == "A", labels == "right", args.ridge)
    for (column, scale, _), weight, centre, width in zip(FEATURES, w, middle, spread):
        print(f"{column:20} {scale:6} weight {weight / width:8.3f} usual {centre:7.3f}   {weight:6.2f} a standard deviation")
    print(f"constant {w[-1]:.3f}")
    for name in "AB":
        of = half == name
        report(name, [r for r, h in zip(rows, half) if h == name], labels[of], p[of])
    return 0


if __name__ == "__main__":
    sys.exit(main())
