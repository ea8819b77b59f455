//! Selects the frames of a file: few of the many similar ones, and all of a sequence with a notable event.
//!
//! Decides by virtual time only, so that the same run gives the same file.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use super::limits::{FULL_SEQUENCES_MAX, GAPS_MS, SEQUENCE_PICTURES_MAX};
use holdpoint_protocol::clock::tick_of;
use holdpoint_protocol::video_frame::VideoFrame;

/// The weight of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventWeight {
    /// A task failed, or there was an unexpected contact.
    Notable,
    /// The monitor decided, or the version was rolled back.
    Decisive,
}

/// A sequence whose frames are kept.
#[derive(Debug)]
struct SampledSequence {
    sequence: u64,
    frames: Vec<Arc<VideoFrame>>,
    whole: bool,
}

#[derive(Debug, Default)]
pub struct FrameSampler {
    /// The last two sequences: the events of one arrive after the next has begun.
    sequences: VecDeque<SampledSequence>,
    /// Ticks in the file; a tick identifies a frame there.
    ticks: BTreeSet<u64>,
    last_ms: Option<u64>,
    chosen_ms: Option<u64>,
    /// Recorded virtual time of the cell, ms.
    recorded_ms: u64,
    noted: u32,
    decisive: u32,
}

/// Frames that are further apart belong to different runs of the cell, ms.
const PIECE_MS: u64 = 1_000;

impl FrameSampler {
    /// Takes the next frame; returns the frames to write now.
    pub fn on_frame(&mut self, frame: &Arc<VideoFrame>) -> Vec<Arc<VideoFrame>> {
        let at_ms = frame.at_ms;
        let step_ms = self.last_ms.map_or(0, |last| at_ms.saturating_sub(last));
        self.recorded_ms += step_ms.min(PIECE_MS);
        self.last_ms = Some(at_ms);
        let begins = self.sequences.back().is_none_or(|sampled| sampled.sequence != frame.sequence);
        if begins {
            if self.sequences.len() >= 2 {
                self.sequences.pop_front();
            }
            self.sequences.push_back(SampledSequence {
                sequence: frame.sequence,
                frames: Vec::new(),
                whole: false,
            });
        }
        let Some(sampled) = self.sequences.back_mut() else { return Vec::new() };
        let gap_ms = gap_ms(self.recorded_ms);
        let due = begins || self.chosen_ms.is_none_or(|chosen| at_ms >= chosen.saturating_add(gap_ms));
        if !due && !sampled.whole {
            if sampled.frames.len() < SEQUENCE_PICTURES_MAX {
                sampled.frames.push(Arc::clone(frame));
            }
            return Vec::new();
        }
        if due {
            self.chosen_ms = Some(at_ms);
        }
        self.new_frames(vec![Arc::clone(frame)])
    }

    /// An event of a sequence (absent: of the running one); returns the frames that were held back.
    pub fn on_event(&mut self, sequence: Option<u64>, weight: EventWeight) -> Vec<Arc<VideoFrame>> {
        let place = match sequence {
            Some(sequence) => self.sequences.iter().position(|sampled| sampled.sequence == sequence),
            None => self.sequences.len().checked_sub(1),
        };
        let Some(sampled) = place.and_then(|place| self.sequences.get_mut(place)) else { return Vec::new() };
        let spent = match weight {
            EventWeight::Notable => &mut self.noted,
            EventWeight::Decisive => &mut self.decisive,
        };
        if sampled.whole || *spent >= FULL_SEQUENCES_MAX {
            return Vec::new();
        }
        *spent += 1;
        sampled.whole = true;
        let held_back = std::mem::take(&mut sampled.frames);
        self.new_frames(held_back)
    }

    /// The frames that are written at any rate, without those already in the file.
    pub fn new_frames(&mut self, frames: Vec<Arc<VideoFrame>>) -> Vec<Arc<VideoFrame>> {
        frames.into_iter().filter(|frame| self.ticks.insert(tick_of(frame.at_ms))).collect()
    }
}

fn gap_ms(recorded_ms: u64) -> u64 {
    GAPS_MS.iter().find(|(until_ms, _)| recorded_ms < *until_ms).map_or(0, |(_, gap_ms)| *gap_ms)
}

#[cfg(test)]
pub mod tests;
