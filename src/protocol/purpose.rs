//! What a question that waits for people is about.

holdpoint_governance::words! {
    /// What people are asked to decide.
    #[derive(Default)]
    Purpose, "purpose of a question", {
        /// Whether a candidate may become active.
        #[default]
        Activation = "activation",
        /// Whether a restriction of an active version is lifted.
        Release = "release",
        /// Whether an emergency activation was right.
        Review = "review",
        /// Whether one person lets a version in alone.
        Emergency = "emergency",
    }
}
