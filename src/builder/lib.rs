//! Builds a skill's component: the starting folder, the toolchain, and the component.
//!
//! Embeds the kit (`src/sdk`), so that a new folder has everything for its build. Writes only into that folder and runs
//! only cargo or clang. Does not run components.

mod encode;
mod scaffold;
mod toolchain;

pub use encode::{EncodeError, encode};
pub use scaffold::{CrateName, CrateNameError, ScaffoldError, scaffold};
pub use toolchain::{BuildError, BuildOutput, build};

/// The language of a skill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lang {
    /// Rust, with the crate `holdpoint-sdk`.
    Rust,
    /// C, with the header `holdpoint_skill.h`.
    C,
}

/// The target of a build.
pub mod target {
    /// The default in Rust: a core module without imports.
    pub const RUST: &str = "wasm32-unknown-unknown";
    /// The target in C.
    pub const C: &str = "wasm32";
}
