//! An administrator's authorization that adds or removes a witness of a store: a folder elsewhere for its checkpoints.
//!
//! It is for one store and one end of its chain, so that it can be used once and nowhere else.

use serde::{Deserialize, Serialize};

use super::admin_authorization::AdminAuthorization;
use super::identity::Identity;
use super::person::{PersonDirectory, PersonError};
use super::signed_approval::ApprovalError;
use holdpoint_governance::ids::Digest;
use holdpoint_text::hex::hex;

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

impl WitnessAct {
    /// The digest that is signed: every field with its length, behind a domain tag.
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
}

/// The authorization with its signature and the claimed key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedWitnessAct {
    act: WitnessAct,
    public_key: String,
    signature: String,
}

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
        let signature = who.signature(&act.digest())?;
        Ok(Self { act, public_key: hex(who.info().public_key.as_bytes()), signature })
    }

    /// The signed content. Trust it only after [`SignedWitnessAct::check`].
    #[must_use]
    pub const fn act(&self) -> &WitnessAct {
        &self.act
    }

    fn authorization(&self, (folder, present): (&str, bool), after: Digest) -> AdminAuthorization<'_> {
        let act = &self.act;
        AdminAuthorization {
            about: &act.folder,
            by: &act.by,
            reason: &act.reason,
            store_id: &act.store_id,
            guarded: act.guarded,
            public_key: &self.public_key,
            signature: &self.signature,
            digest: act.digest(),
            follows: (act.folder.as_str(), act.present, act.after) == (folder, present, after),
        }
    }

    /// Whether it permits the act: valid, with a readable reason.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn check(
        &self,
        persons: &PersonDirectory,
        of: (&str, bool),
        after: Digest,
    ) -> Result<(), PersonError> {
        self.authorization(of, after).check(persons)
    }

    /// Whether a recorded authorization is valid: an enrolled administrator signed it, for this witness and this end of
    /// the chain.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn judge(
        &self,
        persons: &PersonDirectory,
        of: (&str, bool),
        after: Digest,
    ) -> Result<(), PersonError> {
        self.authorization(of, after).judge(persons)
    }

    /// Whether, by the record, only the administrator could have signed it.
    ///
    /// # Errors
    /// [`PersonError::Unguarded`] or [`PersonError::SignerUnconfirmed`].
    pub fn check_guarded(&self, persons: &PersonDirectory) -> Result<(), PersonError> {
        self.authorization((&self.act.folder, self.act.present), self.act.after).check_guarded(persons)
    }
}
