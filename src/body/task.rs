//! The tasks that there are: each is declared once, with its name and what the rest of the program asks of it.
//!
//! Owns the declarations and the sequence of the built-in cell. Whether the work is done is physics and belongs to the
//! cell that performs the task. How it is done belongs to a controller.

use serde::{Deserialize, Serialize};

use crate::messages::FailureSignal;

/// What a task is, beside the physics of the cell that performs it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskDeclaration {
    /// How an episode of the task alone starts.
    pub start: EpisodeStart,
    /// Whether the hand holds the object when the task is done.
    pub ends_held: bool,
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

/// Declares the tasks: the variant, the name in manifests and on screen, and the declaration.
macro_rules! tasks {
    ($($(#[$doc:meta])* $variant:ident = $name:literal => $declaration:expr),+ $(,)?) => {
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
        }
    };
}

tasks! {
    /// Approach the object on the table, close on it and lift it.
    Grasp = "grasp" => TaskDeclaration {
        start: EpisodeStart::Home,
        ends_held: true,
        zone: "work",
        attempt: AttemptMark::Close,
        // The object stands on the table until it is lifted.
        object_meets_fixture: true,
        body_meets_object: false,
        not_done: FailureSignal::GraspMissed,
    },
    /// Bring the held object over the tray, square to it.
    Align = "align" => TaskDeclaration {
        start: EpisodeStart::InHand,
        ends_held: true,
        zone: "tray",
        attempt: AttemptMark::Descent,
        object_meets_fixture: false,
        body_meets_object: false,
        not_done: FailureSignal::AlignmentLost,
    },
    /// Set the held object down in the tray and retreat.
    Place = "place" => TaskDeclaration {
        start: EpisodeStart::OverTarget,
        ends_held: false,
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
