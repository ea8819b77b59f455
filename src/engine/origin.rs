//! Where a version comes from: who registered it, who wrote it, and what risk class that and its changes give it.
//!
//! Reads ledger and enrolled people; the classes are the rules' ([`holdpoint_governance::risk`]).

use holdpoint_approvals::Persons;
use holdpoint_governance::approval::{Author, Authorship, Requester};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::risk::{RiskClass, RiskInput, classify};
use holdpoint_governance::submission::Risk;
use holdpoint_runtime::capability::Capability;

use crate::dossier::Dossier;
use crate::ledger::{Ledger, Member, Origin};

/// Who wrote a version, as far as it is known.
pub(crate) fn author(persons: &Persons, member: &Member) -> Author {
    let name = member.capability.submission.author.clone();
    match (&member.origin.author_key, persons.named(&name)) {
        (Some(key), _) => Author { name, authorship: Authorship::Signed, key: key.clone() },
        (None, Some(person)) => Author { name, authorship: Authorship::Named, key: person.key_hex() },
        (None, None) => Author { name, authorship: Authorship::Unverified, key: String::new() },
    }
}

/// Whether a version of the same author was confirmed in this store and is still in use or kept as a way back.
pub(crate) fn author_known(ledger: &Ledger, candidate: &Capability, origin: &Origin) -> bool {
    let Some(key) = &origin.author_key else { return false };
    ledger.families().any(|(_, entry)| {
        entry.members.iter().zip(&entry.state.versions).any(|(member, version)| {
            member.capability.id() != candidate.id()
                && member.origin.author_key.as_ref() == Some(key)
                && member.course.confirmed
                && matches!(version.state, State::Active | State::Superseded)
        })
    })
}

/// The risk class of a version against the one it would replace.
pub(crate) fn risk(candidate: &Capability, active: Option<&Capability>, author_known: bool) -> RiskClass {
    classify(&RiskInput {
        candidate: &candidate.manifest,
        active: active.map(|active| &*active.manifest),
        same_code: active.is_some_and(|active| active.has_code_of(candidate)),
        author_known,
        estimated: candidate.submission.estimated_risk,
    })
}

/// The risk class that a decision rests on: what was assessed, or the highest where nothing was.
pub(crate) fn assessed_risk(dossier: &Dossier) -> Risk {
    dossier.risk.as_ref().map_or(Risk::High, |risk| risk.class)
}

/// Where a version comes from that this requester registers. Who registers a version of their own signed it by that.
pub(crate) fn of(requester: Requester, candidate: &Capability) -> Origin {
    let author_key = match &requester {
        Requester::Person { name, key } if *name == candidate.submission.author && !key.is_empty() => {
            Some(key.clone())
        }
        Requester::Person { .. } | Requester::Script | Requester::Program | Requester::Unknown => None,
    };
    Origin { requester, author_key }
}

/// Who asks for a registration: the person who signed it; in a script the person whom the step names.
pub(crate) fn requester(
    signer: Option<(&str, &str)>,
    is_scripted: bool,
    named: Option<&str>,
    persons: &Persons,
) -> Requester {
    let person = |name: &str, key: String| Requester::Person { name: name.to_owned(), key };
    match (signer, is_scripted, named) {
        (Some((name, key)), _, _) => person(name, key.to_owned()),
        (None, true, Some(name)) => {
            let key = persons.named(name).map(holdpoint_approvals::Person::key_hex).unwrap_or_default();
            person(name, key)
        }
        (None, true, None) => Requester::Script,
        (None, false, _) => Requester::Unknown,
    }
}
