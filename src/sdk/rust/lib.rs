//! What a skill's component in Rust is written with: the messages, one trait and one macro.
//!
//! A component is a [`Bundle`] that says what it offers and begins runs of a [`Skill`]; [`component!`] makes of it what
//! the contract `holdpoint:skill@2.0.0` (`wit/2/skill.wit`) asks for:
//!
//! ```ignore
//! struct MyGrasp;
//!
//! impl Bundle for MyGrasp {
//!     type Params = Params; // any type that serde reads
//!     fn describe(_: Params) -> Result<Description, String> {
//!         Ok(Description { task: TaskKind::Grasp, interface: include_str!("interface.json").to_owned() })
//!     }
//!     fn start(_seed: u64, params: Params) -> Result<Box<dyn Skill>, String> {
//!         Ok(Box::new(Grasp::new(params)))
//!     }
//! }
//!
//! holdpoint_sdk::component!(MyGrasp);
//! ```
//!
//! A skill answers one command a tick. [`then`] adds commands for the ticks after it, in which the code is not asked.
//!
//! The types are those of the engine itself: a [`Skill`] compiled into it and one in a component are the same code.
//! One instance of a component runs one task, so its run is stored in one static place.
//!
//! `wit-bindgen` generates the exports from the contract, and its code is `unsafe`: it takes apart what the host wrote
//! into the component's memory. Nothing that is written here is.

mod params;
mod wit;

pub use holdpoint_body::*;
pub use holdpoint_skill::{Hook, Skill};
pub use serde;

pub use wit::then;
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

    /// The sensors of the cell that it uses, by name, with how many numbers each has. The manifest declares `named`, and
    /// `Observation::sensors` has what they measured.
    const SENSORS: &'static [(&'static str, u32)] = &[];

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
