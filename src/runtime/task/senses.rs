//! What a task shows of the cell it is worked in: how steadily the camera sees what stands, how often it sees nothing.

use holdpoint_body::{Observation, Pose};
use holdpoint_governance::sensor_health::SensorReadings;

/// Counts over the ticks of one task.
#[derive(Clone, Debug, Default)]
pub(super) struct SensesMeter {
    /// The newest camera frame of the tray: its number and the measured pose.
    newest: Option<(u32, Pose)>,
    /// Squared steps from picture to picture, m².
    steps_m2: f64,
    steps: u32,
    /// Ticks since the first picture, and of these without one.
    ticks: u32,
    blind: u32,
}

impl SensesMeter {
    /// Takes in one tick.
    pub(super) fn note(&mut self, observation: &Observation) {
        let Some(target) = observation.target() else {
            if self.newest.is_some() {
                self.ticks = self.ticks.saturating_add(1);
                self.blind = self.blind.saturating_add(1);
            }
            return;
        };
        self.ticks = self.ticks.saturating_add(1);
        match &self.newest {
            Some((number, _)) if *number == target.sequence => return,
            Some((_, before)) => {
                let [dx, dy] = [0, 1].map(|axis| target.pose.position[axis] - before.position[axis]);
                self.steps_m2 += dx * dx + dy * dy;
                self.steps = self.steps.saturating_add(1);
            }
            None => {}
        }
        self.newest = Some((target.sequence, target.pose));
    }

    /// What it comes to.
    pub(super) fn values(&self) -> SensorReadings {
        let mean_m2 = (self.steps > 0).then(|| self.steps_m2 / f64::from(self.steps));
        SensorReadings {
            picture_jitter_m: mean_m2.map(libm::sqrt),
            pictures_missing: (self.ticks > 0).then(|| f64::from(self.blind) / f64::from(self.ticks)),
        }
    }
}
