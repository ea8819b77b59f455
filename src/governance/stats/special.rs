//! Normal, Student and beta distribution functions and their inverses.
//!
//! Uses libm, so equal inputs give equal bits on every platform.

/// The standard normal distribution function.
#[must_use]
pub fn normal_cdf(z: f64) -> f64 {
    0.5 * libm::erfc(-z / std::f64::consts::SQRT_2)
}

/// The standard normal quantile: `z` with `normal_cdf(z) = p`, or `None` unless 0 < p < 1.
#[must_use]
pub fn normal_quantile(p: f64) -> Option<f64> {
    if !(p > 0.0 && p < 1.0) {
        return None;
    }
    // By symmetry only the lower half is searched, where `normal_cdf` keeps its relative precision.
    if p > 0.5 {
        return normal_quantile(1.0 - p).map(|z| -z);
    }
    Some(bisect(-40.0, 0.0, |z| normal_cdf(z) < p))
}

/// Student's distribution function with `df` > 0 degrees of freedom, or `None` outside the domain.
#[must_use]
pub fn student_cdf(t: f64, df: f64) -> Option<f64> {
    if !(df > 0.0 && df.is_finite()) || t.is_nan() {
        return None;
    }
    let tail = 0.5 * beta_cdf(df / (df + t * t), df / 2.0, 0.5);
    Some(if t > 0.0 { 1.0 - tail } else { tail })
}

/// Student's quantile with `df` degrees of freedom, or `None` unless 0 < p < 1 and `df` > 0.
#[must_use]
pub fn student_quantile(p: f64, df: f64) -> Option<f64> {
    if !(p > 0.0 && p < 1.0 && df > 0.0 && df.is_finite()) {
        return None;
    }
    if p > 0.5 {
        return student_quantile(1.0 - p, df).map(|t| -t);
    }
    // P(T < t) = I_x(df/2, 1/2) / 2 with x = df / (df + t^2).
    let x = beta_quantile(2.0 * p, df / 2.0, 0.5);
    Some(-(df * (1.0 - x) / x).sqrt())
}

/// The regularised incomplete beta function `I_x(a, b)` for a, b > 0 (DLMF 8.17.22, Lentz's method).
pub(super) fn beta_cdf(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if x >= 1.0 {
        return 1.0;
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - beta_cdf(1.0 - x, b, a);
    }
    let ln_front = a * libm::log(x) + b * libm::log1p(-x) - ln_beta(a, b) - libm::log(a);
    libm::exp(ln_front) * beta_fraction(x, a, b)
}

/// The quantile of the beta distribution: `x` with `I_x(a, b) = p`.
pub(super) fn beta_quantile(p: f64, a: f64, b: f64) -> f64 {
    bisect(0.0, 1.0, |x| beta_cdf(x, a, b) < p)
}

/// `ln C(n, k)`.
#[cfg(test)]
pub(super) fn ln_choose(n: f64, k: f64) -> f64 {
    libm::lgamma(n + 1.0) - libm::lgamma(k + 1.0) - libm::lgamma(n - k + 1.0)
}

fn ln_beta(a: f64, b: f64) -> f64 {
    libm::lgamma(a) + libm::lgamma(b) - libm::lgamma(a + b)
}

fn beta_fraction(x: f64, a: f64, b: f64) -> f64 {
    const STEPS_MAX: u32 = 5_000;
    // Far below every term of the fraction: a quotient by 0 would end it.
    const TINY: f64 = 1e-300;
    // Below the distance of two neighboring numbers at 1 nothing changes any more.
    const CONVERGED: f64 = 1e-16;
    let away_from_zero = |value: f64| if value.abs() < TINY { TINY } else { value };
    let mut c = 1.0;
    let mut d = 1.0 / away_from_zero(1.0 - (a + b) * x / (a + 1.0));
    let mut fraction = d;
    for step in 1..=STEPS_MAX {
        let m = f64::from(step);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        d = 1.0 / away_from_zero(1.0 + even * d);
        c = away_from_zero(1.0 + even / c);
        fraction *= d * c;
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        d = 1.0 / away_from_zero(1.0 + odd * d);
        c = away_from_zero(1.0 + odd / c);
        fraction *= d * c;
        if (d * c - 1.0).abs() < CONVERGED {
            break;
        }
    }
    fraction
}

/// The point in `[lower, upper]` where `below` turns from true to false; it must be monotone there.
pub(super) fn bisect(mut lower: f64, mut upper: f64, below: impl Fn(f64) -> bool) -> f64 {
    const STEPS: u32 = 1_100;
    for _ in 0..STEPS {
        let middle = lower + (upper - lower) / 2.0;
        if middle <= lower || middle >= upper {
            break;
        }
        if below(middle) { lower = middle } else { upper = middle }
    }
    lower + (upper - lower) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_probability_has_no_quantile() {
        for p in [0.0, 1.0, -0.1, 1.1, f64::NAN, f64::INFINITY] {
            assert_eq!(normal_quantile(p), None, "{p}");
            assert_eq!(student_quantile(p, 5.0), None, "{p}");
        }
        for df in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(student_quantile(0.5, df), None, "{df}");
            assert_eq!(student_cdf(0.5, df), None, "{df}");
        }
        assert_eq!(student_cdf(f64::NAN, 3.0), None);
    }

    proptest::proptest! {
        #[test]
        fn quantiles_invert_the_distributions(p in 1e-9..0.999_999, df in 1.0..2_000.0) {
            let z = normal_quantile(p).unwrap();
            proptest::prop_assert!((normal_cdf(z) - p).abs() < 1e-12);
            let t = student_quantile(p, df).unwrap();
            proptest::prop_assert!((student_cdf(t, df).unwrap() - p).abs() < 1e-9);
        }
    }
}
