//! How the seeds of a session are named.

/// The run's seed, or that the seeds are secret.
#[must_use]
pub fn named(seed: Option<u64>) -> String {
    seed.map_or_else(|| "secret seeds".to_owned(), |seed| format!("seed {seed}"))
}
