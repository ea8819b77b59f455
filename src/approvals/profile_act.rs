//! An administrator's signed authorization of a change of the profile that a store is used under.
//!
//! It is for one store, one end of its chain and one change, with the fields that become less strict. So it can be
//! used only once, only there and before anything else is recorded.

use serde::{Deserialize, Serialize};

use super::admin_authorization::AdminAuthorization;
use super::identity::Identity;
use super::person::{PersonDirectory, PersonError};
use super::signed_approval::ApprovalError;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile_downgrade::DowngradedField;
use holdpoint_text::hex::hex;

/// Separates these bytes from all other signed bytes.
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
    /// The fields that become less strict, as shown to the administrator.
    pub loosened: Vec<DowngradedField>,
    /// Digest of the rules that come into force.
    pub to: Digest,
}

/// The signed content of an authorization of a profile.
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
    /// Whether the signing key had a passphrase or lay elsewhere, as far as the program could see.
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
        for DowngradedField { before, field, now, shipped } in loosened {
            parts.extend([field.as_bytes(), before.as_bytes(), shipped.as_bytes(), now.as_bytes()]);
        }
        Digest::of_parts(DOMAIN, &parts)
    }
}

/// The authorization with its signature and the claimed key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedProfileAct {
    act: ProfileAct,
    public_key: String,
    signature: String,
}

impl SignedProfileAct {
    /// Signed by an administrator, for a store and the end of its chain.
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

    /// The signed content. Trust it only after [`SignedProfileAct::check`].
    #[must_use]
    pub const fn act(&self) -> &ProfileAct {
        &self.act
    }

    fn authorization(&self, profile: ProfileName, after: Digest) -> AdminAuthorization<'_> {
        let act = &self.act;
        AdminAuthorization {
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

    /// Whether it permits the act: valid, with a readable reason.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn check(
        &self,
        persons: &PersonDirectory,
        profile: ProfileName,
        after: Digest,
    ) -> Result<(), PersonError> {
        self.authorization(profile, after).check(persons)
    }

    /// Whether a recorded authorization is valid: an enrolled administrator signed it, for this profile and this end of
    /// the chain.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn judge(
        &self,
        persons: &PersonDirectory,
        profile: ProfileName,
        after: Digest,
    ) -> Result<(), PersonError> {
        self.authorization(profile, after).judge(persons)
    }

    /// Whether, by the record, only the administrator could have signed it.
    ///
    /// # Errors
    /// [`PersonError::Unguarded`] or [`PersonError::SignerUnconfirmed`].
    pub fn check_guarded(&self, persons: &PersonDirectory) -> Result<(), PersonError> {
        self.authorization(self.act.profile, self.act.after).check_guarded(persons)
    }
}
