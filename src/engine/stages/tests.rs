//! The stages together: every verb in every standing of a version, and what is kept between them.

mod beside;
mod checkpoints;
mod kept;
mod left_out;
mod paused;
mod refused;
mod shifted;
mod standings;
mod telemetry;
mod wiring;
