//! The settings of an engine that a front end starts.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::control_socket::AccountRoles;
use holdpoint_cell::CellSource;
use holdpoint_governance::site_profile::ChosenProfile;
use holdpoint_protocol::sink::MakeSink;
use holdpoint_trials::seeds::EpisodeSeeds;
use holdpoint_trials::site::LoadedSite;

/// The settings of a host.
pub struct LaunchConfig {
    pub data: PathBuf,
    pub profile: ChosenProfile,
    pub seeds: EpisodeSeeds,
    /// Workers for evaluation; 0 for one fewer than there are cores.
    pub jobs: usize,
    /// Where its cell comes from.
    pub cells: Arc<dyn CellSource>,
    /// The robot's URDF file; absent for the site's.
    pub robot: Option<PathBuf>,
    /// The site file; absent for the built-in site.
    pub site: Option<Arc<LoadedSite>>,
    /// Simulated seconds of the live cell per second; absent for unlimited.
    pub pace: Option<f64>,
    /// Further listeners: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
    /// How long it runs without an attached console before it ends cleanly; absent for unlimited.
    pub alone_max: Option<Duration>,
    /// Where it listens as well, for consoles of other accounts; absent for nowhere.
    pub console_access: Option<ConsoleAccess>,
}

/// The access of other accounts.
#[derive(Clone, Debug)]
pub struct ConsoleAccess {
    /// The folder of their socket; its group may connect.
    pub folder: PathBuf,
    /// What each of them may do.
    pub roles: AccountRoles,
}

impl LaunchConfig {
    /// The requested number of workers, else one fewer than there are cores, so that the front end stays responsive.
    #[must_use]
    pub fn workers(&self) -> usize {
        let spare = || std::thread::available_parallelism().map_or(1, usize::from).saturating_sub(1);
        if self.jobs == 0 { spare().max(1) } else { self.jobs }
    }
}
