//! What an evaluation left unmeasured, from its evidence file.

use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::Dimension;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::outcome::{Assessment, Basis};
use holdpoint_protocol::approval_document::UntestedAspect;

use crate::evidence_file::EvidenceFile;

/// What was not measured.
#[must_use]
pub fn untested(evidence_file: &EvidenceFile) -> Vec<UntestedAspect> {
    let mut aspects = vec![UntestedAspect::PhysicalArm];
    match &evidence_file.kappas {
        None => aspects.push(UntestedAspect::Everything),
        Some(kappas) => aspects.extend(estimates(kappas)),
    }
    if evidence_file.pairs.is_empty() {
        aspects.push(UntestedAspect::Pairs);
    }
    for kind in DrillKind::ALL {
        let feasible = evidence_file.drills.map_or(0, |(candidate, _)| candidate.of(kind).feasible());
        if feasible == 0 {
            aspects.push(UntestedAspect::Drill(kind));
        }
    }
    if evidence_file.twins.is_empty() {
        aspects.push(UntestedAspect::Twin);
    }
    aspects
}

fn estimates(kappas: &Kappas) -> Vec<UntestedAspect> {
    fn of<O>(dimension: Dimension, assessment: &Assessment<O>) -> Option<UntestedAspect> {
        match (assessment.basis, assessment.kappa) {
            (Basis::Measured, Some(_)) => None,
            (_, None) => Some(UntestedAspect::Unmeasured(dimension)),
            (Basis::Estimated, Some(_)) => Some(UntestedAspect::Estimated(dimension)),
        }
    }
    [
        of(Dimension::Interface, &kappas.interface),
        of(Dimension::Policy, &kappas.policy),
        of(Dimension::Behavior, &kappas.behavior),
        of(Dimension::Recovery, &kappas.recovery),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::evidence::{DrillTallies, DrillTally};

    #[test]
    fn untested_aspects_are_listed() {
        use UntestedAspect::{Drill, Everything, Pairs, PhysicalArm, Twin};
        let mut evidence_file = EvidenceFile::default();
        let drills = DrillKind::ALL.map(Drill);
        let nothing = [&[PhysicalArm, Everything, Pairs][..], &drills, &[Twin]].concat();
        assert_eq!(untested(&evidence_file), nothing);
        let ran = DrillTally { passed: 1, failed: 0, infeasible: 0, failed_alone: 0 };
        let candidate = DrillTallies { rollback: ran, ..DrillTallies::default() };
        evidence_file.drills = Some((candidate, DrillTallies::default()));
        let some = untested(&evidence_file);
        assert!(!some.contains(&Drill(DrillKind::Rollback)), "{some:?}");
        assert_eq!(some.len(), nothing.len() - 1, "{some:?}");
    }
}
