//! All actions of the keyboard: one table that makes the help, the palette, the guide's keys and the default keymap.
//! The action that shows a view has these facts in the view's description.
//!
//! An action is what the operator asks for; `update` decides whether it is possible and what it does. An action without
//! a help line or without a decision about its keys does not compile.

use super::views::View;
use holdpoint_wording::console::action as wording;

/// Where an action applies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Scope {
    /// Everywhere but in text fields.
    Everywhere,
    /// In lists and charts.
    Lists,
    /// On a version under the cursor.
    Version,
    /// On an alarm under the cursor.
    Alarms,
    /// In shadow's charts and the overview.
    Charts,
    /// Only in an open approval prompt.
    Prompt,
}

impl Scope {
    /// The heading in help and README.
    #[must_use]
    pub const fn title(self) -> &'static str {
        match self {
            Self::Everywhere => "Everywhere",
            Self::Lists => "Lists",
            Self::Version => wording::VERSION_UNDER_THE_CURSOR,
            Self::Alarms => "Alarms",
            Self::Charts => "Charts",
            Self::Prompt => wording::OPEN_PROMPT,
        }
    }

    /// In the order of help and README.
    pub const ALL: [Self; 6] =
        [Self::Everywhere, Self::Lists, Self::Version, Self::Alarms, Self::Charts, Self::Prompt];
}

macro_rules! actions {
    ($($(#[doc = $help:literal])+ $variant:ident = $name:literal, $scope:ident, [$($key:literal),*];)*) => {
        /// The actions.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Action {
            /// Shows a view, whose description has its name, help and keys.
            Show(View),
            $($(#[doc = $help])+ $variant,)*
        }

        impl Action {
            /// Every action but those that show a view.
            const OTHERS: &'static [Self] = &[$(Self::$variant),*];

            /// Its name on the command line and in the keymap file.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self {
                    Self::Show(view) => view.description().action,
                    $(Self::$variant => $name,)*
                }
            }

            /// What it does, one sentence without a period.
            #[must_use]
            pub fn help(self) -> &'static str {
                match self {
                    Self::Show(view) => view.description().help,
                    $(Self::$variant => concat!($($help),+).trim(),)*
                }
            }

            /// Where it applies.
            #[must_use]
            pub const fn scope(self) -> Scope {
                match self {
                    Self::Show(_) => Scope::Everywhere,
                    $(Self::$variant => Scope::$scope,)*
                }
            }

            /// Its keys unless the keymap file says otherwise.
            #[must_use]
            pub fn default_keys(self) -> &'static [&'static str] {
                match self {
                    Self::Show(view) => view.description().keys,
                    $(Self::$variant => &[$($key),*],)*
                }
            }
        }
    };
}

actions! {
    /// Stop the arm at once, whatever is under way; no question is asked
    Stop = "stop", Everywhere, ["X", "f9"];
    /// Start the stopped cell, reason required
    Go = "go", Everywhere, ["W"];
    /// Abort an evaluation or a provisional version, confirmed by one more key
    Abort = "abort", Everywhere, ["x", "ctrl-x"];
    /// Go to the highest unacknowledged alarm
    JumpToAlarm = "jump-to-alarm", Everywhere, ["!"];
    /// Keys of this view; type to filter, Enter runs one
    Help = "help", Everywhere, ["?", "f1"];
    /// Command line
    CommandLine = "command-line", Everywhere, [":"];
    /// Filter this list, or find in one that hides nothing
    Filter = "filter", Everywhere, ["/"];
    /// What each key of this console did, with the engine's answers
    KeyLog = "log", Everywhere, ["L"];
    /// Undo the last shelving, hold, mark or goal of this console, with a reason where its reverse needs one
    Undo = "undo", Everywhere, ["U"];
    /// Back one step; close undecided
    Back = "back", Everywhere, ["esc"];
    /// Submit the next demonstration candidate
    Demo = "demo", Everywhere, [];
    /// Dismiss the tour line, or bring it back
    Tour = "tour", Everywhere, ["."];
    /// Next theme
    NextTheme = "next-theme", Everywhere, ["T"];
    /// Take the mouse (click, wheel), or give it back to the terminal
    Mouse = "mouse", Everywhere, ["M"];
    /// Copy the focused value (OSC 52)
    Copy = "copy", Everywhere, ["y"];
    /// Export this view as text and JSON
    Export = "export", Everywhere, ["ctrl-s"];
    /// Leave the engine running and end only the console
    Detach = "detach", Everywhere, [];
    /// Leave this view; from the overview, end the program
    Quit = "quit", Everywhere, ["q", "ctrl-c"];
    /// Refused: a suspended console shows no alarm
    Suspend = "suspend", Everywhere, ["ctrl-z"];
    /// Up
    Up = "up", Lists, ["k", "up"];
    /// Down
    Down = "down", Lists, ["j", "down"];
    /// Left: previous pane, or close a branch
    Left = "left", Lists, ["h", "left"];
    /// Right: next pane, or open a branch
    Right = "right", Lists, ["l", "right"];
    /// Page up
    PageUp = "page-up", Lists, ["pageup", "ctrl-b"];
    /// Page down
    PageDown = "page-down", Lists, ["pagedown", "ctrl-f"];
    /// First
    Top = "top", Lists, ["g", "home"];
    /// Last
    Bottom = "bottom", Lists, ["G", "end"];
    /// Next pane
    NextPane = "next-pane", Lists, ["tab"];
    /// Previous pane
    PreviousPane = "previous-pane", Lists, ["backtab"];
    /// List only running, queued, waiting, held, rejected or own versions: the next of these, then all
    StateFilter = "state-filter", Lists, ["i"];
    /// Sort by the next column
    Sort = "sort", Lists, ["s"];
    /// Reverse the order
    SortReverse = "sort-reverse", Lists, ["S"];
    /// Mark or unmark this alarm or version; acknowledge, reject, pause and copy take all marked ones
    Mark = "mark", Lists, ["m"];
    /// Find the next match
    FindNext = "find-next", Lists, ["n"];
    /// Open what is under the cursor; never a side effect
    Open = "open", Lists, ["enter"];
    /// Open the recording of this upgrade; without a viewer, in this terminal
    OpenRecording = "open-recording", Version, ["o"];
    /// Open the live scene in 3D
    OpenLive = "open-live", Lists, ["O"];
    /// Pause this candidate, or the promotion of a provisional version; reason required
    Pause = "pause", Version, ["p"];
    /// Resume what is paused or on hold, reason required
    Resume = "resume", Version, ["u"];
    /// Reject this candidate finally, reason required
    Refuse = "refuse", Version, ["F"];
    /// Return this version to evaluation, reason required
    Demote = "demote", Version, ["D"];
    /// Roll this active version back, reason required
    Rollback = "rollback", Version, ["B"];
    /// Tighten the envelope of this active version, reason required
    Restrict = "restrict", Version, ["t"];
    /// Run the sandbox of this version again, reason required
    Repeat = "repeat", Version, ["e"];
    /// Lift the restriction of this active version, reason required
    Release = "release", Version, ["w"];
    /// Break-glass: activate this version alone; two people review it
    BreakGlass = "break-glass", Version, ["E"];
    /// Answer a monitor's question: continue, reason required
    Continue = "continue", Version, ["c"];
    /// Reactivate a superseded version of a stopped family, reason required
    Rearm = "rearm", Version, ["A"];
    /// Make this confirmed version its family's anchor, reason required
    Anchor = "anchor", Version, ["K"];
    /// Check the whole audit chain
    Verify = "verify", Everywhere, ["v"];
    /// Acknowledge this alarm
    Acknowledge = "acknowledge", Alarms, ["space"];
    /// Shelve this alarm for a time, reason required
    Shelve = "shelve", Alarms, ["z"];
    /// End the shelving of this alarm
    Unshelve = "unshelve", Alarms, ["Z"];
    /// Close a latched alarm, reason required
    ResetAlarm = "reset-alarm", Alarms, ["R"];
    /// Freeze charts and events, or let them run; the arm, alarms and questions stay live
    Freeze = "freeze", Charts, ["f"];
    /// Zoom in
    ZoomIn = "zoom-in", Charts, ["+", "="];
    /// Zoom out
    ZoomOut = "zoom-out", Charts, ["-"];
    /// Whole range
    ZoomReset = "zoom-reset", Charts, ["0"];
    /// Approve, once the tier's conditions are met
    Approve = "approve", Prompt, ["Y"];
    /// Reject, reason required
    Reject = "reject", Prompt, ["N"];
    /// Read changed evidence again
    Reread = "reread", Prompt, ["r"];
}

impl Action {
    const EACH: [Self; View::ALL.len() + Self::OTHERS.len()] = {
        let mut each = [Self::Stop; View::ALL.len() + Self::OTHERS.len()];
        let mut at = 0;
        while at < each.len() {
            each[at] = if at < View::ALL.len() {
                Self::Show(View::ALL[at])
            } else {
                Self::OTHERS[at - View::ALL.len()]
            };
            at += 1;
        }
        each
    };

    /// Every action, in the order of help and README: first the views.
    pub const ALL: &'static [Self] = &Self::EACH;

    /// The action of a name.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|action| action.name() == name)
    }

    /// Whether it decides on a candidate: such a key is never Enter, Space, Esc or a key that moves.
    #[must_use]
    pub const fn decides(self) -> bool {
        matches!(self, Self::Approve | Self::Reject)
    }

    /// Whether it changes the item under the cursor.
    #[must_use]
    pub const fn aims_at_item(self) -> bool {
        matches!(
            self,
            Self::Open
                | Self::Pause
                | Self::Resume
                | Self::Refuse
                | Self::Demote
                | Self::Rollback
                | Self::Restrict
                | Self::Continue
                | Self::Rearm
                | Self::Anchor
                | Self::Acknowledge
                | Self::Shelve
                | Self::Unshelve
                | Self::ResetAlarm
        )
    }

    /// Whether it opens a form, or a request, with text to type.
    #[must_use]
    pub const fn asks_for_reason(self) -> bool {
        matches!(
            self,
            Self::Go
                | Self::Pause
                | Self::Resume
                | Self::Refuse
                | Self::Demote
                | Self::Rollback
                | Self::Restrict
                | Self::Repeat
                | Self::Release
                | Self::BreakGlass
                | Self::Continue
                | Self::Rearm
                | Self::Anchor
                | Self::Shelve
                | Self::ResetAlarm
        )
    }

    /// Whether it only moves the cursor.
    #[must_use]
    pub const fn moves_cursor(self) -> bool {
        matches!(
            self,
            Self::Up
                | Self::Down
                | Self::Left
                | Self::Right
                | Self::PageUp
                | Self::PageDown
                | Self::Top
                | Self::Bottom
                | Self::NextPane
                | Self::PreviousPane
                | Self::FindNext
        )
    }

    /// Whether it works while text is typed, given a key with a modifier.
    #[must_use]
    pub const fn works_while_typing(self) -> bool {
        matches!(self, Self::Abort | Self::Stop)
    }

    /// Whether a read-only console refuses it.
    #[must_use]
    pub const fn changes_something(self) -> bool {
        match self {
            Self::Abort
            | Self::Go
            | Self::Demo
            | Self::Pause
            | Self::Resume
            | Self::Refuse
            | Self::Demote
            | Self::Rollback
            | Self::Restrict
            | Self::Repeat
            | Self::Release
            | Self::BreakGlass
            | Self::Continue
            | Self::Rearm
            | Self::Anchor
            | Self::Acknowledge
            | Self::Shelve
            | Self::Unshelve
            | Self::ResetAlarm
            | Self::Undo
            | Self::Approve
            | Self::Reject => true,
            // Every user who sees the screen may stop.
            Self::Stop
            | Self::Show(_)
            | Self::JumpToAlarm
            | Self::Help
            | Self::CommandLine
            | Self::Filter
            | Self::StateFilter
            | Self::KeyLog
            | Self::Back
            | Self::Tour
            | Self::NextTheme
            | Self::Mouse
            | Self::Copy
            | Self::Export
            | Self::Detach
            | Self::Quit
            | Self::Suspend
            | Self::Up
            | Self::Down
            | Self::Left
            | Self::Right
            | Self::PageUp
            | Self::PageDown
            | Self::Top
            | Self::Bottom
            | Self::NextPane
            | Self::PreviousPane
            | Self::Sort
            | Self::SortReverse
            | Self::FindNext
            | Self::Mark
            | Self::Open
            | Self::OpenRecording
            | Self::OpenLive
            | Self::Verify
            | Self::Freeze
            | Self::ZoomIn
            | Self::ZoomOut
            | Self::ZoomReset
            | Self::Reread => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_helps_are_unique_and_present() {
        let names: std::collections::BTreeSet<&str> =
            Action::ALL.iter().map(|action| action.name()).collect();
        assert_eq!(names.len(), Action::ALL.len());
        for action in Action::ALL {
            assert_eq!(Action::parse(action.name()), Some(*action));
            assert!(!action.help().is_empty() && !action.help().ends_with('.'), "{action:?}");
            let unbound = action.default_keys().is_empty();
            assert!(!unbound || matches!(action, Action::Demo | Action::Detach), "{action:?} has no key");
        }
    }
}
