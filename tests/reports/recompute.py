"""Computes the statistics of a committed report again, with SciPy, from the report's own CSV.

    python recompute.py FOLDER

Every signed-rank p-value (by all sign patterns, which is exact with ties), Holm's correction, every bootstrap interval (BCa,
to the accuracy of its resamples) and every Wilson interval that the report prints. Says what differs and ends with 1.
"""

import csv
import itertools
import re
import sys
from pathlib import Path

import numpy
from scipy import stats

# Beyond this many differences all sign patterns are too many, and SciPy's own exact test has no ties to fear or is told so.
PATTERNS_MAX = 18
# Half a unit of the last digit that the report prints, of percent.
PRINTED = 0.0501
# Of the width of an interval: two runs of 10,000 resamples differ by chance.
RESAMPLES_SLACK = 0.06
# Where few differences are not zero, the resamples lie on few points with gaps between them, and an end falls on either side of
# a gap by chance, however wide it is. Ends further apart than the slack are the same where no more of the resamples lie
# between them than so many standard errors of the shares that two such runs have there.
ERRORS_MAX = 4.0
OUR_RESAMPLES, RESAMPLES = 10_000, 20_000

COUNTED = re.compile(r"(\d+)/(\d+) = ([\d.]+) % \[([\d.]+), ([\d.]+)\]")


def signed_rank(differences):
    """Two-sided exact p-value: the share of sign patterns at least as far out, and the number of non-zero differences."""
    nonzero = numpy.array([d for d in differences if d != 0.0])
    if len(nonzero) == 0:
        return None, 0
    ranks = stats.rankdata(numpy.abs(nonzero))
    plus = ranks[nonzero > 0].sum()
    if len(nonzero) <= PATTERNS_MAX:
        sums = numpy.array([numpy.dot(signs, ranks) for signs in itertools.product((0, 1), repeat=len(ranks))])
        low, high = (sums <= plus + 1e-9).mean(), (sums >= plus - 1e-9).mean()
        return min(1.0, 2 * min(low, high)), len(nonzero)
    return stats.wilcoxon(nonzero, method="exact").pvalue, len(nonzero)


def holm(p_values):
    order = numpy.argsort(p_values)
    adjusted, least = [0.0] * len(p_values), 0.0
    for place, index in enumerate(order):
        least = max(least, min(1.0, (len(p_values) - place) * p_values[index]))
        adjusted[index] = least
    return adjusted


def gap(draws, ours, theirs):
    """How far two ends are apart, if hardly a resample lies between them; else nothing."""
    low, high = sorted((ours, theirs))
    between = ((draws > low + 1e-9) & (draws < high - 1e-9)).mean()
    share = (draws <= theirs).mean()
    error = numpy.sqrt(share * (1 - share) * (1 / OUR_RESAMPLES + 1 / RESAMPLES))
    return high - low if between <= ERRORS_MAX * error else None


def main():
    folder = Path(sys.argv[1])
    checked, wrong = 0, []

    def same(what, ours, theirs, within):
        nonlocal checked
        checked += 1
        if not abs(ours - theirs) <= within:
            wrong.append(f"{what}: the report has {ours}, SciPy {theirs}")

    tests = folder / "tests.csv"
    if tests.exists():
        rows = list(csv.DictReader(tests.open()))
        p_values = []
        for row in rows:
            differences = [float(value) for value in row["differences"].split(";")]
            same(f"{row['comparison']}, mean", float(row["mean"]), numpy.mean(differences), 1e-9)
            p, n = signed_rank(differences)
            same(f"{row['comparison']}, n", int(row["n"]), n, 0)
            p_values.append(1.0 if p is None else p)
            if p is not None:
                same(f"{row['comparison']}, p", float(row["p"]), p, 1e-9)
            if row["lower"]:
                run = stats.bootstrap(
                    (numpy.array(differences),), numpy.mean, n_resamples=RESAMPLES, method="BCa",
                    random_state=numpy.random.default_rng(1),
                )
                found, draws = run.confidence_interval, run.bootstrap_distribution
                slack = RESAMPLES_SLACK * (found.high - found.low)
                for end, ours, theirs in (("lower", row["lower"], found.low), ("upper", row["upper"], found.high)):
                    within = gap(draws, float(ours), theirs) or slack
                    same(f"{row['comparison']}, {end} end", float(ours), theirs, within)
        for row, p_holm in zip(rows, holm(p_values)):
            same(f"{row['comparison']}, p after Holm", float(row["p_holm"]), p_holm, 1e-9)
    for count, total, share, low, high in COUNTED.findall((folder / "report.md").read_text()):
        interval = stats.binomtest(int(count), int(total)).proportion_ci(method="wilson")
        what = f"{count}/{total}"
        same(f"{what}, share", float(share), 100 * int(count) / int(total), PRINTED)
        same(f"{what}, lower end", float(low), 100 * interval.low, PRINTED)
        same(f"{what}, upper end", float(high), 100 * interval.high, PRINTED)
    for line in wrong:
        print(line)
    print(f"{checked} numbers computed again, {len(wrong)} differ")
    return 1 if wrong or checked == 0 else 0


if __name__ == "__main__":
    sys.exit(main())
