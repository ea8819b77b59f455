//! The stages together: every verb in every standing of a version.

mod refused;
mod standings;
