//! Answers to a front end's questions about versions. Only reads.

pub(crate) use lookup::full_evidence_file;

pub mod lookup;
