//! Which pictures a file gets: few of the many that look alike, and all of a sequence in which something happened.
//!
//! Decides by virtual time only, so that the same run gives the same file.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use super::limits::{FULL_SEQUENCES_MAX, GAPS_MS, SEQUENCE_PICTURES_MAX};
use crate::engine::clock::tick_of;
use crate::engine::picture::Picture;

/// How much something matters that happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// A task failed, or something was touched that should not be.
    Noted,
    /// The monitor decided, or the version is taken off.
    Decisive,
}

/// A sequence whose pictures are kept.
#[derive(Debug)]
struct Kept {
    sequence: u64,
    pictures: Vec<Arc<Picture>>,
    whole: bool,
}

/// Chooses pictures.
#[derive(Debug, Default)]
pub struct Pace {
    /// The last two sequences: what happened in one is told when the next has begun.
    kept: VecDeque<Kept>,
    /// Ticks that are in the file: a tick names a picture there.
    ticks: BTreeSet<u64>,
    last_ms: Option<u64>,
    chosen_ms: Option<u64>,
    /// How much of the cell's work was recorded, ms.
    recorded_ms: u64,
    noted: u32,
    decisive: u32,
}

/// Two pictures that are further apart are not of one piece of work, ms.
const PIECE_MS: u64 = 1_000;

impl Pace {
    /// A picture that came; gives those that are to be written now.
    pub fn came(&mut self, picture: &Arc<Picture>) -> Vec<Arc<Picture>> {
        let at_ms = picture.at_ms;
        let step_ms = self.last_ms.map_or(0, |last| at_ms.saturating_sub(last));
        self.recorded_ms += step_ms.min(PIECE_MS);
        self.last_ms = Some(at_ms);
        let begins = self.kept.back().is_none_or(|kept| kept.sequence != picture.sequence);
        if begins {
            if self.kept.len() >= 2 {
                self.kept.pop_front();
            }
            self.kept.push_back(Kept { sequence: picture.sequence, pictures: Vec::new(), whole: false });
        }
        let Some(kept) = self.kept.back_mut() else { return Vec::new() };
        let gap_ms = gap_ms(self.recorded_ms);
        let due = begins || self.chosen_ms.is_none_or(|chosen| at_ms >= chosen.saturating_add(gap_ms));
        if !due && !kept.whole {
            if kept.pictures.len() < SEQUENCE_PICTURES_MAX {
                kept.pictures.push(Arc::clone(picture));
            }
            return Vec::new();
        }
        if due {
            self.chosen_ms = Some(at_ms);
        }
        self.new_ones(vec![Arc::clone(picture)])
    }

    /// Something happened in a sequence (absent: in the running one); gives the pictures that were held back.
    pub fn happened(&mut self, sequence: Option<u64>, news: News) -> Vec<Arc<Picture>> {
        let place = match sequence {
            Some(sequence) => self.kept.iter().position(|kept| kept.sequence == sequence),
            None => self.kept.len().checked_sub(1),
        };
        let Some(kept) = place.and_then(|place| self.kept.get_mut(place)) else { return Vec::new() };
        let spent = match news {
            News::Noted => &mut self.noted,
            News::Decisive => &mut self.decisive,
        };
        if kept.whole || *spent >= FULL_SEQUENCES_MAX {
            return Vec::new();
        }
        *spent += 1;
        kept.whole = true;
        let held_back = std::mem::take(&mut kept.pictures);
        self.new_ones(held_back)
    }

    /// Pictures that are written whatever the pace; those that are in the file already are left out.
    pub fn new_ones(&mut self, pictures: Vec<Arc<Picture>>) -> Vec<Arc<Picture>> {
        pictures.into_iter().filter(|picture| self.ticks.insert(tick_of(picture.at_ms))).collect()
    }
}

fn gap_ms(recorded_ms: u64) -> u64 {
    GAPS_MS.iter().find(|(until_ms, _)| recorded_ms < *until_ms).map_or(0, |(_, gap_ms)| *gap_ms)
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::engine::picture::{Body, NO_TURN};

    /// A picture at a time.
    pub fn picture(sequence: u64, at_ms: u64) -> Arc<Picture> {
        let sway = (at_ms as f32 / 500.0).sin() * 0.2;
        let body = Body {
            links: vec![[0.0, 0.0, 0.0], [0.0, 0.0, 0.33], [0.3, sway, 0.6], [0.5, sway, 0.3]],
            pads: [[0.5, sway + 0.02, 0.25], [0.5, sway - 0.02, 0.25]],
            hand: NO_TURN,
            object: [0.5, sway, 0.25],
            object_turn: NO_TURN,
            object_half_m: 0.02,
            held: sway > 0.0,
        };
        Arc::new(Picture {
            sequence,
            at_ms,
            at_secs: at_ms as f64 / 1000.0,
            task: Some("grasp".to_owned()),
            version: Some("grasp@1.1.0".parse().unwrap()),
            body,
            speed_m_s: sway.abs(),
            force_n: 3.0,
            contact_n: 0.5,
            envelope: None,
            contacts: Vec::new(),
            unexpected_contact: false,
            stopped: false,
            twin: None,
        })
    }

    fn run(pace: &mut Pace, sequence: u64, from_ms: u64, to_ms: u64) -> usize {
        let times = (from_ms..to_ms).step_by(33);
        times.map(|at_ms| pace.came(&picture(sequence, at_ms)).len()).sum()
    }

    #[test]
    fn the_longer_it_lasts_the_fewer_pictures() {
        let mut pace = Pace::default();
        let first = run(&mut pace, 0, 0, 60_000);
        let second = run(&mut pace, 1, 60_000, 120_000);
        run(&mut pace, 2, 120_000, 180_000);
        let fourth = run(&mut pace, 3, 180_000, 240_000);
        assert!((550..=610).contains(&first), "{first}");
        assert!((270..=310).contains(&second), "{second}");
        assert!((100..=125).contains(&fourth), "{fourth}");
    }

    #[test]
    fn a_sequence_in_which_something_happened_is_written_whole_and_once() {
        let mut pace = Pace::default();
        let before = run(&mut pace, 7, 0, 9_900);
        run(&mut pace, 8, 10_000, 11_000);
        let more = pace.happened(Some(7), News::Noted).len();
        assert_eq!(before + more, 300);
        assert!(pace.happened(Some(7), News::Noted).is_empty());
        assert!(pace.happened(Some(99), News::Noted).is_empty());
    }

    #[test]
    fn there_is_a_budget_of_whole_sequences_and_one_for_decisions() {
        let mut pace = Pace::default();
        let mut whole = 0;
        for sequence in 0..20 {
            run(&mut pace, sequence, sequence * 10_000, sequence * 10_000 + 5_000);
            whole += u32::from(!pace.happened(None, News::Noted).is_empty());
        }
        assert_eq!(whole, FULL_SEQUENCES_MAX);
        run(&mut pace, 30, 300_000, 305_000);
        assert!(!pace.happened(None, News::Decisive).is_empty());
    }
}
