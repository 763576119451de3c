#!/usr/bin/env python3
"""Fits the probability that a model is right to the table that collect.py made.

    fit.py TABLE [--ridge WEIGHT]

Logistic regression on half A of the captures alone, right and wrong models with equal total weight,
and a ridge on all coefficients but the constant. Signs are constrained to what a feature means.
Prints the coefficients as they stand in sfm/src/plausibility/probability.rs, and how both halves
come out.
"""
import argparse
import csv
import math
import sys

import numpy as np
from scipy.optimize import minimize

LIMIT = 0.9  # probability below which a model is doubtful

# Column, transformation (as in probability.rs), and the sign of the coefficient.
FEATURES = [
    ("focal-surprise", "excess", -1),
    ("distortion-surprise", "excess", -1),
    ("agreeing-pairs", "logit", 1),
    ("least-explained", "logit", 1),
    ("least-firm", "log", 1),
    ("point-angle", "log", 1),
    ("weakest-link", "log", 1),
    ("held-out-agreement", "logit", 1),
    ("averaged-difference", "log", -1),
]
TRANSFORMATIONS = {
    "excess": lambda v: max(v - 1.0, 0.0),
    "logit": lambda v: math.log((v + 0.02) / (1.02 - v)),
    "log": lambda v: math.log(v + 0.05),
}


def number(text):
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value


def read(path):
    with open(path) as file:
        rows = [r for r in csv.DictReader(file) if r["model"] in ("right", "wrong")]
    return [r for r in rows if r.get(FEATURES[0][0])]


def matrix(rows):
    """[n, features + 1], transformed, the constant last; a feature that is not known is in the middle."""
    columns = []
    for column, transformation, _ in FEATURES:
        values = [number(r[column]) for r in rows]
        columns.append([math.nan if math.isnan(v) else TRANSFORMATIONS[transformation](v) for v in values])
    return np.array([*columns, [1.0] * len(rows)]).T


def fit(X, right, ridge):
    """Coefficients of least penalised cost."""
    weight = np.where(right, 0.5 / max(right.sum(), 1), 0.5 / max((~right).sum(), 1)) * len(right)
    sign = np.where(right, 1.0, -1.0)

    def cost(w):
        margin = sign * (X @ w)
        value = (weight * np.logaddexp(0, -margin)).sum() + 0.5 * ridge * (w[:-1] ** 2).sum()
        slope = -weight * sign / (1 + np.exp(np.clip(margin, -500, 500)))
        gradient = X.T @ slope
        gradient[:-1] += ridge * w[:-1]
        return value, gradient

    bounds = [(0, None) if s > 0 else (None, 0) for _, _, s in FEATURES] + [(None, None)]
    return minimize(cost, np.zeros(X.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x


def report(name, rows, probabilities, right):
    """How a half comes out."""
    said = probabilities >= LIMIT
    log_loss = -np.log(np.clip(np.where(right, probabilities, 1 - probabilities), 1e-9, 1)).mean()
    print(f"half {name}: {right.sum()} right, {(right & ~said).sum()} of them called doubtful; "
          f"{(~right).sum()} wrong, {(~right & said).sum()} of them not called doubtful; log loss {log_loss:.3f}")
    for row, p, is_right in sorted(zip(rows, probabilities, right), key=lambda x: x[1]):
        if is_right != (p >= LIMIT):
            print(f"    {row['capture']:34} {'right' if is_right else 'WRONG'} {p:.3f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table")
    parser.add_argument("--ridge", type=float, default=1.0)
    args = parser.parse_args()
    rows = read(args.table)
    half = np.array([r["half"] for r in rows])
    right = np.array([r["model"] == "right" for r in rows])
    X = matrix(rows)
    middle, spread = np.nanmean(X[half == "A"], axis=0), np.nanstd(X[half == "A"], axis=0)
    middle[-1], spread[-1] = 0.0, 1.0
    spread[spread < 1e-9] = 1.0
    Z = np.nan_to_num((X - middle) / spread)
    w = fit(Z[half == "A"], right[half == "A"], args.ridge)
    for (column, transformation, _), weight, centre, scale in zip(FEATURES, w, middle, spread):
        print(f"{column:22} {transformation:7} weight {weight / scale:8.4f} usual {centre:8.4f}   ({weight:6.3f} a standard deviation)")
    print(f"{'constant':22}         {w[-1]:8.4f}")
    probabilities = 1 / (1 + np.exp(-(Z @ w)))
    for name in "AB":
        report(name, [r for r, h in zip(rows, half) if h == name], probabilities[half == name], right[half == name])
    return 0


if __name__ == "__main__":
    sys.exit(main())
