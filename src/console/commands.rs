//! The command line: `:` and a command. Every action is a command by its name; a few commands take an argument.

use super::action::Action;
use super::palette::best;
use super::state_filter::StateFilter;
use holdpoint_body::TaskKind;
use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude, UnknownName};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::PACE_ALLOWED;
use holdpoint_trials::embedded;
use holdpoint_wording::console::commands as wording;

/// A command with an argument: name, argument, help.
pub const WITH_ARGUMENT: [(&str, &str, &str); 14] = [
    ("as", "NAME", wording::USE_IDENTITY),
    ("candidate", "VERSION", wording::SHOW_VERSION),
    ("close", "PROFILE", wording::BLOCK_FOR_A_PROFILE),
    ("demo", "[NAME]", wording::SUBMIT_DEMONSTRATION),
    ("drift", "KIND MAGNITUDE | off", wording::START_A_DRIFT),
    ("export", "", wording::EXPORT_VIEW),
    ("filter", "NAME", wording::FILTER_BY_STATE),
    ("goal", "GOAL", wording::SET_THE_GOAL),
    ("confirm-time", "", wording::CONFIRM_TIME),
    ("note", "[TEXT]", wording::LEAVE_A_NOTE),
    ("open", "PROFILE", wording::UNBLOCK_FOR_A_PROFILE),
    ("pace", "N | max", wording::SET_THE_PACE),
    ("register", "DIR", wording::SUBMIT_A_FOLDER),
    ("theme", "NAME", wording::USE_THEME),
];

/// A parsed command line.
#[derive(Clone, Debug, PartialEq)]
pub enum ConsoleCommand {
    /// An action by its name.
    Action(Action),
    Demo(Option<String>),
    Register(String),
    As(String),
    Theme(String),
    /// Which versions the overview and the registry list.
    StateFilter(StateFilter),
    /// A pace; absent for as fast as it computes.
    Pace(Option<f64>),
    /// Show the current pace.
    PaceNow,
    /// A drift; absent ends it.
    Drift(Option<Drift>),
    Candidate(CapabilityId),
    /// Blocks or unblocks the version under the cursor for a profile.
    Profile(ProfileName, bool),
    /// The agent's goal, in words for its interpreter.
    Goal(String),
    /// Trust the machine's clock.
    ConfirmTime,
    /// A note for the next shift.
    Note(String),
}

impl ConsoleCommand {
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
            Self::As(_) | Self::Theme(_) | Self::StateFilter(_) | Self::Candidate(_) | Self::PaceNow => false,
        }
    }
}

/// Reads a command line.
///
/// # Errors
/// What is wrong, and what is allowed.
pub fn parse(text: &str) -> Result<ConsoleCommand, String> {
    let text = text.trim().trim_start_matches(':');
    let (command, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    let rest = rest.trim();
    let needs = |what: &str| {
        if rest.is_empty() { Err(format!(":{command} needs {what}")) } else { Ok(rest.to_owned()) }
    };
    match command {
        "demo" if rest.is_empty() => Ok(ConsoleCommand::Demo(None)),
        "demo" => demonstration(rest),
        "register" => needs("a folder").map(ConsoleCommand::Register),
        "as" => needs(wording::NEEDS_IDENTITY).map(ConsoleCommand::As),
        "filter" if !rest.is_empty() => state_filter(rest),
        "theme" => needs(wording::NEEDS_THEME).map(ConsoleCommand::Theme),
        "pace" if rest.is_empty() => Ok(ConsoleCommand::PaceNow),
        "pace" => pace(rest).map(ConsoleCommand::Pace),
        "drift" => drift(rest),
        "goal" => needs(wording::NEEDS_GOAL).map(ConsoleCommand::Goal),
        "confirm-time" if rest.is_empty() => Ok(ConsoleCommand::ConfirmTime),
        "note" => Ok(ConsoleCommand::Note(rest.to_owned())),
        "close" => needs(&wording::needs_profile()).and_then(|name| profile(&name, true)),
        "open" if !rest.is_empty() => profile(rest, false),
        "candidate" if !rest.is_empty() => {
            let version = rest.parse::<CapabilityId>();
            version.map(ConsoleCommand::Candidate).map_err(|error| wording::is_no_version(rest, error))
        }
        "q" => Ok(ConsoleCommand::Action(Action::Quit)),
        _ => {
            let action = Action::parse(command).filter(|action| !action.decides());
            let action = action.ok_or_else(|| wording::no_such_command(command))?;
            if rest.is_empty() {
                Ok(ConsoleCommand::Action(action))
            } else {
                Err(wording::takes_nothing(command))
            }
        }
    }
}

/// Parses a pace: `max`, or simulated seconds in a second.
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
        wording::pace_not_allowed(text, *least, *most)
    })
}

fn profile(name: &str, block: bool) -> Result<ConsoleCommand, String> {
    let parsed = name.parse::<ProfileName>();
    parsed.map(|profile| ConsoleCommand::Profile(profile, block)).map_err(|error| error.to_string())
}

fn demonstration(name: &str) -> Result<ConsoleCommand, String> {
    if embedded::names().any(|known| known == name) {
        return Ok(ConsoleCommand::Demo(Some(name.to_owned())));
    }
    let known: Vec<&str> = embedded::names().collect();
    Err(wording::no_such_demonstration(name, &known.join(", ")))
}

fn state_filter(name: &str) -> Result<ConsoleCommand, String> {
    StateFilter::parse(name).map(ConsoleCommand::StateFilter).ok_or_else(|| {
        let known = StateFilter::ALL.map(StateFilter::name).join(", ");
        wording::no_such_filter(name, &known)
    })
}

fn drift(text: &str) -> Result<ConsoleCommand, String> {
    if text == "off" {
        return Ok(ConsoleCommand::Drift(None));
    }
    let Some((kind, magnitude)) = text.split_once(char::is_whitespace) else {
        let kinds = DriftKind::ALL.map(DriftKind::name).join(", ").replace('_', "-");
        let magnitudes = Magnitude::ALL.map(Magnitude::name).join(", ");
        return Err(wording::allowed_drifts(&kinds, &magnitudes));
    };
    let kind = kind.parse().map_err(|error: UnknownName| error.to_string())?;
    let magnitude = magnitude.trim().parse().map_err(|error: UnknownName| error.to_string())?;
    Ok(ConsoleCommand::Drift(Some(Drift { kind, magnitude })))
}

/// The goals that are offered; the agent's interpreter may know others.
fn goals() -> Vec<String> {
    std::iter::once("pick-align-place")
        .chain(TaskKind::ALL.map(TaskKind::name))
        .map(ToOwned::to_owned)
        .collect()
}

/// The paces that are offered.
const PACES: [&str; 5] = ["1", "2", "5", "10", "max"];

/// Every drift, as written on the command line.
fn drifts() -> Vec<String> {
    let kinds = DriftKind::ALL.map(|kind| kind.name().replace('_', "-"));
    let all = kinds
        .iter()
        .flat_map(|kind| Magnitude::ALL.map(|magnitude| format!("{kind} {}", magnitude.name())).into_iter());
    std::iter::once("off".to_owned()).chain(all).collect()
}

/// The typed part of a path, if the line takes one: its folder must be read for completions.
#[must_use]
pub fn path_of(typed: &str) -> Option<&str> {
    typed.trim_start().strip_prefix("register ").map(str::trim_start)
}

/// The names for completion.
#[derive(Clone, Copy, Debug)]
pub struct KnownNames<'a> {
    /// Versions in the snapshot.
    pub versions: &'a [String],
    pub people: &'a [String],
    pub themes: &'a [String],
}

/// Completions of the typed text, the best first.
#[must_use]
pub fn complete(typed: &str, known: &KnownNames<'_>) -> Vec<String> {
    let typed = typed.trim_start();
    let Some((command, rest)) = typed.split_once(' ') else {
        let actions = Action::ALL.iter().filter(|action| !action.decides()).map(|action| action.name());
        let mut commands: Vec<&str> = actions.chain(WITH_ARGUMENT.iter().map(|(name, ..)| *name)).collect();
        commands.sort_unstable();
        commands.dedup();
        let matching = commands.iter().filter(|name| name.starts_with(typed)).map(|name| (*name).to_owned());
        let matching: Vec<String> = matching.collect();
        if !matching.is_empty() {
            return matching;
        }
        return best(typed, commands.into_iter().map(|name| (name.to_owned(), name.to_owned())).collect());
    };
    let demos: Vec<String> = embedded::names().map(ToOwned::to_owned).collect();
    let profiles = ProfileName::ALL.map(|profile| profile.name().to_owned());
    let owned = |values: &[&str]| values.iter().map(|value| (*value).to_owned()).collect::<Vec<_>>();
    let (goals, paces, drifts) = (goals(), owned(&PACES), drifts());
    let filters = owned(&StateFilter::ALL.map(StateFilter::name));
    let arguments: &[String] = match command {
        "as" => known.people,
        "theme" => known.themes,
        "candidate" => known.versions,
        "demo" => &demos,
        "close" | "open" => &profiles,
        "filter" => &filters,
        "goal" => &goals,
        "pace" => &paces,
        "drift" => &drifts,
        _ => &[],
    };
    let rest = rest.trim();
    let matching = arguments.iter().filter(|argument| argument.starts_with(rest));
    matching.map(|argument| format!("{command} {argument}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::View;

    #[test]
    fn command_lines_are_parsed_or_refused_with_the_allowed_values() {
        let version: CapabilityId = "grasp@1.2.0".parse().unwrap();
        for (text, command) in [
            ("alarms", ConsoleCommand::Action(Action::Show(View::Alarms))),
            (":q", ConsoleCommand::Action(Action::Quit)),
            ("demo", ConsoleCommand::Demo(None)),
            ("demo grasp-improved", ConsoleCommand::Demo(Some("grasp-improved".to_owned()))),
            ("pace", ConsoleCommand::PaceNow),
            ("pace max", ConsoleCommand::Pace(None)),
            ("pace 2.5", ConsoleCommand::Pace(Some(2.5))),
            ("candidate grasp@1.2.0", ConsoleCommand::Candidate(version)),
            ("candidate", ConsoleCommand::Action(Action::Show(View::Candidate))),
            ("drift off", ConsoleCommand::Drift(None)),
            ("goal align", ConsoleCommand::Goal("align".to_owned())),
            ("confirm-time", ConsoleCommand::ConfirmTime),
            ("filter", ConsoleCommand::Action(Action::Filter)),
            ("filter held", ConsoleCommand::StateFilter(StateFilter::Held)),
            ("log", ConsoleCommand::Action(Action::KeyLog)),
            ("note", ConsoleCommand::Note(String::new())),
            ("note the tray is new", ConsoleCommand::Note("the tray is new".to_owned())),
            ("close human", ConsoleCommand::Profile(ProfileName::Human, true)),
            ("open human", ConsoleCommand::Profile(ProfileName::Human, false)),
            ("open", ConsoleCommand::Action(Action::Open)),
        ] {
            assert_eq!(parse(text), Ok(command), "{text}");
        }
        for (text, expected) in [
            ("fly", wording::no_such_command("fly")),
            ("approve", wording::no_such_command("approve")),
            ("reject", wording::no_such_command("reject")),
            ("pace 0", wording::pace_not_allowed("0", 0.1, 100.0)),
            ("pace NaN", wording::pace_not_allowed("NaN", 0.1, 100.0)),
            ("pace -1", wording::pace_not_allowed("-1", 0.1, 100.0)),
            ("pace 1e9", wording::pace_not_allowed("1e9", 0.1, 100.0)),
            ("pace 1e308", wording::pace_not_allowed("1e308", 0.1, 100.0)),
            ("pace 1e-308", wording::pace_not_allowed("1e-308", 0.1, 100.0)),
            ("pace inf", wording::pace_not_allowed("inf", 0.1, 100.0)),
            ("as", wording::NEEDS_IDENTITY.to_owned()),
            ("goal", wording::NEEDS_GOAL.to_owned()),
            ("demo grasp-low-flight", embedded::names().collect::<Vec<_>>().join(", ")),
            ("drift strong", "`:drift off`".to_owned()),
            ("filter moon", "running, queued, waiting, held".to_owned()),
            ("close", wording::needs_profile()),
            ("close moon", "moon".to_owned()),
            ("alarms now", wording::takes_nothing("alarms")),
            ("candidate grasp", "\"grasp\"".to_owned()),
        ] {
            let problem = parse(text).unwrap_err();
            assert!(problem.contains(&expected), "{text}: {problem}");
        }
    }

    #[test]
    fn commands_and_arguments_are_completed() {
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
        assert_eq!(complete("filter r", &known), ["filter running", "filter rejected"]);
        assert_eq!(path_of("register a/b"), Some("a/b"));
        assert_eq!(path_of("registry"), None);
        for line in complete("drift ", &known).into_iter().chain(complete("goal ", &known)) {
            assert!(parse(&line).is_ok(), "{line}");
        }
    }
}
