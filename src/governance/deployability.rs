//! The paper's four deployment outcomes (section 4.5).

crate::closed_set! {
    /// Deployment outcomes (paper section 4.5).
    Deployability, "deployment outcome", {
        /// May proceed to gated activation.
        Fully = "fully-compatible",
        /// Admissible under bounded conditions: simulation only, stricter thresholds, shadow first, approval.
        Conditionally = "conditionally-compatible",
        /// Not for activation; the results of sandbox and shadow stay available.
        EvaluationOnly = "evaluation-only",
        /// Rejected, or to be revised.
        Incompatible = "incompatible",
    }
}
