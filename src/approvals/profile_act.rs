//! An administrator's signed authorization of a change of the profile that a store is used under.
//!
//! It is for one store, one end of its chain and one change, with the fields that become less strict. So it can be
//! used only once, only there and before anything else is recorded.

use serde::{Deserialize, Serialize};

use super::admin_authorization::{AdminAct, AdminActFields, SignedAdminAct};
use super::identity::Identity;
use super::signed_approval::ApprovalError;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile_downgrade::DowngradedField;

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

impl AdminAct for ProfileAct {
    type Subject<'a> = ProfileName;

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

    fn is_about(&self, profile: ProfileName) -> bool {
        self.profile == profile
    }

    fn fields(&self) -> AdminActFields<'_> {
        let Self { profile, by, reason, store_id, after, guarded, .. } = self;
        AdminActFields { about: profile.name(), by, reason, store_id, after: *after, guarded: *guarded }
    }
}

/// The authorization of a profile with its signature and the claimed key.
pub type SignedProfileAct = SignedAdminAct<ProfileAct>;

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
        Self::signed(who, act)
    }
}
