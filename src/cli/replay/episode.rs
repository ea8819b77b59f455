//! `holdpoint replay VERSION --episode …`: re-runs an episode of its evaluation.
//!
//! Asks the running engine, or one opened for this verb, and shows the answer: in the terminal, as lines, as JSON,
//! or in a file for the viewer. Stores and decides nothing.

use std::path::Path;

use serde_json::json;

use super::{ReplayArgs, ReplaySubject};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::cli::verb_executor::{VerbExecutor, refused};
use crate::error::{CliError, Exit};
use crate::scenes;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::clock::TICKS_PER_SECOND;
use holdpoint_protocol::command::{Command, Reply};
use holdpoint_protocol::film::{Film, FilmRequest, FilmSubject, FilmedRun};
use holdpoint_recordings::episode_recording::recording;
use holdpoint_recordings::recording::RecordingSubject;
use holdpoint_text::Untrusted;
use holdpoint_wording::film::title;
use holdpoint_wording::program::recordings as sentences;

/// Which episode: a number from 1, or the worst.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeSelector(pub Option<u32>);

/// Reads `worst` or a number.
pub(super) fn parse_which(text: &str) -> Result<EpisodeSelector, String> {
    if text == "worst" {
        return Ok(EpisodeSelector(None));
    }
    let number = text.parse().ok().filter(|number| *number > 0);
    number
        .map(|number| EpisodeSelector(Some(number)))
        .ok_or_else(|| "worst is allowed, or a number from 1".to_owned())
}

/// The requested episode, if one is requested.
pub(super) fn film_request(args: &ReplayArgs) -> Option<FilmRequest> {
    let all = [
        (FilmSubject::Episode, args.episode),
        (FilmSubject::Drill, args.drill),
        (FilmSubject::Alone, args.alone),
        (FilmSubject::Confirmation, args.confirmation),
    ];
    let (of, which) = all.into_iter().find_map(|(of, which)| Some((of, which?)))?;
    Some(FilmRequest { of, number: which.0 })
}

/// Runs the verb. A result that differs from the recorded one exits with 1.
pub(super) fn run(
    context: &CliContext,
    args: &ReplayArgs,
    request: FilmRequest,
    has_terminal: bool,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let ReplaySubject::Version(version) = &args.upgrade else {
        return Err(CliError::usage("an episode is of a version, not of a recording's file")
            .with_hint("name the version, such as grasp@1.1.0"));
    };
    let mut executor = VerbExecutor::open(context)?;
    let command = Command::Film { version: version.clone(), asked: request };
    let film = match executor.send(command)? {
        Reply::Film { film } => film,
        Reply::Refused { code, text, hint } => return Err(refused(code, &text, hint.as_deref())),
        other => {
            return Err(CliError::internal(format!("the engine sent an unexpected answer: {other:?}")));
        }
    };
    let unlike = |run: &FilmedRun| run.as_recorded == Some(false);
    let exit = if unlike(&film.candidate) || unlike(&film.active) { Exit::Rejected } else { Exit::Confirmed };
    if let Some(path) = &args.rrd {
        let about = about(&mut executor, version, &film)?;
        scenes::write_film(path, about, &film)?;
        let value = json!({ "file": path.display().to_string(), "frames": film.candidate.frames.len() });
        out.answer(&value, |out| print_film(path, &film, out))?;
    } else if context.json {
        out.json(&film)?;
    } else if args.plain || !has_terminal {
        lines(&film, out)?;
    } else {
        let about = about(&mut executor, version, &film)?;
        super::play(recording(&film, about), args)?;
    }
    Ok(exit)
}

fn about(
    executor: &mut VerbExecutor,
    version: &CapabilityId,
    film: &Film,
) -> Result<RecordingSubject, CliError> {
    let snapshot = executor.snapshot()?;
    let Reply::Detail { detail } = executor.send(Command::Detail { version: version.clone() })? else {
        return Err(CliError::internal("the engine answered without a detail"));
    };
    Ok(RecordingSubject {
        version: version.clone(),
        digest: detail.digest,
        predecessor: Some(film.active.version.clone()),
        profile: snapshot.profile.into(),
        robot: snapshot.robot,
        seed: Some(film.seed),
        engine_build: env!("CARGO_PKG_VERSION").to_owned(),
    })
}

fn print_film(path: &Path, film: &Film, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let path = Untrusted::new(path.to_string_lossy()).line();
    out.line(&format!("wrote {}: {}", path.as_str(), title(film)))
}

/// The film in words: its title, result and marks, and two moments a second.
pub(in crate::cli) fn lines(film: &Film, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let why = if film.why.is_empty() { String::new() } else { format!(": {}", film.why) };
    out.paragraph("", &format!("{}{why}", title(film)))?;
    for doubt in &film.doubts {
        out.paragraph("", &sentences::other_episode(doubt))?;
    }
    for (name, run) in [("candidate", &film.candidate), ("active", &film.active)] {
        out.line("")?;
        out.paragraph("", &sentences::world(name, &run.version, &run.ended, run.as_recorded))?;
        for mark in &run.marks {
            let sign = if mark.bad { "!" } else { "-" };
            out.paragraph("  ", &format!("{sign} {:.3} s  {}", secs(mark.tick), mark.text))?;
        }
        let limits = run.envelope;
        out.line(&sentences::moments_heading(limits.speed_m_s, limits.force_n, limits.contact_n))?;
        for half in run.frames.chunks(15) {
            let peak =
                |of: fn(&holdpoint_protocol::film::FilmFrame) -> f32| half.iter().map(of).fold(0.0, f32::max);
            let (speed, grip, contact) =
                (peak(|frame| frame.speed_m_s), peak(|frame| frame.grip_n), peak(|frame| frame.contact_n));
            let to = half.last().map_or(0.0, |frame| secs(frame.tick));
            out.line(&format!("  {to:>6.2}   {speed:>20.3}   {grip:>17.2}   {contact:>20.2}"))?;
        }
    }
    Ok(())
}

fn secs(tick: u64) -> f64 {
    tick as f64 / TICKS_PER_SECOND as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episode_is_selected_by_number_or_as_the_worst() {
        assert_eq!(parse_which("worst"), Ok(EpisodeSelector(None)));
        assert_eq!(parse_which("17"), Ok(EpisodeSelector(Some(17))));
        for wrong in ["0", "-1", "best", "", "1.5"] {
            assert!(parse_which(wrong).is_err(), "{wrong}");
        }
    }
}
