//! An administrator's signed authorization of a change of the profile that a store is used under.
//!
//! It is for one store, one end of its chain and one change with the fields that get looser, so that it can be used once, at
//! once, and nowhere else.

use serde::{Deserialize, Serialize};

use super::identity::Identity;
use super::keyfile::hex;
use super::person::{PersonError, Persons};
use super::signed::ApprovalError;
use super::word::Word;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::loosened::Loosened;
use holdpoint_governance::profile::ProfileName;

/// Separates these bytes from everything else that is ever signed.
const DOMAIN: &str = "holdpoint/profile-act/v2";
/// As [`DOMAIN`], of acts of earlier versions, which authorized a class of profile and named no rules.
const DOMAIN_OF_CLASS: &str = "holdpoint/profile-act/v1";

/// The change of rules that is authorized. Fields stand in the order of their names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RulesChange {
    /// Digest of the rules in force; absent where there are none, or an earlier version did not put it on record.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<Digest>,
    /// The fields that get looser, as the administrator was shown them.
    pub loosened: Vec<Loosened>,
    /// Digest of the rules that come into force.
    pub to: Digest,
}

/// What is signed of a profile.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProfileAct {
    /// The class of profile that the store may be used under next.
    pub profile: ProfileName,
    /// Name of the administrator.
    pub by: String,
    /// Why, in the administrator's own words.
    pub reason: String,
    pub store_id: String,
    /// Hash of the record that this one follows.
    pub after: Digest,
    /// Whether the key that signs lay under a passphrase or elsewhere, as far as that could be seen.
    pub guarded: bool,
    /// What changes; absent in acts of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rules: Option<RulesChange>,
}

impl ProfileAct {
    /// The digest that is signed: every field with its length, behind a domain tag.
    fn digest(&self) -> Digest {
        let Self { profile, by, reason, store_id, after, guarded, rules } = self;
        let mut parts: Vec<&[u8]> = vec![
            store_id.as_bytes(),
            after.bytes(),
            profile.name().as_bytes(),
            by.as_bytes(),
            reason.as_bytes(),
            if *guarded { b"guarded" } else { b"" },
        ];
        let Some(RulesChange { from, loosened, to }) = rules else {
            return Digest::of_parts(DOMAIN_OF_CLASS, &parts);
        };
        parts.push(from.as_ref().map_or(&[], |from| from.bytes().as_slice()));
        parts.push(to.bytes());
        for Loosened { before, field, now, shipped } in loosened {
            parts.extend([field.as_bytes(), before.as_bytes(), shipped.as_bytes(), now.as_bytes()]);
        }
        Digest::of_parts(DOMAIN, &parts)
    }
}

/// The word with its signature and the key that is to have made it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedProfileAct {
    act: ProfileAct,
    public_key: String,
    signature: String,
}

impl SignedProfileAct {
    /// Signed by an administrator, for the store and the end of its chain that they are told.
    ///
    /// # Errors
    /// If the agent that holds the key signs nothing.
    pub fn by(
        who: &Identity,
        (profile, rules): (ProfileName, RulesChange),
        (store_id, after): (&str, Digest),
        reason: &str,
    ) -> Result<Self, ApprovalError> {
        let act = ProfileAct {
            profile,
            by: who.info().name.clone(),
            reason: reason.to_owned(),
            store_id: store_id.to_owned(),
            after,
            guarded: who.is_guarded(),
            rules: Some(rules),
        };
        let signature = who.signature(&act.digest())?;
        Ok(Self { act, public_key: hex(who.info().public_key.as_bytes()), signature })
    }

    /// What was signed. Trust it only after [`SignedProfileAct::check`].
    #[must_use]
    pub const fn act(&self) -> &ProfileAct {
        &self.act
    }

    fn word(&self, profile: ProfileName, after: Digest) -> Word<'_> {
        let act = &self.act;
        Word {
            about: act.profile.name(),
            by: &act.by,
            reason: &act.reason,
            store_id: &act.store_id,
            guarded: act.guarded,
            public_key: &self.public_key,
            signature: &self.signature,
            digest: act.digest(),
            follows: (act.profile, act.after) == (profile, after),
        }
    }

    /// Whether this may be done: the word holds, with a reason that can be read.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn check(&self, persons: &Persons, profile: ProfileName, after: Digest) -> Result<(), PersonError> {
        self.word(profile, after).check(persons)
    }

    /// Whether a word on record holds: an administrator who is enrolled signed it, of this profile and over this end of the
    /// chain.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn judge(&self, persons: &Persons, profile: ProfileName, after: Digest) -> Result<(), PersonError> {
        self.word(profile, after).judge(persons)
    }

    /// Whether the signature is one that only the administrator could have made, as far as is on record.
    ///
    /// # Errors
    /// [`PersonError::Unguarded`] or [`PersonError::SignerUnconfirmed`].
    pub fn check_guarded(&self, persons: &Persons) -> Result<(), PersonError> {
        self.word(self.act.profile, self.act.after).check_guarded(persons)
    }
}
