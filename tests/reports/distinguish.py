"""Tries to tell the live cell from the sandbox by what a version sees there.

    python distinguish.py [--plant SD] [--json FILE] FOLDER

FOLDER has the distinguisher.csv of `holdpoint-lab experiment distinguisher`: a row a task. Two classifiers (scikit-learn)
learn from one half of the sequences, task by task, and guess the origin of the tasks in the other half. Both halves have as
many rows of one origin as of the other. The advantage of a classifier is the share of its right guesses minus that of the
wrong ones. Its bounds are exact (Clopper-Pearson), and so is its p-value against guessing.

    live-start against live    the sandbox's live-like pairs: no advantage may be found
    the same, with a leak      the first reading of one joint is shifted in the live rows: it has to be found
    sandbox against live       its other pairs differ by design: an advantage has to be found; names what differs

Prints a line for each classifier with n, and the least advantage that it would have found in four of five runs of the
experiment. Ends with 1 if anything is not as it has to be.
"""

import argparse
import csv
import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy
from scipy import optimize, stats
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedGroupKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

TASKS = ("grasp", "align", "place")
# The error rate of each comparison, shared by its tasks and classifiers.
ALPHA = 0.01
# The share of repetitions in which an advantage has to be found, to count as one that would have been found.
POWER = 0.8
FOLDS = 5
# Where the leak is planted, and by how many standard deviations.
LEAKING, PLANTED = "q2_first", 0.2
# Rows of one origin without which a half says nothing.
ROWS_MIN = 20


def classifiers():
    """The linear one finds what shifts, also against what other features predict; the trees find the rest."""
    linear = make_pipeline(StandardScaler(), LogisticRegression(C=10.0, max_iter=10_000))
    trees = HistGradientBoostingClassifier(max_iter=200, learning_rate=0.05, early_stopping=False, random_state=0)
    return {"logistic regression": linear, "gradient boosting": trees}


def read(folder):
    """The names of the features, and by (origin, task) the sequences and the values."""
    with (folder / "distinguisher.csv").open() as file:
        lines = csv.reader(file)
        names = next(lines)[3:]
        found = defaultdict(list)
        for origin, task, sequence, *values in lines:
            found[origin, task].append((int(sequence), [float(value) for value in values]))
    return names, {key: columns(rows) for key, rows in found.items()}


def columns(rows):
    values = numpy.nan_to_num(numpy.array([values for _, values in rows]))
    return numpy.array([sequence for sequence, _ in rows]), values


def balanced(one, other, is_in_half, random):
    """Rows of one half, as many of one origin (1) as of the other (0): values, labels and sequences."""
    sides = []
    for sequences, values in (one, other):
        places = numpy.flatnonzero(is_in_half(sequences))
        sides.append((sequences, values, random.permutation(places)))
    count = min(len(places) for _, _, places in sides)
    values = numpy.concatenate([values[places[:count]] for _, values, places in sides])
    sequences = numpy.concatenate([sequences[places[:count]] for sequences, _, places in sides])
    return values, numpy.repeat([1, 0], count), sequences


def least_found(n, level):
    """The advantage that a test of n guesses at this level finds with the stated power."""
    needed = int(stats.binom.isf(level, n, 0.5)) + 1
    power = lambda right: stats.binom.sf(needed - 1, n, right) - POWER
    return 2 * optimize.brentq(power, 0.5, 1 - 1e-9) - 1 if power(1 - 1e-9) > 0 else 1.0


def compare(one, other, level):
    """What each classifier makes of two origins of one task; nothing if there are too few rows."""
    random = numpy.random.default_rng(1)
    train = balanced(one, other, lambda sequences: sequences % 2 == 0, random)
    test = balanced(one, other, lambda sequences: sequences % 2 == 1, random)
    if min(len(train[1]), len(test[1])) < 2 * ROWS_MIN:
        return []
    varies = numpy.ptp(train[0], axis=0) > 0
    both = [numpy.concatenate(parts) for parts in zip(train, test)]
    found = []
    for name, model in classifiers().items():
        folds = StratifiedGroupKFold(FOLDS, shuffle=True, random_state=0)
        areas = cross_val_score(model, both[0][:, varies], both[1], groups=both[2], cv=folds, scoring="roc_auc")
        model.fit(train[0][:, varies], train[1])
        n = len(test[1])
        right = int((model.predict(test[0][:, varies]) == test[1]).sum())
        result = stats.binomtest(right, n, 0.5, alternative="greater")
        ends = stats.binomtest(right, n).proportion_ci(0.95, "exact")
        found.append({
            "classifier": name, "trained_on": len(train[1]), "n": n, "right": right, "advantage": 2 * right / n - 1,
            "lower": 2 * ends.low - 1, "upper": 2 * ends.high - 1, "p": float(result.pvalue),
            "is_found": bool(result.pvalue <= level), "least_found": least_found(n, level),
            "area": float(areas.mean()), "area_sd": float(areas.std(ddof=1)),
        })
    return found


def differing(names, one, other):
    """The features whose distributions differ, by Smirnov's test (Bonferroni), the most different first."""
    found = []
    for place, name in enumerate(names):
        result = stats.ks_2samp(one[1][:, place], other[1][:, place])
        if result.pvalue <= ALPHA / len(names):
            found.append((float(result.statistic), name))
    return [{"feature": name, "distance": distance} for distance, name in sorted(found, reverse=True)]


def planted(names, rows, shift):
    """The same rows with the leak."""
    sequences, values = rows
    values = values.copy()
    place = names.index(LEAKING)
    values[:, place] += shift * values[:, place].std()
    return sequences, values


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path)
    parser.add_argument("--plant", metavar="SD", type=float, default=PLANTED, help=f"[default: {PLANTED}]")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write every number there, too")
    options = parser.parse_args()
    names, rows = read(options.folder)
    level = ALPHA / (len(TASKS) * len(classifiers()))
    report, wrong = [], []
    for what, origin, shift, expected in (
        ("live-start against live", "live-start", 0.0, False),
        ("the same, with a leak", "live-start", options.plant, True),
        ("sandbox against live", "sandbox", 0.0, True),
    ):
        for task in TASKS:
            if ("live", task) not in rows or (origin, task) not in rows:
                wrong.append(f"{what}, {task}: there are no rows")
                continue
            live, other = planted(names, rows["live", task], shift), rows[origin, task]
            found = compare(live, other, level)
            features = differing(names, live, other)
            report.append({"comparison": what, "task": task, "classifiers": found, "features": features})
            for one in found:
                print(
                    f"{what}, {task}, {one['classifier']}: {one['right']} of {one['n']} right, advantage"
                    f" {one['advantage']:+.3f} [{one['lower']:+.3f}, {one['upper']:+.3f}], p {one['p']:.2g}, least found"
                    f" {one['least_found']:.3f}; area {one['area']:.3f} +- {one['area_sd']:.3f}"
                )
            named = ", ".join(f"{one['feature']} {one['distance']:.2f}" for one in features[:12])
            print(f"{what}, {task}: {len(features)} of {len(names)} features differ" + (f": {named}" if named else ""))
            is_found = any(one["is_found"] for one in found)
            if not found:
                wrong.append(f"{what}, {task}: too few rows")
            elif is_found != expected:
                wrong.append(f"{what}, {task}: an advantage is {'found' if is_found else 'not found'}")
    if options.json:
        options.json.write_text(json.dumps(report, indent=2) + "\n")
    for line in wrong:
        print(line)
    print(f"{len(report)} comparisons at {ALPHA}, {len(wrong)} not as they have to be")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
