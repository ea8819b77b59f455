//! `holdpoint skill test` and `skill run`: episodes of a folder's candidate, for whoever writes it.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use serde::Serialize;

use super::measured::{Measured, Measures};
use super::{RunArgs, TestArgs};
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_body::CodeFault;
use holdpoint_engine::check::{Standing, StaticFindings};
use holdpoint_engine::trial::worker::Worker;
use holdpoint_engine::tryout::{Tryout, TryoutError};
use holdpoint_governance::manifest::FUEL_PER_US;
use holdpoint_governance::own_profile::ChosenProfile;
use holdpoint_governance::permission::PermissionsUsed;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_protocol::film::Film;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;

/// Episodes of a test.
const EPISODES: u64 = 10;

/// Columns and lines of the picture.
#[cfg(feature = "console")]
const PICTURE: (u16, u16) = (100, 30);

/// What a test found.
#[derive(Debug, Serialize)]
struct TestReport {
    id: String,
    bundle: String,
    seeds: [u64; 2],
    /// Profile by profile: whether the static rules admit it, and what they say.
    admitted: Vec<Admitted>,
    /// What is declared of recovery and cannot be had.
    recovery: Vec<String>,
    episodes: Vec<Episode>,
    /// The largest of all episodes.
    used: PermissionsUsed,
    declared: Declared,
    /// Time of a tick, us: half of all are at or below the first, 99 of 100 at or below the second.
    tick_us: [f64; 2],
    /// Episodes that gave other commands when they were worked again.
    unlike: u64,
}

#[derive(Debug, Serialize)]
struct Admitted {
    profile: ProfileName,
    /// Whether the static rules let it run there.
    runs: bool,
    reasons: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Episode {
    seed: u64,
    success: bool,
    violation: bool,
    retries: u32,
    time_s: f64,
    fault: Option<CodeFault>,
}

#[derive(Debug, Serialize)]
struct Declared {
    cpu_us_per_tick: u32,
    memory_kib: u32,
}

impl TestReport {
    /// Whether the code keeps its contract.
    fn keeps(&self) -> bool {
        self.unlike == 0
            && self.admitted.iter().any(|one| one.runs)
            && self.episodes.iter().all(|episode| episode.fault.is_none())
    }
}

fn load(folder: &Path) -> Result<Tryout, CliError> {
    let candidate = Capability::read(folder).map_err(CliError::usage)?;
    Tryout::new(candidate).map_err(|error| match error {
        TryoutError::Family(unknown) => CliError::usage(unknown),
        TryoutError::Check(_) | TryoutError::Cell(_) | TryoutError::BuiltIn(_) => CliError::internal(error),
    })
}

/// Tries a folder's candidate.
pub(super) fn test(args: &TestArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let tryout = load(&args.folder)?;
    let last = args.seed.saturating_add(EPISODES - 1);
    let mut worker = Worker::new();
    let mut measured = |seed| worked(&tryout, &mut worker, seed);
    let (mut episodes, mut used, mut tick_ns, mut unlike) =
        (Vec::new(), PermissionsUsed::default(), Vec::new(), 0);
    for seed in args.seed..=last {
        let (record, measures) = measured(seed);
        let (_, again) = measured(seed);
        unlike += u64::from(measures.digest() != again.digest());
        used.merge(&record.used);
        tick_ns.extend(measures.tick_ns);
        episodes.push(Episode {
            seed,
            success: record.success,
            violation: record.violation,
            retries: record.retries,
            time_s: record.time_secs,
            fault: record.fault,
        });
    }
    tick_ns.sort_unstable();
    let candidate = tryout.candidate();
    let resources = &candidate.manifest.permissions.resources;
    let standing = Standing::commissioned().map_err(CliError::internal)?;
    let report = TestReport {
        id: candidate.id().to_string(),
        bundle: candidate.manifest.deployment.bundle.clone().into(),
        seeds: [args.seed, last],
        admitted: admitted(&standing, candidate)?,
        recovery: standing.recovery(candidate).iter().map(ToString::to_string).collect(),
        episodes,
        used,
        declared: Declared { cpu_us_per_tick: resources.cpu_us_per_tick, memory_kib: resources.memory_kib },
        tick_us: [0.5, 0.99].map(|share| quantile_us(&tick_ns, share)),
        unlike,
    };
    let film = tryout.film(args.seed);
    out.answer(&report, |out| {
        lines(&report, out)?;
        picture(&tryout, &film, out)
    })?;
    Ok(if report.keeps() { Exit::Confirmed } else { Exit::Rejected })
}

/// One episode with its measures.
fn worked(tryout: &Tryout, worker: &mut Worker, seed: u64) -> (TaskRecord, Measures) {
    let measures = Arc::new(Mutex::new(Measures::default()));
    let record =
        tryout.work(worker, seed, &mut |skill| Box::new(Measured { skill, measures: Arc::clone(&measures) }));
    let measures = measures.lock().unwrap_or_else(PoisonError::into_inner).clone();
    (record, measures)
}

/// What the static rules say of it beside the commissioned versions, as at its registration.
fn admitted(standing: &Standing, candidate: &Capability) -> Result<Vec<Admitted>, CliError> {
    let profiles: Vec<ChosenProfile> = ProfileName::ALL.into_iter().map(ChosenProfile::from).collect();
    let judged = standing.judge(candidate, &profiles).map_err(CliError::internal)?;
    let one = |(profile, found): (Profile, StaticFindings)| Admitted {
        profile: profile.name,
        runs: found.admits(),
        reasons: found.reasons().map(ToString::to_string).collect(),
    };
    Ok(judged.into_iter().map(one).collect())
}

/// The value that this share of them is at or below, us; 0 without any.
fn quantile_us(sorted_ns: &[u64], share: f64) -> f64 {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in a list")]
    let place = (share * sorted_ns.len() as f64).ceil() as usize;
    sorted_ns.get(place.saturating_sub(1)).map_or(0.0, |ns| *ns as f64 / 1_000.0)
}

fn lines(report: &TestReport, out: &mut Output<'_>) -> Result<(), CliError> {
    let [first, last] = report.seeds;
    out.line(&format!(
        "{}, {}: {} episodes in the simulated cell, seeds {first} to {last}",
        report.id,
        report.bundle,
        report.episodes.len()
    ))?;
    for one in &report.admitted {
        let verdict = if one.runs { "admitted by the static rules" } else { "NOT ADMITTED" };
        out.line(&format!("in {:<8} {verdict}", one.profile.name()))?;
        one.reasons.iter().try_for_each(|reason| out.paragraph("            ", reason))?;
    }
    for reason in &report.recovery {
        out.paragraph("recovery    ", &format!("its drills cannot pass: {reason}"))?;
    }
    let count = |is: fn(&Episode) -> bool| report.episodes.iter().filter(|one| is(one)).count();
    let mean_s = report.episodes.iter().map(|one| one.time_s).sum::<f64>() / report.episodes.len() as f64;
    out.line(&format!(
        "worked      {} of {} done, {mean_s:.1} s each; {} passed a limit; {} tried again",
        count(|one| one.success),
        report.episodes.len(),
        count(|one| one.violation),
        count(|one| one.retries > 0),
    ))?;
    for episode in &report.episodes {
        if let Some(fault) = episode.fault {
            out.line(&format!("CODE FAILED with seed {}: {}", episode.seed, words(fault)))?;
        }
    }
    let declared = &report.declared;
    if report.used.memory_max_bytes > 0 {
        out.line(&format!(
            "fuel        {} of {} in the largest tick",
            report.used.fuel_tick_max,
            u64::from(declared.cpu_us_per_tick) * FUEL_PER_US
        ))?;
        out.line(&format!(
            "memory      {} of {} KiB",
            report.used.memory_max_bytes.div_ceil(1024),
            declared.memory_kib
        ))?;
    }
    let [half, most] = report.tick_us;
    out.line(&format!("time        {half:.1} us a tick, 99 of 100 within {most:.1} us"))?;
    out.line(&match report.unlike {
        0 => "same seed   the same commands in every episode".to_owned(),
        unlike => format!("SAME SEED   OTHER COMMANDS in {unlike} episodes"),
    })
}

/// How code fails, in words.
const fn words(fault: CodeFault) -> &'static str {
    match fault {
        CodeFault::Trap => "it trapped",
        CodeFault::Fuel => "a call needed more fuel than its budget",
        CodeFault::Memory => "it asked for more memory than it declares",
        CodeFault::Answer => "it refused to start, or what it answered is no command",
        CodeFault::Machine => "the machine stalled; nothing is said of the code",
    }
}

/// Works one episode and shows it.
pub(super) fn run(context: &CliContext, args: &RunArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let tryout = load(&args.folder)?;
    let film = tryout.film(args.seed);
    if context.json {
        out.json(&film)?;
    } else {
        show(&tryout, &film, args, out)?;
    }
    Ok(Exit::Confirmed)
}

#[cfg(feature = "console")]
mod screen {
    use std::io::IsTerminal as _;

    use super::{CliError, Film, Output, PICTURE, RunArgs, Tryout};
    use crate::cli::replay::{episode, not_shown, shown};
    use holdpoint_console::options::CommandLineFlags;
    use holdpoint_console::replay::speed::Speed;
    use holdpoint_console::replay::{run as run_in_terminal, still};
    use holdpoint_governance::profile::ProfileName;
    use holdpoint_recordings::film::recording;
    use holdpoint_recordings::recording::{About, Recording};

    fn recorded(tryout: &Tryout, film: &Film) -> Recording {
        let candidate = tryout.candidate();
        let about = About {
            version: candidate.id(),
            digest: candidate.digest(),
            predecessor: Some(tryout.active().id()),
            profile: ProfileName::Sim.into(),
            robot: tryout.robot().to_owned(),
            seed: film.seed,
            engine_build: env!("CARGO_PKG_VERSION").to_owned(),
        };
        recording(film, about)
    }

    /// The episode on this terminal, or as lines.
    pub(in crate::cli::skill) fn show(
        tryout: &Tryout,
        film: &Film,
        args: &RunArgs,
        out: &mut Output<'_>,
    ) -> Result<(), CliError> {
        let has_terminal = std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
        if !args.terminal || !has_terminal {
            return episode::lines(film, out);
        }
        let options = shown(CommandLineFlags::default(), None, Speed::default())?;
        run_in_terminal(recorded(tryout, film), options).map_err(not_shown)
    }

    /// The moment at which the candidate goes wrong, or its last.
    pub(in crate::cli::skill) fn picture(
        tryout: &Tryout,
        film: &Film,
        out: &mut Output<'_>,
    ) -> Result<(), CliError> {
        let last = film.candidate.frames.last().map(|frame| frame.tick);
        let Some(at) = film.candidate.failed_at().or(last) else { return Ok(()) };
        let options = shown(CommandLineFlags::default(), Some(at), Speed::default())?;
        let drawn = still(recorded(tryout, film), &options, PICTURE).map_err(not_shown)?;
        drawn.lines().try_for_each(|line| out.line(line))
    }
}

#[cfg(feature = "console")]
use screen::{picture, show};

/// A build without the console draws nothing.
#[cfg(not(feature = "console"))]
fn picture(_: &Tryout, _: &Film, out: &mut Output<'_>) -> Result<(), CliError> {
    out.line("picture     none: this build has no screen")
}

#[cfg(not(feature = "console"))]
fn show(_: &Tryout, film: &Film, _: &RunArgs, out: &mut Output<'_>) -> Result<(), CliError> {
    for run in [&film.candidate, &film.active] {
        out.paragraph("", &format!("{}: {}", run.version, run.ended))?;
    }
    Ok(())
}
