//! What front ends see of a pipeline: the snapshot, and answers to questions. Reads, and changes nothing.

mod evidence;
mod lookup;
mod snapshot;
