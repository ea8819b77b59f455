//! An administrator's signed word on a witness of a store: a folder elsewhere that gets every checkpoint, or no more.
//!
//! It is for one store and one end of its chain, so that it can be used once and nowhere else.

use serde::{Deserialize, Serialize};

use super::identity::Identity;
use super::keyfile::hex;
use super::person::{PersonError, Persons};
use super::signed::ApprovalError;
use super::word::Word;
use holdpoint_governance::ids::Digest;

/// Separates these bytes from everything else that is ever signed.
const DOMAIN: &str = "holdpoint/witness-act/v1";

/// What is signed of a witness.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WitnessAct {
    /// Absolute.
    pub folder: String,
    /// Whether it gets every checkpoint from now on, or no more.
    pub present: bool,
    /// Name of the administrator.
    pub by: String,
    /// Why, in the administrator's own words.
    pub reason: String,
    pub store_id: String,
    /// Hash of the record that this one follows.
    pub after: Digest,
    /// Whether the key that signs lay under a passphrase or elsewhere, as far as that could be seen.
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

/// The word with its signature and the key that is to have made it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedWitnessAct {
    act: WitnessAct,
    public_key: String,
    signature: String,
}

impl SignedWitnessAct {
    /// Signed by an administrator, for the store and the end of its chain that they are told.
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

    /// What was signed. Trust it only after [`SignedWitnessAct::check`].
    #[must_use]
    pub const fn act(&self) -> &WitnessAct {
        &self.act
    }

    fn word(&self, (folder, present): (&str, bool), after: Digest) -> Word<'_> {
        let act = &self.act;
        Word {
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

    /// Whether this may be done: the word holds, with a reason that can be read.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn check(&self, persons: &Persons, of: (&str, bool), after: Digest) -> Result<(), PersonError> {
        self.word(of, after).check(persons)
    }

    /// Whether a word on record holds: an administrator who is enrolled signed it, of this witness and over this end of the
    /// chain.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn judge(&self, persons: &Persons, of: (&str, bool), after: Digest) -> Result<(), PersonError> {
        self.word(of, after).judge(persons)
    }

    /// Whether the signature is one that only the administrator could have made, as far as is on record.
    ///
    /// # Errors
    /// [`PersonError::Unguarded`] or [`PersonError::SignerUnconfirmed`].
    pub fn check_guarded(&self, persons: &Persons) -> Result<(), PersonError> {
        self.word((&self.act.folder, self.act.present), self.act.after).check_guarded(persons)
    }
}
