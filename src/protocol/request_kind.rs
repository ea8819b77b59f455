//! The kinds of approval request.

holdpoint_governance::closed_set! {
    /// The decision that a request asks for.
    #[derive(Default)]
    RequestKind, "purpose of a question", {
        /// Whether a candidate may become active.
        #[default]
        Activation = "activation",
        /// Whether a restriction of an active version is lifted.
        Release = "release",
        /// Whether a break-glass activation was right.
        Review = "review",
        /// Whether one person activates a version by break-glass.
        Emergency = "emergency",
    }
}
