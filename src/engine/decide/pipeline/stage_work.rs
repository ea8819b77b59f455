//! The stage that runs, or rests while its version is paused.

use holdpoint_governance::evaluation_key::KeyUse;
use holdpoint_governance::ids::CapabilityId;

use crate::decide::stages::confirmation::ConfirmationRun;
use crate::decide::stages::re_evaluation::ReEvaluationRun;
use crate::decide::stages::sandbox::SandboxRun;
use crate::decide::stages::shadow::ShadowRun;

pub(super) enum StageWork {
    Sandbox(Box<SandboxRun>),
    Shadow(Box<ShadowRun>),
    Confirmation(Box<ConfirmationRun>),
    ReEvaluation(Box<ReEvaluationRun>),
}

impl StageWork {
    pub(super) fn id(&self) -> &CapabilityId {
        match self {
            Self::Sandbox(run) => &run.id,
            Self::Shadow(run) => &run.id,
            Self::Confirmation(run) => &run.id,
            Self::ReEvaluation(run) => &run.id,
        }
    }

    /// What the key of its seeds is for; absent for shadow, which has the live world's.
    pub(super) const fn key_use(&self) -> Option<KeyUse> {
        match self {
            Self::Sandbox(_) => Some(KeyUse::Sandbox),
            Self::Shadow(_) => None,
            Self::Confirmation(_) => Some(KeyUse::Confirmation),
            Self::ReEvaluation(_) => Some(KeyUse::ReEvaluation),
        }
    }
}
