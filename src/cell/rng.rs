//! Portable random streams: SplitMix64, one stream per purpose.
//!
//! Every disturbance of an episode draws from its own stream, and draws the same count whatever the
//! robot does, so two skills that face one seed meet identical disturbances. Transcendental
//! functions come from `libm`, so streams agree across machines.

use serde::{Deserialize, Serialize};

/// What a stream is for. The discriminant is part of the seed: never renumber.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamPurpose {
    /// Object pose, mass, friction.
    Object = 1,
    /// Tray pose.
    Target = 2,
    /// Initial arm state.
    Arm = 3,
    /// Which clutter stands where.
    Clutter = 4,
    /// Pushes on the object.
    Push = 5,
    /// Windows in which the gripper does not answer.
    Tool = 6,
    /// Latency of the episode and of each command.
    Latency = 7,
    /// Bias of the camera, and the noise of its measurements of the object.
    Picture = 8,
    /// Dropped camera frames and their timing.
    Timing = 9,
    /// Noise of the joint, force and width sensors.
    Sensors = 10,
    /// Pose of the object in the hand at the start.
    InHand = 11,
    /// Points and faults of recovery drills.
    Drill = 12,
    /// Starts of further objects, and the noise of the camera's measurements of them.
    Further = 13,
}

/// SplitMix64 (Steele, Lea and Flood 2014): one 64-bit word of state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stream {
    state: u64,
}

const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl Stream {
    /// The stream of one purpose in the episode of one seed.
    #[must_use]
    pub fn new(seed: u64, purpose: StreamPurpose) -> Self {
        Self::from_state(mix(mix(seed.wrapping_add(GOLDEN)) ^ (purpose as u64).wrapping_mul(GOLDEN)))
    }

    /// A stream that starts at a raw SplitMix64 state.
    #[must_use]
    pub const fn from_state(state: u64) -> Self {
        Self { state }
    }

    /// The next 64 bits.
    #[inline]
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN);
        mix(self.state)
    }

    /// Uniform in `[0, 1)`, 53 bits.
    #[inline]
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// Uniform between two bounds; the lower bound when they are equal.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Standard normal (Box-Muller, the cosine branch).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.unit()));
        radius * libm::cos(core::f64::consts::TAU * self.unit())
    }

    /// Close to standard normal, bounded at 3.46: the sum of four uniforms from one draw. Cheap
    /// enough for every sensor in every tick.
    #[inline]
    pub fn normal_bounded(&mut self) -> f64 {
        let bits = self.bits();
        let sum: u64 = (0..4).map(|i| (bits >> (16 * i)) & 0xFFFF).sum();
        // Mean 4 * 32767.5, variance 4 * (2^32 - 1) / 12.
        (sum as f64 - 131_070.0) * (1.0 / 37_837.227)
    }

    /// True with the given probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_generator_is_splitmix64() {
        // Reference output for state 0 (Vigna's splitmix64.c).
        let mut stream = Stream::from_state(0);
        assert_eq!(stream.bits(), 0xE220_A839_7B1D_CDAF);
        assert_eq!(stream.bits(), 0x6E78_9E6A_A1B9_65F4);
    }

    #[test]
    fn normals_have_unit_variance() {
        type SamplerFn = fn(&mut Stream) -> f64;
        for (name, draw) in [("normal", Stream::normal as SamplerFn), ("bounded", Stream::normal_bounded)] {
            let mut stream = Stream::new(7, StreamPurpose::Sensors);
            let n = 40_000;
            let (mut sum, mut square) = (0.0, 0.0);
            for _ in 0..n {
                let x = draw(&mut stream);
                sum += x;
                square += x * x;
            }
            let mean = sum / f64::from(n);
            let variance = square / f64::from(n) - mean * mean;
            assert!(mean.abs() < 0.02, "{name}: mean {mean}");
            assert!((variance - 1.0).abs() < 0.03, "{name}: variance {variance}");
        }
    }

    #[test]
    fn purposes_and_seeds_give_different_streams() {
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..100 {
            for purpose in
                [StreamPurpose::Object, StreamPurpose::Target, StreamPurpose::Push, StreamPurpose::InHand]
            {
                assert!(seen.insert(Stream::new(seed, purpose).bits()));
            }
        }
    }
}
