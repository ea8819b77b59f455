//! The findings of a check of a store, in words: each with what helps.

use holdpoint_governance::store_finding::StoreFinding;

use crate::counted;

/// What helps with a secret key that is lost.
const RESTORE: &str = "put it back from a backup of the folder keys; a store's key cannot be replaced";

/// A finding as one line, with its mark.
#[must_use]
pub fn checked(of: &StoreFinding) -> String {
    let mark = if of.is_good() { "ok   " } else { "WRONG" };
    format!("{mark}  {}", store_finding(of))
}

/// A finding as a sentence.
#[must_use]
pub fn store_finding(of: &StoreFinding) -> String {
    match of {
        StoreFinding::Schema { present, newest } if present == newest => {
            format!("The tables are those of schema {present}, the newest.")
        }
        StoreFinding::Schema { present, newest } => format!(
            "The tables are those of schema {present}; the next engine brings them to schema {newest}."
        ),
        StoreFinding::WrongTables { problem } => {
            format!("The tables are not those of this program: {problem}.")
        }
        StoreFinding::SoundHistory { records, batches, signatures_checked } => {
            let signatures =
                if *signatures_checked { "" } else { "; without the public key no signature was checked" };
            format!(
                "The history is sound: every row matches its records, {} in all, and so does the telemetry, {}{signatures}.",
                counted(*records, "record"),
                counted(*batches, "sealed batch")
            )
        }
        StoreFinding::BadHistory { problem, can_rebuild } => {
            let remedy = if *can_rebuild {
                "`holdpoint store rebuild --from-chain` rebuilds the tables from the audit chain"
            } else {
                "restore the folder from a backup"
            };
            format!("The history is not sound: {problem}; {remedy}.")
        }
        StoreFinding::TelemetryFile => "The telemetry file is as this program makes it.".to_owned(),
        StoreFinding::WrongTelemetryFile { problem } => {
            format!("The telemetry file is damaged or foreign: {problem}; the next engine quarantines it.")
        }
        StoreFinding::WholeChain { records } => {
            format!("The audit chain has {}, none is missing.", counted(*records, "record"))
        }
        StoreFinding::CutChain { records, last, recorded_end } => format!(
            "The audit chain has {} up to {last}, and its end was recorded at {recorded_end}.",
            counted(*records, "record")
        ),
        StoreFinding::BadPerson { name, problem } => format!("The person {name:?} is bad: {problem}."),
        StoreFinding::FreeSpace { size, is_enough: true } => format!("{size} are free where the store lies."),
        StoreFinding::FreeSpace { size, is_enough: false } => {
            format!("Only {size} are free where the store lies.")
        }
        StoreFinding::InUse { owner: Some(owner) } => format!("The store is in use by {owner}."),
        StoreFinding::InUse { owner: None } => "No engine has the store.".to_owned(),
        StoreFinding::Witness { folder, heads } => {
            format!("The witness {folder:?} has {} and can be written.", counted(*heads, "head"))
        }
        StoreFinding::UnusableWitness { folder, problem } => {
            format!("The witness {folder:?} cannot be used: {problem}.")
        }
        StoreFinding::NothingToSign => "There is no record yet that had to be signed.".to_owned(),
        StoreFinding::SignedByCheckpoints => {
            "An earlier version signed the audit chain by checkpoints alone; the next engine signs its end."
                .to_owned()
        }
        StoreFinding::SignedUpTo { record } => format!(
            "An earlier version signed the audit chain up to record {record}; later records are unsigned; \
             `holdpoint store rebuild --from-chain` names them."
        ),
        StoreFinding::UnsignedEnd => "The end of the audit chain is not signed.".to_owned(),
        StoreFinding::BadSignedEnd { problem } => {
            format!("The signed end of the audit chain is bad: {problem}.")
        }
        StoreFinding::OtherSignedEnd => {
            "The signed end is not the end of this audit chain, or another key signed it.".to_owned()
        }
        StoreFinding::BadCheckpoint { file, problem } => {
            format!("The checkpoint {file:?} is bad: {problem}.")
        }
        StoreFinding::NewerCheckpoint { file } => {
            format!("There is a newer checkpoint than the chain: {file:?}.")
        }
        StoreFinding::SignedToEnd { checkpoints } => {
            format!("The audit chain is signed to its end, with {}.", counted(*checkpoints, "checkpoint"))
        }
        StoreFinding::UnreadablePublicKey { problem } => {
            format!("The store's public key cannot be read: {problem}.")
        }
        StoreFinding::OpenKeyFolder { folder, mode } => format!(
            "Others may write into the folder {folder:?} (mode {mode:04o}); `chmod 700 {}` ends that.",
            folder.display()
        ),
        StoreFinding::StoreKeys => {
            "The store's secret key is there, for its owner alone, and the public one belongs to it."
                .to_owned()
        }
        StoreFinding::OpenSecretKey { problem } => format!("The store's secret key: {problem}."),
        StoreFinding::UnusableSecretKey { problem } => {
            format!("The store's secret key cannot be used: {problem}; {RESTORE}.")
        }
        StoreFinding::UnusablePublicKey { problem } => {
            format!("The store's public key cannot be used: {problem}; put it back from a backup.")
        }
        StoreFinding::OtherStoreKey { public, secret } => format!(
            "{public:?} does not belong to {secret:?}; put back the two that belong together from a backup."
        ),
        StoreFinding::UnlistedKeyFolder { folder, problem } => {
            format!("The folder {folder:?} cannot be listed: {problem}.")
        }
        StoreFinding::TooManyKeyFiles { folder, most } => {
            format!("The folder {folder:?} holds more than {most} files; take away what is no key.")
        }
        StoreFinding::UnfinishedKey { path } => format!(
            "{path:?} was not written to its end, and may hold a key; remove it, unless a key is just being written."
        ),
        StoreFinding::BadPersonKey { name, problem } => format!("The key of {name}: {problem}."),
        StoreFinding::UnusablePersonKey { name, problem } => {
            format!("The public key of {name} cannot be used: {problem}; put it back from a backup.")
        }
        StoreFinding::OtherPersonKey { key, public } => {
            format!("{key:?} and {public:?} do not belong together; put back the two that do from a backup.")
        }
        StoreFinding::NotEnrolled { key, name, administrator } => format!(
            "The key {key:?} is not enrolled and decides nothing; \
             `holdpoint identity enroll {name} --by {administrator} --reason TEXT` enrolls it, or remove it."
        ),
        StoreFinding::OtherEnrolledKey { public, name, enrolled } => format!(
            "{public:?} is not the key that {name} is enrolled with ({enrolled}); put back the files of that key from a \
             backup, or have {name} revoked and another name enrolled."
        ),
        StoreFinding::KeyFiles { names } => {
            format!("The key files of {names} names are as they have to be.")
        }
    }
}
