//! Telemetry as plain data, and the key of an episode's cached result.

use holdpoint_governance::ids::{CapabilityId, Digest};

pub const BATCH_BYTES_MAX: usize = 4 << 20;

/// Rows of telemetry of one stream, encoded by the caller (postcard or JSON).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// The version they are about.
    pub version: CapabilityId,
    /// Which stream, a name, e.g. `monitor` or `sandbox`.
    pub stream: String,
    /// Virtual time of the first row, ms.
    pub from_ms: u64,
    /// Virtual time of the last row, ms.
    pub to_ms: u64,
    /// Number of rows, at least 1.
    pub rows: u64,
    /// The rows, at most 4 MiB.
    pub body: Vec<u8>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EpisodeKey {
    /// Digest of the version.
    pub bundle: Digest,
    /// Digest of the scenario with its perturbations.
    pub scenario: Digest,
    pub seed: u64,
    /// The engine's build: name, version and whatever else changes results.
    pub engine_build: String,
}

impl EpisodeKey {
    /// The key of its cached result.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let seed = self.seed.to_le_bytes();
        let parts =
            [self.bundle.bytes().as_slice(), self.scenario.bytes(), &seed, self.engine_build.as_bytes()];
        Digest::of_parts("holdpoint/episode-key/v2", &parts)
    }
}

/// A batch's row. The caller compares its digest with the telemetry digest in the audit chain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredBatch {
    pub number: u64,
    /// Digest of its present fields.
    pub digest: Digest,
    /// `None` if the row is malformed: no engine writes such a row.
    pub batch: Option<Batch>,
}
