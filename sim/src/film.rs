//! Records what a world shows during a run, for later viewing.
//!
//! Looks and keeps. It changes no step, and is in no snapshot, copy or digest: an episode that is filmed is the same
//! episode.

use holdpoint_cell::film::{EpisodeFrame, FRAME_EVERY_TICKS, FRAMES_MAX};

use crate::world::World;

/// The frames of one episode.
#[derive(Default)]
pub(crate) struct EpisodeFilm {
    frames: Vec<EpisodeFrame>,
    speed_m_s: f64,
    grip_n: f64,
    contact_n: f64,
    touched: bool,
}

impl EpisodeFilm {
    fn note(&mut self, world: &World) {
        if self.frames.len() >= FRAMES_MAX {
            return;
        }
        let seen = world.telemetry();
        let contacts = &seen.contacts;
        self.speed_m_s = self.speed_m_s.max(seen.tool_speed_m_s);
        self.grip_n = self.grip_n.max(seen.gripper_force_n);
        self.contact_n = self.contact_n.max(seen.contact_force_n);
        self.touched |= contacts.robot_fixture || contacts.robot_clutter || contacts.robot_robot;
        let tick = world.tick();
        if tick.is_multiple_of(FRAME_EVERY_TICKS) {
            let last = std::mem::take(self);
            self.frames = last.frames;
            self.frames.push(EpisodeFrame {
                tick,
                seen,
                tau: world.torques().clone(),
                object: world.object().0,
                speed_m_s: last.speed_m_s,
                grip_n: last.grip_n,
                contact_n: last.contact_n,
                touched: last.touched,
                stopped: world.stop_declared().is_some(),
            });
        }
    }

    /// Nothing of what came after a tick has happened.
    fn rewind(&mut self, tick: u64) {
        let mut frames = std::mem::take(&mut self.frames);
        frames.retain(|frame| frame.tick <= tick);
        *self = Self { frames, ..Self::default() };
    }
}

impl World {
    /// From now on every episode is filmed, from its reset on.
    pub fn film(&mut self) {
        self.film = Some(Box::default());
        self.keep_frame();
    }

    /// The frames of the episode so far, oldest first; none if it is not filmed. After [`World::go_on_from`] they are
    /// what this world showed up to there: the same work, where it is the same episode.
    #[must_use]
    pub fn take_film(&mut self) -> Vec<EpisodeFrame> {
        self.film.as_mut().map(|film| std::mem::take(film.as_mut()).frames).unwrap_or_default()
    }

    /// Keeps what this tick shows.
    pub(crate) fn keep_frame(&mut self) {
        if let Some(mut film) = self.film.take() {
            film.note(self);
            self.film = Some(film);
        }
    }

    /// Another episode begins.
    pub(crate) fn restart_film(&mut self) {
        if self.film.is_some() {
            self.film();
        }
    }

    /// It stands at an earlier tick of its episode again.
    pub(crate) fn rewind_film(&mut self) {
        let tick = self.tick();
        if let Some(film) = &mut self.film {
            film.rewind(tick);
        }
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_body::{Command, TaskKind};

    use super::*;
    use crate::RobotModel;
    use holdpoint_cell::EpisodeSetup;

    fn world() -> World {
        let robot = RobotModel::builtin("arm7").unwrap();
        World::new(&robot, &crate::published::scene().unwrap()).unwrap()
    }

    fn setup(world: &World, seed: u64) -> EpisodeSetup {
        EpisodeSetup::sample(TaskKind::Grasp, world.scene(), &crate::published::canonical().unwrap(), seed)
    }

    #[test]
    fn filming_changes_no_state_of_an_episode() {
        let (mut plain, mut filmed) = (world(), world());
        filmed.film();
        for world in [&mut plain, &mut filmed] {
            let setup = setup(world, 7);
            world.reset(&setup).unwrap();
            for _ in 0..40 {
                world.step(&Command::Hold).unwrap();
            }
        }
        assert_eq!(plain.state_hash(), filmed.state_hash());
        assert!(plain.take_film().is_empty());
        let ticks: Vec<u64> = filmed.take_film().iter().map(|frame| frame.tick).collect();
        assert_eq!(ticks, [0, 8, 16, 24, 32, 40]);
    }

    #[test]
    fn film_drops_the_frames_after_a_restored_copy() {
        let mut world = world();
        world.film();
        let setup = setup(&world, 7);
        world.reset(&setup).unwrap();
        let step =
            |world: &mut World, count: usize| (0..count).for_each(|_| world.step(&Command::Hold).unwrap());
        step(&mut world, 20);
        let copy = world.copy();
        step(&mut world, 60);
        world.go_on_from(&copy).unwrap();
        step(&mut world, 10);
        let ticks: Vec<u64> = world.take_film().iter().map(|frame| frame.tick).collect();
        assert_eq!(ticks, [0, 8, 16, 24]);
    }

    #[test]
    fn peaks_between_frames_are_recorded() {
        let mut world = world();
        world.film();
        let setup = setup(&world, 7);
        world.reset(&setup).unwrap();
        let q = world.telemetry().q.iter().map(|at| at + 0.2).collect();
        let mut peak = 0.0_f64;
        world.step(&Command::Joints { q, max_speed_rad_s: 1.0 }).unwrap();
        peak = peak.max(world.telemetry().tool_speed_m_s);
        for _ in 0..79 {
            world.step(&Command::Hold).unwrap();
            peak = peak.max(world.telemetry().tool_speed_m_s);
        }
        let recorded = world.take_film().iter().fold(0.0_f64, |most, frame| most.max(frame.speed_m_s));
        assert!(peak > 0.05 && (recorded - peak).abs() < 1e-12, "{recorded} of {peak}");
    }
}
