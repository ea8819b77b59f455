//! The effects that the comparison of behavior and harm finds: a table of effect sizes for every component and measure
//! under every profile. A second table counts how often equally good versions are rejected for harm.
//!
//! Pairs are sampled from recorded ones, and a coin selects the candidate; then one component of the candidate gets worse.
//! For a rate, that part of its episodes gets the event; for time and retries every episode gets more; for a measure of
//! harm every episode gets a multiple of the profile's margin more. An effect counts as found if the result is not
//! "compatible".

use super::figure::{StatedBound, StudyFigure, StudyMeasure, rate, unjudged};
use super::sampling::{SampleStream, binding};
use super::tables::RecordedTable;
use super::{Study, missing};
use holdpoint::bench::BenchError;
use holdpoint_governance::behavior::{self, BehaviorAssessment, ComponentName, HarmComparison};
use holdpoint_governance::evidence::{EpisodeValues, Pair, PairedEvidence};
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::outcome::BehaviorOutcome;
use holdpoint_governance::profile::Profile;

const RULE: &str = "power";

/// Each of the many effects gets one in this many of the study's runs.
const RUNS_DIVISOR: u32 = 50;

/// Fewest runs of an effect.
const RUNS_MIN: u32 = 10;

/// Added rate of episodes with an event.
const RATES: [f64; 4] = [0.02, 0.05, 0.1, 0.2];

/// Added time, as a fraction of each episode's time; and more attempts, as a rate of the episodes.
const MORE: [f64; 4] = [0.1, 0.25, 0.5, 1.0];

/// Added amount of a measure in every episode, in margins of the profile.
const TOLERANCES: [f64; 4] = [1.0, 1.5, 2.0, 3.0];

pub(super) fn study(study: &Study) -> Result<Vec<StudyFigure>, BenchError> {
    let runs = (study.runs / RUNS_DIVISOR).max(RUNS_MIN);
    let mut findings = Vec::new();
    for profile in &study.profiles {
        for table in &study.recorded.harm {
            let under = format!("{}, {}", table.name, profile.name);
            let found = count(runs, &format!("equal {under}"), table, profile, |_, _| (), establishes_harm);
            let stated = Some(StatedBound::AtMost(profile.evaluation.alpha));
            findings.push(rate("harm", StudyMeasure::EqualRejectedForHarm, under, found, stated)?);
        }
        for effect in WorsenedMeasure::all().filter(|effect| effect.is_limited(profile)) {
            let table = study.recorded.harm.iter().find(|table| table.name.starts_with(effect.family()));
            let table = table.ok_or_else(|| missing("a table with harm"))?;
            for size in effect.sizes() {
                let under = format!("{}, {}, {}", effect.name(), effect.label(size, profile), profile.name);
                let worsen =
                    |draw: &mut SampleStream, pair: &mut Pair| effect.worsen(size, profile, draw, pair);
                let (found, of) = count(runs, &under, table, profile, worsen, is_found);
                let value = found as f64 / of as f64;
                findings.push(unjudged(RULE, StudyMeasure::WorseFound, under, of, value, "share"));
            }
        }
    }
    Ok(findings)
}

fn count(
    runs: u32,
    name: &str,
    table: &RecordedTable,
    profile: &Profile,
    worsen: impl Fn(&mut SampleStream, &mut Pair),
    is: fn(&BehaviorAssessment) -> bool,
) -> (u64, u64) {
    let mut draw = SampleStream::new(name);
    let found = (0..runs).filter(|_| {
        let mut pairs = draw.equal_pairs(table, profile.evaluation.sandbox_pairs);
        for pair in &mut pairs {
            worsen(&mut draw, pair);
        }
        let evidence = PairedEvidence { binding: binding(), pairs, hard_stops: Vec::new() };
        is(&behavior::assess(&evidence, &binding(), profile))
    });
    (found.count() as u64, runs.into())
}

fn is_found(found: &BehaviorAssessment) -> bool {
    found.assessment.outcome != BehaviorOutcome::Compatible
}

fn establishes_harm(found: &BehaviorAssessment) -> bool {
    found.harm.iter().any(HarmComparison::is_established)
}

/// The component that gets worse.
#[derive(Clone, Copy)]
enum WorsenedMeasure {
    Component(ComponentName),
    Harm(HarmKind),
}

impl WorsenedMeasure {
    fn all() -> impl Iterator<Item = Self> {
        let components = ComponentName::ALL.into_iter().map(Self::Component);
        components.chain(HarmKind::ALL.into_iter().map(Self::Harm))
    }

    fn name(self) -> &'static str {
        match self {
            Self::Component(name) => name.name(),
            Self::Harm(kind) => kind.name(),
        }
    }

    /// Whether the profile limits it: a rate that may rise by 1 is unlimited.
    fn is_limited(self, profile: &Profile) -> bool {
        match self {
            Self::Harm(kind) => !kind.unit().is_empty() || profile.harm.of(kind).mean < 1.0,
            Self::Component(_) => true,
        }
    }

    /// The version whose episodes are most affected.
    const fn family(self) -> &'static str {
        match self {
            Self::Harm(HarmKind::GripPeak | HarmKind::GripHeld | HarmKind::TouchSpeed | HarmKind::Slip) => {
                "grasp"
            }
            Self::Harm(
                HarmKind::ContactPeak
                | HarmKind::ContactHeld
                | HarmKind::ContactTime
                | HarmKind::LandingSpeed
                | HarmKind::DropHeight,
            ) => "place",
            Self::Component(_)
            | Self::Harm(
                HarmKind::ZoneClearance
                | HarmKind::ArmClearance
                | HarmKind::WorkspaceMargin
                | HarmKind::JointMargin
                | HarmKind::NearTime
                | HarmKind::Jerk
                | HarmKind::Energy
                | HarmKind::ClampedShare
                | HarmKind::ClampDepth
                | HarmKind::ExcessShare
                | HarmKind::ExcessDepth
                | HarmKind::DeniedShare,
            ) => "align",
        }
    }

    const fn sizes(self) -> [f64; 4] {
        match self {
            Self::Component(ComponentName::Time | ComponentName::Retry) => MORE,
            Self::Component(_) => RATES,
            Self::Harm(_) => TOLERANCES,
        }
    }

    fn label(self, size: f64, profile: &Profile) -> String {
        match self {
            Self::Component(ComponentName::Time) => format!("{:.0} % longer", 100.0 * size),
            Self::Component(_) => format!("in {:.0} % more", 100.0 * size),
            Self::Harm(kind) => {
                format!("{size} x its tolerance of {}", kind.format(profile.harm.of(kind).mean))
            }
        }
    }

    fn worsen(self, size: f64, profile: &Profile, draw: &mut SampleStream, pair: &mut Pair) {
        let one: &mut EpisodeValues = &mut pair.candidate;
        match self {
            Self::Component(ComponentName::Time) => one.time_s *= 1.0 + size,
            Self::Component(name) if draw.chance(size) => match name {
                ComponentName::Success => one.success = false,
                ComponentName::Retry => one.retries += 1,
                ComponentName::Violation => one.violation = true,
                ComponentName::Anomaly => one.anomaly = true,
                ComponentName::Recovery => one.recovery = true,
                ComponentName::Time => {}
            },
            Self::Component(_) => {}
            Self::Harm(kind) => {
                if let Some(harm) = &mut one.harm {
                    let more = size * profile.harm.of(kind).mean;
                    let value = harm.of_mut(kind);
                    *value += if kind.is_worse_when_lower() { -more } else { more };
                    *harm = harm.rounded();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::stats::TablesByOrigin;
    use holdpoint_governance::profile::ProfileName;

    /// The largest effect of every component is found, except that a new attempt costs little and counts against
    /// nothing alone.
    #[test]
    fn largest_effect_of_every_component_is_found() {
        let recorded = TablesByOrigin::read().unwrap();
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let judged = |effect: &WorsenedMeasure| {
            effect.name() != ComponentName::Retry.name() && effect.is_limited(&profile)
        };
        for effect in WorsenedMeasure::all().filter(judged) {
            let table = recorded.harm.iter().find(|table| table.name.starts_with(effect.family())).unwrap();
            let [.., largest] = effect.sizes();
            let worsen =
                |draw: &mut SampleStream, pair: &mut Pair| effect.worsen(largest, &profile, draw, pair);
            let (found, of) = count(4, effect.name(), table, &profile, worsen, is_found);
            assert_eq!(found, of, "{} {}", effect.name(), effect.label(largest, &profile));
        }
    }
}
