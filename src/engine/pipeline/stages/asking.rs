//! What people are shown when they are asked: everything a decision needs, in sentences that are true.
//!
//! Derives; decides nothing. What was not measured is said, never passed over.

use crate::pipeline::dossier::Dossier;
use crate::pipeline::manager::{Fault, UpgradeManager};
use crate::pipeline::stages::activation::{Prompt, secs_to_ms};
use holdpoint_governance::approval::Answer;
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::outcome::{Assessment, Basis};
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::snapshot::PromptView;
use holdpoint_registry::AuditBody;

/// The longest text of a screen that is kept with a decision, bytes.
pub const SHOWN_BYTES_MAX: usize = 16 * 1024;

impl UpgradeManager {
    /// What waits for people.
    #[must_use]
    pub fn prompts(&self) -> Vec<PromptView> {
        self.prompts.iter().map(|(id, prompt)| self.prompt_view(id, prompt)).collect()
    }

    pub(in crate::pipeline) fn prompt_view(&self, id: &CapabilityId, prompt: &Prompt) -> PromptView {
        let approved = prompt.votes.iter().filter(|vote| vote.answer == Answer::Approve);
        let quorum = prompt.request.quorum;
        let empty = Dossier::default();
        let dossier = self.dossier_of(id).unwrap_or(&empty);
        PromptView {
            id: prompt.id.clone(),
            version: id.clone(),
            replaces: prompt.replaces.clone(),
            candidate: prompt.request.subject.candidate,
            row_version: prompt.row_version,
            evidence: prompt.evidence,
            policy: self.context_digest,
            profile: self.profile.name,
            needed: u32::from(quorum),
            approved_by: approved.map(|vote| vote.person.clone()).collect(),
            deadline_ms: prompt.deadline_ms,
            valid_until_ms: self.clock.now_ms().saturating_add(secs_to_ms(self.profile.approval.valid_s)),
            store_id: self.ledger.store().store_id().to_owned(),
            asked_ms: prompt.asked_ms,
            tier: tier(self.profile.name, quorum, prompt.review),
            author: prompt.request.author.clone(),
            new_permissions: dossier.new_permissions.clone(),
            untested: untested(dossier),
            on_drift: self.on_drift(prompt),
        }
    }

    /// What happens when a version gets worse after its activation.
    fn on_drift(&self, prompt: &Prompt) -> String {
        let (monitor, window) = (&self.profile.monitor, self.profile.activation.provisional_episodes);
        let back = prompt.replaces.as_ref().map_or_else(
            || "it is taken off and the family stops, for there is no way back".to_owned(),
            |id| format!("{id} takes over again"),
        );
        let share = 100.0 * monitor.restrict_factor;
        format!(
            "after a safety event or an established rise of a rate {back}; a drifting rate lowers speed and force to \
             {share:.0} % and asks people, for {:.0} s; confirmed after {window} live tasks",
            monitor.escalation_deadline_s
        )
    }

    /// The record of what somebody had on the screen when deciding.
    pub(in crate::pipeline) fn shown_record(
        id: &CapabilityId,
        who: &str,
        nonce: &str,
        shown: &str,
    ) -> Result<AuditBody, Fault> {
        let digest = Digest::of_parts("holdpoint.shown.v1", &[shown.as_bytes()]);
        let body = serde_json::json!({ "by": who, "nonce": nonce, "digest": digest, "text": shown });
        let body = serde_json::to_string(&body)?;
        Ok(AuditBody { kind: holdpoint_governance::record::RecordKind::Shown, subject: id.to_string(), body })
    }
}

/// How much friction a decision needs (reference A6).
const fn tier(profile: ProfileName, quorum: u8, review: bool) -> u8 {
    if quorum >= 2 || review {
        return 2;
    }
    match profile {
        ProfileName::Sim => 0,
        ProfileName::Real => 1,
        ProfileName::Human => 2,
    }
}

/// What was not measured, one sentence each.
pub(crate) fn untested(dossier: &Dossier) -> Vec<String> {
    let mut said =
        vec!["It was not tried on a physical arm: everything was measured in simulation".to_owned()];
    match &dossier.kappas {
        None => said.push("Nothing was assessed yet".to_owned()),
        Some(kappas) => said.extend(estimates(kappas)),
    }
    if dossier.pairs.is_empty() {
        said.push("It was not compared with the active version episode by episode".to_owned());
    }
    for kind in DrillKind::ALL {
        let feasible = dossier.drills.map_or(0, |(candidate, _)| candidate.of(kind).feasible());
        if feasible == 0 {
            said.push(format!("No {} drill was carried out with it", kind.name()));
        }
    }
    if dossier.twins.is_empty() {
        said.push("It was not run in a twin of the live world".to_owned());
    }
    said
}

fn estimates(kappas: &Kappas) -> Vec<String> {
    fn of<O>(name: &str, assessment: &Assessment<O>) -> Option<String> {
        let text = match (assessment.basis, assessment.kappa) {
            (Basis::Measured, Some(_)) => return None,
            (_, None) => format!("There is no value for {name}: it was not measured"),
            (Basis::Estimated, Some(_)) => format!("The value for {name} is an estimate, not measured"),
        };
        Some(text)
    }
    [
        of("interface compatibility", &kappas.interface),
        of("policy compatibility", &kappas.policy),
        of("behaviour", &kappas.behavior),
        of("recovery", &kappas.recovery),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::evidence::{DrillTally, Drills};

    #[test]
    fn friction_follows_profile_and_quorum() {
        use ProfileName::{Human, Real, Sim};
        for (profile, quorum, review, expected) in [
            (Sim, 0, false, 0),
            (Sim, 1, false, 0),
            (Sim, 2, false, 2),
            (Sim, 1, true, 2),
            (Real, 1, false, 1),
            (Real, 2, false, 2),
            (Human, 1, false, 2),
        ] {
            assert_eq!(tier(profile, quorum, review), expected, "{profile:?} {quorum} {review}");
        }
    }

    #[test]
    fn what_was_not_tested_is_said() {
        let mut dossier = Dossier::default();
        let nothing = untested(&dossier);
        assert!(nothing.iter().any(|text| text.contains("rollback drill")), "{nothing:?}");
        assert!(nothing.iter().any(|text| text.contains("twin")), "{nothing:?}");
        let ran = DrillTally { passed: 1, failed: 0, infeasible: 0 };
        let candidate = Drills { rollback: ran, ..Drills::default() };
        dossier.drills = Some((candidate, Drills::default()));
        let some = untested(&dossier);
        assert!(!some.iter().any(|text| text.contains("rollback drill")), "{some:?}");
        assert!(some.iter().any(|text| text.contains("abort drill")), "{some:?}");
        assert!(some.iter().any(|text| text.contains("physical arm")), "{some:?}");
    }
}
