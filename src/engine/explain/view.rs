//! The front end's view of a pipeline: the snapshot, and answers to queries. Only reads.

pub(crate) mod evidence;
pub(crate) use lookup::full_evidence_file;

pub(crate) mod check_explanation;
pub(crate) mod lookup;
pub(crate) mod snapshot;
