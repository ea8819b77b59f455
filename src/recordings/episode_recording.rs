//! A re-run part of an evaluation as frames of a recording: the candidate as the robot, the compared version as its
//! twin.
//!
//! Converts one form into the other and interpolates nothing.

use holdpoint_protocol::clock::TICKS_PER_SECOND;
use holdpoint_protocol::film::{Film, FilmFrame};
use holdpoint_protocol::video_frame::{Twin, VideoFrame};
use holdpoint_wording::film::title;

use crate::recording::{FailureMoment, FilmSpan, Recording, RecordingSubject, Series};

/// Time of a tick, ms.
#[must_use]
pub const fn at_ms(tick: u64) -> u64 {
    tick.saturating_mul(1_000) / TICKS_PER_SECOND
}

/// The frames of a film, in order. A version that has finished stays at its last pose.
#[must_use]
pub fn video_frames(film: &Film) -> Vec<VideoFrame> {
    let (own, other) = (&film.candidate, &film.active);
    let mut ticks: Vec<u64> = own.frames.iter().chain(&other.frames).map(|frame| frame.tick).collect();
    ticks.sort_unstable();
    ticks.dedup();
    let video_frame = |tick: u64| {
        let frame = own.frame_at(tick)?;
        let twin = other.frame_at(tick);
        Some(VideoFrame {
            sequence: u64::from(film.number),
            at_ms: at_ms(tick),
            at_secs: tick as f64 / TICKS_PER_SECOND as f64,
            task: Some(film.task),
            version: Some(own.version.clone()),
            body: frame.body.clone(),
            speed_m_s: frame.speed_m_s,
            force_n: frame.grip_n,
            contact_n: frame.contact_n,
            envelope: Some(own.envelope),
            contacts: Vec::new(),
            blocks: own.blocks.clone(),
            unexpected_contact: frame.touched,
            stopped: frame.stopped,
            twin: twin.map(|frame| Twin { version: other.version.clone(), body: frame.body.clone() }),
        })
    };
    ticks.into_iter().filter_map(video_frame).collect()
}

/// The most failures of one part that a recording names.
const FAILURES_MAX: usize = 8;

/// The place of a film in a recording, from a virtual time on, ms, with the candidate's failures.
#[must_use]
pub fn span(film: &Film, from_ms: u64) -> FilmSpan {
    let in_recording = |tick: u64| from_ms.saturating_add(at_ms(tick));
    let bad = film.candidate.marks.iter().filter(|mark| mark.bad).take(FAILURES_MAX);
    FilmSpan {
        from_ms,
        until_ms: in_recording(film.end()),
        title: title(film),
        why: film.why.clone(),
        ended: film.candidate.ended.clone(),
        failures: bad
            .map(|mark| {
                // The end of a task may lie between the last frame and the next.
                let tick = mark.tick.min(film.end());
                FailureMoment { at_ms: in_recording(tick), text: mark.text.clone() }
            })
            .collect(),
    }
}

/// A film as a recording, for replay.
#[must_use]
pub fn recording(film: &Film, about: RecordingSubject) -> Recording {
    let envelope = film.candidate.envelope;
    let series = |name: &str, of: &dyn Fn(&FilmFrame) -> f32| {
        let frames = film.candidate.frames.iter();
        let points = frames.map(|frame| (at_ms(frame.tick), f64::from(of(frame)))).collect();
        Series { name: name.to_owned(), points }
    };
    let limit = |name: &str, value: f32| {
        let from = film.candidate.frames.first().map_or(0, |frame| at_ms(frame.tick));
        Series { name: format!("{name}/limit"), points: vec![(from, f64::from(value))] }
    };
    Recording {
        about,
        outcome: None,
        scenery: film.scenery.clone(),
        pictures: video_frames(film),
        events: Vec::new(),
        series: vec![
            series("tool/speed", &|frame| frame.speed_m_s),
            limit("tool/speed", envelope.speed_m_s),
            series("tool/force", &|frame| frame.grip_n),
            limit("tool/force", envelope.force_n),
            series("tool/contact", &|frame| frame.contact_n),
            limit("tool/contact", envelope.contact_n),
        ],
        films: vec![span(film, 0)],
        dropped: (0, 0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use holdpoint_protocol::film::{FilmMark, FilmSubject, FilmedRun};
    use holdpoint_protocol::video_frame::{ArmView, EnvelopeView, NO_TURN, Scenery};

    fn run(version: &str, ticks: &[u64]) -> FilmedRun {
        let body = ArmView {
            links: vec![[0.0; 3]; 2],
            pads: [[0.0; 3]; 2],
            hand: NO_TURN,
            object: [0.0; 3],
            object_turn: NO_TURN,
            object_half_m: 0.02,
            held: false,
        };
        let frame = |tick: &u64| FilmFrame {
            tick: *tick,
            body: body.clone(),
            q: Vec::new(),
            tau: Vec::new(),
            speed_m_s: *tick as f32,
            grip_n: 0.0,
            contact_n: 0.0,
            touched: false,
            stopped: false,
        };
        FilmedRun {
            version: version.parse().unwrap(),
            envelope: EnvelopeView { speed_m_s: 1.0, force_n: 1.0, contact_n: 1.0 },
            ended: String::new(),
            failed: false,
            as_recorded: Some(true),
            marks: Vec::new(),
            blocks: Vec::new(),
            frames: ticks.iter().map(frame).collect(),
        }
    }

    fn film(candidate: FilmedRun, active: FilmedRun) -> Film {
        Film {
            of: FilmSubject::Episode,
            number: 3,
            count: 9,
            beyond: 0,
            task: serde_json::from_str("\"grasp\"").unwrap(),
            seed: 1,
            drill: None,
            phase: None,
            why: String::new(),
            doubts: Vec::new(),
            scenery: Scenery::default(),
            candidate,
            active,
        }
    }

    #[test]
    fn version_keeps_its_final_state() {
        let film = film(run("grasp@1.1.0", &[0, 8, 16, 24]), run("grasp@1.0.0", &[0, 8]));
        let frames = video_frames(&film);
        let times: Vec<u64> = frames.iter().map(|frame| frame.at_ms).collect();
        assert_eq!(times, [0, 33, 66, 100]);
        assert!(frames.iter().all(|frame| frame.twin.is_some() && frame.sequence == 3));
        assert!((frames[3].speed_m_s - 24.0).abs() < 1e-6);
    }

    #[test]
    fn only_what_speaks_against_the_candidate_is_a_failure() {
        let mark = |tick, bad| FilmMark { tick, text: format!("at {tick}"), bad };
        let mut candidate = run("grasp@1.1.0", &[0, 240, 480]);
        candidate.marks = vec![mark(120, false), mark(240, true)];
        candidate.marks.extend((0..9).map(|more| mark(300 + more, true)));
        candidate.ended = "does not do the task".to_owned();
        let mut active = run("grasp@1.0.0", &[0, 240]);
        active.marks = vec![mark(60, true)];
        let film = film(candidate, active);
        let span = span(&film, 5_000);
        assert_eq!((span.from_ms, span.until_ms), (5_000, 7_000));
        assert_eq!(span.failures[0], FailureMoment { at_ms: 6_000, text: "at 240".to_owned() });
        assert_eq!((span.failures.len(), span.ended.as_str()), (FAILURES_MAX, "does not do the task"));
        let subject = RecordingSubject {
            version: film.candidate.version.clone(),
            digest: holdpoint_governance::ids::Digest::from_bytes([1; 32]),
            predecessor: None,
            profile: holdpoint_governance::profile::ProfileName::Sim.into(),
            robot: String::new(),
            seed: None,
            engine_build: String::new(),
        };
        let recording = recording(&film, subject);
        assert_eq!(recording.rerun().map(|film| film.failures[0].at_ms), Some(1_000));
    }

    /// Files of older builds have neither a result nor failures.
    #[test]
    fn span_of_an_older_build_is_read() {
        let old = r#"{"from_ms":1,"until_ms":2,"title":"episode 3 of 9","why":""}"#;
        let span: FilmSpan = serde_json::from_str(old).unwrap();
        assert!(span.ended.is_empty() && span.failures.is_empty());
        assert_eq!(serde_json::to_string(&span).unwrap(), old);
    }
}
