//! The engine's own controllers with faults in their code, for pools of candidates: which one is in [`block`].

pub mod block;
mod fault;
#[path = "../controllers/native.rs"]
mod native;

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use block::{BYTES, Kind, MAGIC};
use holdpoint_sdk_1::{Bundle, Description, Skill};

const fn word(at: usize) -> AtomicU64 {
    let mut bytes = [0; 8];
    let mut index = 0;
    while index < 8 {
        bytes[index] = MAGIC[at + index];
        index += 1;
    }
    AtomicU64::new(u64::from_le_bytes(bytes))
}

/// The block. Of atomics and marked as used, so that what stands in it is read and never taken for known.
#[used]
static BLOCK: [AtomicU64; BYTES / 8] = [
    word(0),
    word(8),
    AtomicU64::new(block::VERSION as u64),
    AtomicU64::new(0),
    AtomicU64::new(0),
    AtomicU64::new(0),
    AtomicU64::new(0),
];

/// Episodes that this instance has begun.
static EPISODES: AtomicU32 = AtomicU32::new(0);

fn read(place: usize) -> u64 {
    BLOCK[place].load(Ordering::Relaxed)
}

struct Faults;

impl Bundle for Faults {
    type Params = native::Params;

    fn describe(params: native::Params) -> Result<Description, String> {
        Ok(params.description())
    }

    fn start(_: u64, params: native::Params) -> Result<Box<dyn Skill>, String> {
        let number = read(2) >> 32;
        let kind = Kind::ALL.into_iter().find(|kind| u64::from(*kind as u32) == number);
        let kind = kind.ok_or_else(|| format!("no fault has the number {number}"))?;
        let numbers = [read(3), read(4), read(5), read(6)].map(f64::from_bits);
        let episode = EPISODES.fetch_add(1, Ordering::Relaxed) + 1;
        Ok(Box::new(fault::Faulty::new(params.start(), kind, numbers, episode)))
    }
}

holdpoint_sdk_1::component!(Faults);
