//! Where a version comes from: who registered it, who wrote it, and what risk class that and its changes give it.
//!
//! Reads version table and enrolled people; the classes are the rules' ([`holdpoint_governance::risk`]).

use std::borrow::Cow;

use holdpoint_approvals::{PersonDirectory, SignedAuthorship};
use holdpoint_governance::approval::{Author, Authorship, Requester};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::risk::{RiskClass, RiskInput, classify};
use holdpoint_governance::submission::Risk;
use holdpoint_runtime::capability::{AUTHOR_SIGNATURE_FILE, Capability};
use holdpoint_text::Hint;

use crate::evidence_file::EvidenceFile;
use crate::version_table::{VersionEntry, VersionOrigin, VersionTable};

/// The author of a version, if known.
#[must_use]
pub fn author(persons: &PersonDirectory, member: &VersionEntry) -> Author {
    let name = member.capability.submission.author.clone();
    match (&member.origin.author_key, persons.named(&name)) {
        (Some(key), _) => Author { name, authorship: Authorship::Signed, key: key.clone() },
        (None, Some(person)) => Author { name, authorship: Authorship::Named, key: person.key_hex() },
        (None, None) => Author { name, authorship: Authorship::Unverified, key: String::new() },
    }
}

/// Whether a person registered a version or wrote it, by name or by key.
#[must_use]
pub fn is_of(persons: &PersonDirectory, member: &VersionEntry, who: &str) -> bool {
    let key = persons.named(who).map(holdpoint_approvals::Person::key_hex).filter(|key| !key.is_empty());
    let is_same = |name: &str, other: &str| name == who || key.as_deref() == Some(other);
    let author = author(persons, member);
    let requested = match &member.origin.requester {
        Requester::Person { name, key } => is_same(name, key),
        Requester::Script | Requester::Program | Requester::Unknown => false,
    };
    requested || is_same(&author.name, &author.key)
}

/// Whether a version of the same author was confirmed in this store under a profile at least as strict, and is in use or a
/// rollback target.
#[must_use]
pub fn author_known(version_table: &VersionTable, candidate: &Capability, origin: &VersionOrigin) -> bool {
    let Some(key) = &origin.author_key else { return false };
    version_table.families().any(|(_, entry)| {
        entry.members.iter().zip(&entry.state.versions).any(|(member, version)| {
            member.capability.id() != candidate.id()
                && member.origin.author_key.as_ref() == Some(key)
                && member.course.confirmed
                && member
                    .course
                    .activated_under
                    .is_some_and(|context| context.suffices(version_table.admission()))
                && matches!(version.state, State::Active | State::Superseded)
        })
    })
}

/// The risk class of a version against the one it would replace.
#[must_use]
pub fn risk(candidate: &Capability, active: Option<&Capability>, author_known: bool) -> RiskClass {
    classify(&RiskInput {
        candidate: &candidate.manifest,
        active: active.map(|active| &*active.manifest),
        same_code: active.is_some_and(|active| active.has_code_of(candidate)),
        author_known,
        estimated: candidate.submission.estimated_risk,
    })
}

/// The risk class for a decision: the assessed one, or the highest without an assessment.
#[must_use]
pub fn assessed_risk(evidence_file: &EvidenceFile) -> Risk {
    evidence_file.risk.as_ref().map_or(Risk::High, |risk| risk.class)
}

/// An author's signature under a version that is not valid.
#[derive(Debug, thiserror::Error)]
#[error("{AUTHOR_SIGNATURE_FILE} beside {version}: {problem}")]
pub struct AuthorSignatureError {
    version: CapabilityId,
    problem: String,
    hint: String,
}

impl Hint for AuthorSignatureError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        Some(self.hint.clone().into())
    }
}

/// The origin of a version that this requester registers. The author's key signs either the version or its registration.
///
/// # Errors
/// If the author's signature is not valid, or its key is not enrolled.
pub fn of(
    (requester, scripted): (Requester, bool),
    candidate: &Capability,
    persons: &PersonDirectory,
) -> Result<VersionOrigin, AuthorSignatureError> {
    let author = &candidate.submission.author;
    let by_signature = match &candidate.package.author_signature {
        Some(text) => Some(signed_by_author(candidate, text, persons)?),
        None => None,
    };
    let by_registration = match &requester {
        Requester::Person { name, key } if name == author && !key.is_empty() => Some(key.clone()),
        Requester::Person { .. } | Requester::Script | Requester::Program | Requester::Unknown => None,
    };
    Ok(VersionOrigin { requester, author_key: by_signature.or(by_registration), scripted })
}

/// The author's key, if it signed the version and is enrolled.
fn signed_by_author(
    candidate: &Capability,
    text: &str,
    persons: &PersonDirectory,
) -> Result<String, AuthorSignatureError> {
    let author = &candidate.submission.author;
    let wrong =
        |problem: String, hint: String| Err(AuthorSignatureError { version: candidate.id(), problem, hint });
    let again = || format!("`holdpoint candidate sign DIR --as {author}` signs the folder as it is now");
    let signed = match serde_json::from_str::<SignedAuthorship>(text) {
        Ok(signed) => signed,
        Err(error) => return wrong(format!("it is not an author's signature: {error}"), again()),
    };
    if signed.author != *author {
        let problem =
            format!("it is by {:?}, and submission.toml names the author {author:?}", signed.author);
        return wrong(problem, again());
    }
    if !signed.holds(&candidate.digest(), &candidate.package.submission) {
        return wrong(format!("the signature of {author:?} is not over these files"), again());
    }
    let enrolled =
        persons.enrolled().any(|person| person.name == *author && person.key_hex() == signed.public_key);
    if !enrolled {
        let problem = format!("the key of {author:?} that signed is not enrolled in this store");
        let hint = format!(
            "an administrator enrolls it (`holdpoint identity enroll {author} …`), or {AUTHOR_SIGNATURE_FILE} is removed"
        );
        return wrong(problem, hint);
    }
    Ok(signed.public_key)
}

/// The person of this name, with their key if they are enrolled.
#[must_use]
pub fn person(persons: &PersonDirectory, name: &str) -> Requester {
    let key = persons.named(name).map(holdpoint_approvals::Person::key_hex).unwrap_or_default();
    Requester::Person { name: name.to_owned(), key }
}

/// The requester of a registration: its signer; in a script the person that the step names.
#[must_use]
pub fn requester(
    signer: Option<(&str, &str)>,
    is_scripted: bool,
    named: Option<&str>,
    persons: &PersonDirectory,
) -> Requester {
    match (signer, is_scripted, named) {
        (Some((name, key)), _, _) => Requester::Person { name: name.to_owned(), key: key.to_owned() },
        (None, true, Some(name)) => person(persons, name),
        (None, true, None) => Requester::Script,
        (None, false, _) => Requester::Unknown,
    }
}
