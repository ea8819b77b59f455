//! Why a person gets no approval request to sign, or why their signed answer is void.
//!
//! Typed values of the engine that never travel: the crate `holdpoint-wording` makes the text of a refusal from them.

use holdpoint_governance::ids::CapabilityId;

use crate::request_kind::RequestKind;

/// Why the engine refuses an approval request or a signed answer to one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum QuestionRefusal {
    /// No request of this kind is open for the version.
    NothingPending {
        /// The kind of request.
        purpose: RequestKind,
        /// The version.
        version: CapabilityId,
    },
    /// The engine remembers no further request.
    TooManyRequests {
        /// How many it remembers.
        max: usize,
    },
    /// The answer is void.
    AnswerVoid {
        /// The version.
        version: CapabilityId,
        /// Why.
        cause: AnswerVoidCause,
    },
}

/// Why a signed answer is void.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnswerVoidCause {
    /// The person signed an approval without the text of the request.
    NotDisplayed,
    /// The answered request is not open.
    RequestClosed,
    /// The answer would be valid for longer than the profile permits.
    ValidTooLong,
    /// Another version of the renderer made the lines.
    OtherRenderer,
    /// The answer is for a store with another key.
    OtherStoreKey,
    /// The signed facts are not the present ones.
    OtherFacts,
    /// The signed lines are not the present ones.
    OtherLines,
}
