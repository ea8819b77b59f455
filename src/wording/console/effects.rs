//! What the console says about jobs outside the engine: copies, exports, identities, viewers.

use std::fmt::Display;
use std::net::SocketAddr;

use holdpoint_governance::ids::CapabilityId;

use crate::counted;

pub const WAIT_FOR_ANSWERS: &str = "wait for its answers, then ask again";
pub const ENGINE_BUSY: &str = "the engine is busy";
pub const NO_LIVE_SCENE: &str = "no live scene is drawn here: this run keeps no recordings";
pub const NO_FOLDER: &str = "there is no folder to write to";
pub const NOTHING_SHOWN: &str = "nothing was shown that could be approved";
pub const WRONG_PASSPHRASE: &str = "wrong passphrase, nothing was signed";
pub const STARTING_VIEWER: &str = "starting the scene viewer";

#[must_use]
pub fn old_ones_stay(why: &str) -> String {
    format!("not loaded, the old ones stay: {why}")
}

#[must_use]
pub fn no_thread(name: &str, error: impl Display) -> String {
    format!("cannot start a thread for {name}: {error}")
}

#[must_use]
pub fn copied_first(copied: usize, all: usize) -> String {
    format!("copied the first {copied} of {all} bytes (OSC 52)")
}

#[must_use]
pub fn copied(bytes: usize) -> String {
    format!("copied {} (OSC 52)", counted(bytes, "byte"))
}

#[must_use]
pub fn exported(stem: impl Display, more: &str) -> String {
    format!("exported {stem}.txt and .json{more}")
}

#[must_use]
pub fn cannot_write(folder: impl Display, error: impl Display) -> String {
    format!("cannot write to \"{folder}\": {error}")
}

#[must_use]
pub fn too_many_exports(exports: u32) -> String {
    format!("{exports} exports of this view are there already")
}

#[must_use]
pub fn cannot_write_beside(error: &std::io::Error) -> String {
    format!("cannot write beside the text: {error}")
}

#[must_use]
pub fn makes_an_identity(name: &str) -> String {
    format!("`holdpoint identity new {name}` makes one; under the sim profile `:as {name}` does, too")
}

#[must_use]
pub fn passphrase_changed(name: &str) -> String {
    format!("the passphrase of {name} was set or removed meanwhile")
}

#[must_use]
pub fn use_it_again(name: &str) -> String {
    format!("`:as {name}`, then again")
}

#[must_use]
pub fn no_recording(version: &CapabilityId, folder: &str) -> String {
    format!("there is no recording of {version} in {folder}")
}

#[must_use]
pub fn no_viewer_thread(error: impl Display) -> String {
    format!("cannot start a thread for the scene viewer: {error}")
}

#[must_use]
pub fn overview_draws(why: impl Display) -> String {
    format!("{why}; the Overview draws the arm")
}

#[must_use]
pub fn live_scene(address: SocketAddr) -> String {
    format!("the live scene at {address}")
}

#[must_use]
pub fn viewer_ended(log: &str) -> String {
    format!("the scene viewer ended at once; {log} says why")
}

#[must_use]
pub fn viewer_shows(version: &str, what: &str) -> String {
    format!("the scene viewer {version} shows {what}")
}

#[must_use]
pub fn not_served(address: SocketAddr, error: impl Display) -> String {
    format!("the live scene is not served at {address}: {error}")
}

#[must_use]
pub fn cannot_read(folder: &str, error: impl Display) -> String {
    format!("cannot read {folder}: {error}")
}
