//! Whether the trace envelope agrees with the watcher: counted over the sequences of a shadow, and gating nothing.

use serde::{Deserialize, Serialize};

use super::evidence::ShadowSequence;

/// In how many sequences the twin left the active version's band, and in how many the watcher spoke: whether the
/// trace envelope agrees with the watcher (paper section 6.7). Reported, never gating.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Alignment {
    /// Sequences in which the twin left the band and the watcher raised a signal.
    pub both: u32,
    /// Left the band, and the watcher named nothing.
    pub envelope_only: u32,
    /// The watcher named something within the band.
    pub watcher_only: u32,
    /// Sequences in which the twin stayed in the band and the watcher was silent.
    pub neither: u32,
}

impl Alignment {
    /// Counts sequences; a twin is out of the band if more than `share_max` of its trajectory is.
    #[must_use]
    pub fn of(sequences: &[ShadowSequence], share_max: f64) -> Self {
        let mut counts = Self::default();
        for sequence in sequences {
            let count = match (sequence.envelope_divergence > share_max, sequence.twin_watcher_event) {
                (true, true) => &mut counts.both,
                (true, false) => &mut counts.envelope_only,
                (false, true) => &mut counts.watcher_only,
                (false, false) => &mut counts.neither,
            };
            *count = count.saturating_add(1);
        }
        counts
    }
}
