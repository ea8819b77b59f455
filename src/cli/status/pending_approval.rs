//! An approval request in `holdpoint status`: the approvers it waits for, and its result.

use holdpoint_approvals::{PersonDirectory, PersonState};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind};
use holdpoint_store::{ApprovalEntry, ApprovalRequest};
use holdpoint_text::Untrusted;
use holdpoint_wording::program::status::{ApprovalLine, ApprovalProgress, approval_request};
use serde::Serialize;

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct PendingApprovalRow {
    pub(super) version: CapabilityId,
    /// The first eight digits of the evidence's digest; an approval names them.
    pub(super) evidence: String,
    /// The subject of the request.
    pub(super) purpose: RequestKind,
    pub(super) needed: u32,
    pub(super) approved_by: Vec<String>,
    /// Whether the quorum is reached, and the version takes control after the current sequence.
    pub(super) granted: bool,
    /// Whether an engine asks now; otherwise the next engine asks again.
    pub(super) asked: bool,
    /// The deadline, after which the version stays on hold.
    pub(super) until: WallTime,
    /// The current time, compared with the deadline.
    #[serde(skip)]
    pub(super) now: WallTime,
    /// Permissions that the active version lacks, or has at a lower level.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) new_permissions: Vec<Untrusted>,
}

impl PendingApprovalRow {
    pub(super) fn from_request(prompt: &ApprovalRequestView, now: WallTime) -> Self {
        Self {
            version: prompt.version.clone(),
            evidence: prompt.evidence.short(),
            purpose: prompt.purpose,
            needed: prompt.needed,
            approved_by: prompt.approved_by.clone(),
            granted: prompt.granted,
            asked: true,
            until: prompt.until,
            now,
            new_permissions: prompt.new_permissions.iter().map(|name| name.as_str().into()).collect(),
        }
    }

    /// The stored request, while no engine asks. The next engine decides whether the answers count.
    pub(super) fn stored(
        request: ApprovalRequest,
        purpose: RequestKind,
        answers: &[ApprovalEntry],
        persons: &PersonDirectory,
        now: WallTime,
    ) -> Self {
        let is_enrolled =
            |who: &str| persons.named(who).is_some_and(|person| person.state == PersonState::Enrolled);
        let mut approved_by: Vec<String> = Vec::new();
        for answer in answers.iter().filter(|answer| answer.consumed_seq.is_none()) {
            let approval = answer.signed.approval();
            let same = approval.row_version == request.row_version
                && approval.evidence_digest == request.evidence_digest
                && approval.policy_digest == request.policy_digest
                && approval.profile == request.profile
                && !approval.break_glass
                && is_enrolled(&approval.who);
            if same {
                // The last answer of a person counts.
                approved_by.retain(|who| *who != approval.who);
                approved_by
                    .extend((approval.decision == ApprovalDecision::Approve).then(|| approval.who.clone()));
            }
        }
        // The request contains its assessment.
        let document: serde_json::Value = serde_json::from_str(&request.json).unwrap_or_default();
        let new = document.get("new_permissions").and_then(serde_json::Value::as_array);
        let new = new.into_iter().flatten().filter_map(serde_json::Value::as_str);
        Self {
            new_permissions: new.map(Into::into).collect(),
            version: request.version,
            evidence: request.evidence_digest.short(),
            purpose,
            needed: request.needed,
            approved_by,
            granted: false,
            asked: false,
            until: request.until,
            now,
        }
    }

    pub(super) fn line(&self) -> String {
        let new: Vec<String> = self.new_permissions.iter().map(|name| name.line().into_string()).collect();
        let state = match (self.granted, self.asked) {
            (true, _) => ApprovalProgress::Granted,
            (false, false) => ApprovalProgress::OnRecord,
            (false, true) => ApprovalProgress::Asked,
        };
        let line = ApprovalLine {
            version: &self.version,
            evidence: &self.evidence,
            purpose: self.purpose,
            needed: self.needed,
            approved_by: &self.approved_by,
            new_permissions: &new,
            until: self.until,
            now: self.now,
        };
        approval_request(&line, state)
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_approvals::{Approval, Identity, Nonce};
    use holdpoint_governance::approval::Role;
    use holdpoint_governance::ids::Digest;
    use holdpoint_governance::profile::ProfileName;
    use holdpoint_store::RequestState;

    use super::*;

    fn request(evidence: &str) -> ApprovalRequest {
        ApprovalRequest {
            id: "approval:grasp@1.1.0".to_owned(),
            version: "grasp@1.1.0".parse().unwrap(),
            row_version: 7,
            evidence_digest: Digest::of_parts("a test", &[evidence.as_bytes()]),
            policy_digest: Digest::of_parts("a test", &[b"policy"]),
            profile: ProfileName::Human,
            needed: 2,
            until: WallTime::SCRIPT_EPOCH.plus_ms(90_000),
            state: RequestState::Open,
            json: r#"{"new_permissions":["zone tray"]}"#.to_owned(),
        }
    }

    /// The enrolled persons, the first of them an administrator.
    fn enrolled(all: &[&Identity]) -> PersonDirectory {
        let mut persons = PersonDirectory::none("store");
        for who in all {
            let act = persons.enrolment(who.info(), true, all[0], "a test").unwrap();
            persons.push(&act).unwrap();
        }
        persons
    }

    fn answer(
        who: &Identity,
        decision: ApprovalDecision,
        over: &ApprovalRequest,
        consumed_seq: Option<u64>,
    ) -> ApprovalEntry {
        let approval = Approval {
            who: String::new(),
            role: Role::Operator,
            decision,
            reason: "evidence read".to_owned(),
            version: over.version.clone(),
            candidate_digest: Digest::of_parts("a test", &[b"candidate"]),
            row_version: over.row_version,
            evidence_digest: over.evidence_digest,
            policy_digest: over.policy_digest,
            profile: over.profile,
            store_id: "store".to_owned(),
            nonce: Nonce::random().unwrap(),
            not_after_ms: WallTime::SCRIPT_EPOCH.plus_ms(60_000).ms().unsigned_abs(),
            break_glass: false,
            shown: None,
        };
        ApprovalEntry { signed: who.sign(approval).unwrap(), consumed_seq, at_ms: 0, wall_ms: None }
    }

    #[test]
    fn approvers_are_read_from_the_record_without_an_engine() {
        let folder = tempfile::tempdir().unwrap();
        let person = |name: &str, role| Identity::create(folder.path(), name, role).unwrap();
        let ana = person("ana", Role::Admin);
        let [ben, eve, ida, tom] = ["ben", "eve", "ida", "tom"].map(|name| person(name, Role::Operator));
        let persons = enrolled(&[&ana, &ben, &eve, &ida]);
        let (current, earlier) = (request("now"), request("then"));
        let answers = [
            answer(&ana, ApprovalDecision::Approve, &current, None),
            // Changed their answer.
            answer(&ben, ApprovalDecision::Approve, &current, None),
            answer(&ben, ApprovalDecision::Reject, &current, None),
            // Over other evidence, and already used.
            answer(&eve, ApprovalDecision::Approve, &earlier, None),
            answer(&ida, ApprovalDecision::Approve, &current, Some(40)),
            // Not enrolled here.
            answer(&tom, ApprovalDecision::Approve, &current, None),
        ];
        let stored = |answers: &[ApprovalEntry]| {
            PendingApprovalRow::stored(
                current.clone(),
                RequestKind::Activation,
                answers,
                &persons,
                WallTime::SCRIPT_EPOCH,
            )
        };
        let row = stored(&answers);
        assert_eq!(row.approved_by, ["ana"]);
        let evidence = current.evidence_digest.short();
        assert_eq!(
            row.line(),
            format!(
                "waiting  grasp@1.1.0 for an engine, which asks 2 people to approve the evidence {evidence} by 00:01:30 UTC, \
                 1 min left; on record as approved by ana; new permissions: zone tray"
            )
        );
        assert!(stored(&[]).line().contains("no one"));
        let row = PendingApprovalRow { asked: true, new_permissions: Vec::new(), ..row };
        assert_eq!(
            row.line(),
            format!(
                "waiting  grasp@1.1.0 for 2 people to approve the evidence {evidence} by 00:01:30 UTC, 1 min left; approved \
                 by ana"
            )
        );
    }

    #[test]
    fn granted_request_needs_no_more_approvers() {
        let current = request("now");
        let evidence = current.evidence_digest.short();
        let approved_by = vec!["ana".to_owned(), "ben".to_owned()];
        let stored = PendingApprovalRow::stored(
            current,
            RequestKind::Activation,
            &[],
            &PersonDirectory::none("store"),
            WallTime::SCRIPT_EPOCH,
        );
        let row = PendingApprovalRow { approved_by, granted: true, new_permissions: Vec::new(), ..stored };
        assert_eq!(
            row.line(),
            format!(
                "granted  grasp@1.1.0 over the evidence {evidence}: approved by ana, ben; it takes effect \
                 after the current sequence"
            )
        );
    }
}
