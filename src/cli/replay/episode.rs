//! `holdpoint replay VERSION --episode …`: a piece of its evaluation, worked again.
//!
//! Asks the engine that runs on the store, or one opened for this alone, and shows what it answers: in the terminal, as
//! lines, as JSON, or in a file for the viewer. Nothing of it is stored or decided.

use std::path::Path;

use serde_json::json;

use super::{ReplayArgs, Wanted};
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::cli::side::{Side, refused};
use crate::error::{CliError, Exit};
use crate::scenes;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::clock::TICKS_PER_SECOND;
use holdpoint_protocol::command::{Command, Reply};
use holdpoint_protocol::film::{Film, FilmAsked, FilmOf, FilmedRun};
use holdpoint_recordings::film::recording;
use holdpoint_recordings::recording::About;
use holdpoint_text::Untrusted;

/// Which piece: a number from 1, or the worst.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Which(pub Option<u32>);

/// Reads `worst` or a number.
pub(super) fn parse_which(text: &str) -> Result<Which, String> {
    if text == "worst" {
        return Ok(Which(None));
    }
    let number = text.parse().ok().filter(|number| *number > 0);
    number.map(|number| Which(Some(number))).ok_or_else(|| "worst is allowed, or a number from 1".to_owned())
}

/// What is asked for, if a piece of the evaluation is.
pub(super) fn asked(args: &ReplayArgs) -> Option<FilmAsked> {
    let all = [
        (FilmOf::Episode, args.episode),
        (FilmOf::Drill, args.drill),
        (FilmOf::Alone, args.alone),
        (FilmOf::Confirmation, args.confirmation),
    ];
    let (of, which) = all.into_iter().find_map(|(of, which)| Some((of, which?)))?;
    Some(FilmAsked { of, number: which.0 })
}

/// Does it. What is not what was recorded ends with 1.
pub(super) fn run(
    context: &CliContext,
    args: &ReplayArgs,
    asked: FilmAsked,
    has_terminal: bool,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    let Wanted::Version(version) = &args.upgrade else {
        return Err(CliError::usage("an episode is of a version, not of a recording's file")
            .with_hint("name the version, such as grasp@1.1.0"));
    };
    let mut side = Side::open(context)?;
    let command = Command::Film { version: version.clone(), asked };
    let film = match side.ask(command)? {
        Reply::Film { film } => film,
        Reply::Refused { code, text, hint } => return Err(refused(code, &text, hint.as_deref())),
        other => {
            return Err(CliError::internal(format!("the engine answered with something else: {other:?}")));
        }
    };
    let unlike = |run: &FilmedRun| run.as_recorded == Some(false);
    let exit = if unlike(&film.candidate) || unlike(&film.active) { Exit::Rejected } else { Exit::Confirmed };
    if let Some(path) = &args.rrd {
        let about = about(&mut side, version, &film)?;
        scenes::write_film(path, about, &film)?;
        let value = json!({ "file": path.display().to_string(), "frames": film.candidate.frames.len() });
        out.answer(&value, |out| said(path, &film, out))?;
    } else if context.json {
        out.json(&film)?;
    } else if args.plain || !has_terminal {
        lines(&film, out)?;
    } else {
        let about = about(&mut side, version, &film)?;
        super::play(recording(&film, about), args)?;
    }
    Ok(exit)
}

fn about(side: &mut Side, version: &CapabilityId, film: &Film) -> Result<About, CliError> {
    let snapshot = side.snapshot()?;
    let Reply::Detail { detail } = side.ask(Command::Detail { version: version.clone() })? else {
        return Err(CliError::internal("the engine answered without a detail"));
    };
    Ok(About {
        version: version.clone(),
        digest: detail.digest,
        predecessor: Some(film.active.version.clone()),
        profile: snapshot.profile.into(),
        robot: snapshot.robot,
        seed: film.seed,
        engine_build: env!("CARGO_PKG_VERSION").to_owned(),
    })
}

fn said(path: &Path, film: &Film, out: &mut Output<'_>) -> Result<(), CliError> {
    let path = Untrusted::new(path.to_string_lossy()).line();
    out.line(&format!("wrote {}: {}", path.as_str(), film.title()))
}

/// The film in words: what it is, what came of it, what happened, and two moments a second.
pub(in crate::cli) fn lines(film: &Film, out: &mut Output<'_>) -> Result<(), CliError> {
    let why = if film.why.is_empty() { String::new() } else { format!(": {}", film.why) };
    out.paragraph("", &format!("{}{why}", film.title()))?;
    for doubt in &film.doubts {
        out.paragraph("", &format!("NOT WHAT WAS JUDGED: {doubt}"))?;
    }
    for (name, run) in [("candidate", &film.candidate), ("active", &film.active)] {
        let checked = match run.as_recorded {
            Some(true) => ", as recorded",
            Some(false) => ", NOT AS RECORDED",
            None => "",
        };
        out.line("")?;
        out.paragraph("", &format!("{name} {}: {}{checked}", run.version, run.ended))?;
        for mark in &run.marks {
            let sign = if mark.bad { "!" } else { "-" };
            out.paragraph("  ", &format!("{sign} {:.3} s  {}", secs(mark.tick), mark.text))?;
        }
        let limits = run.envelope;
        out.line(&format!(
            "  time s   speed m/s (max {:.2})   grip N (max {:.1})   contact N (max {:.1})",
            limits.speed_m_s, limits.force_n, limits.contact_n
        ))?;
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
    fn a_piece_is_named_by_its_number_or_as_the_worst() {
        assert_eq!(parse_which("worst"), Ok(Which(None)));
        assert_eq!(parse_which("17"), Ok(Which(Some(17))));
        for wrong in ["0", "-1", "best", "", "1.5"] {
            assert_eq!(parse_which(wrong).unwrap_err(), "worst is allowed, or a number from 1", "{wrong}");
        }
    }
}
