//! The stages together: every verb in every standing of a version.

mod paused;
mod refused;
mod standings;
