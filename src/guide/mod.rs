//! # The guide
//!
#![doc = include_str!("index.md")]

#[doc = include_str!("operating.md")]
pub mod operating {}

#[doc = include_str!("scenarios.md")]
pub mod scenarios {}

#[doc = include_str!("recordings.md")]
pub mod recordings {}

#[doc = include_str!("candidate.md")]
pub mod candidate {}

#[doc = include_str!("controller.md")]
pub mod controller {}

#[doc = include_str!("robot.md")]
pub mod robot {}

#[doc = include_str!("events.md")]
pub mod events {}

#[doc = include_str!("statistics.md")]
pub mod statistics {}

#[doc = include_str!("performance.md")]
pub mod performance {}

#[doc = include_str!("glossary.md")]
pub mod glossary {}

#[doc = include_str!("changes.md")]
pub mod changes {}

#[doc = include_str!("third-party.md")]
pub mod third_party {}
