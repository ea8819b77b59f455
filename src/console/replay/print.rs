//! The replay without a screen: one line for each event, as in the plain stream.
//!
//! Must not move a cursor or wait: screen readers get the same output.

use std::io::{self, Write};

use holdpoint_protocol::clock::tick_of;
use holdpoint_recordings::recording::Recording;
use holdpoint_text::Untrusted;
use holdpoint_wording::console::replay as wording;
use holdpoint_wording::film::recorded_part;
use holdpoint_wording::{counted, event as event_text, seeds};

/// Prints the recording's version, its events with virtual time in seconds and tick, up to `to_ms`, and its end.
///
/// # Errors
/// If `out` cannot be written to.
pub fn print(recording: &Recording, to_ms: Option<u64>, out: &mut dyn Write) -> io::Result<()> {
    let about = &recording.about;
    let against = about.predecessor.as_ref().map_or_else(String::new, |id| format!(" against {id}"));
    let head = wording::head(
        &about.version.to_string(),
        &against,
        &about.profile.to_string(),
        &about.robot,
        &seeds::named(about.seed),
        &about.engine_build,
    );
    writeln!(out, "{}", Untrusted::new(head).line())?;
    let is_shown = |at_ms: u64| to_ms.is_none_or(|to_ms| at_ms <= to_ms);
    for film in recording.films.iter().filter(|film| is_shown(film.from_ms)) {
        let part = Untrusted::new(recorded_part(&film.title, &film.why));
        writeln!(out, "{:>8} {}", tick_of(film.from_ms), part.line())?;
        for failure in film.failures.iter().filter(|failure| is_shown(failure.at_ms)) {
            let text = Untrusted::new(wording::went_wrong(&failure.text)).line();
            writeln!(out, "{:>8} {text}", tick_of(failure.at_ms))?;
        }
    }
    for event in recording.events.iter().filter(|event| is_shown(event.at_ms)) {
        writeln!(out, "{:>8} {}", tick_of(event.at_ms), event_text::line(event))?;
    }
    let frames = recording.pictures.iter().filter(|frame| is_shown(frame.at_ms)).count();
    let all_shown = recording.span_ms().is_none_or(|(_, last_ms)| is_shown(last_ms));
    let end = match (&recording.outcome, all_shown) {
        (_, false) => wording::RECORDING_GOES_ON.to_owned(),
        (Some(outcome), true) => format!("ended: {outcome}"),
        (None, true) => match recording.rerun() {
            Some(film) => format!("re-run: {}", film.ended),
            None => wording::NOT_CLOSED.to_owned(),
        },
    };
    let (lost_frames, lost_events) = recording.dropped;
    let lost =
        if recording.dropped == (0, 0) { String::new() } else { wording::dropped(lost_frames, lost_events) };
    writeln!(out, "{}; {}{lost}", Untrusted::new(end).line(), counted(frames, "frame"))
}
