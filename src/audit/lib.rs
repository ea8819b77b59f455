//! The signed history of a store, for stores and for programs that check one without its database.
//!
//! Owns the chain of records, its tree heads and proofs, checkpoints and their copies at witnesses, and the exported file
//! with its verification. Reads and writes plain files; knows no database. Must not decide, or make a key.
//!
//! | part | source | errors |
//! | --- | --- | --- |
//! | the chain: each record holds the hash of the one before | [`chain`] | the problem, as text |
//! | the Merkle tree over the records (RFC 9162, section 2.1) | [`merkle`] | none |
//! | signed tree heads, as files | [`checkpoint`] | [`FileError`](files::FileError), [`BadCheckpointFile`](checkpoint::BadCheckpointFile) |
//! | proofs of inclusion and consistency | [`proof`] | [`ProofFault`](proof::ProofFault) to make one, [`ProofError`](proof::ProofError) to check one |
//! | heads that were kept elsewhere | [`head_copies`], [`witness`] | [`HeadFault`](head_copies::HeadFault), [`FileError`](files::FileError) |
//! | a whole history in one file of JSON lines | [`export_file`], [`export_line`] | [`HistoryError`](history_error::HistoryError) |
//! | the judged records: approvals, displayed texts, profiles, rebuilds | [`recorded_approval`], [`display_records`], [`profile_history`], [`rebuild_report`] | the problem, as text |
//! | the id of a store, from its key | [`store_id`] | the problem, as text |
//!
//! Each form and each hash is in the guide's page on records. `examples/verify_export.rs` is a whole program; in short:
//!
//! ```no_run
//! use std::path::Path;
//!
//! use holdpoint_approvals::keyfile;
//! use holdpoint_audit::export_file::verify_export;
//!
//! let (key, _note) = keyfile::read_public(Path::new("store.pub"))?;
//! let report = verify_export(Path::new("store.jsonl"), Some(&key))?;
//! println!("{} records, {} signed heads", report.records, report.heads);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod ascii_json;
pub mod chain;
pub mod checkpoint;
pub mod display_records;
mod export_body;
pub mod export_file;
pub mod export_line;
mod export_verify;
pub mod files;
pub mod head_copies;
pub mod history_error;
pub mod merkle;
pub mod profile_history;
pub mod proof;
pub mod rebuild_report;
pub mod recorded_approval;
pub mod store_id;
pub mod witness;
