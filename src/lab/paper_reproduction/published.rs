//! The paper's own numbers, read from `paper.toml`.

use serde::Deserialize;

use crate::pipeline_experiments::ExperimentError;
use holdpoint_governance::text_error::parse_toml;

/// The text that comes with the program.
const TEXT: &str = include_str!("../paper.toml");

/// Blocked faults, and all faults.
type BlockedCount = [u32; 2];

/// Mean and standard deviation, percent.
type PublishedMeanStd = [f64; 2];

/// W of a signed-rank test, and the ends of the interval of the difference, percent.
pub type SignedRankTest = [f64; 3];

/// A row of table 10: BADR, faulty accepted, unsafe activation, success, rollback, violation; percent, NaN where the
/// paper has a dash.
pub type PublishedAblationRow = [f64; 6];

/// The tables of the paper that the report compares with.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedNumbers {
    pub t6: PublishedScreening,
    pub t7: PublishedDeployment,
    pub f4: PublishedCurves,
    pub f5: PublishedDetections,
    pub t8: PublishedRollback,
    pub t9: PublishedProfiles,
    pub t10: PublishedAblation,
    pub t11: PublishedKappas,
    pub t12: PublishedSensitivity,
    pub marginal: PublishedBorderline,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedScreening {
    pub faulty: u32,
    pub benign: u32,
    pub interface: BlockedCount,
    pub policy: BlockedCount,
    pub behavior: BlockedCount,
    pub marginal: BlockedCount,
    pub badr: f64,
    pub false_reject_rate: f64,
}

/// Static, naive, governed.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedDeployment {
    pub success: [PublishedMeanStd; 3],
    pub success_p: f64,
    pub unsafe_activation: [PublishedMeanStd; 3],
    pub unsafe_activation_p: f64,
    pub violation: [PublishedMeanStd; 3],
    pub violation_p: f64,
    pub success_test: SignedRankTest,
    pub unsafe_activation_test: SignedRankTest,
    pub violation_test: SignedRankTest,
}

/// By round.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedCurves {
    pub success_static: [f64; 6],
    pub success_naive: [f64; 6],
    pub success_governed: [f64; 6],
    pub unsafe_naive: [f64; 6],
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedDetections {
    pub sandbox: u32,
    pub shadow_only: u32,
    /// By category: retry instability, policy-sensitive drift, timeout or stall, recovery degradation, live-context
    /// divergence.
    pub sandbox_by: [u32; 5],
    pub shadow_only_by: [u32; 5],
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedRollback {
    /// Sensor noise, distribution shift, actuator delay, combined.
    pub by: [PublishedMeanStd; 4],
    pub overall: PublishedMeanStd,
}

impl PublishedDetections {
    /// The share of shadow alone in all detections, percent.
    #[must_use]
    pub fn shadow_only_percent(&self) -> f64 {
        100.0 * f64::from(self.shadow_only) / f64::from(self.shadow_only + self.sandbox)
    }
}

/// Kappas of overt faults, from lowest to highest.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedKappas {
    pub interface: [f64; 2],
    pub policy: [f64; 2],
    pub behavior: [f64; 2],
}

/// Thresholds a tenth lower, as they are, a tenth higher.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedSensitivity {
    pub badr: [f64; 3],
    pub false_reject_rate: [f64; 3],
    pub success: [PublishedMeanStd; 3],
    pub unsafe_activation: [PublishedMeanStd; 3],
    pub violation: [PublishedMeanStd; 3],
}

/// The two faults that the paper's screening lets through (its section 8.3).
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedBorderline {
    /// How much more often there is an anomaly; a share.
    pub anomaly_rise: f64,
    /// Recovered of those that need it, before and after; shares.
    pub recovery: [f64; 2],
}

/// Sim, real, human.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedProfiles {
    pub badr: [f64; 3],
    pub false_reject_rate: [f64; 3],
    pub unsafe_activation: [f64; 3],
    pub success: [f64; 3],
    pub violation: [f64; 3],
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedAblation {
    pub full: PublishedAblationRow,
    pub no_shadow: PublishedAblationRow,
    pub no_recovery_compat: PublishedAblationRow,
    pub no_online_monitoring: PublishedAblationRow,
    pub no_rollback: PublishedAblationRow,
    pub no_sandbox: PublishedAblationRow,
    pub compat_only: PublishedAblationRow,
    pub naive: PublishedAblationRow,
}

impl PublishedNumbers {
    /// The numbers that come with the program.
    ///
    /// # Errors
    /// If the text does not parse; a test parses it.
    pub fn builtin() -> Result<Self, ExperimentError> {
        parse_toml("paper.toml", TEXT).map_err(|error| ExperimentError::Unexpected(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper prints some numbers twice. The copies agree here, so a typing error in one is found.
    #[test]
    fn the_tables_agree_where_they_repeat_each_other() {
        let printed = PublishedNumbers::builtin().unwrap();
        let (t6, t10) = (&printed.t6, &printed.t10);
        let blocked = t6.interface[0] + t6.policy[0] + t6.behavior[0] + t6.marginal[0];
        assert!((100.0 * f64::from(blocked) / f64::from(t6.faulty) - t6.badr).abs() < 1e-9);
        assert_eq!(t6.interface[1] + t6.policy[1] + t6.behavior[1] + t6.marginal[1], t6.faulty);
        assert!((t10.full[0] - t6.badr).abs() < 1e-9 && (t10.full[4] - printed.t8.overall[0]).abs() < 1e-9);
        assert!((t10.naive[3] - printed.t7.success[1][0]).abs() < 1e-9 && t10.naive[4].is_nan());
        let by = printed.t8.by.iter().map(|[mean, _]| mean).sum::<f64>() / 4.0;
        assert!((by - printed.t8.overall[0]).abs() < 0.05, "twelve drifts of each kind: {by}");
        assert!((printed.f4.success_naive[5] - printed.t7.success[1][0]).abs() < 1e-9);
        let shadow = f64::from(printed.f5.shadow_only);
        assert_eq!(printed.f5.sandbox_by.iter().sum::<u32>(), printed.f5.sandbox);
        assert_eq!(printed.f5.shadow_only_by.iter().sum::<u32>(), printed.f5.shadow_only);
        assert!((shadow / (shadow + f64::from(printed.f5.sandbox)) - 0.4).abs() < 1e-9);
        // BADR and what is accepted make 75 in every row of the pipeline (readings 2.4).
        for row in [t10.full, t10.no_shadow, t10.no_recovery_compat, t10.no_sandbox, t10.compat_only] {
            assert!((row[0] + row[1] - 75.0).abs() < 1e-9, "{row:?}");
        }
    }
}
