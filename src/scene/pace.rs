//! Which pictures a file gets: few of the many that look alike, and all of a sequence in which something happened.
//!
//! Decides by virtual time only, so that the same run gives the same file.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use super::limits::{FULL_SEQUENCES_MAX, GAPS_MS, SEQUENCE_PICTURES_MAX};
use holdpoint_protocol::clock::tick_of;
use holdpoint_protocol::picture::Picture;

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

#[derive(Debug, Default)]
pub struct PictureSampler {
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

impl PictureSampler {
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
pub mod tests;
