//! What front ends see of a pipeline: the snapshot, and answers to questions. Reads, and changes nothing.

pub(crate) mod evidence;
pub(crate) use lookup::whole_dossier;

pub(crate) mod lookup;
pub(crate) mod snapshot;
pub(crate) mod why;
