//! The one-sided two-sample test of Smirnov (1939), exactly, by counting lattice paths.
//!
//! Whether the second sample lies above the first: the largest excess of the first one's empirical distribution function
//! over the second one's. The chance is that of all orders of the pooled sample that are equally likely if nothing
//! differs; values that are equal make it too large, never too small.

use super::{StatsError, finite};

/// The comparison of two samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smirnov {
    /// The largest excess, 0 to 1.
    pub excess: f64,
    /// The chance of as large an excess or a larger one, if both samples are of one distribution.
    pub p_value: f64,
}

/// Most values of either sample: the paths are counted in the product of both sizes.
pub const SMIRNOV_MAX: usize = 10_000;

/// Whether `second` lies above `first`.
///
/// # Errors
/// An empty sample, one of more than [`SMIRNOV_MAX`] values, or a value that is no number.
pub fn smirnov_above(first: &[f64], second: &[f64]) -> Result<Smirnov, StatsError> {
    finite(first, 1)?;
    finite(second, 1)?;
    let (n, m) = (first.len(), second.len());
    if n.max(m) > SMIRNOV_MAX {
        return Err(StatsError::Parameter {
            name: "samples",
            value: n.max(m) as f64,
            allowed: "at most 10,000",
        });
    }
    let mut pooled: Vec<(f64, bool)> =
        first.iter().map(|v| (*v, true)).chain(second.iter().map(|v| (*v, false))).collect();
    pooled.sort_by(|a, b| a.0.total_cmp(&b.0));
    // In whole numbers: the excess times both sizes.
    let whole = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
    let (mut of_first, mut of_second, mut largest) = (0, 0, 0);
    for (place, (value, is_first)) in pooled.iter().enumerate() {
        if *is_first {
            of_first += 1;
        } else {
            of_second += 1;
        }
        // Written so that the zeros of either sign are one value.
        let goes_on = pooled.get(place + 1).is_some_and(|(next, _)| next == value);
        if !goes_on {
            largest = largest.max(of_first * whole(m) - of_second * whole(n));
        }
    }
    let excess = largest as f64 / (n * m) as f64;
    if largest <= 0 {
        return Ok(Smirnov { excess: 0.0, p_value: 1.0 });
    }
    // The share of the paths to (i, j) that have stayed below, row by row.
    let stays = |i: usize, j: usize| whole(i) * whole(m) - whole(j) * whole(n) < largest;
    let mut row = vec![0.0_f64; m + 1];
    for i in 0..=n {
        for j in 0..=m {
            let steps = (i + j) as f64;
            row[j] = match (i, j) {
                _ if !stays(i, j) => 0.0,
                (0, 0) => 1.0,
                (_, 0) => row[0],
                (0, _) => row[j - 1],
                _ => row[j] * (i as f64 / steps) + row[j - 1] * (j as f64 / steps),
            };
        }
    }
    Ok(Smirnov { excess, p_value: (1.0 - row[m]).clamp(0.0, 1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every choice of which of the pooled values are the first sample's.
    fn enumerated(n: usize, m: usize, excess: f64) -> f64 {
        let (mut as_large, mut all) = (0_u32, 0_u32);
        for mask in 0_u32..1 << (n + m) {
            if mask.count_ones() as usize != n {
                continue;
            }
            let of = |first: bool| {
                (0..n + m)
                    .filter(|bit| (mask >> bit & 1 == 1) == first)
                    .map(|bit| bit as f64)
                    .collect::<Vec<_>>()
            };
            all += 1;
            as_large += u32::from(smirnov_above(&of(true), &of(false)).unwrap().excess >= excess - 1e-12);
        }
        f64::from(as_large) / f64::from(all)
    }

    #[test]
    fn p_value_equals_full_enumeration() {
        for (first, second) in [
            (vec![1.0, 2.0, 3.0], vec![4.0, 5.0, 6.0]),
            (vec![1.0, 4.0, 3.0], vec![2.0, 5.0, 6.0, 7.0]),
            (vec![5.0, 1.0, 2.5, 0.5, 3.5], vec![3.0, 4.0, 6.0, 2.0]),
            (vec![4.0, 5.0], vec![1.0, 2.0, 3.0, 6.0, 7.0, 8.0]),
        ] {
            let found = smirnov_above(&first, &second).unwrap();
            let expected = enumerated(first.len(), second.len(), found.excess);
            assert!((found.p_value - expected).abs() < 1e-12, "{first:?} {second:?}: {found:?} {expected}");
        }
        // One order of twenty has all three of the second above the first.
        assert!((smirnov_above(&[1.0, 2.0, 3.0], &[4.0, 5.0, 6.0]).unwrap().p_value - 0.05).abs() < 1e-12);
    }

    #[test]
    fn test_is_one_sided_and_equal_values_do_not_differ() {
        assert_eq!(smirnov_above(&[4.0, 5.0], &[1.0, 2.0]).unwrap(), Smirnov { excess: 0.0, p_value: 1.0 });
        assert_eq!(smirnov_above(&[0.0; 300], &[-0.0; 20]).unwrap().p_value, 1.0);
        let far = smirnov_above(&[0.0; 300], &[1.0; 20]).unwrap();
        assert!(far.excess >= 1.0 && far.p_value < 1e-30, "{far:?}");
        assert!(smirnov_above(&[], &[1.0]).is_err() && smirnov_above(&[f64::NAN], &[1.0]).is_err());
    }
}
