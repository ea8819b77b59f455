//! The normal rates of a version, from the episodes of its twins.

use crate::evidence::{EpisodeValues, Signature};
use crate::profile::MonitorSettings;
use crate::stats::wilson_upper;

/// What is normal for a version: for each rate the upper bound that the episodes of its twins leave open, so
/// that so few of them do not pass for a proof of a low rate. `None` without episodes.
#[must_use]
pub fn normal_rates(twins: &[EpisodeValues], settings: &MonitorSettings) -> Option<Signature> {
    let n = u64::try_from(twins.len()).ok().filter(|n| *n > 0)?;
    let mean = crate::behavior::signature(twins.iter())?;
    let bound = |flag: &dyn Fn(&EpisodeValues) -> bool| {
        let count = twins.iter().filter(|values| flag(values)).count() as u64;
        wilson_upper(count, n, settings.normal_alpha).ok()
    };
    Some(Signature {
        success: 1.0 - bound(&|v| !v.success)?,
        violation: bound(&|v| v.violation)?,
        anomaly: bound(&|v| v.anomaly)?,
        recovery: bound(&|v| v.recovery)?,
        retry: bound(&|v| v.retries > 0)?,
        intervention: bound(&|v| v.intervention)?,
        timeout: bound(&|v| v.timeout)?,
        policy_warning: bound(&|v| v.policy_warning)?,
        near_limit: bound(&|v| v.near_violation)?,
        ..mean
    })
}
