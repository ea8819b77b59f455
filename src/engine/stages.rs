//! The seven stages, one file each: functions over the parts they need, which return how they ended.

pub mod activation;
pub(crate) mod closing;
pub mod confirmation;
pub(crate) mod ladder;
pub mod monitoring;
pub mod resume;
pub mod rollback;
pub mod sandbox;
pub mod shadow;
pub mod validation;
