//! The kit of contract `holdpoint:skill@1.0.0` (`wit/skill.wit`), for the components of tests that keep it.
//!
//! New skills are written with the crate `holdpoint-sdk`, which explains what both have. Only the messages differ.

#[path = "../rust/params.rs"]
mod params;
mod wit;

pub use holdpoint_body::*;
pub use holdpoint_skill::{Hook, Skill};
pub use serde;

#[doc(hidden)]
pub use wit::{Adapter, bindings};

/// What a component says of its code.
pub struct Description {
    /// The primitive it performs.
    pub task: TaskKind,
    /// Its interface as JSON, see `description` in the WIT; the engine compares it with the manifest.
    pub interface: String,
}

/// A component's code, before any run of it.
pub trait Bundle {
    /// The parameter file beside the manifest, as serde reads it.
    type Params: serde::de::DeserializeOwned;

    /// What the code offers and needs with these parameters.
    ///
    /// # Errors
    /// If the parameters are not allowed. The version is then not registered.
    fn describe(params: Self::Params) -> Result<Description, String>;

    /// Begins the one task of this instance. The seed tells nothing of the episode.
    ///
    /// # Errors
    /// If it cannot begin. The task has then failed.
    fn start(seed: u64, params: Self::Params) -> Result<Box<dyn Skill>, String>;
}

/// Makes a component of a [`Bundle`]; once a crate.
#[macro_export]
macro_rules! component {
    ($bundle:ty) => {
        type HoldpointComponent = $crate::Adapter<$bundle>;
        $crate::bindings::export!(HoldpointComponent with_types_in $crate::bindings);
    };
}
