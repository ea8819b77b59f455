//! The filter by state of the lists of versions: the versions that each of its names takes, and how many there are.
//!
//! The overview and the registry share one filter. It hides rows of these two lists alone: alarms and requests stay.

use std::collections::BTreeSet;

use unicode_width::UnicodeWidthStr as _;

use super::model::{ConsoleModel, View};
use super::waiting_rows;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_governance::version_status::VersionCondition;

/// Which versions the lists show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StateFilter {
    #[default]
    All,
    /// A stage of it runs.
    Running,
    /// Its next stage has not begun, or waits for that of another version.
    Queued,
    /// Approvers are asked.
    Waiting,
    /// It continues when a person resumes it or has it evaluated again.
    Held,
    Rejected,
    /// The operator is its author, or it waits for the operator.
    Mine,
}

impl StateFilter {
    /// In the order in which a key steps through them.
    pub const ALL: [Self; 7] =
        [Self::All, Self::Running, Self::Queued, Self::Waiting, Self::Held, Self::Rejected, Self::Mine];

    /// Its name on the command line and on the screen.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Running => "running",
            Self::Queued => "queued",
            Self::Waiting => "waiting",
            Self::Held => "held",
            Self::Rejected => "rejected",
            Self::Mine => "mine",
        }
    }

    /// The filter of a name.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|filter| filter.name() == name)
    }

    /// The next one.
    #[must_use]
    pub fn next(self) -> Self {
        let at = Self::ALL.iter().position(|filter| *filter == self).unwrap_or(0);
        Self::ALL.get((at + 1) % Self::ALL.len()).copied().unwrap_or_default()
    }
}

/// A version as a list has it.
#[derive(Clone, Copy, Debug)]
pub struct ListedVersion<'a> {
    pub version: &'a CapabilityId,
    pub state: State,
    pub flags: &'a VersionFlags,
    pub author: &'a str,
}

/// What the filter needs besides the rows, read once for many of them.
#[derive(Debug)]
pub struct StateFilterFacts<'a> {
    /// Versions that the gate or an unanswered request holds.
    held: BTreeSet<&'a CapabilityId>,
    /// Versions whose stage has begun and rests.
    parked: BTreeSet<&'a CapabilityId>,
    /// Versions whose open request or question the operator may answer.
    asked: BTreeSet<&'a CapabilityId>,
    /// Name of the operator; absent if none is named.
    operator: Option<&'a str>,
}

impl<'a> StateFilterFacts<'a> {
    #[must_use]
    pub fn of(model: &'a ConsoleModel) -> Self {
        let operator = model.session.operator.as_ref().map(|operator| operator.name.as_str());
        let now = model.engine_data.snapshot.as_deref();
        let candidates = now.map_or(&[][..], |now| &now.candidates);
        let held = candidates.iter().filter(|one| one.held).map(|one| &one.version).collect();
        let parked = candidates.iter().filter(|one| one.parked).map(|one| &one.version).collect();
        let (prompts, questions) =
            now.map_or((&[][..], &[][..]), |now| (&now.prompts[..], &now.questions[..]));
        let open = prompts.iter().filter(|prompt| {
            !prompt.granted && operator.is_some_and(|name| !waiting_rows::is_closed_to(prompt, name))
        });
        let asked = questions.iter().filter(|_| operator.is_some()).map(|question| &question.version);
        Self { held, parked, asked: open.map(|prompt| &prompt.version).chain(asked).collect(), operator }
    }

    /// Whether a filter takes a version.
    #[must_use]
    pub fn takes(&self, filter: StateFilter, one: ListedVersion<'_>) -> bool {
        match filter {
            StateFilter::All => true,
            StateFilter::Mine => self.is_mine(one),
            of_state => self.of_state(one) == Some(of_state),
        }
    }

    /// The filter of a version's own state; absent if none of them takes it.
    fn of_state(&self, one: ListedVersion<'_>) -> Option<StateFilter> {
        use VersionCondition as C;
        match C::of(one.state, one.flags, self.held.contains(one.version)) {
            C::Running if self.parked.contains(one.version) => Some(StateFilter::Queued),
            C::Running => Some(StateFilter::Running),
            C::Queued => Some(StateFilter::Queued),
            C::AwaitingApproval => Some(StateFilter::Waiting),
            C::Paused | C::PromotionPaused | C::Held | C::Demoted => Some(StateFilter::Held),
            C::Rejected => Some(StateFilter::Rejected),
            C::Provisional | C::Restricted | C::Confirmed | C::Leaving | C::Superseded | C::RolledBack => {
                None
            }
        }
    }

    fn is_mine(&self, one: ListedVersion<'_>) -> bool {
        self.operator == Some(one.author) || self.asked.contains(one.version)
    }
}

impl ConsoleModel {
    /// Whether the filter in use takes a version.
    #[must_use]
    pub fn is_listed(
        &self,
        facts: &StateFilterFacts<'_>,
        version: &CapabilityId,
        state: State,
        flags: &VersionFlags,
        author: &str,
    ) -> bool {
        facts.takes(self.view_state.state_filter, ListedVersion { version, state, flags, author })
    }

    /// How many versions of the view's list each filter takes, in the order of [`StateFilter::ALL`]; a typed filter
    /// does not count.
    #[must_use]
    pub fn state_counts(&self) -> [usize; 7] {
        let facts = StateFilterFacts::of(self);
        let mut counts = [0; 7];
        let mut count = |one: ListedVersion<'_>| {
            // Once for all filters: each frame asks for every row.
            let (of_state, is_mine) = (facts.of_state(one), facts.is_mine(one));
            for (count, filter) in counts.iter_mut().zip(StateFilter::ALL) {
                *count += usize::from(match filter {
                    StateFilter::All => true,
                    StateFilter::Mine => is_mine,
                    other => of_state == Some(other),
                });
            }
        };
        if self.view_state.view == View::Registry {
            for row in &self.engine_data.registry.page.rows {
                let (version, flags, author) = (&row.version, &row.flags, row.author.as_str());
                count(ListedVersion { version, state: row.state, flags, author });
            }
        } else {
            for row in self.engine_data.snapshot.iter().flat_map(|now| &now.candidates) {
                let (version, flags, author) = (&row.version, &row.flags, row.author.as_str());
                count(ListedVersion { version, state: row.state, flags, author });
            }
        }
        counts
    }
}

/// The counts by state and the place of the cursor, in at most `room` columns: `running 2  [held 1]  1 of 1`. The filter
/// in use is in brackets and always stands; one that takes no version is left out.
#[must_use]
pub fn counts_and_place(model: &ConsoleModel, place: &str, room: usize) -> String {
    let here = model.view_state.state_filter;
    let mut counts: Vec<(StateFilter, usize)> = StateFilter::ALL
        .into_iter()
        .zip(model.state_counts())
        .filter(|(filter, count)| *filter != StateFilter::All && (*count > 0 || *filter == here))
        .collect();
    let place = if place.is_empty() && here != StateFilter::All { "none" } else { place };
    let text = |counts: &[(StateFilter, usize)], is_cut: bool, place: &str| {
        let count = |(filter, count): &(StateFilter, usize)| {
            let text = format!("{} {count}", filter.name());
            if *filter == here { format!("[{text}]") } else { text }
        };
        let cut = is_cut.then(|| "…".to_owned());
        let place = (!place.is_empty()).then(|| place.to_owned());
        let parts: Vec<String> = counts.iter().map(count).chain(cut).chain(place).collect();
        parts.join("  ")
    };
    let mut is_cut = false;
    while text(&counts, is_cut, place).width() > room {
        let Some(last) = counts.iter().rposition(|(filter, _)| *filter != here) else { break };
        counts.remove(last);
        is_cut = !counts.is_empty();
    }
    let texts = [text(&counts, is_cut, place), text(&counts, false, place), text(&counts, false, "")];
    let fits = texts.iter().position(|text| text.width() <= room);
    texts.into_iter().nth(fits.unwrap_or(2)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_key_steps_through_every_filter_and_each_has_its_own_name() {
        let mut seen = vec![StateFilter::default()];
        while seen.len() < StateFilter::ALL.len() {
            seen.push(seen.last().copied().unwrap_or_default().next());
        }
        assert_eq!(seen, StateFilter::ALL);
        assert_eq!(StateFilter::Mine.next(), StateFilter::All);
        for filter in StateFilter::ALL {
            assert_eq!(StateFilter::parse(filter.name()), Some(filter));
        }
        assert_eq!(StateFilter::parse("moon"), None);
    }

    #[test]
    fn a_version_in_flight_has_one_state_filter() {
        let version: CapabilityId = "grasp@1.0.0".parse().unwrap();
        let facts = |is_held: bool| StateFilterFacts {
            held: is_held.then_some(&version).into_iter().collect(),
            parked: BTreeSet::new(),
            asked: BTreeSet::new(),
            operator: Some("ana"),
        };
        let none = VersionFlags::default();
        let paused = VersionFlags { paused: true, ..none };
        let asked = VersionFlags { awaiting_approval: true, ..none };
        for (state, flags, is_held, expected) in [
            (State::Registered, none, false, Some(StateFilter::Queued)),
            (State::Shadowed, asked, false, Some(StateFilter::Waiting)),
            (State::Shadowed, none, true, Some(StateFilter::Held)),
            (State::Sandboxed, paused, false, Some(StateFilter::Held)),
            (State::Active, paused, false, Some(StateFilter::Held)),
            (State::Demoted, none, false, Some(StateFilter::Held)),
            (State::Rejected, paused, true, Some(StateFilter::Rejected)),
            (State::RolledBack, none, false, None),
            (State::Active, none, false, None),
        ] {
            let facts = facts(is_held);
            let one = ListedVersion { version: &version, state, flags: &flags, author: "cora" };
            let taken: Vec<StateFilter> =
                StateFilter::ALL.into_iter().skip(1).filter(|filter| facts.takes(*filter, one)).collect();
            assert_eq!(taken, expected.into_iter().collect::<Vec<_>>(), "{state} {flags:?} {is_held}");
        }
        let one = ListedVersion { version: &version, state: State::Active, flags: &none, author: "ana" };
        assert!(facts(false).takes(StateFilter::Mine, one), "the operator is its author");
    }
}
