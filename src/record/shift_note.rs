//! The record of a person's note for the next shift.

use serde::{Deserialize, Serialize};

/// A note in the audit chain.
#[derive(Serialize, Deserialize)]
pub struct ShiftNoteRecord {
    pub by: String,
    pub text: String,
}
