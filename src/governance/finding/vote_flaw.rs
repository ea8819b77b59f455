//! Why an answer or an approval does not count, and the code of each reason. Owns no rule: approvals apply it.

use crate::decision::ReasonCode;

crate::closed_set! {
    /// Why an answer or an approval does not count.
    VoteFlaw, "flaw of an answer", {
        /// The signature is not theirs.
        Signature = "signature",
        /// It was used before.
        Replayed = "replayed",
        /// It is over something else than what is asked.
        Stale = "stale",
        /// It has expired.
        Expired = "expired",
        /// They registered the version.
        Requester = "requester",
        /// They wrote the version.
        Author = "author",
        /// They asked for it themselves.
        AskedBy = "asked-by",
        /// Their role does not reach the risk class.
        Role = "role",
    }
}

impl VoteFlaw {
    /// The code of the reason.
    #[must_use]
    pub const fn code(self) -> ReasonCode {
        match self {
            Self::Signature => ReasonCode::ApprovalSignature,
            Self::Replayed => ReasonCode::ApprovalReplayed,
            Self::Stale => ReasonCode::ApprovalStale,
            Self::Expired => ReasonCode::ApprovalExpired,
            Self::Requester | Self::Author | Self::AskedBy => ReasonCode::ApprovalSelf,
            Self::Role => ReasonCode::ApprovalRole,
        }
    }
}
