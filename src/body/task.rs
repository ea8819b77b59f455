//! The tasks that there are: each is declared once, with its name and what the rest of the program asks of it.
//!
//! Owns the declarations and the sequence of the built-in cell. Whether a condition of done work holds is physics and
//! belongs to the cell that performs the task. How the work is done belongs to a controller.

use serde::{Deserialize, Serialize};

use crate::messages::{Estimate, FailureSignal, ObjectName, ObjectVec, SeenObject};

/// What a task is, beside the physics of the cell that performs it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskDeclaration {
    /// How an episode of the task alone starts.
    pub start: EpisodeStart,
    /// Whether the hand holds the object when the task is done.
    pub ends_held: bool,
    /// The name of the object on which the task works.
    pub object: &'static str,
    /// The name of the place to which the work brings it.
    pub target: &'static str,
    /// The zone of the cell in which the tool works.
    pub zone: &'static str,
    /// The command that begins an attempt.
    pub attempt: AttemptMark,
    /// Whether the work brings the object into contact with table or tray.
    pub object_meets_fixture: bool,
    /// Whether the work brings parts of the robot other than the pads into contact with the object.
    pub body_meets_object: bool,
    /// The failure if the work was not done and nothing else tells why.
    pub not_done: FailureSignal,
}

/// How an episode of a task alone starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EpisodeStart {
    /// The arm at home, the hand empty, the object on the table.
    Home,
    /// The object in the hand, over the place where it was drawn.
    InHand,
    /// The object in the hand, over the tray.
    OverTarget,
}

impl EpisodeStart {
    /// Whether the hand holds the object.
    #[must_use]
    pub const fn is_held(self) -> bool {
        match self {
            Self::Home => false,
            Self::InHand | Self::OverTarget => true,
        }
    }
}

/// The command that begins an attempt at a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttemptMark {
    /// The hand closes.
    Close,
    /// The tool descends.
    Descent,
}

/// What holds at the end of a task whose work is done. The cell measures it within the tolerances of its scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DoneCondition {
    /// The hand holds the object, and it has not slipped.
    InHand,
    /// The object is higher than at the start of the task.
    Lifted,
    /// The object is over the middle of the target.
    OverTarget,
    /// The object is square to the target.
    SquareToTarget,
    /// The object is at the height of release over the target.
    AtHover,
    /// The object is inside the target.
    InTarget,
    /// The object stands on the ground of the target.
    Seated,
    /// A face of the object points up.
    Upright,
    /// The object does not move.
    Still,
    /// No part of the robot touches the object.
    Untouched,
    /// The tool is away from the object.
    ToolClear,
}

/// Declares the tasks: the variant, the name in manifests and on screen, the conditions of done work, and the declaration.
macro_rules! tasks {
    ($($(#[$doc:meta])* $variant:ident = $name:literal, done: [$($done:ident),+] => $declaration:expr),+ $(,)?) => {
        /// One primitive of the cell's work; a sequence is several of them in the order of the cell.
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema,
        )]
        pub enum TaskKind { $($(#[$doc])* #[serde(rename = $name)] $variant),+ }

        impl TaskKind {
            /// Every declared task, in the order of the declarations.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$variant),+];

            /// Lower-case name, as in manifests and on screen. The family that performs the task bears it.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),+ }
            }

            /// What the task is.
            #[must_use]
            pub const fn declaration(self) -> &'static TaskDeclaration {
                match self { $(Self::$variant => const { &$declaration }),+ }
            }

            /// What holds at its end if the work is done.
            #[must_use]
            pub const fn done(self) -> &'static [DoneCondition] {
                match self { $(Self::$variant => &[$(DoneCondition::$done),+]),+ }
            }
        }
    };
}

tasks! {
    /// Approach the object on the table, close on it and lift it.
    Grasp = "grasp", done: [InHand, Lifted] => TaskDeclaration {
        start: EpisodeStart::Home,
        ends_held: true,
        object: "object",
        target: "tray",
        zone: "work",
        attempt: AttemptMark::Close,
        // The object stands on the table until it is lifted.
        object_meets_fixture: true,
        body_meets_object: false,
        not_done: FailureSignal::GraspMissed,
    },
    /// Bring the held object over the tray, square to it.
    Align = "align", done: [InHand, OverTarget, SquareToTarget, AtHover, Still] => TaskDeclaration {
        start: EpisodeStart::InHand,
        ends_held: true,
        object: "object",
        target: "tray",
        zone: "tray",
        attempt: AttemptMark::Descent,
        object_meets_fixture: false,
        body_meets_object: false,
        not_done: FailureSignal::AlignmentLost,
    },
    /// Set the held object down in the tray and retreat.
    Place = "place", done: [InTarget, Seated, Upright, Still, Untouched, ToolClear] => TaskDeclaration {
        start: EpisodeStart::OverTarget,
        ends_held: false,
        object: "object",
        target: "tray",
        zone: "tray",
        attempt: AttemptMark::Descent,
        object_meets_fixture: true,
        body_meets_object: true,
        not_done: FailureSignal::PlacementMissed,
    },
}

impl TaskKind {
    /// The tasks of the built-in cell, in their order.
    pub const SEQUENCE: [Self; 3] = [Self::Grasp, Self::Align, Self::Place];

    /// The task of this name; `None` if none is declared.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|task| task.name() == name)
    }

    /// The object and the target of the task under their names, as far as they are in sight.
    #[must_use]
    pub fn seen_objects(self, object: Option<Estimate>, target: Option<Estimate>) -> ObjectVec {
        let declared = self.declaration();
        let seen = |name: &str, estimate: Option<Estimate>| {
            Some(SeenObject { name: ObjectName::from(name).ok()?, estimate: estimate? })
        };
        [seen(declared.object, object), seen(declared.target, target)].into_iter().flatten().collect()
    }
}

impl std::fmt::Display for TaskKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// What [`is_sequence`] asks of tasks, for errors.
pub const SEQUENCE_ALLOWED: &str =
    "at least one task, each once, and each starting with the hand as the one before leaves it";

/// Whether tasks make a sequence: there is one, each is there once, and each starts with the hand as the one before
/// leaves it. The first starts with an empty hand.
#[must_use]
pub fn is_sequence(tasks: &[TaskKind]) -> bool {
    let mut is_held = false;
    for (place, task) in tasks.iter().enumerate() {
        let declared = task.declaration();
        if declared.start.is_held() != is_held || tasks.iter().take(place).any(|before| before == task) {
            return false;
        }
        is_held = declared.ends_held;
    }
    !tasks.is_empty()
}

#[cfg(test)]
mod tests {
    use TaskKind::{Align, Grasp, Place};

    use super::*;
    use crate::messages::{
        GuardVerdict, JointVec, OBJECT_NAME_BYTES_MAX, Observation, Pose, ReadingVec, Twist,
    };

    fn estimate(x: f64) -> Estimate {
        Estimate { pose: Pose { position: [x, 0.0, 0.0], ..Pose::IDENTITY }, age_ticks: 3, sequence: 7 }
    }

    fn observation(objects: ObjectVec) -> Observation {
        Observation {
            tick: 0,
            q: JointVec::new(),
            dq: JointVec::new(),
            tau: JointVec::new(),
            tool: Pose::IDENTITY,
            tool_twist: Twist::default(),
            gripper_width_m: 0.0,
            gripper_force_n: 0.0,
            wrist_force_n: 0.0,
            objects,
            sensors: ReadingVec::new(),
            tool_available: true,
            goal: Place,
            guard: GuardVerdict::Allowed,
        }
    }

    #[test]
    fn declared_objects_have_two_names_that_fit() {
        for task in TaskKind::ALL {
            let declared = task.declaration();
            assert_ne!(declared.object, declared.target, "{task}");
            for name in [declared.object, declared.target] {
                assert!((1..=OBJECT_NAME_BYTES_MAX).contains(&name.len()), "{task}: {name}");
            }
        }
    }

    #[test]
    fn a_task_ends_with_the_object_in_hand_where_its_done_work_needs_it() {
        for task in TaskKind::ALL {
            let is_held = task.done().contains(&DoneCondition::InHand);
            assert_eq!(is_held, task.declaration().ends_held, "{task}");
        }
    }

    #[test]
    fn object_and_target_are_found_by_the_names_of_the_goal() {
        let mut seen = observation(Place.seen_objects(Some(estimate(0.1)), Some(estimate(0.2))));
        let other = SeenObject { name: ObjectName::from("lid").unwrap(), estimate: estimate(0.3) };
        seen.objects.insert(0, other);
        assert_eq!((seen.object(), seen.target()), (Some(&estimate(0.1)), Some(&estimate(0.2))));
        assert_eq!((seen.named("lid"), seen.named("tray")), (Some(&estimate(0.3)), seen.target()));
        seen.target_mut().unwrap().age_ticks = 9;
        assert_eq!((seen.target().unwrap().age_ticks, seen.object().unwrap().age_ticks), (9, 3));
        seen.object_mut().unwrap().sequence = 8;
        assert_eq!((seen.object().unwrap().sequence, seen.objects.len()), (8, 3));
    }

    #[test]
    fn what_is_not_in_sight_has_no_entry() {
        let only = observation(Place.seen_objects(None, Some(estimate(0.2))));
        assert_eq!((only.object(), only.target(), only.objects.len()), (None, Some(&estimate(0.2)), 1));
        assert!(Place.seen_objects(None, None).is_empty());
        assert_eq!(only.named("lid"), None);
    }

    #[test]
    fn a_name_finds_its_task_and_no_two_tasks_share_one() {
        for task in TaskKind::ALL {
            assert_eq!(TaskKind::named(task.name()), Some(task));
            assert_eq!(TaskKind::named(&task.to_string()), Some(task));
        }
        assert_eq!(TaskKind::named("park"), None);
    }

    /// Records and the wire have these names and these numbers.
    #[test]
    fn names_and_order_of_the_recorded_tasks_stay() {
        assert_eq!([Grasp, Align, Place].map(TaskKind::name), ["grasp", "align", "place"]);
        assert_eq!([Grasp, Align, Place].map(|task| task as u32), [0, 1, 2]);
        assert_eq!(format!("{:?}", TaskKind::SEQUENCE), "[Grasp, Align, Place]");
    }

    #[test]
    fn a_task_follows_only_one_that_leaves_the_hand_as_it_starts() {
        assert!(is_sequence(&TaskKind::SEQUENCE));
        let table: [(&[TaskKind], bool); 7] = [
            (&[], false),
            (&[Grasp], true),
            (&[Grasp, Place], true),
            (&[Align, Grasp], false),
            (&[Grasp, Grasp], false),
            (&[Grasp, Place, Align], false),
            // Each follows the one before, and one is there twice.
            (&[Grasp, Place, Grasp, Align], false),
        ];
        for (tasks, expected) in table {
            assert_eq!(is_sequence(tasks), expected, "{tasks:?}");
        }
    }
}
