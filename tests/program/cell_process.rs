//! The simulated cell as a process of its own: it keeps the protocol, a site file names it, and it tells the same bits.

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Instant;

use holdpoint_body::{Command as ArmCommand, GuardVerdict, Interrupt, JointVec, TaskKind};
use holdpoint_cell::{CellFactory, CellSource as _, EpisodeSetup, TrialCell};
use holdpoint_cellwire::client::{ClientOptions, Connect};
use holdpoint_cellwire::endpoint::EndpointStream;
use holdpoint_cellwire::framing::{WireStream, encode};
use holdpoint_cellwire::messages::Truth;
use holdpoint_cellwire::{CellServer, ServerOptions, WireFactory};
use holdpoint_sim::SimCells;
use holdpoint_wording::program::cell::listens;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/site.toml");

fn holdpoint(arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_holdpoint"));
    program.args(["--data", "/nowhere"]).args(arguments).output().unwrap()
}

/// A served cell; it ends with the test.
pub(crate) struct CellProcess {
    process: Child,
    pub(crate) endpoint: String,
    /// What it tells, a line each, and when.
    pub(crate) notes: Receiver<(Instant, String)>,
}

impl CellProcess {
    pub(crate) fn in_folder(folder: &Path) -> Self {
        let endpoint = format!("unix:{}", folder.join("cell.sock").display());
        let mut process = Command::new(env!("CARGO_BIN_EXE_holdpoint"))
            .args(["--data", "/nowhere", "cell", "serve", "--listen", &endpoint])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let told = BufReader::new(process.stderr.take().unwrap());
        let (sender, notes) = channel();
        thread::spawn(move || {
            for line in told.lines().map_while(Result::ok) {
                let _ = sender.send((Instant::now(), line));
            }
        });
        let mut first = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut first).unwrap();
        assert_eq!(first.trim_end(), listens("arm7", &endpoint));
        Self { process, endpoint, notes }
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.process), signal).unwrap();
    }

    /// The processor time of the process so far, s.
    pub(crate) fn cpu_secs(&self) -> f64 {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.process.id())).unwrap();
        // After the name in parentheses: the state, ten numbers, then the ticks as user and as system.
        let (_, numbers) = stat.rsplit_once(") ").unwrap();
        let ticks = numbers.split(' ').skip(11).take(2).map(|ticks| ticks.parse::<f64>().unwrap());
        // Linux tells programs a hundred ticks a second.
        ticks.sum::<f64>() / 100.0
    }
}

impl Drop for CellProcess {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// The shipped site with its cells at an endpoint.
pub(crate) fn site_at(folder: &Path, endpoint: &str) -> String {
    let text = fs::read_to_string(SHIPPED).unwrap();
    let cell = format!("kind = \"wire\"\nendpoint = \"{endpoint}\"");
    let file = folder.join("site.toml");
    fs::write(&file, text.replace("kind = \"simulated\"", &cell)).unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn served_cell_keeps_every_promise() {
    let root = tempfile::tempdir().unwrap();
    let served = CellProcess::in_folder(root.path());
    let checked = holdpoint(&["cell", "check", &served.endpoint, "--json"]);
    let document: Value = serde_json::from_slice(&checked.stdout).unwrap();
    let promises = document["promises"].as_array().unwrap();
    let broken: Vec<&Value> = promises.iter().filter(|promise| promise.get("problem").is_some()).collect();
    assert!(promises.len() >= 40 && broken.is_empty(), "{broken:#?}");
    assert!(checked.status.success() && document["exchange"]["ticks"] == 1000, "{document}");
}

#[test]
fn site_file_names_a_served_cell() {
    let root = tempfile::tempdir().unwrap();
    let served = CellProcess::in_folder(root.path());
    let site = site_at(root.path(), &served.endpoint);
    let checked = holdpoint(&["site", "check", &site, "--json"]);
    let document: Value = serde_json::from_slice(&checked.stdout).unwrap();
    assert!(checked.status.success() && document["robot"] == "arm7", "{document}");
    assert_eq!(document["live"]["kind"], "wire");
    assert_eq!(document["live"]["endpoint"], served.endpoint.as_str());
    drop(served);
    let gone = holdpoint(&["site", "check", &site, "--json"]);
    let error: Value = serde_json::from_slice(&gone.stderr).unwrap();
    assert!(gone.status.code() == Some(2), "{error}");
    assert!(error.to_string().contains("holdpoint cell serve"), "{error}");
}

/// Everything that a run tells, and the state at its end.
fn run(cell: &mut dyn TrialCell, setup: &EpisodeSetup, home: &JointVec) -> Vec<Vec<u8>> {
    cell.reset(setup).unwrap();
    let mut all = Vec::new();
    let verdicts = [GuardVerdict::Allowed, GuardVerdict::Clamped, GuardVerdict::Denied];
    for (tick, verdict) in verdicts.into_iter().cycle().take(120).enumerate() {
        let observation = cell.observe(verdict);
        let truth = Truth::from(cell.true_state());
        let told = (observation, cell.telemetry(), truth, cell.inspect(), cell.stop_declared());
        all.push(encode(&told).unwrap());
        match tick {
            30 => cell.begin_task(TaskKind::Align),
            60 => cell.interrupt(Interrupt::Stop),
            80 => cell.interrupt(Interrupt::Release),
            _ => {}
        }
        let moved: JointVec = home.iter().map(|q| q + if tick < 60 { 0.2 } else { -0.1 }).collect();
        let command = match tick % 20 {
            0 => ArmCommand::Joints { q: moved, max_speed_rad_s: 0.8 },
            10 => ArmCommand::Gripper { width_m: 0.03, speed_m_s: 0.1, force_n: 20.0 },
            _ => ArmCommand::Hold,
        };
        cell.step(&command).unwrap();
    }
    all.push(cell.export().unwrap().bytes().to_vec());
    all
}

#[test]
fn simulated_cell_over_the_wire_tells_the_same_bits() {
    let near = SimCells.builtin(None).unwrap();
    let server = Arc::new(CellServer::new(Arc::clone(&near), ServerOptions::default()).unwrap());
    let connect: Connect = Box::new(move || -> std::io::Result<Box<dyn WireStream>> {
        let (own, other) = std::os::unix::net::UnixStream::pair()?;
        let server = Arc::clone(&server);
        thread::spawn(move || server.attend(EndpointStream::Unix(other)));
        Ok(Box::new(EndpointStream::Unix(own)))
    });
    let far = WireFactory::over("test".to_owned(), connect, ClientOptions::lockstep()).unwrap();
    assert_eq!(far.spec().digest(), near.spec().digest());
    assert_eq!(far.build_digest(), near.build_digest());
    let [_, sandbox, live] = near.distributions().unwrap();
    let (mut one, mut other) = (near.trial().unwrap(), far.trial().unwrap());
    for (distribution, seed) in [(&sandbox, 1), (&live, 2), (&live, 3)] {
        let setup = EpisodeSetup::sample(TaskKind::Grasp, &near.spec().scene, distribution, seed);
        let home = &near.spec().robot.home;
        let (here, there) = (run(one.as_mut(), &setup, home), run(other.as_mut(), &setup, home));
        let differs = here.iter().zip(&there).position(|(here, there)| here != there);
        assert_eq!((differs, here.len()), (None, there.len()), "seed {seed}");
    }
}
