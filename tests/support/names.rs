//! Digests and names made of texts.

use holdpoint_governance::ids::{CapabilityId, Digest};

pub fn digest(text: &str) -> Digest {
    Digest::of_parts("test", &[text.as_bytes()])
}

pub fn id(text: &str) -> CapabilityId {
    text.parse().unwrap()
}
