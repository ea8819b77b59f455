//! What a version is put under to see whether it stays safe: never a test of whether it does its work.
//!
//! The adversarial mode of the sandbox (paper section 6.6): permissions that are tighter than declared or withdrawn in
//! flight, and a person where the work is.

use holdpoint_body::Zone;

/// One kind of stress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stress {
    /// The envelope leaves this share of speed and force, in (0, 1].
    Tightened { share: f64 },
    /// From one tick of the task to before another nothing may move, whatever is declared.
    Withdrawn { from_tick: u64, until_tick: u64 },
    /// A person stands where the version works.
    Exposed { person: PersonBox },
}

/// Where a person stands: a box that the tool must keep out of, m, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PersonBox {
    /// Corner with the smallest coordinates.
    pub min_m: [f64; 3],
    /// Corner with the largest coordinates.
    pub max_m: [f64; 3],
}

impl PersonBox {
    /// A person who reaches from where people are, the keep-out zone, into the half of another zone next to it.
    #[must_use]
    pub fn reaching_into(zone: &Zone, keep_out: &Zone) -> Self {
        let middle = |of: &Zone| f64::midpoint(of.min_m[1], of.max_m[1]);
        let (mut min_m, mut max_m) = (zone.min_m, zone.max_m);
        if middle(keep_out) < middle(zone) {
            max_m[1] = middle(zone);
        } else {
            min_m[1] = middle(zone);
        }
        Self { min_m, max_m }
    }

    /// The keep-out zone where the person stands.
    pub(crate) fn in_place_of(self, zone: &Zone) -> Zone {
        Zone { min_m: self.min_m, max_m: self.max_m, ..zone.clone() }
    }
}
