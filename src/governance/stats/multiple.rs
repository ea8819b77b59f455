//! Correction for several tests at once.

use super::StatsError;

/// Holm's step-down adjustment (1979): p-values that may each be compared with the family's level.
///
/// The answer keeps the order of the input.
///
/// # Errors
/// No p-values, or one outside [0, 1].
pub fn holm(p_values: &[f64]) -> Result<Vec<f64>, StatsError> {
    super::finite(p_values, 1)?;
    if let Some(&value) = p_values.iter().find(|p| !(0.0..=1.0).contains(*p)) {
        return Err(StatsError::Parameter { name: "p-value", value, allowed: "from 0 to 1" });
    }
    let mut order: Vec<usize> = (0..p_values.len()).collect();
    order.sort_by(|&a, &b| p_values[a].total_cmp(&p_values[b]));
    let mut adjusted = vec![0.0; p_values.len()];
    let mut largest: f64 = 0.0;
    for (rank, index) in order.into_iter().enumerate() {
        let factor = (p_values.len() - rank) as f64;
        largest = largest.max((factor * p_values[index]).min(1.0));
        adjusted[index] = largest;
    }
    Ok(adjusted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holm_reproduces_worked_values() {
        for (given, expected) in [
            (vec![0.01, 0.04, 0.03], vec![0.03, 0.06, 0.06]),
            (vec![0.5], vec![0.5]),
            (vec![0.9, 0.8], vec![1.0, 1.0]),
        ] {
            for (a, b) in holm(&given).unwrap().iter().zip(&expected) {
                assert!((a - b).abs() < 1e-12, "{given:?}");
            }
        }
        assert!(holm(&[]).is_err());
        assert!(holm(&[1.5]).is_err());
        assert!(holm(&[f64::NAN]).is_err());
    }
}
