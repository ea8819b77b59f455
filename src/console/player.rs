//! The player of a filmed re-run: position, whether it plays, and speed.
//!
//! Pure: the clock is an argument. Computes nothing of the film, and draws only what the engine sent.

use std::sync::Arc;

use holdpoint_body::RATE_HZ;
use holdpoint_protocol::film::{Film, FilmMark};

use crate::replay::speed::Speed;

/// Ticks of one step: a frame.
const STEP_TICKS: u64 = 8;

/// The longest step, ms: after a pause of the terminal the film does not leap.
const PASS_MS_MAX: u64 = 1_000;

/// Ticks shown before the moment at which it goes wrong.
const LEAD_TICKS: u64 = RATE_HZ as u64;

/// See the module's head.
#[derive(Clone, Debug, PartialEq)]
pub struct Player {
    pub film: Arc<Film>,
    /// Position, quarter ticks: the slowest speed moves by a quarter.
    at: u64,
    /// Console time up to which it has played, ms; absent while it is paused.
    running_ms: Option<u64>,
    pub speed: Speed,
}

impl Player {
    /// A film that plays from a second before the failure, or from the start.
    #[must_use]
    pub fn new(film: Arc<Film>, now_ms: u64) -> Self {
        let begin = film.candidate.failed_at().map_or(0, |tick| tick.saturating_sub(LEAD_TICKS));
        let mut player = Self { film, at: 0, running_ms: Some(now_ms), speed: Speed::default() };
        player.go_to(begin);
        player
    }

    /// Position, ticks.
    #[must_use]
    pub const fn tick(&self) -> u64 {
        self.at / 4
    }

    /// Whether it runs.
    #[must_use]
    pub const fn runs(&self) -> bool {
        self.running_ms.is_some()
    }

    /// Advances the film by the time passed.
    pub fn pass(&mut self, now_ms: u64) {
        let Some(until_ms) = self.running_ms else { return };
        let passed_ms = now_ms.saturating_sub(until_ms).min(PASS_MS_MAX);
        self.running_ms = Some(now_ms);
        let quarters = self.speed.quarters(passed_ms).saturating_mul(u64::from(RATE_HZ)) / 1_000;
        if quarters == 0 {
            // Not yet a quarter of a tick: the time is not lost.
            self.running_ms = Some(until_ms);
            return;
        }
        self.at = self.at.saturating_add(quarters).min(4 * self.film.end());
        if self.tick() >= self.film.end() {
            self.running_ms = None;
        }
    }

    /// Plays or pauses; at the end it starts over.
    pub fn toggle(&mut self, now_ms: u64) {
        if self.runs() {
            self.running_ms = None;
        } else {
            if self.tick() >= self.film.end() {
                self.at = 0;
            }
            self.running_ms = Some(now_ms);
        }
    }

    /// Pauses and moves by one frame.
    pub fn step(&mut self, forward: bool) {
        let at = self.tick() / STEP_TICKS;
        self.running_ms = None;
        let next = if forward { at + 1 } else { at.saturating_sub(1) };
        self.go_to(next * STEP_TICKS);
    }

    /// Moves by a number of seconds.
    pub fn skip(&mut self, forward: bool) {
        let second = u64::from(RATE_HZ);
        let tick = self.tick();
        self.go_to(if forward { tick + second } else { tick.saturating_sub(second) });
    }

    fn go_to(&mut self, tick: u64) {
        self.at = 4 * tick.min(self.film.end());
    }

    pub fn begin(&mut self) {
        self.go_to(0);
    }

    pub fn end(&mut self) {
        self.running_ms = None;
        self.go_to(self.film.end());
    }

    /// Moves to the candidate's failure; returns whether there is one.
    pub fn to_failure(&mut self) -> bool {
        let Some(tick) = self.film.candidate.failed_at() else { return false };
        self.running_ms = None;
        self.go_to(tick);
        true
    }

    /// Moves to the next mark of either version, or to the one before.
    pub fn to_mark(&mut self, forward: bool) {
        let here = self.tick();
        let ticks = self.marks().map(|(_, mark)| mark.tick);
        let next = if forward {
            ticks.filter(|tick| *tick > here).min()
        } else {
            ticks.filter(|tick| *tick < here).max()
        };
        if let Some(tick) = next {
            self.running_ms = None;
            self.go_to(tick);
        }
    }

    /// The marks of the candidate (`true`) and of the active version.
    pub fn marks(&self) -> impl Iterator<Item = (bool, &FilmMark)> {
        let own = self.film.candidate.marks.iter().map(|mark| (true, mark));
        own.chain(self.film.active.marks.iter().map(|mark| (false, mark)))
    }
}
