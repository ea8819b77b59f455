//! From nothing to a skill's component: a folder to begin with, the toolchain that builds it, and the component.
//!
//! Carries the kit (`src/sdk`) with it, so that a new folder has all that it is built from. Writes into that folder alone; runs
//! cargo or clang and nothing else. Knows nothing of how a component is run.

mod encode;
mod scaffold;
mod toolchain;

pub use encode::{EncodeError, encode};
pub use scaffold::{Name, NameError, ScaffoldError, scaffold};
pub use toolchain::{BuildError, Built, build};

/// What a skill is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lang {
    /// With the crate `holdpoint-sdk`.
    Rust,
    /// With the header `holdpoint_skill.h`.
    C,
}

/// What a skill is built for.
pub mod target {
    /// In Rust, unless another is named: a core module without imports.
    pub const RUST: &str = "wasm32-unknown-unknown";
    /// In C.
    pub const C: &str = "wasm32";
}
