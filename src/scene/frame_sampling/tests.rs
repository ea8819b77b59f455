//! Which frames are selected.

use super::*;
use holdpoint_protocol::video_frame::{ArmView, NO_TURN};

/// A frame at a time.
pub fn video_frame(sequence: u64, at_ms: u64) -> Arc<VideoFrame> {
    let sway = (at_ms as f32 / 500.0).sin() * 0.2;
    let body = ArmView {
        links: vec![[0.0, 0.0, 0.0], [0.0, 0.0, 0.33], [0.3, sway, 0.6], [0.5, sway, 0.3]],
        pads: [[0.5, sway + 0.02, 0.25], [0.5, sway - 0.02, 0.25]],
        hand: NO_TURN,
        object: [0.5, sway, 0.25],
        object_turn: NO_TURN,
        object_half_m: 0.02,
        held: sway > 0.0,
    };
    Arc::new(VideoFrame {
        sequence,
        at_ms,
        at_secs: at_ms as f64 / 1000.0,
        task: Some(holdpoint_body::TaskKind::Grasp),
        version: Some("grasp@1.1.0".parse().unwrap()),
        body,
        speed_m_s: sway.abs(),
        force_n: 3.0,
        contact_n: 0.5,
        envelope: None,
        contacts: Vec::new(),
        blocks: Vec::new(),
        unexpected_contact: false,
        stopped: false,
        twin: None,
    })
}

fn run(pace: &mut FrameSampler, sequence: u64, from_ms: u64, to_ms: u64) -> usize {
    let times = (from_ms..to_ms).step_by(33);
    times.map(|at_ms| pace.on_frame(&video_frame(sequence, at_ms)).len()).sum()
}

#[test]
fn longer_recordings_sample_fewer_frames() {
    let mut pace = FrameSampler::default();
    let first = run(&mut pace, 0, 0, 60_000);
    let second = run(&mut pace, 1, 60_000, 120_000);
    run(&mut pace, 2, 120_000, 180_000);
    let fourth = run(&mut pace, 3, 180_000, 240_000);
    assert!((550..=610).contains(&first), "{first}");
    assert!((270..=310).contains(&second), "{second}");
    assert!((100..=125).contains(&fourth), "{fourth}");
}

#[test]
fn sequence_with_an_event_is_written_completely_and_once() {
    let mut pace = FrameSampler::default();
    let before = run(&mut pace, 7, 0, 9_900);
    run(&mut pace, 8, 10_000, 11_000);
    let more = pace.on_event(Some(7), EventWeight::Notable).len();
    assert_eq!(before + more, 300);
    assert!(pace.on_event(Some(7), EventWeight::Notable).is_empty());
    assert!(pace.on_event(Some(99), EventWeight::Notable).is_empty());
}

#[test]
fn complete_sequences_and_decisions_have_separate_budgets() {
    let mut pace = FrameSampler::default();
    let mut whole = 0;
    for sequence in 0..20 {
        run(&mut pace, sequence, sequence * 10_000, sequence * 10_000 + 5_000);
        whole += u32::from(!pace.on_event(None, EventWeight::Notable).is_empty());
    }
    assert_eq!(whole, FULL_SEQUENCES_MAX);
    run(&mut pace, 30, 300_000, 305_000);
    assert!(!pace.on_event(None, EventWeight::Decisive).is_empty());
}
