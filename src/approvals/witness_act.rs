//! An administrator's authorization that adds or removes a witness of a store: a folder elsewhere for its checkpoints.
//!
//! It is for one store and one end of its chain, so that it can be used once and nowhere else.

use serde::{Deserialize, Serialize};

use super::admin_authorization::{AdminAct, AdminActFields, SignedAdminAct};
use super::identity::Identity;
use super::signed_approval::ApprovalError;
use holdpoint_governance::ids::Digest;

/// Separates these bytes from all other signed bytes.
const DOMAIN: &str = "holdpoint/witness-act/v1";

/// The signed content of an authorization of a witness.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WitnessAct {
    /// The absolute path of the witness's folder.
    pub folder: String,
    /// Whether the folder receives every checkpoint from now on; false ends that.
    pub present: bool,
    /// Name of the administrator.
    pub by: String,
    /// Why, in the administrator's own words.
    pub reason: String,
    pub store_id: String,
    /// Hash of the record that this one follows.
    pub after: Digest,
    /// Whether, as far as the program could see, the signing key had a passphrase or an agent held it.
    pub guarded: bool,
}

impl AdminAct for WitnessAct {
    type Subject<'a> = (&'a str, bool);

    fn digest(&self) -> Digest {
        let Self { folder, present, by, reason, store_id, after, guarded } = self;
        let parts: [&[u8]; 7] = [
            store_id.as_bytes(),
            after.bytes(),
            folder.as_bytes(),
            if *present { b"present" } else { b"" },
            by.as_bytes(),
            reason.as_bytes(),
            if *guarded { b"guarded" } else { b"" },
        ];
        Digest::of_parts(DOMAIN, &parts)
    }

    fn is_about(&self, subject: (&str, bool)) -> bool {
        (self.folder.as_str(), self.present) == subject
    }

    fn fields(&self) -> AdminActFields<'_> {
        let Self { folder, by, reason, store_id, after, guarded, .. } = self;
        AdminActFields { about: folder, by, reason, store_id, after: *after, guarded: *guarded }
    }
}

/// The authorization of a witness with its signature and the claimed key.
pub type SignedWitnessAct = SignedAdminAct<WitnessAct>;

impl SignedWitnessAct {
    /// Signed by an administrator, for a store and the end of its chain.
    ///
    /// # Errors
    /// If the agent that holds the key signs nothing.
    pub fn by(
        who: &Identity,
        (folder, present): (&str, bool),
        (store_id, after): (&str, Digest),
        reason: &str,
    ) -> Result<Self, ApprovalError> {
        let act = WitnessAct {
            folder: folder.to_owned(),
            present,
            by: who.info().name.clone(),
            reason: reason.to_owned(),
            store_id: store_id.to_owned(),
            after,
            guarded: who.is_guarded(),
        };
        Self::signed(who, act)
    }
}
