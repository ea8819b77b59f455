//! The version of the rules of this crate, which every decision names.
//!
//! It rises whenever the same evidence may be decided in another way. A replay applies these rules only to decisions that
//! they made; one of older rules is reported as such.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A version of the rules. Decisions that name none were made before versions were recorded: 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct RulesVersion(pub u32);

impl RulesVersion {
    /// The rules of this build. What each version changed:
    ///
    /// 1. Events count one-sided, candidates are compared with the active version alone.
    /// 2. Events are paired; a loss of success of 5 points rejects; a lost success is no recovery as well; the anchor
    ///    bounds what several versions may lose together; failed stops and rollbacks are settled by more drills.
    /// 3. Tries are counted: each has a level at which its pairs exclude a loss of success of the margin, and a price in
    ///    pairs; content with a measured verdict gets it again; spent tries wait for a person's review.
    /// 4. A third of the pairs is live-like, and decides by itself, too; the shift test of shadow compares with the others.
    /// 5. A try whose pairs leave the margin open has a second look at more pairs; both share its level.
    /// 6. A rate rolls a version back for good only where the rollback target does better in forks of the same live tasks.
    pub const CURRENT: Self = Self(6);
}

impl Default for RulesVersion {
    fn default() -> Self {
        Self(1)
    }
}
