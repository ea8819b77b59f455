//! A question to people in `holdpoint status`: whom it waits for, and what it came to.

use holdpoint_approvals::{PersonState, Persons};
use holdpoint_governance::approval::Answer;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::{PromptView, Purpose};
use holdpoint_registry::{ApprovalEntry, ApprovalRequest};
use holdpoint_text::Untrusted;
use serde::Serialize;

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct WaitingRow {
    pub(super) version: CapabilityId,
    /// The first eight digits of the evidence's digest; an approval names them.
    pub(super) evidence: String,
    /// What is asked.
    pub(super) purpose: Purpose,
    pub(super) needed: u32,
    pub(super) approved_by: Vec<String>,
    /// Whether enough people approved, and it takes over when the sequence that runs is over.
    pub(super) granted: bool,
    /// Whether an engine asks; without one it is asked again by the next.
    pub(super) asked: bool,
    /// When it becomes a hold.
    pub(super) until: WallTime,
    /// The time that it is held against now.
    #[serde(skip)]
    pub(super) now: WallTime,
    /// Permissions that the active version does not have, or has at a lower level.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) new_permissions: Vec<Untrusted>,
}

impl WaitingRow {
    pub(super) fn asked(prompt: &PromptView, now: WallTime) -> Self {
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

    /// What the store holds of it, while no engine asks. Whether an answer counts is for the engine to say that comes up
    /// next.
    pub(super) fn stored(
        request: ApprovalRequest,
        purpose: Purpose,
        answers: &[ApprovalEntry],
        persons: &Persons,
        now: WallTime,
    ) -> Self {
        let is_enrolled =
            |who: &str| persons.named(who).is_some_and(|person| person.state == PersonState::Enrolled);
        let mut approved_by: Vec<String> = Vec::new();
        for answer in answers.iter().filter(|answer| answer.consumed_seq.is_none()) {
            let said = answer.signed.approval();
            let same = said.row_version == request.row_version
                && said.evidence_digest == request.evidence_digest
                && said.policy_digest == request.policy_digest
                && said.profile == request.profile
                && !said.break_glass
                && is_enrolled(&said.who);
            if same {
                // The last answer of a person is the one that stands.
                approved_by.retain(|who| *who != said.who);
                approved_by.extend((said.decision == Answer::Approve).then(|| said.who.clone()));
            }
        }
        // What was assessed of it is in the request.
        let asked: serde_json::Value = serde_json::from_str(&request.json).unwrap_or_default();
        let new = asked.get("new_permissions").and_then(serde_json::Value::as_array);
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
        let have =
            if self.approved_by.is_empty() { "nobody yet".to_owned() } else { self.approved_by.join(", ") };
        let new: Vec<String> = self.new_permissions.iter().map(|name| name.line().into_string()).collect();
        let new =
            if new.is_empty() { String::new() } else { format!("; new permissions: {}", new.join(", ")) };
        let purpose = match self.purpose {
            Purpose::Activation | Purpose::Emergency => "",
            Purpose::Release => " (its release)",
            Purpose::Review => " (the review of its emergency activation)",
        };
        let Self { version, evidence, .. } = self;
        if self.granted {
            return format!(
                "granted  {version} over the evidence {evidence}{purpose}: approved by {have}; it takes effect when the \
                 sequence that runs is over{new}"
            );
        }
        let (people, until) = (self.people(), self.until.as_deadline(self.now));
        if !self.asked {
            return format!(
                "waiting  {version} for an engine, which asks {people} to approve the evidence {evidence}{purpose} by {until}; \
                 on record as approved by {have}{new}"
            );
        }
        format!(
            "waiting  {version} for {people} to approve the evidence {evidence}{purpose} by {until}; approved by {have}{new}"
        )
    }

    fn people(&self) -> String {
        if self.needed == 1 { "one person".to_owned() } else { format!("{} people", self.needed) }
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_approvals::{Approval, Identity, Nonce};
    use holdpoint_governance::approval::Role;
    use holdpoint_governance::ids::Digest;
    use holdpoint_governance::profile::ProfileName;
    use holdpoint_registry::names::RequestState;

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

    /// Those who are enrolled, the first of them an administrator.
    fn enrolled(all: &[&Identity]) -> Persons {
        let mut persons = Persons::none("store");
        for who in all {
            let act = persons.enrolment(who.info(), true, all[0], "a test").unwrap();
            persons.push(&act).unwrap();
        }
        persons
    }

    fn answer(
        who: &Identity,
        decision: Answer,
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
        ApprovalEntry { signed: who.sign(approval).unwrap(), consumed_seq, at_ms: 0 }
    }

    #[test]
    fn without_an_engine_the_record_tells_who_approved() {
        let folder = tempfile::tempdir().unwrap();
        let person = |name: &str, role| Identity::create(folder.path(), name, role).unwrap();
        let ana = person("ana", Role::Admin);
        let [ben, eve, ida, tom] = ["ben", "eve", "ida", "tom"].map(|name| person(name, Role::Operator));
        let persons = enrolled(&[&ana, &ben, &eve, &ida]);
        let (asked, earlier) = (request("now"), request("then"));
        let answers = [
            answer(&ana, Answer::Approve, &asked, None),
            // Thought better of it.
            answer(&ben, Answer::Approve, &asked, None),
            answer(&ben, Answer::Reject, &asked, None),
            // Over other evidence, and used already.
            answer(&eve, Answer::Approve, &earlier, None),
            answer(&ida, Answer::Approve, &asked, Some(40)),
            // Nobody here.
            answer(&tom, Answer::Approve, &asked, None),
        ];
        let stored = |answers: &[ApprovalEntry]| {
            WaitingRow::stored(asked.clone(), Purpose::Activation, answers, &persons, WallTime::SCRIPT_EPOCH)
        };
        let row = stored(&answers);
        assert_eq!(row.approved_by, ["ana"]);
        let evidence = asked.evidence_digest.short();
        assert_eq!(
            row.line(),
            format!(
                "waiting  grasp@1.1.0 for an engine, which asks 2 people to approve the evidence {evidence} by 00:01:30 UTC, \
                 1 min left; on record as approved by ana; new permissions: zone tray"
            )
        );
        assert!(stored(&[]).line().contains("on record as approved by nobody yet"));
        let row = WaitingRow { asked: true, new_permissions: Vec::new(), ..row };
        assert_eq!(
            row.line(),
            format!(
                "waiting  grasp@1.1.0 for 2 people to approve the evidence {evidence} by 00:01:30 UTC, 1 min left; approved \
                 by ana"
            )
        );
    }

    #[test]
    fn what_enough_people_approved_waits_for_nobody() {
        let asked = request("now");
        let evidence = asked.evidence_digest.short();
        let approved_by = vec!["ana".to_owned(), "ben".to_owned()];
        let stored = WaitingRow::stored(
            asked,
            Purpose::Activation,
            &[],
            &Persons::none("store"),
            WallTime::SCRIPT_EPOCH,
        );
        let row = WaitingRow { approved_by, granted: true, new_permissions: Vec::new(), ..stored };
        assert_eq!(
            row.line(),
            format!(
                "granted  grasp@1.1.0 over the evidence {evidence}: approved by ana, ben; it takes effect when the \
                 sequence that runs is over"
            )
        );
    }
}
