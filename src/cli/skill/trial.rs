//! `holdpoint skill test` and `skill run`: episodes of a candidate's folder, for its author.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use serde::Serialize;

use super::measured_skill::{MeasuredSkill, RunMeasurements};
use super::{SkillRunArgs, TestArgs};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::cli::site_choice;
use crate::error::{CliError, Exit};
use crate::headless::cell;
use holdpoint_body::CodeFault;
use holdpoint_explain::tryout::{Tryout, TryoutError};
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::manifest::FUEL_PER_US;
use holdpoint_governance::permission::PermissionsUsed;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::site_profile::ChosenProfile;
use holdpoint_protocol::film::Film;
use holdpoint_record::check::{ProfileFindings, RegisteredVersions};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_trials::site::LoadedSite;
use holdpoint_trials::worker::Worker;
use holdpoint_wording::failure_cause;
use holdpoint_wording::film::refusal;
use holdpoint_wording::program::candidate::drills_cannot_pass;
use holdpoint_wording::program::skill as sentences;

/// Episodes of a test.
const EPISODES: u64 = 10;

/// Columns and lines of the drawing.
#[cfg(feature = "console")]
const PICTURE: (u16, u16) = (100, 30);

/// The results of a test.
#[derive(Debug, Serialize)]
struct TestReport {
    id: String,
    bundle: String,
    seeds: [u64; 2],
    /// For each profile, whether the static rules admit it, with the reasons.
    admitted: Vec<ProfileAdmission>,
    /// Declared recovery that is unavailable.
    recovery: Vec<String>,
    episodes: Vec<TestEpisode>,
    /// The largest value of all episodes.
    used: PermissionsUsed,
    declared: DeclaredResources,
    /// Time of a tick, us: the median and the 99th percentile.
    tick_us: [f64; 2],
    /// Episodes with other commands when re-run.
    unlike: u64,
}

#[derive(Debug, Serialize)]
struct ProfileAdmission {
    profile: ProfileName,
    /// Whether the static rules let it run there.
    runs: bool,
    reasons: Vec<String>,
}

#[derive(Debug, Serialize)]
struct TestEpisode {
    seed: u64,
    success: bool,
    violation: bool,
    retries: u32,
    time_s: f64,
    fault: Option<CodeFault>,
    /// Why the task failed, physically; absent where it was done.
    failure: Option<FailureCause>,
}

#[derive(Debug, Serialize)]
struct DeclaredResources {
    cpu_us_per_tick: u32,
    memory_kib: u32,
}

impl TestReport {
    /// Whether the code keeps its contract.
    fn meets_contract(&self) -> bool {
        self.unlike == 0
            && self.admitted.iter().any(|one| one.runs)
            && self.episodes.iter().all(|episode| episode.fault.is_none())
    }
}

fn load(folder: &Path, site: Option<&Arc<LoadedSite>>) -> Result<Tryout, CliError> {
    let candidate = Capability::read(folder).map_err(CliError::usage)?;
    Tryout::new(candidate, cell(None, site)?).map_err(|error| match error {
        TryoutError::Family(unknown) => CliError::usage(unknown),
        TryoutError::Zone(unknown) => CliError::usage(unknown),
        TryoutError::Sensor(unoffered) => CliError::usage(unoffered),
        TryoutError::Check(_) | TryoutError::BuiltIn(_) => CliError::internal(error),
    })
}

/// Tests a folder's candidate.
pub(super) fn test(args: &TestArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let site = site_choice::named(args.site.as_deref())?;
    let tryout = load(&args.folder, site.as_ref())?;
    let last = args.seed.saturating_add(EPISODES - 1);
    let mut worker = Worker::new();
    let mut measure = |seed| run_episode(&tryout, &mut worker, seed);
    let (mut episodes, mut used, mut tick_ns, mut unlike) =
        (Vec::new(), PermissionsUsed::default(), Vec::new(), 0);
    for seed in args.seed..=last {
        let (record, measures) = measure(seed);
        let (_, again) = measure(seed);
        unlike += u64::from(measures.digest() != again.digest());
        used.merge(&record.used);
        tick_ns.extend(measures.tick_ns);
        episodes.push(TestEpisode {
            seed,
            success: record.success,
            violation: record.violation,
            retries: record.retries,
            time_s: record.time_secs,
            fault: record.fault,
            failure: record.failure_cause(),
        });
    }
    tick_ns.sort_unstable();
    let candidate = tryout.candidate();
    let resources = &candidate.manifest.permissions.resources;
    let versions = RegisteredVersions::commissioned(site.as_deref()).map_err(CliError::internal)?;
    let report = TestReport {
        id: candidate.id().to_string(),
        bundle: candidate.manifest.deployment.bundle.clone().into(),
        seeds: [args.seed, last],
        admitted: admitted(&versions, candidate)?,
        recovery: versions.recovery(candidate).iter().map(holdpoint_wording::line).collect(),
        episodes,
        used,
        declared: DeclaredResources {
            cpu_us_per_tick: resources.cpu_us_per_tick,
            memory_kib: resources.memory_kib,
        },
        tick_us: [0.5, 0.99].map(|share| quantile_us(&tick_ns, share)),
        unlike,
    };
    let film = tryout.film(args.seed);
    out.answer(&report, |out| {
        lines(&report, out)?;
        match &film {
            Ok(film) => print_frame(&tryout, film, out),
            Err(why) => out.line(&format!("drawing     none: {}", refusal(why))),
        }
    })?;
    Ok(if report.meets_contract() { Exit::Confirmed } else { Exit::Rejected })
}

/// Runs one episode with measurements.
fn run_episode(tryout: &Tryout, worker: &mut Worker, seed: u64) -> (TaskRecord, RunMeasurements) {
    let measures = Arc::new(Mutex::new(RunMeasurements::default()));
    let record = tryout.run_episode(worker, seed, &mut |skill| {
        Box::new(MeasuredSkill { skill, measures: Arc::clone(&measures) })
    });
    let measures = measures.lock().unwrap_or_else(PoisonError::into_inner).clone();
    (record, measures)
}

/// The static rules' verdict beside the baselines, as at registration.
fn admitted(
    versions: &RegisteredVersions,
    candidate: &Capability,
) -> Result<Vec<ProfileAdmission>, CliError> {
    let profiles: Vec<ChosenProfile> = ProfileName::ALL.into_iter().map(ChosenProfile::from).collect();
    let findings = versions.judge(candidate, &profiles).map_err(CliError::internal)?;
    let one = |found: ProfileFindings| ProfileAdmission {
        profile: found.profile.name,
        runs: found.admits(),
        reasons: found.reasons().map(holdpoint_wording::line).collect(),
    };
    Ok(findings.into_iter().map(one).collect())
}

/// The percentile of the values, us; 0 without any.
fn quantile_us(sorted_ns: &[u64], share: f64) -> f64 {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in a list")]
    let place = (share * sorted_ns.len() as f64).ceil() as usize;
    sorted_ns.get(place.saturating_sub(1)).map_or(0.0, |ns| *ns as f64 / 1_000.0)
}

fn lines(report: &TestReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&sentences::test_heading(&report.id, &report.bundle, report.episodes.len(), report.seeds))?;
    for one in &report.admitted {
        out.line(&sentences::static_verdict(one.profile.name(), one.runs))?;
        one.reasons.iter().try_for_each(|reason| out.paragraph("            ", reason))?;
    }
    for reason in &report.recovery {
        out.paragraph("recovery    ", &drills_cannot_pass(reason))?;
    }
    let count = |is: fn(&TestEpisode) -> bool| report.episodes.iter().filter(|one| is(one)).count();
    let mean_s = report.episodes.iter().map(|one| one.time_s).sum::<f64>() / report.episodes.len() as f64;
    out.line(&sentences::episodes(&sentences::TestedEpisodes {
        all: report.episodes.len(),
        done: count(|one| one.success),
        mean_s,
        violations: count(|one| one.violation),
        retried: count(|one| one.retries > 0),
    }))?;
    let causes: Vec<String> = FailureCause::ALL
        .into_iter()
        .map(|cause| (cause, report.episodes.iter().filter(|one| one.failure == Some(cause)).count()))
        .filter(|(_, failed)| *failed > 0)
        .map(|(cause, failed)| format!("{}: {failed}", failure_cause(cause)))
        .collect();
    if !causes.is_empty() {
        out.paragraph("failed      ", &causes.join(", "))?;
    }
    for episode in &report.episodes {
        if let Some(fault) = episode.fault {
            out.line(&sentences::code_failed(episode.seed, fault))?;
        }
    }
    let declared = &report.declared;
    if report.used.memory_max_bytes > 0 {
        let budget = u64::from(declared.cpu_us_per_tick) * FUEL_PER_US;
        out.line(&sentences::fuel(report.used.fuel_tick_max, budget))?;
        out.line(&sentences::memory(report.used.memory_max_bytes.div_ceil(1024), declared.memory_kib))?;
    }
    let [half, most] = report.tick_us;
    out.line(&sentences::tick_time(half, most))?;
    out.line(&sentences::same_seed(report.unlike))
}

/// Runs one episode and shows it.
pub(super) fn run(
    context: &CliContext,
    args: &SkillRunArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let site = site_choice::named(args.site.as_deref())?;
    let tryout = load(&args.folder, site.as_ref())?;
    let film = tryout.film(args.seed).map_err(|why| CliError::usage(refusal(&why)))?;
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

    use super::{CliError, CommandOutput, Film, PICTURE, SkillRunArgs, Tryout};
    use crate::cli::replay::{episode, replay_failed, replay_options};
    use holdpoint_console::options::CommandLineFlags;
    use holdpoint_console::replay::speed::Speed;
    use holdpoint_console::replay::{run as run_in_terminal, still};
    use holdpoint_governance::profile::ProfileName;
    use holdpoint_recordings::episode_recording::recording;
    use holdpoint_recordings::recording::{Recording, RecordingSubject};

    fn recorded(tryout: &Tryout, film: &Film) -> Recording {
        let candidate = tryout.candidate();
        let about = RecordingSubject {
            version: candidate.id(),
            digest: candidate.digest(),
            predecessor: Some(tryout.active().id()),
            profile: ProfileName::Sim.into(),
            robot: tryout.robot().to_owned(),
            seed: Some(film.seed),
            engine_build: env!("CARGO_PKG_VERSION").to_owned(),
        };
        recording(film, about)
    }

    /// Shows the episode on this terminal, or as lines.
    pub(in crate::cli::skill) fn show(
        tryout: &Tryout,
        film: &Film,
        args: &SkillRunArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<(), CliError> {
        let has_terminal = std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
        if !args.terminal || !has_terminal {
            return episode::lines(film, out);
        }
        let options = replay_options(CommandLineFlags::default(), None, Speed::default())?;
        run_in_terminal(recorded(tryout, film), options).map_err(replay_failed)
    }

    /// The moment of the candidate's first failure, or its last.
    pub(in crate::cli::skill) fn print_frame(
        tryout: &Tryout,
        film: &Film,
        out: &mut CommandOutput<'_>,
    ) -> Result<(), CliError> {
        let last = film.candidate.frames.last().map(|frame| frame.tick);
        let Some(at) = film.candidate.failed_at().or(last) else { return Ok(()) };
        let options = replay_options(CommandLineFlags::default(), Some(at), Speed::default())?;
        let drawn = still(recorded(tryout, film), &options, PICTURE).map_err(replay_failed)?;
        drawn.lines().try_for_each(|line| out.line(line))
    }
}

#[cfg(feature = "console")]
use screen::{print_frame, show};

/// A build without the console cannot draw.
#[cfg(not(feature = "console"))]
fn print_frame(_: &Tryout, _: &Film, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(sentences::NO_SCREEN)
}

#[cfg(not(feature = "console"))]
fn show(_: &Tryout, film: &Film, _: &SkillRunArgs, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    for run in [&film.candidate, &film.active] {
        out.paragraph("", &format!("{}: {}", run.version, run.ended))?;
    }
    Ok(())
}
