//! The quantities of the health view, one a pane: their values in a bucket, their unit, and their labels.
//!
//! Owns no drawing: the view has it.

use crate::trend::SCALE;
use holdpoint_protocol::health::{HealthPoint, together};
use holdpoint_wording::console::health as wording;

/// Columns of a number at the axis.
pub(super) const LABEL_WIDTH: usize = SCALE as usize - 2;

/// The quantity of a pane.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum HealthQuantity {
    Success,
    Violations,
    Time,
    Force,
}

impl HealthQuantity {
    /// Of a pane of the view.
    pub(super) const fn of(pane: usize) -> Self {
        match pane {
            1 => Self::Violations,
            2 => Self::Time,
            3 => Self::Force,
            _ => Self::Success,
        }
    }

    /// Value and band of a family's results in one bucket, in the unit of the axis.
    pub(super) fn of_points(self, points: &[&HealthPoint]) -> Option<(f64, [f64; 2])> {
        let tasks: u64 = points.iter().map(|point| point.tasks).sum();
        let share = |count: u64| 100.0 * count as f64 / tasks.max(1) as f64;
        // Medians cannot be averaged: of several versions in a bucket, the one with the most episodes is shown.
        let most = points.iter().max_by_key(|point| point.tasks)?;
        Some(match self {
            Self::Success => {
                let (tasks, done, interval) = together(points.iter().copied())?;
                (100.0 * done as f64 / tasks as f64, interval.map(|end| 100.0 * end))
            }
            Self::Violations => {
                let violated = share(points.iter().map(|point| point.violated).sum());
                (violated, [violated, share(points.iter().map(|point| point.near).sum())])
            }
            Self::Time => (most.time_s[0], most.time_s),
            Self::Force => (most.force_n[0], most.force_n),
        })
    }

    /// The unit of the axis.
    const fn unit(self) -> &'static str {
        match self {
            Self::Success | Self::Violations => "%",
            Self::Time => "s",
            Self::Force => "N",
        }
    }

    /// A number of the axis with its unit, in the columns beside a chart.
    pub(super) fn label(self, value: f64) -> String {
        let (number, unit) =
            (if value < 10.0 { format!("{value:.1}") } else { format!("{value:.0}") }, self.unit());
        let label = format!("{number} {unit}");
        if label.len() <= LABEL_WIDTH { label } else { format!("{number}{unit}") }
    }

    /// The meaning of the dots and the band.
    pub(super) const fn legend(self) -> &'static str {
        match self {
            Self::Success => wording::SUCCESS,
            Self::Violations => wording::VIOLATIONS,
            Self::Time => wording::TIME,
            Self::Force => wording::FORCE,
        }
    }
}
