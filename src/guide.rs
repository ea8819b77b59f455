//! # The guide
//!
#![doc = include_str!("guide/index.md")]

#[doc = include_str!("guide/operating.md")]
pub mod operating {}

#[doc = include_str!("guide/governance.md")]
pub mod governance {}

#[doc = include_str!("guide/lifecycle.md")]
pub mod lifecycle {}

#[doc = include_str!("guide/scenarios.md")]
pub mod scenarios {}

#[doc = include_str!("guide/recordings.md")]
pub mod recordings {}

#[doc = include_str!("guide/candidate.md")]
pub mod candidate {}

#[doc = include_str!("guide/component.md")]
pub mod component {}

#[doc = include_str!("guide/controller.md")]
pub mod controller {}

#[doc = include_str!("guide/robot.md")]
pub mod robot {}

#[doc = include_str!("guide/events.md")]
pub mod events {}

#[doc = include_str!("guide/statistics.md")]
pub mod statistics {}

#[doc = include_str!("guide/evaluation.md")]
pub mod evaluation {}

#[doc = include_str!("guide/audit.md")]
pub mod audit {}

#[doc = include_str!("guide/kept.md")]
pub mod kept {}
#[doc = include_str!("guide/limits.md")]
pub mod limits {}

#[doc = include_str!("guide/security.md")]
pub mod security {}

#[doc = include_str!("guide/attacks.md")]
pub mod attacks {}

#[doc = include_str!("guide/records.md")]
pub mod records {}

#[doc = include_str!("guide/metrics.md")]
pub mod metrics {}

#[doc = include_str!("guide/health.md")]
pub mod health {}

#[doc = include_str!("guide/habits.md")]
pub mod habits {}

#[doc = include_str!("guide/performance.md")]
pub mod performance {}

#[doc = include_str!("guide/glossary.md")]
pub mod glossary {}

#[doc = include_str!("guide/changes.md")]
pub mod changes {}

#[doc = include_str!("guide/third-party.md")]
pub mod third_party {}
