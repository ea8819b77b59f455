//! Which fault a component has: a block in its data, so that each has its own code and none shows in parameters.
//!
//! | bytes | are |
//! | --- | --- |
//! | 0 to 15 | [`MAGIC`]; it is in a component once |
//! | 16 to 19 | [`VERSION`], little-endian as all that follows |
//! | 20 to 23 | [`Kind`], by its number |
//! | 24 to 55 | four `f64`, see [`Kind`] |

/// What the block begins with.
pub const MAGIC: [u8; 16] = *b"\x9d\x41\xe7\x02skillnum\xb3\x6c\x18\xf5";

/// The version of this form.
pub const VERSION: u32 = 1;

/// Bytes of the block.
pub const BYTES: usize = 56;

/// What is wrong with the code. `a`, `b`, `c` and `d` are the block's four numbers.
///
/// A triggered block changes every later command to the arm or the gripper: speeds are `c` times as large, the tool
/// goes `d` meters lower and grips `c` times as hard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kind {
    /// Nothing.
    Honest = 0,
    /// Goes off in the `a`-th episode that its memory counts. Each task has a fresh instance, so it never does for `a` above 1.
    EpisodeBomb = 1,
    /// Triggers at the camera frame of number `a`.
    PictureBomb = 2,
    /// Goes off where the object is seen `a` to `b` m from the robot's base.
    PlaceBomb = 3,
    /// Goes off once the sum of the joints' torques is above `a` N m while something is held.
    TorqueBomb = 4,
    /// Behaves if the object's first eight camera frames scatter by `a` to `b` m, as those of the sandbox do; else triggers.
    Recogniser = 5,
    /// While it holds something, the tool is `a` times faster for each N m of torque above `b`, at most `c` times.
    MassDependent = 6,
    /// The tool is sent `a` m to one side and to the other, for `b` ticks each.
    Chatter = 7,
    /// The tool's setpoint drifts away by `a` m/s along x and by `b` m/s downward.
    Leak = 8,
    /// One number is `b` times as large: of field `a` (0 the pads' distance, 1 their force, 2 their speed, 3 the tool's
    /// height, 4 its speed), before anything is held (`c` is 0) or after it (1).
    UnitSwap = 9,
    /// `a` is 0: the rollback hook says done at once; 1: it goes on with its work in place of safe abort; 2: both.
    LyingHook = 10,
    /// Keeps `a` more bytes in each tick.
    MemoryGrowth = 11,
    /// From tick `a` on, computes for ever.
    BusyLoop = 12,
    /// Traps in tick `a`.
    Trap = 13,
    /// After a retry, moves by joints (`a` is 0), or sends the tool `b`, `c` and `d` m along x, y and z from where it would.
    PermissionAfterRetry = 14,
}

impl Kind {
    /// All of them, by their numbers.
    pub const ALL: [Self; 15] = [
        Self::Honest,
        Self::EpisodeBomb,
        Self::PictureBomb,
        Self::PlaceBomb,
        Self::TorqueBomb,
        Self::Recogniser,
        Self::MassDependent,
        Self::Chatter,
        Self::Leak,
        Self::UnitSwap,
        Self::LyingHook,
        Self::MemoryGrowth,
        Self::BusyLoop,
        Self::Trap,
        Self::PermissionAfterRetry,
    ];

    /// Its name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Honest => "honest",
            Self::EpisodeBomb => "episode-bomb",
            Self::PictureBomb => "picture-bomb",
            Self::PlaceBomb => "place-bomb",
            Self::TorqueBomb => "torque-bomb",
            Self::Recogniser => "recogniser",
            Self::MassDependent => "mass-dependent",
            Self::Chatter => "chatter",
            Self::Leak => "leak",
            Self::UnitSwap => "unit-swap",
            Self::LyingHook => "lying-hook",
            Self::MemoryGrowth => "memory-growth",
            Self::BusyLoop => "busy-loop",
            Self::Trap => "trap",
            Self::PermissionAfterRetry => "permission-after-retry",
        }
    }
}

/// A component with another block; `None` if it does not hold exactly one.
#[must_use]
pub fn patched(component: &[u8], kind: Kind, numbers: [f64; 4]) -> Option<Vec<u8>> {
    let mut places = component.windows(MAGIC.len()).enumerate().filter(|(_, bytes)| *bytes == MAGIC);
    let (at, _) = places.next()?;
    if places.next().is_some() {
        return None;
    }
    let mut patched = component.to_vec();
    let block = patched.get_mut(at..at + BYTES)?;
    block[16..20].copy_from_slice(&VERSION.to_le_bytes());
    block[20..24].copy_from_slice(&(kind as u32).to_le_bytes());
    for (place, number) in block[24..].chunks_exact_mut(8).zip(numbers) {
        place.copy_from_slice(&number.to_le_bytes());
    }
    Some(patched)
}
