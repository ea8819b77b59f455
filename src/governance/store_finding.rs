//! What a check of a store finds, as values. Reads no store: the registry fills them in, and `holdpoint-wording` says them.

use std::path::PathBuf;

/// A finding of a check of a store. A problem is the text of an error.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum StoreFinding {
    /// The tables are those of a schema; the next engine brings them to the newest.
    Schema { present: u64, newest: u64 },
    /// The tables are not those of this program.
    WrongTables { problem: String },
    /// The history is sound.
    SoundHistory { records: u64, batches: u64, signatures_checked: bool },
    /// The history is not sound; either the tables can be rebuilt from the audit chain, or only a backup helps.
    BadHistory { problem: String, can_rebuild: bool },
    /// The telemetry file has the right shape.
    TelemetryFile,
    /// The telemetry file has another shape.
    WrongTelemetryFile { problem: String },
    /// No record of the audit chain is missing.
    WholeChain { records: u64 },
    /// The audit chain has another end than the recorded one, or gaps.
    CutChain { records: u64, last: u64, recorded_end: u64 },
    /// No record has to be signed yet.
    NothingToSign,
    /// An earlier version signed the whole audit chain by checkpoints.
    SignedByCheckpoints,
    /// An earlier version signed the audit chain up to this record.
    SignedUpTo { record: u64 },
    /// The end of the audit chain is not signed.
    UnsignedEnd,
    /// The signed end cannot be read.
    BadSignedEnd { problem: String },
    /// The signed end is of another chain or by another key.
    OtherSignedEnd,
    /// A checkpoint cannot be read.
    BadCheckpoint { file: String, problem: String },
    /// A checkpoint is newer than the audit chain.
    NewerCheckpoint { file: String },
    /// The audit chain is signed to its end.
    SignedToEnd { checkpoints: usize },
    /// The record of a person is bad.
    BadPerson { name: String, problem: String },
    /// The free space, with its size in words.
    FreeSpace { size: String, is_enough: bool },
    /// The process that has the store, if there is one.
    InUse { owner: Option<String> },
    /// A witness that can be written.
    Witness { folder: String, heads: u64 },
    /// A witness that cannot be used.
    UnusableWitness { folder: String, problem: String },
    /// Others may write into a folder of keys.
    OpenKeyFolder { folder: PathBuf, mode: u32 },
    /// The keys of the store are right.
    StoreKeys,
    /// Others may read the secret key of the store.
    OpenSecretKey { problem: String },
    /// The secret key of the store cannot be used.
    UnusableSecretKey { problem: String },
    /// The public key of the store cannot be read, so no signature can be checked.
    UnreadablePublicKey { problem: String },
    /// The public key of the store cannot be used.
    UnusablePublicKey { problem: String },
    /// The keys of the store do not belong together.
    OtherStoreKey { public: PathBuf, secret: PathBuf },
    /// A folder of keys cannot be listed.
    UnlistedKeyFolder { folder: PathBuf, problem: String },
    /// A folder of keys has too many files.
    TooManyKeyFiles { folder: PathBuf, most: usize },
    /// A key file was not written to its end.
    UnfinishedKey { path: PathBuf },
    /// The key of a person has a problem.
    BadPersonKey { name: String, problem: String },
    /// The public key of a person cannot be used.
    UnusablePersonKey { name: String, problem: String },
    /// The key files of a person do not belong together.
    OtherPersonKey { key: PathBuf, public: PathBuf },
    /// A key belongs to no enrolled person; this administrator could enroll it.
    NotEnrolled { key: PathBuf, name: String, administrator: String },
    /// A person is enrolled with another key.
    OtherEnrolledKey { public: PathBuf, name: String, enrolled: String },
    /// The key files are right; `names` is their number.
    KeyFiles { names: usize },
}

impl StoreFinding {
    /// Whether it needs no action.
    #[must_use]
    pub const fn is_good(&self) -> bool {
        match self {
            Self::Schema { .. }
            | Self::SoundHistory { .. }
            | Self::TelemetryFile
            | Self::WholeChain { .. }
            | Self::NothingToSign
            | Self::SignedByCheckpoints
            | Self::SignedToEnd { .. }
            | Self::InUse { .. }
            | Self::Witness { .. }
            | Self::StoreKeys
            | Self::KeyFiles { .. } => true,
            Self::FreeSpace { is_enough, .. } => *is_enough,
            Self::WrongTables { .. }
            | Self::BadHistory { .. }
            | Self::WrongTelemetryFile { .. }
            | Self::CutChain { .. }
            | Self::SignedUpTo { .. }
            | Self::UnsignedEnd
            | Self::BadSignedEnd { .. }
            | Self::OtherSignedEnd
            | Self::BadCheckpoint { .. }
            | Self::NewerCheckpoint { .. }
            | Self::BadPerson { .. }
            | Self::UnusableWitness { .. }
            | Self::OpenKeyFolder { .. }
            | Self::OpenSecretKey { .. }
            | Self::UnusableSecretKey { .. }
            | Self::UnreadablePublicKey { .. }
            | Self::UnusablePublicKey { .. }
            | Self::OtherStoreKey { .. }
            | Self::UnlistedKeyFolder { .. }
            | Self::TooManyKeyFiles { .. }
            | Self::UnfinishedKey { .. }
            | Self::BadPersonKey { .. }
            | Self::UnusablePersonKey { .. }
            | Self::OtherPersonKey { .. }
            | Self::NotEnrolled { .. }
            | Self::OtherEnrolledKey { .. } => false,
        }
    }
}

crate::closed_set! {
    /// Why a file of the folder of recordings is not in a copy of a store.
    OmissionCause, "cause of an omission", {
        /// It is not on record: its upgrade is not closed, or it belongs to another store.
        NotOnRecord = "not-on-record",
        /// Its name on record is not a file name.
        NoFileName = "no-file-name",
        /// It was recorded at closure, and no removal is on record.
        Missing = "missing",
        /// It is a link, no file, or cannot be read.
        Unreadable = "unreadable",
        /// It has another size than was recorded at closure.
        OtherSize = "other-size",
        /// It has another SHA-256 than was recorded at closure.
        OtherDigest = "other-digest",
    }
}
