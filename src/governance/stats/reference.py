#!/usr/bin/env python3
"""Checks every row of reference.json against SciPy, and writes the rows that this file makes.

    python3 -m venv venv && venv/bin/pip install scipy==1.17.1
    venv/bin/python src/stats/reference.py            # check only
    venv/bin/python src/stats/reference.py --write    # renew the sections made here

Sections made here: runs_possible and pairs_possible (confidence sets by full enumeration of the hypergeometric
and the multivariate hypergeometric likelihood), and the rows of signed_rank and bootstrap that are in MADE_*.
The other rows were made with the calls that "source" names; here they are computed again and compared.
"""

import json
import math
import pathlib
import sys

import numpy as np
from scipy import stats

FILE = pathlib.Path(__file__).with_name("reference.json")


def rows_of(rng):
    """Differences with zeros and ties: exact by enumeration of signs, or the normal approximation."""
    made = []
    for size, zeros, step in [(14, 3, 0.5), (16, 0, 1.0), (12, 2, 0.25), (90, 10, 0.2), (200, 0, 0.5)]:
        values = np.round(rng.normal(0.2, 1.0, size) / step) * step
        values[values == 0.0] = step
        made.append([float(v) for v in np.concatenate([values, np.zeros(zeros)])])
    return made


def signed_rank(differences):
    """The row of one list: exact over all signs up to 20 non-zero pairs, SciPy's own methods otherwise."""
    nonzero = np.array([d for d in differences if d != 0.0])
    n = len(nonzero)
    ranks = stats.rankdata(np.abs(nonzero))
    plus, total = float(ranks[nonzero > 0].sum()), float(ranks.sum())
    row = {"differences": differences, "w": min(plus, total - plus)}
    tied = len(set(np.abs(nonzero))) < n or n < len(differences)
    if n > 60 or not tied:
        method = "approx" if n > 60 else "exact"
        for key in ("two-sided", "greater", "less"):
            found = stats.wilcoxon(nonzero, alternative=key, method=method, correction=False)
            row[key.replace("-", "_")] = float(found.pvalue)
        return row | {"method": method}
    assert n <= 20, "full enumeration only"
    signs = (np.arange(2**n)[:, None] >> np.arange(n)) & 1
    sums = signs @ ranks
    less, greater = float(np.mean(sums <= plus + 1e-9)), float(np.mean(sums >= plus - 1e-9))
    return row | {"two_sided": min(1.0, 2 * min(less, greater)), "greater": greater, "less": less, "method": "permutation"}


def runs_possible(size, passed, seen, alpha):
    """The smallest and the largest number of passes whose likelihood is above alpha / (seen + 1)."""
    totals = np.arange(size + 1)
    keep = totals[stats.hypergeom.pmf(passed, size, totals, seen) > alpha / (seen + 1)]
    return {"size": size, "passed": passed, "seen": seen, "alpha": alpha, "least": int(keep[0]), "most": int(keep[-1])}


def pairs_possible(size, seen, worse, better, alpha):
    """The least net count and the most discordance above 2 alpha / ((seen + 1)(seen + 2))."""
    bar = math.log(2 * alpha / ((seen + 1) * (seen + 2)))
    counts = [worse, better, seen - worse - better]
    kept = [
        (w, b)
        for b in range(better, size - seen + better + 1)
        for w in range(worse, size - b - counts[2] + 1)
        if stats.multivariate_hypergeom.logpmf(counts, [w, b, size - w - b], seen) > bar
    ]
    return {
        "size": size, "seen": seen, "worse": worse, "better": better, "alpha": alpha,
        "least_net": min(w - b for w, b in kept), "most_discordant": max(w + b for w, b in kept),
    }


def bootstrap(values, method):
    found = stats.bootstrap(
        (values,), np.mean, confidence_level=0.95, method=method, n_resamples=100_000, rng=np.random.default_rng(1)
    ).confidence_interval
    return {"values": values, "method": method, "level": 0.95, "lower": float(found.low), "upper": float(found.high)}


def check(reference):
    """Every row again; stops at the first that differs."""
    close = lambda a, b, what: math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12) or sys.exit(f"{what}: {a} is not {b}")
    for row in reference["proportions"]:
        test = stats.binomtest(row["k"], row["n"])
        for name, method in (("wilson", "wilson"), ("exact", "exact")):
            found = test.proportion_ci(row["level"], method)
            close(found.low, row[name][0], row), close(found.high, row[name][1], row)
    for row in reference["normal"]:
        close(stats.norm.ppf(row["p"]), row["z"], row)
    for row in reference["student"]:
        close(stats.t.ppf(row["p"], row["df"]), row["t"], row)
    for row in reference["student_pairs"]:
        d = np.array(row["differences"])
        ends = stats.t.interval(1 - 2 * row["alpha"], len(d) - 1, d.mean(), d.std(ddof=1) / math.sqrt(len(d)))
        close(ends[0], row["lower"], row), close(ends[1], row["upper"], row)
    for row in reference["signed_rank"]:
        nonzero = [d for d in row["differences"] if d != 0.0]
        if len(nonzero) <= 20 or row["method"] != "permutation":
            for key, value in signed_rank(row["differences"]).items():
                if key in ("w", "two_sided", "greater", "less"):
                    close(value, row[key], row)
    for row in reference["bootstrap"]:
        found = bootstrap(row["values"], row["method"])
        for end in ("lower", "upper"):
            assert abs(found[end] - row[end]) < 0.02 * max(1.0, abs(row[end])), (found, row)


def main():
    reference = json.loads(FILE.read_text())
    if "--write" in sys.argv:
        rng = np.random.default_rng(20260821)
        known = [row["differences"] for row in reference["signed_rank"]]
        reference["signed_rank"] += [signed_rank(d) for d in rows_of(rng) if d not in known]
        counts = [float(v) for v in rng.poisson(2.0, 40)]
        if all(row["values"] != counts for row in reference["bootstrap"]):
            reference["bootstrap"].append(bootstrap(counts, "BCa"))
        reference["runs_possible"] = [
            runs_possible(*case)
            for case in [(40, 0, 0, 0.01), (40, 5, 12, 0.0025), (40, 12, 12, 0.0025), (150, 60, 80, 0.05), (300, 299, 300, 0.01)]
        ]
        reference["pairs_possible"] = [
            pairs_possible(*case)
            for case in [(60, 20, 6, 1, 0.05), (120, 40, 20, 0, 0.0025), (120, 60, 9, 9, 0.0025), (120, 100, 30, 2, 0.01)]
        ]
        lines = []
        for name, value in reference.items():
            if isinstance(value, list):
                body = ",\n  ".join(json.dumps(row) for row in value)
                lines.append(f'"{name}": [\n  {body}\n]')
            else:
                lines.append(f'"{name}": {json.dumps(value)}')
        FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    check(reference)
    print(f"SciPy {stats.__dict__.get('__version__') or __import__('scipy').__version__}: every row agrees")


if __name__ == "__main__":
    main()
