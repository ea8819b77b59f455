//! What a profile demands of shadow where the cell has no twin.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

crate::closed_set! {
    /// Whether shadow may rest on outputs alone.
    OutputsAlone, "answer to outputs alone", {
        /// It passes a version; a large divergence of outputs makes it longer.
        Enough = "enough",
        /// The version is put on hold.
        Hold = "hold",
    }
}

/// What is demanded of shadow where the cell has no twin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShadowSettings {
    /// What follows where a live cell can neither export its state nor have a trial cell set to what it observed.
    pub outputs_alone: OutputsAlone,
}
