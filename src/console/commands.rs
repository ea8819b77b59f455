//! The command line: `:` and a word. Every action is a command by its name; a few take an argument.

use super::action::Action;
use super::palette::best;
use holdpoint_body::rehearsal::{Drift, DriftKind, Magnitude, UnknownWord};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::PACE_ALLOWED;

/// A command with an argument: name, argument, help.
pub const WITH_ARGUMENT: [(&str, &str, &str); 13] = [
    ("as", "NAME", "Sit down as this identity"),
    ("candidate", "VERSION", "Show a version in full"),
    ("close", "PROFILE", "Close a profile to the version under the cursor, reason required"),
    ("demo", "[NAME]", "Submit a demonstration candidate: the next one, or this one"),
    ("drift", "KIND MAGNITUDE | off", "Let a drift set in in the simulated cell, or end it"),
    ("export", "", "Export this view as text and JSON"),
    ("goal", "GOAL", "Say what the agent of the live cell works towards, reason required"),
    (
        "confirm-time",
        "",
        "Confirm what the machine's clock says, where it was set; nothing is activated before",
    ),
    ("note", "[TEXT]", "Leave a note for those who come after: on record, and marked in Health"),
    ("open", "PROFILE", "Open a profile to the version under the cursor again, reason required"),
    ("pace", "N | max", "Simulated seconds in a second of the live cell"),
    ("register", "DIR", "Submit a candidate's folder"),
    ("theme", "NAME", "Use this theme"),
];

/// What was asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum Asked {
    /// An action by its name.
    Action(Action),
    Demo(Option<String>),
    Register(String),
    As(String),
    Theme(String),
    /// A pace; absent for as fast as it computes.
    Pace(Option<f64>),
    /// Which pace is in force.
    PaceNow,
    /// A drift; absent ends it.
    Drift(Option<Drift>),
    Candidate(CapabilityId),
    /// A profile is closed (or opened) to the version under the cursor.
    Profile(ProfileName, bool),
    /// What the agent works towards, in words for its interpreter.
    Goal(String),
    /// The machine's clock is to be believed.
    ConfirmTime,
    /// A note for those who come after.
    Note(String),
}

impl Asked {
    /// Whether a read-only console refuses it.
    #[must_use]
    pub const fn changes_something(&self) -> bool {
        match self {
            Self::Action(action) => action.changes_something(),
            Self::Demo(_)
            | Self::Register(_)
            | Self::Pace(_)
            | Self::Drift(_)
            | Self::Profile(..)
            | Self::Goal(_)
            | Self::ConfirmTime
            | Self::Note(_) => true,
            Self::As(_) | Self::Theme(_) | Self::Candidate(_) | Self::PaceNow => false,
        }
    }
}

/// Reads a command line.
///
/// # Errors
/// What is wrong, and what is allowed.
pub fn parse(text: &str) -> Result<Asked, String> {
    let text = text.trim().trim_start_matches(':');
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    let rest = rest.trim();
    let needs = |what: &str| {
        if rest.is_empty() { Err(format!(":{word} needs {what}")) } else { Ok(rest.to_owned()) }
    };
    match word {
        "demo" => Ok(Asked::Demo((!rest.is_empty()).then(|| rest.to_owned()))),
        "register" => needs("a folder").map(Asked::Register),
        "as" => needs("the name of an identity; `holdpoint identity list` shows them").map(Asked::As),
        "theme" => needs("a name; tab shows them").map(Asked::Theme),
        "pace" if rest.is_empty() => Ok(Asked::PaceNow),
        "pace" => pace(rest).map(Asked::Pace),
        "drift" => drift(rest),
        "goal" => needs("a goal: pick-align-place, grasp, align or place").map(Asked::Goal),
        "confirm-time" if rest.is_empty() => Ok(Asked::ConfirmTime),
        "note" => Ok(Asked::Note(rest.to_owned())),
        "close" => needs("a profile: sim, real or human").and_then(|name| profile(&name, true)),
        "open" if !rest.is_empty() => profile(rest, false),
        "candidate" if !rest.is_empty() => {
            let version = rest.parse::<CapabilityId>();
            version.map(Asked::Candidate).map_err(|error| format!("{rest:?} is no version: {error}"))
        }
        "q" => Ok(Asked::Action(Action::Quit)),
        _ => {
            let action = Action::parse(word).filter(|action| !action.decides());
            let action = action.ok_or_else(|| format!("there is no command {word:?}; ? lists them"))?;
            if rest.is_empty() {
                Ok(Asked::Action(action))
            } else {
                Err(format!(":{word} takes nothing after it"))
            }
        }
    }
}

/// A pace as it is written: `max`, or simulated seconds in a second.
///
/// # Errors
/// What is allowed.
pub fn pace(text: &str) -> Result<Option<f64>, String> {
    if text == "max" {
        return Ok(None);
    }
    let times = text.parse::<f64>().ok().filter(|times| PACE_ALLOWED.contains(times));
    times.map(Some).ok_or_else(|| {
        let (least, most) = (PACE_ALLOWED.start(), PACE_ALLOWED.end());
        format!("the pace {text:?} is not allowed; max or a number from {least} to {most} is")
    })
}

fn profile(name: &str, close: bool) -> Result<Asked, String> {
    let known = name.parse::<ProfileName>();
    known.map(|profile| Asked::Profile(profile, close)).map_err(|error| error.to_string())
}

fn drift(text: &str) -> Result<Asked, String> {
    if text == "off" {
        return Ok(Asked::Drift(None));
    }
    let Some((kind, magnitude)) = text.split_once(char::is_whitespace) else {
        let kinds = DriftKind::ALL.map(DriftKind::name).join(", ").replace('_', "-");
        let magnitudes = Magnitude::ALL.map(Magnitude::name).join(", ");
        return Err(format!("allowed are `:drift off`, or a kind ({kinds}) and a magnitude ({magnitudes})"));
    };
    let kind = kind.parse().map_err(|error: UnknownWord| error.to_string())?;
    let magnitude = magnitude.trim().parse().map_err(|error: UnknownWord| error.to_string())?;
    Ok(Asked::Drift(Some(Drift { kind, magnitude })))
}

/// The goals that are offered; the agent's interpreter may know others.
const GOALS: [&str; 4] = ["pick-align-place", "grasp", "align", "place"];

/// The paces that are offered.
const PACES: [&str; 5] = ["1", "2", "5", "10", "max"];

/// Every drift there is, as it is written.
fn drifts() -> Vec<String> {
    let kinds = DriftKind::ALL.map(|kind| kind.name().replace('_', "-"));
    let all = kinds
        .iter()
        .flat_map(|kind| Magnitude::ALL.map(|magnitude| format!("{kind} {}", magnitude.name())).into_iter());
    std::iter::once("off".to_owned()).chain(all).collect()
}

/// What is typed of a path, if the line takes one: its folder has to be read for what it could become.
#[must_use]
pub fn path_of(typed: &str) -> Option<&str> {
    typed.trim_start().strip_prefix("register ").map(str::trim_start)
}

/// What can be completed to.
#[derive(Clone, Copy, Debug)]
pub struct KnownNames<'a> {
    /// Versions in the snapshot.
    pub versions: &'a [String],
    pub people: &'a [String],
    pub themes: &'a [String],
}

/// Lines that what is typed could become, the best first.
#[must_use]
pub fn complete(typed: &str, known: &KnownNames<'_>) -> Vec<String> {
    let typed = typed.trim_start();
    let Some((word, rest)) = typed.split_once(' ') else {
        let actions = Action::ALL.iter().filter(|action| !action.decides()).map(|action| action.word());
        let mut words: Vec<&str> = actions.chain(WITH_ARGUMENT.iter().map(|(word, ..)| *word)).collect();
        words.sort_unstable();
        words.dedup();
        let starts = words.iter().filter(|word| word.starts_with(typed)).map(|word| (*word).to_owned());
        let starts: Vec<String> = starts.collect();
        if !starts.is_empty() {
            return starts;
        }
        return best(typed, words.into_iter().map(|word| (word.to_owned(), word.to_owned())).collect());
    };
    let demos: Vec<String> = holdpoint_engine::embedded::names().map(ToOwned::to_owned).collect();
    let profiles = ProfileName::ALL.map(|profile| profile.name().to_owned());
    let own = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
    let (goals, paces, drifts) = (own(&GOALS), own(&PACES), drifts());
    let arguments: &[String] = match word {
        "as" => known.people,
        "theme" => known.themes,
        "candidate" => known.versions,
        "demo" => &demos,
        "close" | "open" => &profiles,
        "goal" => &goals,
        "pace" => &paces,
        "drift" => &drifts,
        _ => &[],
    };
    let rest = rest.trim();
    let fits = arguments.iter().filter(|argument| argument.starts_with(rest));
    fits.map(|argument| format!("{word} {argument}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_lines_and_refuses_with_what_is_allowed() {
        let version: CapabilityId = "grasp@1.2.0".parse().unwrap();
        for (text, asked) in [
            ("alarms", Asked::Action(Action::ShowAlarms)),
            (":q", Asked::Action(Action::Quit)),
            ("demo", Asked::Demo(None)),
            ("demo grasp-improved", Asked::Demo(Some("grasp-improved".to_owned()))),
            ("pace", Asked::PaceNow),
            ("pace max", Asked::Pace(None)),
            ("pace 2.5", Asked::Pace(Some(2.5))),
            ("candidate grasp@1.2.0", Asked::Candidate(version)),
            ("candidate", Asked::Action(Action::ShowCandidate)),
            ("drift off", Asked::Drift(None)),
            ("goal align", Asked::Goal("align".to_owned())),
            ("confirm-time", Asked::ConfirmTime),
            ("note", Asked::Note(String::new())),
            ("note the tray is new", Asked::Note("the tray is new".to_owned())),
            ("close human", Asked::Profile(ProfileName::Human, true)),
            ("open human", Asked::Profile(ProfileName::Human, false)),
            ("open", Asked::Action(Action::Open)),
        ] {
            assert_eq!(parse(text), Ok(asked), "{text}");
        }
        for (text, word) in [
            ("fly", "no command \"fly\""),
            ("approve", "no command"),
            ("reject", "no command"),
            ("pace 0", "not allowed"),
            ("pace NaN", "not allowed"),
            ("pace -1", "not allowed"),
            ("pace 1e9", "0.1 to 100"),
            ("pace 1e308", "0.1 to 100"),
            ("pace 1e-308", "0.1 to 100"),
            ("pace inf", "not allowed"),
            ("as", "needs"),
            ("goal", "needs a goal"),
            ("drift strong", "allowed are"),
            ("close", "needs a profile"),
            ("close moon", "moon"),
            ("alarms now", "takes nothing"),
            ("candidate grasp", "is no version"),
        ] {
            let why = parse(text).unwrap_err();
            assert!(why.contains(word), "{text}: {why}");
        }
    }

    #[test]
    fn completes_words_and_arguments() {
        let people = ["ana".to_owned(), "bo".to_owned()];
        let known = KnownNames { versions: &[], people: &people, themes: &[] };
        assert_eq!(complete("alar", &known), ["alarms"]);
        assert_eq!(complete("as b", &known), ["as bo"]);
        assert_eq!(complete("demo place-r", &known), ["demo place-robust"]);
        assert!(complete("approve", &known).iter().all(|line| line != "approve"));
        let versions = ["place@1.0.0".to_owned(), "place@1.1.0".to_owned()];
        let known = KnownNames { versions: &versions, ..known };
        assert_eq!(complete("candidate pl", &known), ["candidate place@1.0.0", "candidate place@1.1.0"]);
        assert_eq!(complete("pace m", &known), ["pace max"]);
        assert_eq!(path_of("register a/b"), Some("a/b"));
        assert_eq!(path_of("registry"), None);
        for line in complete("drift ", &known).into_iter().chain(complete("goal ", &known)) {
            assert!(parse(&line).is_ok(), "{line}");
        }
    }
}
