//! The meaning of a piece of the screen. All drawing code asks for a role; only a theme knows colors.

macro_rules! roles {
    ($($(#[doc = $help:literal])+ $variant:ident = $name:literal;)*) => {
        /// A meaning that a theme gives a look.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum ThemeRole {
            $($(#[doc = $help])+ $variant,)*
        }

        impl ThemeRole {
            /// Every role, in the order of theme files and of the preview.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Its name in theme files.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// What it is used for.
            #[must_use]
            pub fn help(self) -> &'static str {
                match self { $(Self::$variant => concat!($($help),+).trim(),)* }
            }
        }
    };
}

roles! {
    /// Text
    Text = "text";
    /// Text that matters less
    Muted = "muted";
    /// Title of a pane
    Title = "title";
    /// Title of the pane that has the keys
    Focus = "focus";
    /// Lines between panes
    Rule = "rule";
    /// Row under the cursor
    Selected = "selected";
    /// Key in a hint
    Key = "key";
    /// Key that does nothing now
    KeyOff = "key-off";
    /// Field that has the keys
    Field = "field";
    /// Answer that says what was done
    Notice = "notice";
    /// Answer that says what was refused or failed
    Problem = "problem";
    /// Banner of the simulation profile
    BannerSim = "banner-sim";
    /// Banner of the profile for a real robot
    BannerReal = "banner-real";
    /// Banner of the profile for work beside people
    BannerHuman = "banner-human";
    /// Mark of a console that changes nothing
    ReadOnly = "read-only";
    /// Data that is older than it should be
    Stale = "stale";
    /// Engine or version that is held
    Held = "held";
    /// Critical alarm
    Critical = "critical";
    /// High alarm
    High = "high";
    /// Low alarm
    Low = "low";
    /// Acknowledged alarm
    Quiet = "quiet";
    /// Something that waits for a person
    Waiting = "waiting";
    /// Good outcome
    Good = "good";
    /// Bad outcome
    Bad = "bad";
    /// Outcome to look at
    Warning = "warning";
    /// Something under way
    Running = "running";
    /// Something unknown, or not measured
    Unknown = "unknown";
    /// Limit in a bar or chart
    Limit = "limit";
    /// Value in a bar or chart
    Value = "value";
    /// Value past its limit
    Past = "past";
    /// Value that the candidate has and the active version does not
    Added = "added";
    /// Value that the active version has and the candidate does not
    Removed = "removed";
    /// Robot in the live cell
    Robot = "robot";
    /// Twin, which drives nothing
    Twin = "twin";
    /// Object in work
    Object = "object";
    /// Contact that was not asked for
    Contact = "contact";
    /// Table, tray and workspace
    Scenery = "scenery";
    /// Zone where nothing may be
    KeepOut = "keep-out";
}

impl ThemeRole {
    /// The role of a name.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|role| role.name() == name)
    }
}
