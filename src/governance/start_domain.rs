//! The domain of a version's evidence: what a skill may see at the start of a task, as declared where it was measured.
//!
//! A domain is a list of closed intervals, one for each declared quantity. The caller computes them from the declared
//! support of what episodes are sampled from, never from the samples. Pure: it compares a start with the intervals, and
//! judges nothing else. Poses are in the world frame, the robot's base at the origin.

use std::fmt;

use holdpoint_body::{Estimate, JointVec, MAX_JOINTS, Observation, Pose, RATE_HZ};
use serde::{Deserialize, Serialize};

crate::closed_set! {
    /// A quantity that is seen at the start of a task.
    StartQuantity, "quantity of a start", {
        /// Position of the object, m.
        ObjectX = "object-x",
        /// Position of the object, m.
        ObjectY = "object-y",
        /// Position of the object, m.
        ObjectZ = "object-z",
        /// Heading of the object, rad.
        ObjectYaw = "object-yaw",
        /// Position of the target, m.
        TargetX = "target-x",
        /// Position of the target, m.
        TargetY = "target-y",
        /// Position of the target, m.
        TargetZ = "target-z",
        /// Heading of the target, rad.
        TargetYaw = "target-yaw",
        /// Position of the object less that of the target, m.
        OffsetX = "offset-x",
        /// Position of the object less that of the target, m.
        OffsetY = "offset-y",
        /// Age of the camera frame, ms.
        PictureAge = "picture-age",
        /// Whether the hand holds something: 1 or 0.
        Held = "held",
        /// Angle of the first joint from the base, rad.
        Joint1 = "joint-1",
        /// Angle of the second joint, rad.
        Joint2 = "joint-2",
        /// Angle of the third joint, rad.
        Joint3 = "joint-3",
        /// Angle of the fourth joint, rad.
        Joint4 = "joint-4",
        /// Angle of the fifth joint, rad.
        Joint5 = "joint-5",
        /// Angle of the sixth joint, rad.
        Joint6 = "joint-6",
        /// Angle of the seventh joint, rad.
        Joint7 = "joint-7",
        /// Angle of the eighth joint, rad.
        Joint8 = "joint-8",
        /// Angle of the ninth joint, rad.
        Joint9 = "joint-9",
        /// Angle of the tenth joint, rad.
        Joint10 = "joint-10",
        /// Angle of the eleventh joint, rad.
        Joint11 = "joint-11",
        /// Angle of the twelfth joint, rad.
        Joint12 = "joint-12",
        /// Angle of the thirteenth joint, rad.
        Joint13 = "joint-13",
        /// Angle of the fourteenth joint, rad.
        Joint14 = "joint-14",
        /// Angle of the fifteenth joint, rad.
        Joint15 = "joint-15",
        /// Angle of the sixteenth joint, rad.
        Joint16 = "joint-16",
    }
}

impl StartQuantity {
    /// The joints, from the base to the tool.
    pub const JOINTS: [Self; MAX_JOINTS] = [
        Self::Joint1,
        Self::Joint2,
        Self::Joint3,
        Self::Joint4,
        Self::Joint5,
        Self::Joint6,
        Self::Joint7,
        Self::Joint8,
        Self::Joint9,
        Self::Joint10,
        Self::Joint11,
        Self::Joint12,
        Self::Joint13,
        Self::Joint14,
        Self::Joint15,
        Self::Joint16,
    ];

    /// The unit of its values; empty for a count.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::ObjectX
            | Self::ObjectY
            | Self::ObjectZ
            | Self::TargetX
            | Self::TargetY
            | Self::TargetZ
            | Self::OffsetX
            | Self::OffsetY => "m",
            Self::ObjectYaw
            | Self::TargetYaw
            | Self::Joint1
            | Self::Joint2
            | Self::Joint3
            | Self::Joint4
            | Self::Joint5
            | Self::Joint6
            | Self::Joint7
            | Self::Joint8
            | Self::Joint9
            | Self::Joint10
            | Self::Joint11
            | Self::Joint12
            | Self::Joint13
            | Self::Joint14
            | Self::Joint15
            | Self::Joint16 => "rad",
            Self::PictureAge => "ms",
            Self::Held => "",
        }
    }
}

crate::closed_set! {
    /// The response to a task whose start the evidence of the active version does not cover.
    OutsideResponse, "response outside the domain", {
        /// The active version runs it, and it counts as uncovered.
        Count = "count",
        /// The newest earlier version whose evidence covers the start runs it; without one it is refused.
        LastCovering = "last-covering",
        /// It is refused, and a person is called.
        Refuse = "refuse",
    }
}

/// The closed interval of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StartBound {
    /// The quantity.
    pub quantity: StartQuantity,
    /// Its least value, in its unit.
    pub low: f64,
    /// Its largest value, in its unit.
    pub high: f64,
}

impl StartBound {
    /// Whether the interval has this value; a value that is not a number is outside.
    #[must_use]
    pub fn covers(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// The intervals within which starts of a task are covered. Without any it covers no start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StartDomain {
    /// At most one for each quantity. A quantity without one is not compared.
    pub bounds: Vec<StartBound>,
}

impl StartDomain {
    /// The interval of a quantity.
    #[must_use]
    pub fn bound(&self, quantity: StartQuantity) -> Option<&StartBound> {
        self.bounds.iter().find(|bound| bound.quantity == quantity)
    }

    /// How a start, as far as it was seen, lies outside, in the order of the bounds; empty if it is covered.
    #[must_use]
    pub fn misses(&self, seen: &StartObservation) -> Vec<DomainMiss> {
        if self.bounds.is_empty() {
            return vec![DomainMiss::Undeclared];
        }
        let miss = |bound: &StartBound| {
            let StartBound { quantity, low, high } = *bound;
            let value = seen.value(quantity)?;
            let is_outside = !bound.covers(value);
            let value = Some(value).filter(|value| value.is_finite());
            is_outside.then_some(DomainMiss::Outside { quantity, value, low, high })
        };
        self.bounds.iter().filter_map(miss).collect()
    }

    /// Whether camera frames of this age are covered.
    #[must_use]
    pub fn covers_age(&self, ticks: u32) -> bool {
        self.bound(StartQuantity::PictureAge).is_none_or(|bound| bound.covers(age_ms(ticks)))
    }
}

/// What a skill sees at the start of a task: joints and hand in the first tick, poses in the first camera frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartObservation {
    joints_rad: JointVec,
    is_held: bool,
    /// Absent before the first camera frame.
    frame: Option<StartFrame>,
}

/// The first camera frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StartFrame {
    object: Pose,
    target: Pose,
    age_ms: f64,
}

impl StartObservation {
    /// The first tick, with its camera frame if there is one. `is_held`: the hand holds something.
    #[must_use]
    pub fn new(first: &Observation, is_held: bool) -> Self {
        let mut seen = Self { joints_rad: first.q.clone(), is_held, frame: None };
        seen.see(first);
        seen
    }

    /// Adds the camera frame of a later tick, unless there is one already.
    pub fn see(&mut self, observation: &Observation) {
        if self.frame.is_some() {
            return;
        }
        if let (Some(object), Some(target)) = (observation.object(), observation.target()) {
            let Estimate { pose, age_ticks, .. } = *object;
            self.frame = Some(StartFrame { object: pose, target: target.pose, age_ms: age_ms(age_ticks) });
        }
    }

    /// Whether a camera frame has been seen.
    #[must_use]
    pub const fn has_frame(&self) -> bool {
        self.frame.is_some()
    }

    /// The value of a quantity; absent while no camera frame shows it. A joint that the robot does not report is not a
    /// number.
    #[must_use]
    pub fn value(&self, quantity: StartQuantity) -> Option<f64> {
        let object = self.frame.map(|frame| frame.object);
        let target = self.frame.map(|frame| frame.target);
        let place = |of: Option<Pose>| of.map(|pose| pose.position);
        let offset = |axis: usize| {
            let [object, target] = [place(object)?, place(target)?];
            Some(object.get(axis)? - target.get(axis)?)
        };
        let joint = |index: usize| Some(self.joints_rad.get(index).copied().unwrap_or(f64::NAN));
        match quantity {
            StartQuantity::ObjectX => place(object).map(|[x, _, _]| x),
            StartQuantity::ObjectY => place(object).map(|[_, y, _]| y),
            StartQuantity::ObjectZ => place(object).map(|[_, _, z]| z),
            StartQuantity::ObjectYaw => object.map(|pose| pose.heading_rad()),
            StartQuantity::TargetX => place(target).map(|[x, _, _]| x),
            StartQuantity::TargetY => place(target).map(|[_, y, _]| y),
            StartQuantity::TargetZ => place(target).map(|[_, _, z]| z),
            StartQuantity::TargetYaw => target.map(|pose| pose.heading_rad()),
            StartQuantity::OffsetX => offset(0),
            StartQuantity::OffsetY => offset(1),
            StartQuantity::PictureAge => self.frame.map(|frame| frame.age_ms),
            StartQuantity::Held => Some(f64::from(u8::from(self.is_held))),
            StartQuantity::Joint1 => joint(0),
            StartQuantity::Joint2 => joint(1),
            StartQuantity::Joint3 => joint(2),
            StartQuantity::Joint4 => joint(3),
            StartQuantity::Joint5 => joint(4),
            StartQuantity::Joint6 => joint(5),
            StartQuantity::Joint7 => joint(6),
            StartQuantity::Joint8 => joint(7),
            StartQuantity::Joint9 => joint(8),
            StartQuantity::Joint10 => joint(9),
            StartQuantity::Joint11 => joint(10),
            StartQuantity::Joint12 => joint(11),
            StartQuantity::Joint13 => joint(12),
            StartQuantity::Joint14 => joint(13),
            StartQuantity::Joint15 => joint(14),
            StartQuantity::Joint16 => joint(15),
        }
    }
}

fn age_ms(ticks: u32) -> f64 {
    f64::from(ticks) * 1000.0 / f64::from(RATE_HZ)
}

/// How a start lies outside a domain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "miss", rename_all = "kebab-case", deny_unknown_fields)]
pub enum DomainMiss {
    /// The evidence declares no domain: it is of an older build, or of another cell.
    Undeclared,
    /// A quantity lies outside its interval.
    Outside {
        /// The quantity.
        quantity: StartQuantity,
        /// Its value, in its unit; absent if it is not a finite number.
        value: Option<f64>,
        /// The least covered value.
        low: f64,
        /// The largest covered value.
        high: f64,
    },
}

impl fmt::Display for DomainMiss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::Outside { quantity, value, low, high } = *self else {
            return f.write_str("the evidence declares no domain");
        };
        let (name, unit) = (quantity.name().replace('-', " "), quantity.unit());
        let digits = if quantity == StartQuantity::PictureAge { 0 } else { 3 };
        match (quantity, value) {
            (StartQuantity::Held, Some(held)) if held > 0.5 => f.write_str("the hand holds something"),
            (StartQuantity::Held, _) => f.write_str("the hand is empty"),
            (_, Some(value)) => {
                write!(f, "{name} {value:.digits$} {unit}, covered {low:.digits$} to {high:.digits$} {unit}")
            }
            (_, None) => {
                write!(f, "{name} is not a number, covered {low:.digits$} to {high:.digits$} {unit}")
            }
        }
    }
}

/// What of a task the evidence of its version does not cover.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Uncovered {
    /// How its start lies outside; empty if it is covered.
    pub start: Vec<DomainMiss>,
    /// Ticks after the start whose camera frame was older than is covered.
    pub old_frame_ticks: u32,
}

impl Uncovered {
    /// Whether everything was covered.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.start.is_empty() && self.old_frame_ticks == 0
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_body::{GuardVerdict, ReadingVec, TaskKind, Twist};

    use super::*;

    fn bound(quantity: StartQuantity, low: f64, high: f64) -> StartBound {
        StartBound { quantity, low, high }
    }

    /// An object at a place, and a target without noise; joints at 0.1 rad.
    fn observation(object_m: Option<[f64; 3]>, age_ticks: u32) -> Observation {
        let estimate =
            |position| Estimate { pose: Pose { position, ..Pose::IDENTITY }, age_ticks, sequence: 1 };
        Observation {
            tick: 0,
            q: JointVec::from_iter([0.1; 7]),
            dq: JointVec::new(),
            tau: JointVec::new(),
            tool: Pose::IDENTITY,
            tool_twist: Twist::default(),
            gripper_width_m: 0.08,
            gripper_force_n: 0.0,
            wrist_force_n: 0.0,
            objects: TaskKind::Grasp
                .seen_objects(object_m.map(estimate), object_m.map(|_| estimate([0.5, 0.2, 0.005]))),
            sensors: ReadingVec::new(),
            tool_available: true,
            goal: TaskKind::Grasp,
            guard: GuardVerdict::Allowed,
        }
    }

    fn domain() -> StartDomain {
        let bounds = vec![
            bound(StartQuantity::ObjectX, 0.42, 0.56),
            bound(StartQuantity::OffsetY, -0.5, 0.0),
            bound(StartQuantity::PictureAge, 0.0, 125.0),
            bound(StartQuantity::Held, 0.0, 0.0),
            bound(StartQuantity::Joint2, 0.05, 0.15),
        ];
        StartDomain { bounds }
    }

    fn quantities(misses: &[DomainMiss]) -> Vec<StartQuantity> {
        let of = |miss: &DomainMiss| match miss {
            DomainMiss::Outside { quantity, .. } => Some(*quantity),
            DomainMiss::Undeclared => None,
        };
        misses.iter().filter_map(of).collect()
    }

    #[test]
    fn ends_of_an_interval_are_covered_and_a_value_past_them_is_not() {
        for (x, covered) in [
            (0.42, true),
            (0.56, true),
            (0.560_001, false),
            (0.419_999, false),
            (f64::NAN, false),
            (f64::INFINITY, false),
        ] {
            let seen = StartObservation::new(&observation(Some([x, -0.2, 0.025]), 4), false);
            let misses = domain().misses(&seen);
            assert_eq!(misses.is_empty(), covered, "{x}: {misses:?}");
            if !covered {
                assert_eq!(quantities(&misses), [StartQuantity::ObjectX], "{x}");
            }
        }
    }

    #[test]
    fn each_quantity_is_read_from_its_own_part_of_the_observation() {
        let seen = StartObservation::new(&observation(Some([0.5, -0.2, 0.025]), 24), true);
        let value = |quantity| seen.value(quantity).unwrap();
        assert_eq!((value(StartQuantity::ObjectY), value(StartQuantity::TargetZ)), (-0.2, 0.005));
        assert!((value(StartQuantity::OffsetY) + 0.4).abs() < 1e-12);
        assert_eq!((value(StartQuantity::PictureAge), value(StartQuantity::Held)), (100.0, 1.0));
        assert_eq!(value(StartQuantity::Joint7), 0.1);
        assert!(value(StartQuantity::Joint8).is_nan(), "the robot has seven joints");
        let mut long = observation(None, 0);
        long.q = (0..16).map(f64::from).collect();
        let long = StartObservation::new(&long, false);
        let angles = StartQuantity::JOINTS.map(|joint| long.value(joint).unwrap());
        assert_eq!(angles.to_vec(), (0..16).map(f64::from).collect::<Vec<f64>>());
        let half = 0.25_f64;
        let turned = Pose { rotation: [0.0, 0.0, half.sin(), half.cos()], ..Pose::IDENTITY };
        assert!((turned.heading_rad() - 0.5).abs() < 1e-12);
        let old = StartObservation::new(&observation(Some([0.6, -0.2, 0.025]), 31), true);
        let expected = [StartQuantity::ObjectX, StartQuantity::PictureAge, StartQuantity::Held];
        assert_eq!(quantities(&domain().misses(&old)), expected);
    }

    #[test]
    fn joints_are_those_of_the_first_tick_and_poses_those_of_the_first_frame() {
        let mut seen = StartObservation::new(&observation(None, 0), false);
        assert!(!seen.has_frame() && domain().misses(&seen).is_empty(), "nothing outside has been seen");
        let mut later = observation(Some([0.6, -0.2, 0.025]), 4);
        later.q[1] = 2.0;
        seen.see(&later);
        seen.see(&observation(Some([0.5, -0.2, 0.025]), 4));
        assert_eq!(quantities(&domain().misses(&seen)), [StartQuantity::ObjectX]);
    }

    #[test]
    fn domain_without_bounds_covers_no_start() {
        let seen = StartObservation::new(&observation(Some([0.5, -0.2, 0.025]), 4), false);
        assert_eq!(StartDomain::default().misses(&seen), [DomainMiss::Undeclared]);
        assert!(StartDomain::default().covers_age(4), "the age is not compared without an interval");
        assert!(domain().covers_age(30) && !domain().covers_age(31));
    }

    #[test]
    fn a_miss_names_value_and_interval() {
        let seen = StartObservation::new(&observation(Some([0.5714, -0.2, 0.025]), 40), true);
        let texts: Vec<String> = domain().misses(&seen).iter().map(ToString::to_string).collect();
        let expected = [
            "object x 0.571 m, covered 0.420 to 0.560 m",
            "picture age 167 ms, covered 0 to 125 ms",
            "the hand holds something",
        ];
        assert_eq!(texts, expected);
        let json = serde_json::to_string(&domain().misses(&seen)).unwrap();
        assert_eq!(serde_json::from_str::<Vec<DomainMiss>>(&json).unwrap(), domain().misses(&seen));
    }
}
