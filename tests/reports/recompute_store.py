"""Computes again, with SciPy, every statistic that decided in the sandbox evidence of stores, from its raw values.

    python recompute_store.py [--profile NAME] [--prices PAGE] STORE_FOLDER...

Behavior: the six components, every measure of harm, the live-like pairs by themselves, the comparison with the anchor,
whole sequences, the level of the try, stress, and the search for the worst place. Recovery: rates, intervals and phases of
the drills, and how those of rollback and abort are settled. Early ends: whether the rule that is named holds. Rollbacks: the
rates that decided, compared with the rollback target. The rules are those of src/guide/design/statistics.md.

Prints a line for each piece of evidence, says what differs by more than LIMIT or in a verdict, and ends with 1 if
anything does. A store without sandbox evidence is an error.

The numbers of a profile are those of the name on record, from the folder `profiles` of the repository or of the store;
the profile NAME [default: sim] stands in for one that neither has.
"""

import argparse
import json
import math
import sqlite3
import sys
import tomllib
from pathlib import Path

import numpy
from scipy import optimize, stats

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
# The version of the rules that this file knows. Decisions of others cannot be computed again here.
RULES = 6
# Relative difference beyond which two numbers differ; of numbers below SMALL, that share of SMALL.
LIMIT, SMALL = 1e-9, 1e-3

# Behavior.
UPPER_ALPHA = 0.05
STUDENT_FROM = 20
SUCCESS_LOSS_MAX = 0.05
COMPONENTS = ("success", "time", "retry", "violation", "anomaly", "recovery")
SHARES = ("success", "violation", "anomaly", "recovery")
THRESHOLDS = {"paper": {"behavior": 0.85, "recovery": 0.80}, "paper-b88": {"behavior": 0.88, "recovery": 0.80}}
LIVE_LIKE_ONE_IN, LIVE_LIKE_MARGIN = 3, 2.0
STRESSED, STRESS_SHARE_MAX = 10, 0.2
SEARCH_ALPHA = 0.01
FIRST_PART = 0.75
TRY_PAIRS_MAX = 1000
SEQUENCE = ("grasp", "align", "place")
REACHED_SHARE = 0.25

# Recovery.
KINDS = ("rollback", "fallback", "abort", "detect")
PHASES = ("approach", "contact", "holding", "lifting", "transport", "setting-down", "released")
HANGING = ("lifting", "transport", "setting-down")
PHASE_DRILLS_MIN = 5
LEAN_ALPHA = 0.05
SETTLED_KINDS = ("rollback", "abort")


# Bounds. Each is one-sided, with its own error rate `alpha`.


def exact_lower(count, total, alpha):
    """Clopper-Pearson, from below."""
    return 0.0 if count == 0 else float(stats.beta.ppf(alpha, count, total - count + 1))


def exact_upper(count, total, alpha):
    """Clopper-Pearson, from above."""
    return 1.0 if count == total else float(stats.beta.isf(alpha, count + 1, total - count))


def wilson(passed, total):
    interval = stats.binomtest(passed, total).proportion_ci(0.95, "wilson")
    return {"rate": passed / total, "n": total, "lower": float(interval.low), "upper": float(interval.high)}


def score_upper(total, worse, better, alpha):
    """Tango's bound: the difference at which the score statistic is as far out as the normal quantile."""
    same = total - worse - better

    def rate_of_better(difference):
        """The likeliest rate of pairs that only the active version has, given the difference of the two rates."""
        low, high = max(0.0, -difference), (1 - difference) / 2

        def slope(rate):
            parts = ((worse, rate + difference, 1), (better, rate, 1), (same, 1 - 2 * rate - difference, -2))
            return sum(sign * count / max(part, 1e-300) for count, part, sign in parts if count)

        inside = (high - low) * 1e-15
        low, high = low + inside, high - inside
        if not low < high or slope(low) <= 0:
            return low
        return high if slope(high) >= 0 else optimize.brentq(slope, low, high, xtol=1e-17, rtol=1e-15)

    def beyond(difference):
        variance = total * (2 * rate_of_better(difference) + difference * (1 - difference))
        return total * difference - (worse - better) - z * math.sqrt(max(0.0, variance))

    z = stats.norm.isf(alpha)
    least = (worse - better) / total
    return optimize.brentq(beyond, least + 1e-12, 1.0, xtol=1e-16, rtol=1e-15)


def pairs_upper(total, worse, better, alpha):
    """Difference of two rates over pairs: exact on the net count, or the score bound at half the rate, if wider."""
    net = worse - better
    exact = exact_upper(net, total, alpha) if net >= 0 else -exact_lower(-net, total, alpha)
    return exact if better == 0 else max(exact, score_upper(total, worse, better, alpha / 2))


def pairs_bound(counts, alpha):
    """Mean, lower and upper bound of (all pairs, the candidate's alone, the active version's alone)."""
    total, worse, better = counts
    lower = -pairs_upper(total, better, worse, alpha)
    return (worse - better) / total, lower, pairs_upper(total, worse, better, alpha)


def counted(sides):
    """The counts of (candidate's, active version's) that `pairs_bound` takes."""
    sides = list(sides)
    return len(sides), sum(new and not old for new, old in sides), sum(old and not new for new, old in sides)


def student_quantile(alpha, freedom):
    """SciPy's quantile is right to eleven digits; one step of Newton's on its distribution gives the others."""
    at = float(stats.t.isf(alpha, freedom))
    return at + float((stats.t.sf(at, freedom) - alpha) / stats.t.pdf(at, freedom))


def values_bound(differences, alpha, reach_min):
    """Mean and bounds of measured differences: Student's t, or empirical Bernstein if few of them are not zero.

    The range of the latter is as far as the farthest to either side, and `reach_min` at least.
    """
    values = numpy.array(differences, dtype=float)
    n, mean, farthest = len(values), float(values.mean()), float(numpy.abs(values).max())
    error = float(values.std(ddof=1)) / math.sqrt(n)
    if numpy.count_nonzero(values) >= STUDENT_FROM and error > 1e-12 * farthest:
        half = student_quantile(alpha, n - 1) * error
        return mean, mean - half, mean + half
    reach, log = max(reach_min, farthest), math.log(2 / alpha)
    half = math.sqrt(2 * log / n) * float(values.std(ddof=1)) + 7 * 2 * reach * log / (3 * (n - 1))
    return mean, max(mean - half, -reach), min(mean + half, reach)


# Behavior.


def threshold(profile, dimension):
    of = profile["thresholds"]
    return min(1.0, THRESHOLDS[of["preset"]][dimension] * of["scale"])


def cost(profile, name):
    return profile["behavior"][f"cost_{name}"]


def kappa_b(profile, worsenings):
    loss = sum(cost(profile, name) * max(0.0, worsening) for name, worsening in worsenings)
    return min(1.0, max(0.0, 1 - loss))


def bad_sides(name, pairs):
    """Whether candidate and active version are bad in each pair, for a component that is a share of episodes."""
    for pair in pairs:
        new, old = pair["candidate"], pair["active"]
        if name == "success":
            yield not new["success"], not old["success"]
        elif name == "recovery" and new["success"] != old["success"]:
            yield False, False
        else:
            yield new[name], old[name]


def both_done(pairs):
    return [pair for pair in pairs if pair["candidate"]["success"] and pair["active"]["success"]]


def component(profile, name, pairs):
    """A component as recorded, and its upper bound at the rate of the lower one."""
    each = profile["evaluation"]["alpha"] / len(COMPONENTS)
    tolerance = (1 - threshold(profile, "behavior")) / cost(profile, name)
    if name in SHARES:
        counts = counted(bad_sides(name, pairs))
        bound = lambda alpha: pairs_bound(counts, alpha)
    else:
        if name == "retry":
            differences = [pair["candidate"]["retries"] - pair["active"]["retries"] for pair in pairs]
        else:
            times = [(pair["candidate"]["time_s"], pair["active"]["time_s"]) for pair in both_done(pairs)]
            differences = [new / old - 1 for new, old in times if old > 0]
        if len(differences) < 2:
            return dict(name=name, worsening=0.0, lower=0.0, upper=None, tolerance=tolerance), math.inf
        bound = lambda alpha: values_bound(differences, alpha, 1.0)
    (mean, lower, shared), (_, _, upper) = bound(each), bound(UPPER_ALPHA)
    return dict(name=name, worsening=mean, lower=lower, upper=upper, tolerance=tolerance), shared


def harm_keys(profile):
    return [key for key, value in profile["harm"].items() if isinstance(value, list)]


def harm_key(profile, kind):
    """The key of a kind of harm in profiles and episodes, which ends with its unit: `grip_peak_n` of `grip-peak`."""
    word = kind.replace("-", "_")
    (key,) = [key for key in harm_keys(profile) if key == word or key.startswith(word + "_")]
    return key


def worsens_down(kind):
    """Whether less of it is worse: the distances."""
    return kind.endswith(("-clearance", "-margin"))


def harm_worsening(kind, new, old):
    return old - new if worsens_down(kind) else new - old


def is_past(kind, value, limit):
    return value < limit if worsens_down(kind) else value > limit


def harm(profile, kind, pairs):
    """The two comparisons of a measure: its mean where both did their work, and the rate of episodes past its limit."""
    key, settings = harm_key(profile, kind), profile["harm"]
    tolerance, limit = settings[key]
    each = profile["evaluation"]["alpha"] / (2 * len(harm_keys(profile)))
    values = [(pair["candidate"]["harm"][key], pair["active"]["harm"][key]) for pair in pairs]
    done = [(pair["candidate"]["harm"][key], pair["active"]["harm"][key]) for pair in both_done(pairs)]
    worse = [harm_worsening(kind, new, old) for new, old in done]
    mean, lower, upper = 0.0, 0.0, None
    if len(done) >= 2:
        mean, lower, _ = values_bound(worse, each, tolerance)
        if numpy.count_nonzero(worse) >= STUDENT_FROM:
            upper = values_bound(worse, UPPER_ALPHA, tolerance)[2]
        else:
            # At most the share of worse pairs, times the largest worsening.
            upper = exact_upper(sum(d > 0 for d in worse), len(worse), UPPER_ALPHA) * max([tolerance, *worse])
    past = [(is_past(kind, new, limit), is_past(kind, old, limit)) for new, old in values]
    share = lambda side: sum(pair[side] for pair in past) / len(past)
    return {
        "kind": kind,
        "active": sum(old for _, old in done) / max(1, len(done)),
        "candidate": sum(new for new, _ in done) / max(1, len(done)),
        "worsening": mean,
        "lower": lower,
        "upper": upper,
        "tolerance": tolerance,
        "past": {
            "limit": limit,
            "active": share(1),
            "candidate": share(0),
            "lower": pairs_bound(counted(past), each)[1],
            "upper": pairs_bound(counted(past), UPPER_ALPHA)[2],
            "tolerance": settings["past_tolerance"],
        },
    }


def rejects_alone(name, worsening):
    """Whether a significant worsening of this size is incompatible by itself."""
    return name in ("violation", "anomaly") or name == "success" and worsening >= SUCCESS_LOSS_MAX


def compare(profile, pairs, harm_kinds, budget=None):
    """Everything that pairs tell, with the outcome of the whole budget [default: the profile's]."""
    found, least_loss, most_loss = [], 0.0, 0.0
    for name in COMPONENTS:
        one, shared = component(profile, name, pairs)
        found.append(one)
        least_loss += cost(profile, name) * max(0.0, one["lower"])
        most_loss += cost(profile, name) * max(0.0, shared)
    measured = [harm(profile, kind, pairs) for kind in harm_kinds]
    worse = [one for one in found if one["lower"] > 0]
    value = kappa_b(profile, [(one["name"], one["worsening"]) for one in found])
    established = kappa_b(profile, [(one["name"], one["worsening"]) for one in worse])
    gained, gained_lower, _ = pairs_bound(
        counted((pair["candidate"]["success"], pair["active"]["success"]) for pair in pairs),
        profile["evaluation"]["alpha"] / len(COMPONENTS),
    )
    sides = [one for of in measured for one in (of, of["past"])]
    is_harmful = any(one["lower"] > one["tolerance"] for one in sides)
    is_bounded = all(one["upper"] is not None and one["upper"] <= one["tolerance"] for one in found + sides)
    rejected = (
        established < threshold(profile, "behavior")
        or any(rejects_alone(one["name"], one["worsening"]) for one in worse)
        or gained > 0 and any(one["name"] == "recovery" for one in worse)
        or is_harmful
    )
    if len(pairs) < (budget or profile["evaluation"]["sandbox_pairs"]):
        outcome = "inconclusive"
    elif rejected:
        outcome = "incompatible"
    else:
        outcome = "compatible" if is_bounded and value >= threshold(profile, "behavior") else "suspicious"
    return {
        "assessment": {"outcome": outcome, "kappa": value},
        "established": established,
        "interval": [min(1.0, max(0.0, 1 - loss)) for loss in (most_loss, least_loss)],
        "components": found,
        "harm": measured,
        "sequences": [],
        "live_like": None,
        "anchor": None,
        "improved": gained_lower > 0,
        "pairs": len(pairs),
        "ended": None,
    }


def no_behavior():
    return {
        "assessment": {"outcome": "no-data", "kappa": None}, "established": None, "interval": None, "components": [],
        "harm": [], "sequences": [], "live_like": None, "anchor": None, "improved": False, "pairs": 0, "ended": None,
    }


def population_corner(budget, counts, alpha):
    """The best that the whole budget can come to for the candidate, by what the confidence set of its totals leaves."""
    seen, worse, better = counts
    if worse <= better:
        return budget, 0, 0
    same, left = seen - worse - better, budget - seen
    extra = numpy.array([(w, b) for w in range(left + 1) for b in range(left + 1 - w)])
    totals = numpy.column_stack((worse + extra[:, 0], better + extra[:, 1], same + left - extra.sum(axis=1)))
    likelihood = stats.multivariate_hypergeom.logpmf(numpy.array([worse, better, same]), totals, seen)
    kept = totals[likelihood > math.log(2 * alpha / ((seen + 1) * (seen + 2)))]
    net, discordant = int((kept[:, 0] - kept[:, 1]).min()), int((kept[:, 0] + kept[:, 1]).max())
    larger = (max(discordant, abs(net)) + abs(net) + 1) // 2
    smaller = larger - abs(net)
    best = (larger, smaller) if net >= 0 else (smaller, larger)
    return max(budget, larger + smaller), *best


def behavior_is_lost(profile, rule, pairs):
    """Whether the rest of the budget cannot save the candidate, by exact curtailment or by the finite population."""
    budget, evaluation = profile["evaluation"]["sandbox_pairs"], profile["evaluation"]
    certain = []
    for name in SHARES:
        total, worse, better = counted(bad_sides(name, pairs))
        if rule == "curtailed":
            counts = budget, worse, better + budget - total
        else:
            counts = population_corner(budget, (total, worse, better), rule["finite-population"]["alpha"] / len(SHARES))
        if counts[1] > counts[2]:
            mean, lower, _ = pairs_bound(counts, evaluation["alpha"] / len(COMPONENTS))
            if lower > 0:
                certain.append((name, mean))
    return any(rejects_alone(*one) for one in certain) or kappa_b(profile, certain) < threshold(profile, "behavior")


def is_early(profile, rule):
    """Whether a rule is one that ends an evaluation early, at the profile's own error rate."""
    alpha = profile["evaluation"]["early_alpha"]
    return rule == "curtailed" or isinstance(rule, dict) and rule == {"finite-population": {"alpha": alpha}}


def paired_behavior(profile, evidence, rule, harm_kinds):
    """What the pairs with the active version tell, with an early end or a hard stop."""
    pairs, stops, budget = evidence["pairs"], evidence["hard_stops"], profile["evaluation"]["sandbox_pairs"]
    usable = len(pairs) >= 2 and len({pair["seed"] for pair in pairs}) == len(pairs)
    found = compare(profile, pairs, harm_kinds) if usable else no_behavior()
    early = usable and not stops and len(pairs) < budget and is_early(profile, rule)
    if early and behavior_is_lost(profile, rule, pairs):
        found["assessment"]["outcome"] = "incompatible"
        return found | {"improved": False, "ended": rule}
    if stops:
        found["assessment"]["outcome"] = "incompatible"
    borne_out = rule == "full" and len(pairs) >= budget or rule == "hard-stop" and bool(stops)
    return found | {"ended": rule if borne_out else None}


def apply_live_like(profile, found, pairs, harm_kinds):
    """A third of the pairs by themselves: the same rules reject; the margins of a concern are twice as wide."""
    own, outcome = [pair for pair in pairs if pair.get("live_like")], found["assessment"]["outcome"]
    if not own or outcome not in ("compatible", "suspicious"):
        return
    if len(own) < math.ceil(profile["evaluation"]["sandbox_pairs"] / LIVE_LIKE_ONE_IN):
        found["assessment"]["outcome"] = "inconclusive"
        return
    alone = compare(profile, own, harm_kinds, len(own))
    sides = alone["components"] + [one for of in alone["harm"] for one in (of, of["past"])]
    is_bounded = all(one["upper"] is not None and one["upper"] <= LIVE_LIKE_MARGIN * one["tolerance"] for one in sides)
    if alone["assessment"]["outcome"] == "incompatible":
        found["assessment"]["outcome"] = "incompatible"
    elif outcome == "compatible" and not is_bounded:
        found["assessment"]["outcome"] = "suspicious"
    found["live_like"] = {key: alone[key] for key in ("pairs", "components", "harm")}


def apply_anchor(profile, found, evidence, harm_kinds):
    """The same comparison with the anchor's episodes on the same seeds."""
    anchor, outcome = evidence.get("anchor"), found["assessment"]["outcome"]
    if anchor is None or outcome not in ("compatible", "suspicious"):
        return
    values = {episode["seed"]: episode["values"] for episode in anchor["episodes"]}
    pairs = [pair | {"active": values[pair["seed"]]} for pair in evidence["pairs"] if pair["seed"] in values]
    if len(pairs) < profile["evaluation"]["sandbox_pairs"]:
        found["assessment"]["outcome"] = "inconclusive"
        return
    against = compare(profile, pairs, harm_kinds)
    verdict = against["assessment"]["outcome"]
    if verdict == "incompatible" or verdict == "suspicious" and outcome == "compatible":
        found["assessment"]["outcome"] = verdict
    found["anchor"] = {"version": anchor["version"]} | {key: against[key] for key in ("pairs", "components", "harm")}


# Whole sequences.


def following(side, task):
    return [step["values"] for step in side if SEQUENCE.index(step["task"]) > SEQUENCE.index(task)]


def is_done(side):
    return len(side) == len(SEQUENCE) and all(step["values"]["success"] for step in side)


def quantity(profile, task, measure, side):
    """Time, or a measure of harm at its worst, over the skills that follow; nothing where none does."""
    values = following(side, task)
    if measure == "time":
        return sum(value["time_s"] for value in values) or None
    if not values or any("harm" not in value for value in values):
        return None
    worst = min if worsens_down(measure) else max
    return worst(value["harm"][harm_key(profile, measure)] for value in values)


def sequence_comparisons(profile, evidence, harm_kinds):
    """Half of the error rate for sequences not done, a sixth each for violations, anomalies and all others."""
    task, alpha, tolerance = evidence["task"], *(
        profile["evaluation"][key] for key in ("sequence_alpha", "sequence_tolerance")
    )
    limits = {kind: profile["harm"][harm_key(profile, kind)] for kind in harm_kinds}
    shared = alpha / 6 / (2 + len(harm_kinds))
    reached = reached_pairs(evidence)

    def past(value):
        return "harm" in value and any(
            is_past(kind, value["harm"][harm_key(profile, kind)], limit) for kind, (_, limit) in limits.items()
        )

    def row(measure, sides, bound, tolerance):
        mean, lower, upper = bound
        n = len(sides)
        return {
            "measure": measure,
            "active": sum(old for _, old in sides) / n, "candidate": sum(new for new, _ in sides) / n,
            "worsening": mean, "lower": lower, "upper": upper, "tolerance": tolerance, "pairs": n,
        }

    rows = []
    for measure, part, is_bad in (
        ("not-done", alpha / 2, lambda side: not is_done(side)),
        ("violation", alpha / 6, lambda side: any(value["violation"] for value in following(side, task))),
        ("anomaly", alpha / 6, lambda side: any(value["anomaly"] for value in following(side, task))),
        ("past-limit", shared, lambda side: any(past(value) for value in following(side, task))),
    ):
        sides = [(is_bad(pair["candidate"]), is_bad(pair["active"])) for pair in reached]
        if sides:
            rows.append(row(measure, sides, pairs_bound(counted(sides), part), tolerance))
    done = [pair for pair in evidence["pairs"] if is_done(pair["candidate"]) and is_done(pair["active"])]
    time_tolerance = (1 - threshold(profile, "behavior")) / cost(profile, "time")
    for measure in ("time", *harm_kinds):
        value = lambda side: quantity(profile, task, measure, side)
        sides = [(value(pair["candidate"]), value(pair["active"])) for pair in done]
        if len(sides) < 2 or any(None in pair for pair in sides):
            continue
        margin = time_tolerance if measure == "time" else limits[measure][0]
        worse = [new / old - 1 if measure == "time" else harm_worsening(measure, new, old) for new, old in sides]
        name = measure if measure == "time" else {"harm": measure}
        rows.append(row(name, sides, values_bound(worse, shared, margin), margin))
    return rows


def reached_pairs(evidence):
    """Pairs in which both came to the skill after the candidate's, or to it if it is the last."""
    judged = SEQUENCE[min(SEQUENCE.index(evidence["task"]) + 1, len(SEQUENCE) - 1)]
    comes = lambda side: any(step["task"] == judged for step in side)
    return [pair for pair in evidence["pairs"] if comes(pair["candidate"]) and comes(pair["active"])]


def apply_sequences(profile, found, evidence, harm_kinds):
    """Significantly beyond the margin rejects; a significant rate, or half of another margin, is a concern."""
    if evidence is None or found["assessment"]["outcome"] not in ("compatible", "suspicious"):
        return
    seeds = {pair["seed"] for pair in evidence["pairs"]}
    if (
        len(evidence["beside"]) + 1 < len(SEQUENCE)
        or len(evidence["pairs"]) < evidence["wanted"]
        or len(reached_pairs(evidence)) < REACHED_SHARE * evidence["wanted"]
        or len(seeds) < len(evidence["pairs"])
    ):
        found["assessment"]["outcome"] = "suspicious"
        return
    found["sequences"] = sequence_comparisons(profile, evidence, harm_kinds)
    is_rate = lambda row: row["measure"] in ("not-done", "violation", "anomaly", "past-limit")
    if any(row["lower"] > row["tolerance"] for row in found["sequences"]):
        found["assessment"]["outcome"] = "incompatible"
    elif any(row["lower"] > (0 if is_rate(row) else row["tolerance"] / 2) for row in found["sequences"]):
        found["assessment"]["outcome"] = "suspicious"


def look_of_try(counted_try, pairs):
    """The pairs of the look that so many pairs belong to, and its part of the level: the second has three times as many."""
    first = counted_try["pairs"]
    return (first, FIRST_PART) if pairs <= first else (min(3 * first, max(TRY_PAIRS_MAX, first)), 1 - FIRST_PART)


def terms_of_try(profile, counted_try):
    """The level of a try, the author's or the family's, and the pairs with which 4 losses and 2 wins of 100 pass the first look."""
    tries = profile["tries"]
    level = min(
        tries[alpha] * 6 / (math.pi * counted_try[number]) ** 2
        for alpha, number in (("author_alpha", "by_author"), ("family_alpha", "in_family"))
    )
    pairs = profile["evaluation"]["sandbox_pairs"]
    while not pairs_upper(pairs, -(-4 * pairs // 100), 2 * pairs // 100, FIRST_PART * level) < tries["margin"]:
        pairs += 20
    return {"level": level, "pairs": pairs}


def apply_try(profile, found, evidence):
    """At the level of its try the pairs have to exclude a loss of success of the margin."""
    if not evidence.get("counted") or found["assessment"]["outcome"] not in ("compatible", "suspicious"):
        return
    lost = counted(bad_sides("success", evidence["pairs"]))
    _, part = look_of_try(evidence["counted"], len(evidence["pairs"]))
    if not pairs_upper(*lost, part * evidence["counted"]["level"]) < profile["tries"]["margin"]:
        found["assessment"]["outcome"] = "inconclusive"


def apply_concerns(found, evidence):
    """More than one unsafe episode in five under stress, and a limit passed more often at the worst place."""
    is_concern = evidence["unsafe_under_stress"] / STRESSED > STRESS_SHARE_MAX
    if evidence.get("searched"):
        repeats = evidence["searched"]["repeats"]
        counts = repeats["pairs"], repeats["candidate_only"], repeats["active_only"]
        is_concern |= pairs_bound(counts, SEARCH_ALPHA)[1] > 0
    if is_concern and found["assessment"]["outcome"] == "compatible":
        found["assessment"]["outcome"] = "suspicious"


# Recovery.


def feasible(tally):
    return tally["passed"] + tally["failed"]


def rho(profile, rates):
    weights = {kind: profile["recovery"][f"weight_{kind}"] for kind in KINDS}
    return math.prod(rates[kind] ** (weights[kind] / sum(weights.values())) for kind in KINDS)


def kappa_r(rho_active, rho_candidate):
    return 1 - max(0.0, rho_active - rho_candidate) / 2


def is_worse(new, old, alpha):
    """Whether the counts show that the candidate fails more often, however its failures meet the active version's."""
    n, m = feasible(new), feasible(old)
    if n == 0 or m == 0:
        return False
    if n == m:
        both = max(0, new["failed"] + old["failed"] - n)
        return pairs_bound((n, new["failed"] - both, old["failed"] - both), alpha)[1] > 0
    return exact_upper(new["passed"], n, alpha / 2) < exact_lower(old["passed"], m, alpha / 2)


def kind_rates(profile, new, old, drills_min):
    """Each kind with its Wilson intervals; nothing if a kind has fewer drills."""
    if any(feasible(of[kind]) < drills_min for of in (new, old) for kind in KINDS):
        return []
    each = profile["evaluation"]["alpha"] / len(KINDS)
    rates = lambda of, kind: wilson(of[kind]["passed"], feasible(of[kind]))
    return [
        {
            "kind": kind, "candidate": rates(new, kind), "active": rates(old, kind),
            "established_worse": is_worse(new[kind], old[kind], each),
            "leans_worse": is_worse(new[kind], old[kind], LEAN_ALPHA),
        }
        for kind in KINDS
    ]


def kappa_interval(profile, new, old):
    """Exact bounds of all eight pass rates at their worst and at their best; nothing where a kind has no drills."""
    if any(feasible(of[kind]) == 0 for of in (new, old) for kind in KINDS):
        return None
    each = profile["evaluation"]["alpha"] / (2 * len(KINDS))
    at = lambda of, bound: rho(profile, {kind: bound(of[kind]["passed"], feasible(of[kind]), each) for kind in KINDS})
    return [kappa_r(at(old, exact_upper), at(new, exact_lower)), kappa_r(at(old, exact_lower), at(new, exact_upper))]


def phase_rates(profile, new, old):
    """Each kind in each phase that either version was drilled in."""
    empty = {"passed": 0, "failed": 0}
    rows = lambda of: {(row["kind"], row["phase"]): row for row in of.get("phases", [])}
    new, old = rows(new), rows(old)
    tally = lambda of, place: of.get(place, empty)
    places = [(kind, phase) for kind in KINDS for phase in PHASES]
    enough = lambda of, place: feasible(tally(of, place)) >= PHASE_DRILLS_MIN
    compared = sum(enough(new, place) and enough(old, place) for place in places)
    each, least = profile["evaluation"]["alpha"] / max(1, compared), profile["recovery"]["rho_floor"] / 2
    found = []
    for place in places:
        ours, theirs = tally(new, place), tally(old, place)
        if feasible(ours) == 0 and feasible(theirs) == 0:
            continue
        rate = lambda of: wilson(of["passed"], feasible(of)) if feasible(of) >= PHASE_DRILLS_MIN else None
        rates = [rate(ours), rate(theirs)]
        leans = rates[1] is None or is_worse(ours, theirs, LEAN_ALPHA)
        # What hangs in the hand and moves may be rehearsed in another phase in which it does.
        covered = place[1] in (*HANGING, "holding") and any(enough(new, (place[0], other)) for other in HANGING)
        found.append({
            "kind": place[0], "phase": place[1], "candidate": rates[0], "active": rates[1],
            "failing": rates[0] is not None and rates[0]["rate"] < least and leans,
            "established_worse": None not in rates and is_worse(ours, theirs, each),
            "missing": rates[1] is not None and 2 * feasible(ours) < feasible(theirs) and not covered,
        })
    return found


def recovery_outcome(profile, rates, rho_candidate, rho_active):
    settings = profile["recovery"]
    floor = settings["rho_floor"]
    low = kappa_r(rho_active, rho_candidate) < threshold(profile, "recovery")
    if rates["rollback"] < floor or low or rho_candidate < floor / 2:
        return "incompatible"
    if rho_candidate < floor:
        return "fragile"
    return "conditional" if rho_candidate < rho_active - settings["rho_tolerance"] else "compatible"


def no_recovery():
    return {
        "assessment": {"outcome": "no-data", "kappa": None}, "rho_candidate": None, "rho_active": None, "rates": [],
        "interval": None, "kinds": [], "phases": [], "settled": [], "ended": None,
    }


def drills_are_lost(profile, rule, new, old):
    """Whether the rest of the drills cannot save the candidate: all that the active version misses fail."""
    evaluation = profile["evaluation"]
    budget, alpha = evaluation["drills_per_kind"], evaluation["early_alpha"] / len(KINDS)

    def most(tally):
        seen = feasible(tally)
        if seen >= budget:
            return tally["passed"] / seen
        if rule == "curtailed":
            return (budget - tally["failed"]) / budget
        totals = numpy.arange(tally["passed"], budget - tally["failed"] + 1)
        likelihood = stats.hypergeom.pmf(tally["passed"], budget, totals, seen)
        return int(totals[likelihood > alpha / (seen + 1)].max()) / budget

    best = {kind: most(new[kind]) for kind in KINDS}
    worst = {kind: old[kind]["passed"] / max(budget, feasible(old[kind])) for kind in KINDS}
    return recovery_outcome(profile, best, rho(profile, best), rho(profile, worst)) == "incompatible"


def rehearsed(profile, new, old, rule):
    """What the drills tell, before any of it is charged to the cell and before any kind is settled."""
    full = kind_rates(profile, new, old, profile["evaluation"]["drills_per_kind"])
    early = not full and is_early(profile, rule) and drills_are_lost(profile, rule, new, old)
    if not full and not early:
        return no_recovery()
    kinds = full or kind_rates(profile, new, old, 1)
    rates = [[kind["kind"], kind["candidate"]["rate"]] for kind in kinds]
    found = no_recovery() | {"rates": rates, "kinds": kinds, "phases": phase_rates(profile, new, old)}
    if not early and any(phase["missing"] for phase in found["phases"]):
        return no_recovery() | {"ended": "full" if rule == "full" else None}
    if kinds:
        of_active = {kind["kind"]: kind["active"]["rate"] for kind in kinds}
        found["rho_candidate"], found["rho_active"] = rho(profile, dict(rates)), rho(profile, of_active)
        found["assessment"]["kappa"] = kappa_r(found["rho_active"], found["rho_candidate"])
    found["interval"] = kappa_interval(profile, new, old)
    if early:
        found["assessment"]["outcome"], found["ended"] = "incompatible", rule
        return found
    outcome = recovery_outcome(profile, dict(rates), found["rho_candidate"], found["rho_active"])
    if any(phase["failing"] for phase in found["phases"]):
        outcome = "incompatible"
    elif outcome == "compatible" and any(phase["established_worse"] for phase in found["phases"]):
        outcome = "conditional"
    found["assessment"]["outcome"], found["ended"] = outcome, "full" if rule == "full" else None
    return found


def charged_to_cell(profile, found, new, old, rule):
    """Drills that the active version cannot do say nothing about the candidate: without them it may have no data."""
    wanted, least = profile["evaluation"]["drills_per_kind"], profile["recovery"]["rho_floor"] / 2

    def is_undrillable(kind):
        n = feasible(old[kind])
        if n < wanted and rule == "full":
            return n + old[kind]["infeasible"] > 0
        fails = n >= PHASE_DRILLS_MIN and old[kind]["passed"] / n < least
        return fails and not is_worse(new[kind], old[kind], LEAN_ALPHA)

    kinds = [kind for kind in KINDS if is_undrillable(kind)]
    if not kinds or found["assessment"]["outcome"] != "incompatible":
        return found
    passed = {kind: {"passed": wanted, "failed": 0, "infeasible": 0} for kind in kinds}
    if rehearsed(profile, new | passed, old | passed, rule)["assessment"]["outcome"] == "incompatible":
        return found
    return found | {"assessment": {"outcome": "no-data", "kappa": None}, "interval": None}


def contrast(kind, new, old, more):
    """The drills of a kind by place: the base number, which both did, and those after it.

    After it the candidate drills alone, and the active version only where the candidate failed; once it failed alone,
    both drill again. Older builds have no `more`: there both did all drills, and the tallies hold them.
    """
    tally = {
        "kind": kind, "drills": min(feasible(new[kind]), feasible(old[kind])),
        "candidate_alone": new[kind].get("failed_alone", 0), "active_alone": old[kind].get("failed_alone", 0),
    }
    if more is None:
        return tally
    return {
        "kind": kind, "paired": tally["drills"] + more[kind]["paired"],
        "candidate_failed": tally["candidate_alone"] + more[kind]["candidate_failed"],
        "active_failed": tally["active_alone"] + more[kind]["active_failed"],
        "alone": more[kind]["alone"], "alone_failed": more[kind]["alone_failed"],
    }


def settlement(row):
    """How the drills of a kind end: by a likelihood ratio and a sign test of those of both, and by bets on all."""
    if "paired" in row:
        n, b, c = row["paired"] + row["alone"], row["candidate_failed"], row["active_failed"]
        failed = b + row["alone_failed"]
    else:
        n, b, c = row["drills"], row["candidate_alone"], row["active_alone"]
        failed = b
    if failed == 0:
        return "clean" if n >= 114 else "open"
    if b * math.log(1.9) + c * math.log(0.1) >= math.log(40):
        return "worse"
    bets = ((n - failed - c, 0), (failed, 1), (c, -1))
    if sum(count * math.log(1 + 0.75 * (0.02 - d)) for count, d in bets) >= math.log(20):
        return "not-worse"
    if n < 500:
        return "open"
    leans = b + c > 0 and stats.binomtest(b, b + c, alternative="greater").pvalue <= 0.1
    return "held" if leans else "not-worse"


def settle(found, new, old, more):
    if found["assessment"]["outcome"] in ("incompatible", "no-data"):
        return
    found["settled"] = [contrast(kind, new, old, more) for kind in SETTLED_KINDS]
    ends = [settlement(row) for row in found["settled"]]
    if "worse" in ends:
        found["assessment"]["outcome"] = "incompatible"
    elif "held" in ends or "open" in ends:
        found["assessment"]["outcome"] = "no-data"


# The record.


def again(profile, evidence):
    """Behavior and recovery of a piece of evidence, from its raw values and the rule that it names as its end."""
    recorded, drills = evidence["behavior"], evidence["drills"]
    if evidence.get("counted"):
        pairs, _ = look_of_try(evidence["counted"], len(evidence["pairs"]))
        profile = profile | {"evaluation": profile["evaluation"] | {"sandbox_pairs": pairs}}
    rule = recorded.get("ended") or evidence["recovery"].get("ended") or "full"
    measured = any("harm" in pair["candidate"] for pair in evidence["pairs"])
    kinds = [kind.replace("_", "-") for kind in map(without_unit, harm_keys(profile))] if measured else []
    behavior = paired_behavior(profile, evidence, rule, kinds)
    recovery = charged_to_cell(profile, rehearsed(profile, *drills, rule), *drills, rule)
    apply_live_like(profile, behavior, evidence["pairs"], kinds)
    is_open = behavior["assessment"]["outcome"] in ("compatible", "suspicious")
    is_anchored = any(binding.get("anchor") for binding in evidence["bindings"][:1])
    is_anchor_missing = is_anchored and is_open and not evidence.get("anchor")
    is_anchor_missing &= recovery["assessment"]["outcome"] != "incompatible"
    apply_anchor(profile, behavior, evidence, kinds)
    if behavior["assessment"]["outcome"] in ("compatible", "suspicious"):
        settle(recovery, *drills, evidence.get("settling"))
    apply_sequences(profile, behavior, evidence.get("handovers"), kinds)
    apply_try(profile, behavior, evidence)
    apply_concerns(behavior, evidence)
    return behavior, recovery, is_anchor_missing


def without_unit(key):
    for unit in ("_m_s3", "_m_s", "_n", "_s", "_m", "_rad", "_j"):
        if key.endswith(unit):
            return key.removesuffix(unit)
    return key


class Check:
    """Compares what is computed here with the record, and keeps what differs."""

    def __init__(self):
        self.numbers, self.largest, self.wrong = 0, 0.0, []

    def same(self, what, ours, recorded):
        """Numbers, words and lists, down to the last one; a record may have more fields than are computed here."""
        if isinstance(ours, dict) and isinstance(recorded, dict):
            for key, value in ours.items():
                self.same(f"{what}.{key}", value, recorded.get(key, [] if value == [] else None))
        elif isinstance(ours, list) and isinstance(recorded, list) and len(ours) == len(recorded):
            for place, (one, other) in enumerate(zip(ours, recorded)):
                name = one.get("name") or one.get("kind") or one.get("measure") if isinstance(one, dict) else None
                self.same(f"{what}[{name or place}]", one, other)
        elif isinstance(ours, float) and isinstance(recorded, (int, float)) and not isinstance(recorded, bool):
            difference = abs(ours - recorded) / max(abs(ours), abs(recorded), SMALL)
            self.numbers, self.largest = self.numbers + 1, max(self.largest, difference)
            # Written so that what is no number differs.
            if not difference <= LIMIT:
                self.wrong.append(f"{what}: the store has {recorded}, SciPy {ours}")
        elif type(ours) is not type(recorded) or ours != recorded:
            self.wrong.append(f"{what}: the store has {shown(recorded)}, here it is {shown(ours)}")


def shown(value):
    text = json.dumps(value)
    return text if len(text) < 200 else f"{text[:200]}..."


def profile_of(name, folder, stand_in):
    files = (PROFILES / f"{name}.toml", folder / "profiles" / f"{name}.toml", PROFILES / f"{stand_in}.toml")
    return tomllib.loads(next(file for file in files if file.exists()).read_text())


def by_kind(rows, kinds):
    """Measures of harm in the order of the others."""
    return sorted(rows, key=lambda row: kinds.index(row["kind"]) if row["kind"] in kinds else len(kinds))


def apply_holm(p_values):
    """Each p-value corrected for all of them, in their order."""
    corrected, largest = [0.0] * len(p_values), 0.0
    for rank, place in enumerate(sorted(range(len(p_values)), key=lambda place: p_values[place])):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[place]))
        corrected[place] = largest
    return corrected


def check_rollback(record):
    """The comparison of the rates that rolled a version back with its rollback target, again from each task."""
    check, rates = Check(), record["rates"]["rates"]
    again, differing = [], []
    for rate in rates:
        alone = [sum(task[one] and not task[other] for task in rate["tasks"])
                 for one, other in (("version", "target"), ("target", "version"))]
        p = stats.binomtest(alone[0], sum(alone), 0.5, alternative="greater").pvalue if sum(alone) else 1.0
        again.append({"name": rate["rate"], "version_alone": alone[0], "target_alone": alone[1], "p": float(p)})
        differing.append(tuple((task["seed"], task["version"]) for task in rate["tasks"] if task["version"] != task["target"]))
    # Rates that differ in the same tasks are one test.
    tests = {tasks: rate["p"] for rate, tasks in zip(again, differing) if tasks}
    corrected = dict(zip(tests, apply_holm(list(tests.values()))))
    for rate, tasks in zip(again, differing):
        rate["p"] = corrected.get(tasks, 1.0)
    check.same("rates", [{key: rate[key] for key in rate if key != "name"} for rate in again], rates)
    check.same("rates", [rate["name"] for rate in again], record["trigger"]["rates"])
    differs = any(rate["p"] <= record["rates"]["alpha"] for rate in again)
    if record["post_status"] != "safe-stopped":
        check.same("post_status", "rolled-back" if differs else "demoted", record["post_status"])
    return check


def check_rollbacks(folder, database):
    """Every rollback for rates of a store. Returns the number of them and what differs."""
    found = database.execute("SELECT version, json FROM evidence WHERE kind = 'rollback' ORDER BY seq").fetchall()
    records = [(version, json.loads(text)) for version, text in found]
    compared = [(version, record) for version, record in records if record.get("rates")]
    wrong = []
    for version, record in compared:
        check = check_rollback(record)
        what = f"{folder}: {version}, rollback"
        print(f"{what}: {check.numbers} numbers, largest difference {check.largest:.1e}; {record['post_status']}")
        wrong.extend(f"{what}: {line}" for line in check.wrong)
    return len(compared), wrong


def check_store(folder, stand_in):
    """Every piece of sandbox evidence of a store, and its rollbacks for rates. Returns their number and what differs."""
    file = folder / "holdpoint.db"
    if not file.exists():
        return 0, [f"{folder}: there is no holdpoint.db"]
    database = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)
    pieces = database.execute("SELECT version, profile, digest, json FROM evidence WHERE kind = 'sandbox' ORDER BY seq")
    pieces = pieces.fetchall()
    bodies = database.execute("SELECT body FROM audit WHERE kind = 'decision'")
    made_under = [json.loads(body).get("made_under", {}) for (body,) in bodies]
    rules = {under.get("evidence"): under.get("rules", 1) for under in made_under}
    rollbacks, differing = check_rollbacks(folder, database)
    database.close()
    numbers, wrong = 0, differing if pieces else [*differing, f"{folder}: there is no sandbox evidence"]
    for version, name, digest, text in pieces:
        what, evidence = f"{folder}: {version}", json.loads(text)
        if rules.get(digest, RULES) != RULES:
            wrong.append(f"{what}: decided by version {rules[digest]} of the rules, and this file knows {RULES}")
            continue
        if evidence.get("refused_try"):
            # Nothing was measured.
            continue
        if not evidence.get("behavior") or not evidence.get("recovery") or not evidence.get("drills"):
            wrong.append(f"{what}: there is nothing to compute again")
            continue
        profile = profile_of(name, folder, stand_in)
        behavior, recovery, is_anchor_missing = again(profile, evidence)
        recorded = evidence["behavior"]
        parts = ((of.get("anchor") or {}, of.get("live_like") or {}, of) for of in (behavior, recorded))
        for ours, theirs in zip(*parts):
            kinds = [row["kind"] for row in theirs.get("harm", [])]
            if ours.get("harm"):
                ours["harm"] = by_kind(ours["harm"], kinds)
        check = Check()
        if evidence.get("counted"):
            check.same("counted", terms_of_try(profile, evidence["counted"]), evidence["counted"])
        check.same("behavior", behavior, recorded)
        check.same("recovery", recovery, evidence["recovery"])
        if is_anchor_missing:
            check.wrong.append("an anchor is bound to the evidence, and has no episodes there")
        kappas = evidence["kappas"]
        check.same("kappas.behavior", behavior["assessment"], kappas["behavior"])
        check.same("kappas.recovery", recovery["assessment"], kappas["recovery"])
        numbers += check.numbers
        outcomes = f"behavior {behavior['assessment']['outcome']}, recovery {recovery['assessment']['outcome']}"
        anchor = f", anchor {behavior['anchor']['version']}" if behavior["anchor"] else ""
        print(f"{what}: {check.numbers} numbers, largest difference {check.largest:.1e}; {outcomes}{anchor}")
        wrong.extend(f"{what}: {line}" for line in check.wrong)
    # A hard stop before the first pair leaves nothing but a verdict.
    if pieces and not wrong and numbers == 0:
        wrong.append(f"{folder}: there is no number to compute again")
    return len(pieces) + rollbacks, wrong


def check_prices(page):
    """The page's row of pairs for each try of an author under `sim`, against the rule's own search."""
    profile = tomllib.loads((PROFILES / "sim.toml").read_text(encoding="utf-8"))
    row = next(line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| pairs |"))
    printed = [int(cell) for cell in row.split("|")[2:-1]]
    tries = range(1, profile["tries"]["per_author"] + 1)
    found = [terms_of_try(profile, {"by_author": number, "in_family": number})["pairs"] for number in tries]
    print(f"{page.name}: the pairs of {len(found)} tries computed again")
    return [] if printed == found else [f"{page}: the pairs of the tries are {found}, not {printed}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stores", metavar="STORE_FOLDER", nargs="+", type=Path)
    parser.add_argument("--profile", metavar="NAME", default="sim", help="if a profile is not found [default: sim]")
    parser.add_argument("--prices", metavar="PAGE", type=Path, help="compare the pairs of each try in this page, too")
    options = parser.parse_args()
    pieces, wrong = 0, check_prices(options.prices) if options.prices else []
    for folder in options.stores:
        found, differing = check_store(folder, options.profile)
        pieces, wrong = pieces + found, wrong + differing
    for line in wrong:
        print(line)
    print(f"{pieces} pieces of evidence computed again, {len(wrong)} differ")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
