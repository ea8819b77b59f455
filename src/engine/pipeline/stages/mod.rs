//! One file per stage; each adds its part to [`super::manager::UpgradeManager`].

pub mod activation;
pub mod asking;
pub mod confirmation;
pub mod monitoring;
pub mod operations;
pub mod questions;
pub mod restart;
pub mod resume;
pub mod rollback;
pub mod sandbox;
pub mod shadowing;
pub mod validation;
