//! Parts of an approval request in words: what was not tested, the response to a drift, and why it is refused.

use std::borrow::Cow;

use holdpoint_governance::decision::Dimension;
use holdpoint_governance::profile::MonitorSettings;
use holdpoint_governance::strictness::Strictness;
use holdpoint_protocol::approval_document::{
    AnswerVoidCause, DriftResponse, QuestionRefusal, UntestedAspect,
};
use holdpoint_protocol::signing_refusal::SigningRefusal;

/// What was not tested, one sentence.
#[must_use]
pub fn untested(of: UntestedAspect) -> String {
    use UntestedAspect as U;
    match of {
        U::PhysicalArm => {
            "It was not tried in the live cell: everything was measured in trial cells".to_owned()
        }
        U::Everything => "Nothing was assessed yet".to_owned(),
        U::Unmeasured(what) => format!("There is no value for {}: it was not measured", compatibility(what)),
        U::Estimated(what) => format!("The value for {} is an estimate, not measured", compatibility(what)),
        U::Pairs => "It was not compared with the active version episode by episode".to_owned(),
        U::Drill(kind) => format!("No {} drill was carried out with it", kind.name()),
        U::Twin => "It was not run in a twin of the live world".to_owned(),
    }
}

const fn compatibility(of: Dimension) -> &'static str {
    match of {
        Dimension::Interface => "interface compatibility",
        Dimension::Policy => "policy compatibility",
        other => other.name(),
    }
}

/// The response if a version gets worse after its activation, and the condition of its confirmation.
#[must_use]
pub fn drift_response(of: &DriftResponse) -> String {
    let back = of.back.as_ref().map_or_else(
        || "the version is deactivated and the family stops, because it has no rollback target".to_owned(),
        |id| format!("{id} takes over again"),
    );
    let response = if of.coupled {
        format!("after a safety event or the first warning of a chart {back}, without asking an operator")
    } else {
        format!(
            "after a safety event or an established rise of a rate {back}; a drifting rate lowers speed and force \
             to {:.0} % and asks people, for {:.0} s",
            100.0 * of.restricted_to,
            of.answer_within_s
        )
    };
    // The live window alone settles no concern.
    let settled = if of.in_doubt { " and once fresh evidence settles its concern" } else { "" };
    let limits = of.limits.as_ref().map_or_else(String::new, |limits| format!("; {limits}"));
    format!("{response}; confirmed after {} live tasks{settled}{limits}", of.confirmed_after)
}

/// The levels of the charts under stricter thresholds, with the profile's.
#[must_use]
pub fn stricter_levels(strictness: &Strictness, plain: &MonitorSettings) -> String {
    let held = strictness.applied(plain);
    format!(
        "a chart warns at {} (plain {}) and trips at {} (plain {})",
        held.cusum_limit, plain.cusum_limit, held.false_alarm_episodes, plain.false_alarm_episodes
    )
}

/// Why people are asked to lift a restriction.
#[must_use]
pub fn release_cause(by: &str, reason: &str) -> String {
    format!("{by} asks for it: {reason}")
}

/// Why people review an emergency activation. `reason` is that of its approval; absent if the store has none.
#[must_use]
pub fn review_cause(by: &str, reason: Option<&str>, is_overdue: bool) -> String {
    let reason = reason.unwrap_or("its approval is not in the store");
    if is_overdue {
        format!("{by} activated it alone ({reason}); it was not reviewed in time and is demoted")
    } else {
        format!("{by} activated it alone ({reason}); without a review by the deadline it is demoted")
    }
}

/// Why a request or an answer is refused.
#[must_use]
pub fn refusal(of: &QuestionRefusal) -> String {
    match of {
        QuestionRefusal::NothingPending { purpose, version } => {
            format!("nothing waits for a decision on the {purpose} of {version}")
        }
        QuestionRefusal::TooManyRequests { max } => {
            format!("{max} requests for open questions are remembered already")
        }
        QuestionRefusal::AnswerVoid { version, cause } => {
            format!("the decision on {version} counts for nothing: {}", void_cause(*cause))
        }
        QuestionRefusal::NoReason => "a decision needs a reason that can be read".to_owned(),
        QuestionRefusal::NotWaiting { version } => format!("nothing waits for a decision on {version}"),
        QuestionRefusal::Ended { version, until } => {
            format!("the request about {version} was open until {until}")
        }
        QuestionRefusal::SubjectChanged { version } => {
            format!("the decision on {version} is over something that has changed since")
        }
        QuestionRefusal::DisplayChanged { version } => {
            format!("what people were shown of {version} has changed since; they are asked again")
        }
        QuestionRefusal::AnsweredAlready { name, answer, version } => format!(
            "{name} has answered {} on {version} already; the same answer is not taken twice",
            answer.name()
        ),
        QuestionRefusal::NoName { name } => {
            format!("{name:?} is not enrolled in this store: it is no name of a person")
        }
        QuestionRefusal::NotEnrolled { name, .. } => {
            format!("{name} is not enrolled in this store, and nothing that they sign counts")
        }
        QuestionRefusal::KeyRevoked { name, by } => {
            format!("the key of {name} was revoked by {by}, and nothing that it signs counts")
        }
        QuestionRefusal::KeyUnprotected { name, profile } => {
            format!("the key of {name} has no passphrase, and the profile {profile} requires one")
        }
        QuestionRefusal::AdministratorUnprotected { name, profile: None } => {
            format!("the key of {name} has no passphrase, although the act says that it was protected")
        }
        QuestionRefusal::AdministratorUnprotected { name, profile: Some(profile) } => format!(
            "the key of {name} has no passphrase; the profile {profile} requires one for enrolling people"
        ),
        QuestionRefusal::NotConfirmed { name, profile, enrolled_by, .. } => {
            let by = enrolled_by.as_deref().unwrap_or("no administrator");
            format!(
                "{name} is not confirmed, and {by} enrolled them with an unencrypted key: the profile {profile} \
                 does not count their approvals"
            )
        }
    }
}

/// The next step after a refusal; absent if there is none.
#[must_use]
pub fn refusal_hint(of: &QuestionRefusal) -> Option<Cow<'static, str>> {
    let hint: Cow<'static, str> = match of {
        QuestionRefusal::NothingPending { .. } | QuestionRefusal::NotWaiting { .. } => {
            "see `holdpoint status`".into()
        }
        QuestionRefusal::TooManyRequests { .. } | QuestionRefusal::NoReason => return None,
        QuestionRefusal::AnswerVoid { .. } | QuestionRefusal::DisplayChanged { .. } => {
            "look at the question again and decide again".into()
        }
        QuestionRefusal::Ended { version, .. } => {
            format!("`holdpoint resume {}` has people asked again", version.family).into()
        }
        QuestionRefusal::SubjectChanged { .. } => "read the request again and decide again".into(),
        QuestionRefusal::AnsweredAlready { .. } => {
            "`holdpoint status` shows whom it waits for; another answer of the same person is taken".into()
        }
        QuestionRefusal::NoName { .. } => "`holdpoint identity list` lists the persons of the store".into(),
        QuestionRefusal::NotEnrolled { name, administrator } => {
            format!("`holdpoint identity enroll {name} --by {administrator} --reason TEXT` adds their key").into()
        }
        QuestionRefusal::KeyRevoked { .. } => {
            "an enrolled person must decide; see `holdpoint identity list`".into()
        }
        QuestionRefusal::KeyUnprotected { name, .. } => {
            format!("`holdpoint identity passphrase {name}` sets one; then try again").into()
        }
        QuestionRefusal::AdministratorUnprotected { name, .. } => {
            format!("`holdpoint identity passphrase {name}` sets one and keeps the key").into()
        }
        QuestionRefusal::NotConfirmed { name, confirmer: Some(by), .. } => format!(
            "`holdpoint identity confirm {name} --by {by} --reason TEXT` confirms them, once that key is protected"
        )
        .into(),
        QuestionRefusal::NotConfirmed { confirmer: None, .. } => {
            "no administrator of this store can confirm them; see the guide on persons and roles".into()
        }
    };
    Some(hint)
}

/// Why the signature under a request does not count, or is missing.
#[must_use]
pub fn signing_refusal(of: &SigningRefusal) -> String {
    use SigningRefusal as S;
    match of {
        S::Unsigned { profile } => format!(
            "this gives authority, and under the profile {profile} an enrolled person signs such a request"
        ),
        S::TooManyUsed { max } => {
            format!("{max} signed requests were made within minutes; wait for some to expire")
        }
        S::OtherStore { name } => format!("the request of {name} was signed for another store"),
        S::EngineEnded { name } => format!("the request of {name} was signed for an engine that has ended"),
        S::OtherRequest { name } => format!("{name} signed another request than this"),
        S::OtherPerson { name } => format!("the request names another person than {name}, who signed it"),
        S::Expired { name } => format!("the signature of {name} under this request has expired"),
        S::ValidTooLong { name, max_s } => {
            format!("the signature of {name} under this request would count for more than {max_s} s")
        }
        S::UsedAlready { name } => format!("the signature of {name} under this request was used already"),
        S::RoleGivesNothing { name, role } => {
            format!("{name} is enrolled as {role}, a role that starts and resumes nothing")
        }
    }
}

/// The next step after such a refusal; absent if there is none.
#[must_use]
pub const fn signing_refusal_hint(of: &SigningRefusal) -> Option<&'static str> {
    use SigningRefusal as S;
    match of {
        S::Unsigned { .. } => {
            Some("`--as NAME` signs it, and `:as NAME` in the console; see the guide on the socket")
        }
        S::OtherStore { .. } | S::EngineEnded { .. } | S::Expired { .. } | S::UsedAlready { .. } => {
            Some("sign it again, with a current snapshot of this engine")
        }
        S::ValidTooLong { .. } => Some("take `signing.until_ms` of a snapshot"),
        S::RoleGivesNothing { .. } => Some("an operator, an engineer or a safety officer signs it"),
        S::TooManyUsed { .. } | S::OtherRequest { .. } | S::OtherPerson { .. } => None,
    }
}

const fn void_cause(of: AnswerVoidCause) -> &'static str {
    match of {
        AnswerVoidCause::NotDisplayed => "it is signed over nothing that was shown",
        AnswerVoidCause::RequestClosed => "it answers a request that is not open",
        AnswerVoidCause::ValidTooLong => "it would count for longer than an answer may",
        AnswerVoidCause::OtherRenderer => "another version of the program put the question into words",
        AnswerVoidCause::OtherStoreKey => "it is signed for a store with another key",
        AnswerVoidCause::OtherFacts => "the facts that were shown are not those of the question",
        AnswerVoidCause::OtherLines => "the lines that were shown are not those of the question",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::approval::ApprovalDecision;
    use holdpoint_governance::condition::Condition;
    use holdpoint_governance::evidence::DrillKind;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_governance::wall_time::WallTime;
    use holdpoint_protocol::snapshot::RequestKind;

    #[test]
    fn a_request_of_people_names_its_cause() {
        assert_eq!(release_cause("mia", "the camera is fixed"), "mia asks for it: the camera is fixed");
        assert_eq!(
            review_cause("mia", Some("parts fall"), false),
            "mia activated it alone (parts fall); without a review by the deadline it is demoted"
        );
        assert_eq!(
            review_cause("engine", None, true),
            "engine activated it alone (its approval is not in the store); it was not reviewed in time and is demoted"
        );
    }

    #[test]
    fn every_untested_aspect_has_its_sentence() {
        use UntestedAspect as U;
        for (of, text) in [
            (U::PhysicalArm, "It was not tried in the live cell: everything was measured in trial cells"),
            (U::Everything, "Nothing was assessed yet"),
            (
                U::Unmeasured(Dimension::Interface),
                "There is no value for interface compatibility: it was not measured",
            ),
            (
                U::Estimated(Dimension::Policy),
                "The value for policy compatibility is an estimate, not measured",
            ),
            (U::Estimated(Dimension::Recovery), "The value for recovery is an estimate, not measured"),
            (U::Pairs, "It was not compared with the active version episode by episode"),
            (U::Drill(DrillKind::Rollback), "No rollback drill was carried out with it"),
            (U::Twin, "It was not run in a twin of the live world"),
        ] {
            assert_eq!(untested(of), text);
        }
    }

    /// Regression: a version with a concern was confirmed hundreds of tasks later than its approval request stated.
    #[test]
    fn a_drift_response_names_target_and_confirmation() {
        let response = DriftResponse {
            back: None,
            coupled: false,
            restricted_to: 0.5,
            answer_within_s: 60.0,
            confirmed_after: 100,
            in_doubt: false,
            limits: None,
        };
        assert_eq!(
            drift_response(&response),
            "after a safety event or an established rise of a rate the version is deactivated and the family stops, \
             because it has no rollback target; a drifting rate lowers speed and force to 50 % and asks people, for 60 s; \
             confirmed after 100 live tasks"
        );
        let strict = DriftResponse {
            back: Some("grasp@1.0.0".parse().unwrap()),
            coupled: true,
            in_doubt: true,
            limits: Some("charts at half their level".to_owned()),
            ..response
        };
        assert_eq!(
            drift_response(&strict),
            "after a safety event or the first warning of a chart grasp@1.0.0 takes over again, without asking an \
             operator; confirmed after 100 live tasks and once fresh evidence settles its concern; charts at half their \
             level"
        );
    }

    #[test]
    fn stricter_levels_stand_beside_those_of_the_profile() {
        let strictness = Strictness::of(&[Condition::StricterThresholds { factor: 0.5 }]);
        let sim = Profile::builtin(ProfileName::Sim).unwrap();
        assert_eq!(
            stricter_levels(&strictness, &sim.monitor),
            "a chart warns at 2.75 (plain 5.5) and trips at 1000 (plain 2000)"
        );
    }

    #[test]
    fn a_refusal_names_version_and_cause() {
        let version = || "grasp@1.1.0".parse().unwrap();
        let pending = QuestionRefusal::NothingPending { purpose: RequestKind::Review, version: version() };
        assert_eq!(refusal(&pending), "nothing waits for a decision on the review of grasp@1.1.0");
        assert_eq!(refusal_hint(&pending).as_deref(), Some("see `holdpoint status`"));
        let full = QuestionRefusal::TooManyRequests { max: 4096 };
        assert_eq!(refusal(&full), "4096 requests for open questions are remembered already");
        assert_eq!(refusal_hint(&full), None);
        for (cause, text) in [
            (AnswerVoidCause::NotDisplayed, "it is signed over nothing that was shown"),
            (AnswerVoidCause::RequestClosed, "it answers a request that is not open"),
            (AnswerVoidCause::ValidTooLong, "it would count for longer than an answer may"),
            (AnswerVoidCause::OtherRenderer, "another version of the program put the question into words"),
            (AnswerVoidCause::OtherStoreKey, "it is signed for a store with another key"),
            (AnswerVoidCause::OtherFacts, "the facts that were shown are not those of the question"),
            (AnswerVoidCause::OtherLines, "the lines that were shown are not those of the question"),
        ] {
            let of = QuestionRefusal::AnswerVoid { version: version(), cause };
            assert_eq!(refusal(&of), format!("the decision on grasp@1.1.0 counts for nothing: {text}"));
            assert_eq!(refusal_hint(&of).as_deref(), Some("look at the question again and decide again"));
        }
    }

    #[test]
    fn a_refused_signature_has_its_sentence_and_its_next_step() {
        use QuestionRefusal as Q;
        let version = || "grasp@1.1.0".parse().unwrap();
        let (ann, ada) = (|| "ann".to_owned(), || "ada".to_owned());
        let until = WallTime::from_ms(0);
        let (answer, profile) = (ApprovalDecision::Approve, ProfileName::Human);
        let unconfirmed =
            |enrolled_by, confirmer| Q::NotConfirmed { name: ann(), profile, enrolled_by, confirmer };
        for (of, text, hint) in [
            (Q::NoReason, "a decision needs a reason that can be read", None),
            (
                Q::NotWaiting { version: version() },
                "nothing waits for a decision on grasp@1.1.0",
                Some("see `holdpoint status`"),
            ),
            (
                Q::Ended { version: version(), until },
                "the request about grasp@1.1.0 was open until 1970-01-01T00:00:00Z",
                Some("`holdpoint resume grasp` has people asked again"),
            ),
            (
                Q::SubjectChanged { version: version() },
                "the decision on grasp@1.1.0 is over something that has changed since",
                Some("read the request again and decide again"),
            ),
            (
                Q::DisplayChanged { version: version() },
                "what people were shown of grasp@1.1.0 has changed since; they are asked again",
                Some("look at the question again and decide again"),
            ),
            (
                Q::AnsweredAlready { name: ann(), answer, version: version() },
                "ann has answered approve on grasp@1.1.0 already; the same answer is not taken twice",
                Some(
                    "`holdpoint status` shows whom it waits for; another answer of the same person is taken",
                ),
            ),
            (
                Q::NoName { name: "x --by y".to_owned() },
                "\"x --by y\" is not enrolled in this store: it is no name of a person",
                Some("`holdpoint identity list` lists the persons of the store"),
            ),
            (
                Q::NotEnrolled { name: ann(), administrator: ada() },
                "ann is not enrolled in this store, and nothing that they sign counts",
                Some("`holdpoint identity enroll ann --by ada --reason TEXT` adds their key"),
            ),
            (
                Q::KeyRevoked { name: ann(), by: ada() },
                "the key of ann was revoked by ada, and nothing that it signs counts",
                Some("an enrolled person must decide; see `holdpoint identity list`"),
            ),
            (
                Q::KeyUnprotected { name: ann(), profile },
                "the key of ann has no passphrase, and the profile human requires one",
                Some("`holdpoint identity passphrase ann` sets one; then try again"),
            ),
            (
                Q::AdministratorUnprotected { name: ada(), profile: Some(profile) },
                "the key of ada has no passphrase; the profile human requires one for enrolling people",
                Some("`holdpoint identity passphrase ada` sets one and keeps the key"),
            ),
            (
                Q::AdministratorUnprotected { name: ada(), profile: None },
                "the key of ada has no passphrase, although the act says that it was protected",
                Some("`holdpoint identity passphrase ada` sets one and keeps the key"),
            ),
            (
                unconfirmed(Some(ada()), Some("otto".to_owned())),
                "ann is not confirmed, and ada enrolled them with an unencrypted key: the profile human does not count \
                 their approvals",
                Some(
                    "`holdpoint identity confirm ann --by otto --reason TEXT` confirms them, once that key is protected",
                ),
            ),
            (
                unconfirmed(None, None),
                "ann is not confirmed, and no administrator enrolled them with an unencrypted key: the profile human \
                 does not count their approvals",
                Some("no administrator of this store can confirm them; see the guide on persons and roles"),
            ),
        ] {
            assert_eq!((refusal(&of).as_str(), refusal_hint(&of).as_deref()), (text, hint));
        }
    }
}
