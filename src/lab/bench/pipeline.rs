//! One candidate through all stages, on a scratch store with one worker: what each stage costs together.
//!
//! Drives the real engine as a script does; judges nothing. The live world's sequences that fall due during a
//! stage are counted with it.

use super::BenchError;
use super::measure::{Figure, FigureClock, FigureUnit, MeasuredFigure};
use super::subjects::{CANDIDATE, Subjects};
use holdpoint_engine::pipeline::SliceOutcome;
use holdpoint_engine::pump::Pump;
use holdpoint_engine::trial::cache::EpisodeCache;
use holdpoint_engine::trial::seeds::CALIBRATION_FROM_RUN;
use holdpoint_engine::{Config, Engine};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::scenario_state::ScenarioState;

/// Most slices of work; a candidate takes some hundred.
const SLICES_MAX: u32 = 100_000;

/// A candidate's stage, and the name of that figure.
const PARTS: [(State, &str); 5] = [
    (State::Registered, "stage, compatibility"),
    (State::Validated, "stage, sandbox with drills"),
    (State::Sandboxed, "stage, shadow"),
    (State::Shadowed, "stage, gate and activation"),
    (State::Active, "stage, monitoring until confirmed"),
];

pub(super) fn measure(subjects: &Subjects) -> Result<Vec<MeasuredFigure>, BenchError> {
    let folder = tempfile::tempdir()?;
    let engine = Engine::start(Config {
        data: folder.path(),
        profile: ProfileName::Sim.into(),
        seed: CALIBRATION_FROM_RUN,
        jobs: 1,
        scripted: true,
        cell: subjects.cell.clone(),
        cache: EpisodeCache::InStore,
    })?;
    let mut pump = Pump::new(engine, Vec::new());
    let package = Subjects::candidate_package()?;
    let command = Command::Register { package, name: CANDIDATE.to_owned(), by: None };
    let mut spent = vec![0.0; PARTS.len()];
    let before = FigureClock::ProcessCpu.secs();
    let reply = pump.submit(Request::unsigned("bench".to_owned(), command));
    let registered = FigureClock::ProcessCpu.secs() - before;
    if !matches!(reply, Reply::Accepted { .. }) {
        return Err(unexpected(format!("{reply:?}")));
    }
    let id = subjects.candidate.id();
    let mut state = State::Registered;
    let mut confirmed = false;
    for _ in 0..SLICES_MAX {
        let before = FigureClock::ProcessCpu.secs();
        let (progress, events) = pump.turn();
        let cost = FigureClock::ProcessCpu.secs() - before;
        if let Some(part) = PARTS.iter().position(|(at, _)| *at == state) {
            spent[part] += cost;
        }
        for event in events {
            match event.kind {
                EventKind::StateChanged { version, to, .. } if version == id => state = to,
                EventKind::Confirmed { version, .. } if version == id => confirmed = true,
                EventKind::Fault { text } => return Err(unexpected(text)),
                _ => {}
            }
        }
        let worked = progress == SliceOutcome::Ran;
        if confirmed || !worked || !PARTS.iter().any(|(at, _)| *at == state) {
            break;
        }
    }
    let end = if confirmed { ScenarioState::Confirmed } else { ScenarioState::In(state) };
    let figure = |name: String| {
        Figure::new(name, FigureUnit::Millis, FigureClock::ProcessCpu, "the demonstration candidate")
    };
    let mut entries = vec![figure("stage, registration".to_owned()).of(vec![registered], 1)?];
    let whole = registered + spent.iter().sum::<f64>();
    for ((_, name), cost) in PARTS.iter().zip(spent) {
        // A stage that was not reached has no figure.
        if cost > 0.0 {
            entries.push(figure((*name).to_owned()).of(vec![cost], 1)?);
        }
    }
    entries.push(figure(format!("candidate, all of it ({end})")).of(vec![whole], 1)?);
    Ok(entries)
}

fn unexpected(found: String) -> BenchError {
    BenchError::Unexpected { what: "whole candidate", found, expected: "an engine that works" }
}
