//! Films: re-run episodes of an evaluation match the recorded ones, and show the reasons.

use std::path::Path;

use holdpoint::engine::Engine;
use holdpoint::governance::decision::Dimension;
use holdpoint::governance::evidence::DrillKind;
use holdpoint::governance::profile::ProfileName;
use holdpoint::protocol::command::{Command, Refusal, Reply, Request};
use holdpoint::protocol::detail::{Detail, FindingVerdict};
use holdpoint::protocol::film::{Film, FilmRequest, FilmSubject};
use holdpoint::runtime::capability;

use crate::quick_folder::quick_folder;
use crate::socket::config;

struct FilmBench {
    engine: Engine,
    request_count: u64,
}

impl FilmBench {
    fn at(data: &Path) -> Self {
        let engine = Engine::start(config(data, ProfileName::Sim, true)).unwrap();
        Self { engine, request_count: 0 }
    }

    fn submit(&mut self, command: Command) -> Reply {
        self.request_count += 1;
        self.engine.submit(Request::unsigned(format!("film-{}", self.request_count), command))
    }

    /// Takes a candidate as far as it gets.
    fn evaluate(&mut self, name: &str) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates").join(name);
        let package = capability::read(&path).unwrap();
        let reply = self.submit(Command::Register { package, name: name.to_owned(), by: None });
        let Reply::Accepted { version: Some(version), .. } = reply else { panic!("{reply:?}") };
        for _ in 0..10_000 {
            self.engine.advance();
            let snapshot = self.engine.snapshot();
            let current = snapshot.candidates.iter().find(|candidate| candidate.version == version).unwrap();
            if current.state.is_terminal() {
                return;
            }
        }
        panic!("{version} is still under way");
    }

    fn film(
        &mut self,
        version: &str,
        of: FilmSubject,
        number: Option<u32>,
    ) -> Result<Film, (Refusal, String)> {
        let request = FilmRequest { of, number };
        match self.submit(Command::Film { version: version.parse().unwrap(), asked: request }) {
            Reply::Film { film } => Ok(*film),
            Reply::Refused { code, text, .. } => Err((code, text)),
            other => panic!("{other:?}"),
        }
    }

    fn detail(&mut self, version: &str) -> Detail {
        match self.submit(Command::Detail { version: version.parse().unwrap() }) {
            Reply::Detail { detail } => *detail,
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn film_of_the_worst_episode_equals_its_record() {
    let folder = quick_folder();
    let mut bench = FilmBench::at(folder.path());
    bench.evaluate("grasp-hard-grip");
    let version = "grasp@1.1.2";
    let film = bench.film(version, FilmSubject::Episode, None).unwrap();
    assert_eq!((film.candidate.as_recorded, film.active.as_recorded), (Some(true), Some(true)));
    assert!(film.doubts.is_empty(), "{:?}", film.doubts);
    assert!(film.candidate.failed_at().is_some(), "{:?}", film.candidate.marks);
    assert!(!film.why.is_empty() && film.candidate.frames.len() > 30 && film.active.frames.len() > 30);
    let ticks: Vec<u64> = film.candidate.frames.iter().map(|frame| frame.tick).collect();
    assert!(ticks.windows(2).all(|two| two[1] == two[0] + 8), "{ticks:?}");

    // Each one is as recorded, also in an engine that opens the store later.
    drop(bench);
    let mut later = FilmBench::at(folder.path());
    for number in [1, film.count / 2, film.count] {
        let film = later.film(version, FilmSubject::Episode, Some(number)).unwrap();
        assert_eq!((film.number, film.why.as_str()), (number, ""));
        assert_eq!((film.candidate.as_recorded, film.active.as_recorded), (Some(true), Some(true)));
    }
    let (code, text) = later.film(version, FilmSubject::Episode, Some(film.count + 1)).unwrap_err();
    assert_eq!(code, Refusal::NotFound);
    assert!([film.count, film.count + 1].iter().all(|number| text.contains(&number.to_string())), "{text}");
    let (code, text) = later.film("grasp@1.0.0", FilmSubject::Episode, None).unwrap_err();
    assert_eq!(code, Refusal::NotFound, "{text}");

    let detail = later.detail(version);
    let why = detail.why.iter().find(|why| why.about == Dimension::Behavior).unwrap();
    assert_eq!(why.film, Some(FilmRequest { of: FilmSubject::Episode, number: None }));
    assert_eq!(why.findings.first().map(|finding| finding.verdict), Some(FindingVerdict::Worse));
    assert!(!why.change.is_empty());
}

/// Episodes of a version that is stopped before the pairs can be seen, too.
#[test]
fn the_ending_episode_is_filmed_alone() {
    let folder = quick_folder();
    let mut bench = FilmBench::at(folder.path());
    bench.evaluate("align-past-permissions");
    let version = &bench.engine.snapshot().candidates[0].version.to_string();
    let why = bench.detail(version).why;
    let behavior = why.iter().find(|why| why.about == Dimension::Behavior).unwrap();
    let alone = FilmRequest { of: FilmSubject::Alone, number: None };
    assert_eq!(behavior.film, Some(alone), "{behavior:?}");
    let film = bench.film(version, FilmSubject::Alone, None).unwrap();
    assert!(film.why.ends_with("an evaluation"), "{}", film.why);
    assert_eq!((film.candidate.as_recorded, film.active.as_recorded), (Some(true), None));
    assert!(film.candidate.failed_at().is_some());
    // The same under stress.
    let last = bench.film(version, FilmSubject::Alone, Some(film.count)).unwrap();
    assert_eq!(last.candidate.as_recorded, Some(true), "{}", last.candidate.ended);
}

#[test]
fn a_failed_drill_is_run_again() {
    let folder = quick_folder();
    let mut bench = FilmBench::at(folder.path());
    bench.evaluate("align-no-stop");
    let version = bench.engine.snapshot().candidates.first().unwrap().version.to_string();
    let film = bench.film(&version, FilmSubject::Drill, None).unwrap();
    assert!(film.drill.is_some_and(|kind| DrillKind::ALL.contains(&kind)) && film.count > 0);
    assert_eq!((film.candidate.as_recorded, film.active.as_recorded), (Some(true), Some(true)));
    assert!(film.candidate.failed_at().is_some());
    let start_mark = film.candidate.marks.iter().find(|mark| !mark.bad).unwrap();
    assert!(start_mark.tick > 0 && start_mark.tick < film.end(), "{:?}", film.candidate.marks);
    // The run before it is visible, too, and time continues without a jump.
    let ticks: Vec<u64> = film.candidate.frames.iter().map(|frame| frame.tick).collect();
    assert!(ticks.first() == Some(&0) && ticks.windows(2).all(|two| two[1] == two[0] + 8), "{ticks:?}");
    let why = bench.detail(&version).why;
    let recovery = why.iter().find(|why| why.about == Dimension::Recovery).unwrap();
    assert!(recovery.decisive.starts_with("fails "), "{}", recovery.decisive);
}
