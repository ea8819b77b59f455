//! `native:place`: lower the aligned object into the tray, let go and retreat.

use holdpoint_body::{Command, FailureSignal, Observation, Pose, TaskKind};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::motion::{
    AbortStyle, OBJECT_HALF_M, PoseAverage, RollbackStyle, arrived, at_height, holds_something, ticks,
    wrap_quarter, yaw_of,
};
use super::phases::{PhaseFrame, PhaseRun, Phased};

/// The parameters of a place version. Lengths in meters, speeds in m/s.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaceParams {
    /// Camera frames of object and tray averaged for a correction before lowering; 0 lowers without one.
    pub look_pictures: u32,
    /// Tool speed of the descent.
    pub lower_speed_m_s: f64,
    /// Wrist force that ends the descent, N.
    pub contact_force_n: f64,
    /// Height above the tray floor at which a contact still counts as arrival.
    pub seat_tolerance_m: f64,
    /// Height above the tray floor at which the gripper releases the object without contact.
    pub release_gap_m: f64,
    /// Pad distance after letting go.
    pub release_width_m: f64,
    /// Opening speed of the pad distance.
    pub release_speed_m_s: f64,
    /// Seconds between opening and retreat.
    pub settle_secs: f64,
    /// How far the tool rises after the release.
    pub retreat_height_m: f64,
    /// Tool speed of the retreat.
    pub retreat_speed_m_s: f64,
    /// Distance that the hand then moves to the pick side (-y) at that height; 0 stays over the tray. Saves the next
    /// grasp a part of its path, low over obstacles.
    pub exit_offset_m: f64,
    /// Sideways step of the search after an early contact; 0 gives up at once.
    pub search_step_m: f64,
    /// New attempts after an early contact, 0 to 8.
    pub retries_max: u32,
    /// After letting go, look whether the object lies in the tray.
    pub verify: bool,
    /// Seconds to wait for a gripper that does not answer.
    pub tool_wait_secs: f64,
    /// Seconds the whole work may take.
    pub timeout_secs: f64,
    /// What the safe-abort hook does.
    pub abort: AbortStyle,
    /// What the rollback hook does.
    pub rollback: RollbackStyle,
    /// Height the hooks rise to.
    pub safe_height_m: f64,
}

/// Its phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlacePhase {
    Look,
    Correct,
    Lower,
    BackUp,
    Release,
    Retreat,
    Exit,
    Verify,
}

/// The place controller at work.
#[derive(Clone, Debug)]
pub struct Place {
    params: PlaceParams,
    tray: PoseAverage,
    object: PoseAverage,
    /// Height of the object's center below the tool, m.
    hang_m: f64,
    seat_height_m: f64,
    retries: u32,
}

impl Place {
    /// A controller before its first tick.
    #[must_use]
    pub fn new(params: PlaceParams) -> Self {
        Self {
            params,
            tray: PoseAverage::default(),
            object: PoseAverage::default(),
            hang_m: 0.0,
            seat_height_m: 0.03,
            retries: 0,
        }
    }

    fn look(&mut self, run: &mut PhaseRun<PlacePhase>, seen: &Observation) -> Command {
        let p = self.params.clone();
        if run.tick == 1 && !holds_something(seen) {
            // Taken over after the object was let go: only the retreat is left.
            run.go(PlacePhase::Retreat);
            return Command::Hold;
        }
        let fresh = |age: u32| self.retries == 0 || u64::from(age) < run.tick;
        if let Some(picture) = seen.target().filter(|picture| fresh(picture.age_ticks)) {
            self.tray.add(picture);
        }
        if let Some(picture) = seen.object().filter(|picture| fresh(picture.age_ticks)) {
            self.object.add(picture);
        }
        // A version that does not correct also needs one camera frame to know the height of the tray floor.
        let wanted = p.look_pictures.max(1);
        if self.tray.count() < wanted || self.object.count() < wanted {
            if run.tick > ticks(2.5) {
                return run.finish(Some(FailureSignal::TargetNotFound));
            }
            return Command::Hold;
        }
        let (Some((seat, seat_yaw)), Some((object, object_yaw))) = (self.tray.mean(), self.object.mean())
        else {
            return run.finish(Some(FailureSignal::TargetNotFound));
        };
        self.hang_m = seen.tool.position[2] - object[2];
        self.seat_height_m = seat[2] + OBJECT_HALF_M;
        if p.look_pictures == 0 {
            run.go(PlacePhase::Lower);
            return Command::Hold;
        }
        // A search step turns by a quarter at each attempt, so that the four sides are tried.
        let step = if self.retries == 0 { 0.0 } else { p.search_step_m };
        let side = f64::from(self.retries) * std::f64::consts::FRAC_PI_2;
        let yaw = yaw_of(&seen.tool) + wrap_quarter(seat_yaw - object_yaw);
        let position = [
            seen.tool.position[0] + seat[0] - object[0] + step * libm::cos(side),
            seen.tool.position[1] + seat[1] - object[1] + step * libm::sin(side),
            seen.tool.position[2],
        ];
        run.target = super::motion::hand_down(position, yaw);
        run.go(PlacePhase::Correct);
        Command::ToolPose { pose: run.target, max_speed_m_s: p.lower_speed_m_s }
    }

    fn lower(&mut self, run: &mut PhaseRun<PlacePhase>, seen: &Observation) -> Command {
        let p = self.params.clone();
        let released_at = self.seat_height_m + self.hang_m + p.release_gap_m;
        if !run.commanded {
            run.commanded = true;
            run.target = at_height(if p.look_pictures > 0 { run.target } else { seen.tool }, released_at);
            return Command::ToolPose { pose: run.target, max_speed_m_s: p.lower_speed_m_s };
        }
        let height_m = seen.tool.position[2] - self.hang_m - self.seat_height_m;
        let touched = run.tick > 12 && seen.wrist_force_n > p.contact_force_n;
        if touched && height_m > p.seat_tolerance_m {
            if self.retries >= p.retries_max || p.search_step_m == 0.0 {
                run.finish(Some(FailureSignal::UnexpectedContact));
                return Command::Stop;
            }
            self.retries += 1;
            run.go(PlacePhase::BackUp);
            run.target = at_height(seen.tool, seen.tool.position[2] + 0.02);
            return Command::ToolPose { pose: run.target, max_speed_m_s: p.lower_speed_m_s };
        }
        if touched || arrived(seen, &run.target, 0.003) {
            run.go(PlacePhase::Release);
            return Command::Stop;
        }
        Command::Hold
    }

    fn verify(&mut self, run: &mut PhaseRun<PlacePhase>, seen: &Observation) -> Command {
        if !self.params.verify {
            return run.finish(None);
        }
        if run.tick == 1 {
            // What was seen before the hand went away does not count.
            self.object = PoseAverage::default();
            self.tray = PoseAverage::default();
        }
        let fresh = |age: u32| u64::from(age) < run.tick;
        if let Some(picture) = seen.target().filter(|picture| fresh(picture.age_ticks)) {
            self.tray.add(picture);
        }
        if let Some(picture) = seen.object().filter(|picture| fresh(picture.age_ticks)) {
            self.object.add(picture);
        }
        if self.tray.count() >= 3 && self.object.count() >= 3 {
            let inside = match (self.tray.mean(), self.object.mean()) {
                (Some((seat, _)), Some((object, _))) => {
                    libm::hypot(seat[0] - object[0], seat[1] - object[1]) < 0.012
                        && (object[2] - seat[2] - OBJECT_HALF_M).abs() < 0.008
                }
                _ => false,
            };
            return run.finish((!inside).then_some(FailureSignal::PlacementMissed));
        }
        if run.tick > ticks(1.5) {
            return run.finish(Some(FailureSignal::TargetNotFound));
        }
        Command::Hold
    }
}

impl Phased for Place {
    type Phase = PlacePhase;
    const FIRST: PlacePhase = PlacePhase::Look;

    fn frame(&self) -> PhaseFrame {
        let p = &self.params;
        PhaseFrame {
            timeout_secs: p.timeout_secs,
            abort: p.abort,
            rollback: p.rollback,
            safe_height_m: p.safe_height_m,
            hook_speed_m_s: p.retreat_speed_m_s,
        }
    }

    fn work(&mut self, run: &mut PhaseRun<PlacePhase>, seen: &Observation) -> Command {
        let p = self.params.clone();
        let carrying = matches!(
            run.phase,
            PlacePhase::Look | PlacePhase::Correct | PlacePhase::Lower | PlacePhase::BackUp
        );
        if carrying && run.tick > 24 && !holds_something(seen) {
            return run.finish(Some(FailureSignal::ObjectSlipped));
        }
        match run.phase {
            PlacePhase::Look => self.look(run, seen),
            PlacePhase::Correct => {
                if arrived(seen, &run.target, 0.001) || run.tick > ticks(0.8) {
                    run.go(PlacePhase::Lower);
                }
                Command::Hold
            }
            PlacePhase::Lower => self.lower(run, seen),
            PlacePhase::BackUp => {
                if arrived(seen, &run.target, 0.003) || run.tick > ticks(1.5) {
                    if p.look_pictures > 0 {
                        self.tray = PoseAverage::default();
                        self.object = PoseAverage::default();
                        run.go(PlacePhase::Look);
                    } else {
                        run.go(PlacePhase::Lower);
                    }
                }
                Command::Hold
            }
            PlacePhase::Release => {
                if !run.commanded {
                    if !seen.tool_available {
                        if run.tick > ticks(p.tool_wait_secs) {
                            return run.finish(Some(FailureSignal::ToolUnavailable));
                        }
                        return Command::Hold;
                    }
                    run.commanded = true;
                    run.tick = 0;
                    return Command::Gripper {
                        width_m: p.release_width_m,
                        speed_m_s: p.release_speed_m_s,
                        force_n: 20.0,
                    };
                }
                let open_secs = 0.03 / p.release_speed_m_s;
                if run.tick > ticks(open_secs + p.settle_secs) {
                    run.go(PlacePhase::Retreat);
                }
                Command::Hold
            }
            PlacePhase::Retreat => {
                if !run.commanded {
                    run.commanded = true;
                    run.target = at_height(seen.tool, seen.tool.position[2] + p.retreat_height_m);
                    return Command::ToolPose { pose: run.target, max_speed_m_s: p.retreat_speed_m_s };
                }
                if arrived(seen, &run.target, 0.006) {
                    run.go(if p.exit_offset_m > 0.0 { PlacePhase::Exit } else { PlacePhase::Verify });
                }
                Command::Hold
            }
            PlacePhase::Exit => {
                if !run.commanded {
                    run.commanded = true;
                    let [x, y, z] = seen.tool.position;
                    run.target = Pose { position: [x, y - p.exit_offset_m, z], ..seen.tool };
                    return Command::ToolPose { pose: run.target, max_speed_m_s: p.retreat_speed_m_s };
                }
                if arrived(seen, &run.target, 0.01) {
                    run.go(PlacePhase::Verify);
                }
                Command::Hold
            }
            PlacePhase::Verify => self.verify(run, seen),
        }
    }
}

/// The signals this controller's code can raise with these parameters.
#[must_use]
pub fn signals(params: &PlaceParams) -> Vec<FailureSignal> {
    let mut signals = vec![
        FailureSignal::TargetNotFound,
        FailureSignal::ObjectSlipped,
        FailureSignal::UnexpectedContact,
        FailureSignal::ToolUnavailable,
        FailureSignal::TimedOut,
    ];
    if params.verify {
        signals.push(FailureSignal::PlacementMissed);
    }
    signals
}

/// The primitive this controller performs.
pub const TASK: TaskKind = TaskKind::Place;
