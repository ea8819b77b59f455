//! The words of an approval prompt: the whole decision, readable by somebody who comes back after half an hour.
//!
//! The screen shows these lines and no others, and they are what is stored with the decision.

use super::prompt::Prompt;
use super::words::{kappa_line, reason_line, seconds, standing, taken_over};
use holdpoint_engine::explain::is_in_favour;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::profile::titled;
use holdpoint_protocol::snapshot::Purpose;
use holdpoint_text::Untrusted;

/// Reasons against it that are shown.
const REASONS_MAX: usize = 4;

/// The longest line, columns; the screen wraps them.
const WIDTH_MAX: usize = 400;

impl Prompt {
    /// What is decided, in full, line by line, sanitised.
    #[must_use]
    pub fn text(&self) -> Vec<String> {
        let seen = &self.seen;
        let (of, id, on) = (&seen.version, self.wanted_id(), &self.robot);
        let mut lines = vec![match seen.purpose {
            Purpose::Activation => {
                format!(
                    "Promote {of} ({id}) to active on {on}, profile {}?",
                    titled(seen.profile, seen.site.as_ref())
                )
            }
            Purpose::Release => format!("Release {of} ({id}) on {on}: lift its restriction?"),
            Purpose::Review => format!("Was it right to let {of} ({id}) in alone, in an emergency, on {on}?"),
            Purpose::Emergency => {
                format!(
                    "EMERGENCY: let {of} ({id}) in alone on {on}, profile {}?",
                    titled(seen.profile, seen.site.as_ref())
                )
            }
        }];
        if seen.purpose == Purpose::Emergency {
            let until = seconds(seen.deadline_ms);
            lines.push(format!(
                "Two people review it by {until}, or it is taken off; it is flagged until then"
            ));
        }
        if !seen.about.is_empty() {
            lines.push(seen.about.clone());
        }
        lines.push(match (seen.purpose, &seen.replaces) {
            (Purpose::Activation | Purpose::Emergency, None) => {
                "Replaces nothing: the family has no active version".to_owned()
            }
            (Purpose::Activation | Purpose::Emergency, Some(replaced)) => {
                format!("Replaces {replaced}, which stays pinned as the way back")
            }
            (Purpose::Release | Purpose::Review, None) => "There is no way back from it".to_owned(),
            (Purpose::Release | Purpose::Review, Some(back)) => format!("The way back is {back}"),
        });
        let stands = standing(self.evidence.state, &self.evidence.flags);
        lines.push(format!("It is {stands}; made by {}", seen.author));
        if let Some(deployment) = self.evidence.deployment {
            lines.push(format!("Deployment outcome so far: {deployment}"));
        }
        lines.extend(self.evidence.stale_line());
        self.evidence_lines(&mut lines);
        let listed = |items: &[String]| if items.is_empty() { "none".to_owned() } else { items.join(", ") };
        lines.push(format!("New permissions: {}", listed(&seen.new_permissions)));
        let changes = seen.changes.lines();
        if changes.is_empty() {
            lines.push("Changes: none known of permissions, parameters and interface".to_owned());
        }
        lines.extend(changes.iter().map(|line| format!("Change: {line}")));
        lines.extend(self.evidence.conditions.iter().map(|condition| format!("Condition: {condition}")));
        if seen.untested.is_empty() {
            lines.push("Not tested: nothing is known to be missing".to_owned());
        }
        lines.extend(seen.untested.iter().map(|what| format!("Not tested: {what}")));
        if matches!(seen.purpose, Purpose::Activation | Purpose::Emergency) {
            lines.push(format!("If it gets worse: {}", seen.on_drift));
        }
        let by =
            if seen.approved_by.is_empty() { "nobody yet".to_owned() } else { seen.approved_by.join(", ") };
        lines.push(format!("Approvals: {} of {} ({by})", seen.approved_by.len(), seen.needed));
        let by = seconds(seen.deadline_ms);
        lines.push(match seen.purpose {
            _ if seen.granted => format!("Approved: it {}", taken_over(self.stopped)),
            Purpose::Activation => format!("Nobody answers by {by}: it is held, never approved"),
            Purpose::Release => format!("Nobody answers by {by}: it stays restricted"),
            Purpose::Review => {
                format!("Nobody answers by {by}: it is taken off; nothing of its family is promoted before")
            }
            Purpose::Emergency => "Nobody answers: it stays held".to_owned(),
        });
        lines.into_iter().map(|line| Untrusted::new(line).display(WIDTH_MAX).into_string()).collect()
    }

    fn evidence_lines(&self, lines: &mut Vec<String>) {
        let evidence = &self.evidence;
        lines.extend(
            evidence.dimensions.iter().map(|dimension| format!("Evidence: {}", kappa_line(dimension))),
        );
        if let Some(pairs) = &evidence.pairs {
            lines.push(format!(
                "Sandbox: {} paired episodes, success {:.3} [{:.3}, {:.3}] against {:.3} [{:.3}, {:.3}]",
                pairs.n,
                pairs.candidate.success,
                pairs.candidate_success[0],
                pairs.candidate_success[1],
                pairs.active.success,
                pairs.active_success[0],
                pairs.active_success[1]
            ));
        }
        if let Some(shadow) = &evidence.shadow {
            lines.push(format!(
                "Shadow: {} sequences, divergence output {:.3}, governance {:.3}, envelope {:.3}",
                shadow.n, shadow.output, shadow.governance, shadow.envelope
            ));
        }
        // What speaks for it is said above, with its numbers; that nobody has answered yet is why this is open.
        let open = evidence
            .reasons
            .iter()
            .filter(|reason| !is_in_favour(reason.code) && reason.code != ReasonCode::ApprovalPending);
        lines.extend(open.take(REASONS_MAX).map(|reason| format!("Asked because: {}", reason_line(reason))));
        lines.extend(self.seen.why.iter().map(|line| format!("Why: {line}")));
        lines.push(format!("Evidence digest {}", self.seen.evidence.short()));
    }
}
