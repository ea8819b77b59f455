//! What `audit` prints: exports, proofs, the lines of a verification, witnesses.

use std::fmt::Display;

use crate::counted;

/// An export to a file.
#[must_use]
pub fn exported(records: u64, file: impl Display) -> String {
    format!("wrote {} to {file}", counted(records, "record"))
}

/// An export with its signed heads to a file.
#[must_use]
pub fn exported_with_heads(records: u64, file: impl Display) -> String {
    format!("wrote {} with the signed heads to {file}", counted(records, "record"))
}

/// A list without the digests of telemetry.
pub const DIGESTS_OMITTED: &str = "telemetry digests are omitted; --all includes them";

/// A list without an entry.
pub const NO_RECORDS: &str = "no records";

/// A proof in a file.
#[must_use]
pub fn wrote_proof(steps: usize, bytes: usize, file: impl Display) -> String {
    format!("wrote a proof of {}, {}, to {file}", counted(steps, "step"), counted(bytes, "byte"))
}

/// The statement of a proof that a record is in a chain: the record with its kind and hash, the store, the signed head.
#[must_use]
pub fn record_is_included(
    (seq, kind, hash): (u64, impl Display, impl Display),
    store_id: impl Display,
    signed_at: u64,
) -> String {
    format!(
        "record {seq} ({kind}, {hash}) is in the chain of the store {store_id} that was signed at record {signed_at}"
    )
}

/// The statement of a proof that a chain begins with an older one.
#[must_use]
pub fn chain_begins_with(store_id: impl Display, newer: u64, older: u64) -> String {
    format!(
        "the chain of the store {store_id} that was signed at record {newer} begins with the one signed at record {older}"
    )
}

/// A history with a fault.
#[must_use]
pub fn not_sound(problem: &str) -> String {
    format!("not sound: {problem}")
}

/// A sound history, with a limit of the statement where no key was given.
#[must_use]
pub fn sound(signatures_checked: bool, records: u64, head: impl Display) -> String {
    let unless = if signatures_checked { "" } else { " but for its signatures, which were not checked" };
    format!("sound{unless}: {}, head {head}", counted(records, "record"))
}

/// The verified checkpoints, and whether their signatures were checked.
#[must_use]
pub fn checkpoints(count: u64, signatures_checked: bool) -> String {
    let signatures =
        if signatures_checked { "signatures checked" } else { "no public key: name one with --key" };
    format!("checkpoints        {count} ({signatures})")
}

/// Heads of this chain that were kept elsewhere.
#[must_use]
pub fn heads_elsewhere(copies: u64) -> String {
    format!("heads elsewhere    {copies} of this chain")
}

/// A witness without a statement.
#[must_use]
pub fn silent_witness(silent: impl Display) -> String {
    format!("no statement       {silent}")
}

/// Unsigned records that a rebuild accepted.
#[must_use]
pub fn accepted_unsigned(first: u64, last: u64) -> String {
    format!("unsigned           {first} to {last}, accepted by a rebuild: nothing vouches for these records")
}

/// The verified approvals.
#[must_use]
pub fn approvals(count: u64) -> String {
    format!("approvals          {count}")
}

/// The persons on record.
#[must_use]
pub fn persons(count: u64, confirmed: u64) -> String {
    format!("persons            {count}, {confirmed} of them confirmed")
}

/// The sealed batches of telemetry.
#[must_use]
pub fn batches(count: u64, removed: u64, unseen: u64) -> String {
    format!("telemetry batches  {count} ({removed} removed for age, {unseen} not looked at)")
}

/// Batches that never came to the store.
#[must_use]
pub fn batches_missed(count: u64) -> String {
    format!("missing batches    {count}: the records telemetry-missed name them")
}

/// Batches that are away, with the records that sealed them.
#[must_use]
pub fn batches_away(first: u64, last: u64, (first_seal, last_seal): (u64, u64)) -> String {
    format!("batches away       {first} to {last}, sealed by the records {first_seal} to {last_seal}")
}

/// The signed heads of an exported file, and the key that checked them.
#[must_use]
pub fn signed_heads(count: u64, key_given: bool) -> String {
    let by = if key_given { "the given key" } else { "the key that the file itself names" };
    format!("signed heads       {count} (checked with {by})")
}

/// The root of the tree of an exported file.
#[must_use]
pub fn root_of_tree(root: impl Display) -> String {
    format!("root of the tree   {root}")
}

/// The keys of secret seeds: all, the revealed ones and the others; then the evaluations that have their seeds from the
/// former, and from the latter.
#[must_use]
pub fn seed_keys(committed: u64, revealed: u64, follow: u64, pending: u64) -> String {
    format!(
        "keys of seeds      {committed}: {revealed} revealed, which give the seeds of {}; {} not revealed yet, which give those \
         of {}",
        counted(follow, "evaluation"),
        committed.saturating_sub(revealed),
        counted(pending, "evaluation")
    )
}

/// Keys of seeds that were replaced.
#[must_use]
pub fn replaced_keys(replaced: u64) -> String {
    format!("replaced keys      {replaced}: seeds that were drawn and gave no result")
}

/// The verified recordings.
#[must_use]
pub fn recordings(count: u64) -> String {
    format!("recordings         {count}")
}

/// What the progress bar counts while recordings are read.
pub const BYTES_OF_RECORDINGS: &str = "bytes of recordings";

/// A store without witnesses.
pub const NO_WITNESSES: &str = "no witnesses; `holdpoint audit witness add DIR` adds one";
