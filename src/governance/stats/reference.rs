//! Comparison with SciPy; the values are in `reference.json`, how they were made in it and in `reference.py`.

use serde::Deserialize;

use super::*;

#[derive(Deserialize)]
struct SciPyReference {
    source: String,
    proportions: Vec<ProportionReference>,
    signed_rank: Vec<SignedRankReference>,
    normal: Vec<NormalReference>,
    student: Vec<StudentReference>,
    student_pairs: Vec<StudentPairsReference>,
    bootstrap: Vec<BootstrapReference>,
    runs_possible: Vec<RunsPossibleReference>,
    pairs_possible: Vec<PairsPossibleReference>,
}

#[derive(Debug, Deserialize)]
struct RunsPossibleReference {
    size: u64,
    passed: u64,
    seen: u64,
    alpha: f64,
    least: u64,
    most: u64,
}

#[derive(Debug, Deserialize)]
struct PairsPossibleReference {
    size: u64,
    seen: u64,
    worse: u64,
    better: u64,
    alpha: f64,
    least_net: i64,
    most_discordant: u64,
}

#[derive(Debug, Deserialize)]
struct ProportionReference {
    k: u64,
    n: u64,
    level: f64,
    wilson: [f64; 2],
    exact: [f64; 2],
}

#[derive(Debug, Deserialize)]
struct SignedRankReference {
    differences: Vec<f64>,
    w: f64,
    two_sided: f64,
    greater: f64,
    less: f64,
    method: String,
}

#[derive(Debug, Deserialize)]
struct NormalReference {
    p: f64,
    z: f64,
}

#[derive(Debug, Deserialize)]
struct StudentReference {
    p: f64,
    df: f64,
    t: f64,
}

#[derive(Debug, Deserialize)]
struct StudentPairsReference {
    differences: Vec<f64>,
    alpha: f64,
    lower: f64,
    upper: f64,
}

#[derive(Debug, Deserialize)]
struct BootstrapReference {
    values: Vec<f64>,
    level: f64,
    lower: f64,
    upper: f64,
}

fn reference() -> SciPyReference {
    let reference: SciPyReference = serde_json::from_str(include_str!("reference.json")).unwrap();
    assert!(reference.source.starts_with("SciPy 1.17"));
    reference
}

#[track_caller]
fn near(got: f64, expected: f64, tolerance: f64, what: &impl std::fmt::Debug) {
    assert!(
        (got - expected).abs() <= tolerance * expected.abs().max(1.0),
        "{got} is not {expected}: {what:?}"
    );
}

#[test]
fn proportion_intervals_match_the_reference() {
    for row in reference().proportions {
        let score = wilson(row.k, row.n, row.level).unwrap();
        let exact = clopper_pearson(row.k, row.n, row.level).unwrap();
        for (got, expected) in [
            (score.lower, row.wilson[0]),
            (score.upper, row.wilson[1]),
            (exact.lower, row.exact[0]),
            (exact.upper, row.exact[1]),
        ] {
            near(got, expected, 1e-11, &row);
        }
    }
}

#[test]
fn signed_rank_tests_match_the_reference() {
    for row in reference().signed_rank {
        let test = signed_rank(&row.differences).unwrap();
        assert_eq!(test.exact, row.method != "approx", "{row:?}");
        for (got, expected) in [
            (test.w, row.w),
            (test.p_two_sided, row.two_sided),
            (test.p_greater, row.greater),
            (test.p_less, row.less),
        ] {
            near(got, expected, 1e-12, &row);
        }
    }
}

#[test]
fn quantiles_match_the_reference() {
    let reference = reference();
    for row in reference.normal {
        near(normal_quantile(row.p).unwrap(), row.z, 1e-12, &row);
    }
    for row in reference.student {
        near(student_quantile(row.p, row.df).unwrap(), row.t, 1e-10, &row);
    }
}

#[test]
fn paired_mean_bounds_match_the_reference() {
    for row in reference().student_pairs {
        let bound = student_pairs(&row.differences, row.alpha).unwrap();
        near(bound.lower, row.lower, 1e-10, &row);
        near(bound.upper, row.upper, 1e-10, &row);
    }
}

#[test]
fn finite_population_bounds_match_the_reference() {
    use population::{PairBudget, RunBudget};
    let reference = reference();
    assert!(reference.runs_possible.len() >= 5 && reference.pairs_possible.len() >= 4);
    for row in reference.runs_possible {
        let found = RunBudget::new(row.size).unwrap().passes(row.passed, row.seen, row.alpha).unwrap();
        assert_eq!(found, (row.least, row.most), "{row:?}");
    }
    for row in reference.pairs_possible {
        let seen = PairedCounts { pairs: row.seen, candidate_only: row.worse, active_only: row.better };
        let found = PairBudget::new(row.size).unwrap().possible(seen, row.alpha).unwrap();
        assert_eq!((found.least_net, found.most_discordant), (row.least_net, row.most_discordant), "{row:?}");
    }
}

#[test]
fn bootstrap_intervals_match_the_reference() {
    for row in reference().bootstrap {
        let interval = bca(&row.values, mean, row.level, 40_000, 3).unwrap();
        // Both are Monte Carlo estimates; their own error here is about 0.01.
        near(interval.lower, row.lower, 0.02, &row);
        near(interval.upper, row.upper, 0.02, &row);
    }
}
