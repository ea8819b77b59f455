//! Verdicts on units, on the determinism of trials, and on states that are kept or sent.

use holdpoint_body::{Command, GuardVerdict, Interrupt, Pose};

use super::{
    CellPromise, Check, Found, SPEED_RAD_S, WITHIN, ask, hello, holds, refused, run_from, seen, told,
};
use crate::client::{CellCallError, Peer};
use crate::framing::decode;
use crate::messages::{Block, Call, CellReply, CellState, Hello, Role};
use crate::refusal::CellRefusal;
use holdpoint_cell::film::{EpisodeFrame, FRAME_EVERY_TICKS};
use holdpoint_text::Untrusted;

/// Sensors of a cell without disturbance are this near to the true state, rad.
const NEAR_RAD: f64 = 0.05;

/// The tool is this near to where the joints put it, m.
const NEAR_M: f64 = 1e-3;

fn observe(peer: &mut Peer) -> Result<CellState, String> {
    seen(peer, Call::Observe { guard: GuardVerdict::Allowed })
}

fn hold(peer: &mut Peer, ticks: usize) -> Found {
    (0..ticks).try_for_each(|_| seen(peer, Call::Step { command: Command::Hold }).map(drop))
}

fn fork(peer: &mut Peer) -> Result<(u64, u64), String> {
    match ask(peer, Call::Fork) {
        Ok(CellReply::Fork { fork, tick }) => Ok((fork, tick)),
        Ok(_) => Err("fork is not answered by a handle".to_owned()),
        Err(error) => Err(format!("fork: {}", told(error))),
    }
}

/// A run with the setpoint that is in force.
fn run_on(peer: &mut Peer) -> Result<Vec<u8>, String> {
    run_from(peer, Command::Hold)
}

fn export(peer: &mut Peer) -> Result<Vec<u8>, String> {
    peer.ask_block(Call::Export, WITHIN).map_err(|error| format!("export: {}", told(error)))
}

fn import(peer: &mut Peer, bytes: &[u8], image: Block) -> Result<CellReply, CellCallError> {
    peer.ask(None, Vec::new(), Call::Import { image }, Some(bytes), WITHIN)
}

impl Check {
    /// A trial cell in motion.
    fn moving(&self, seed: u64) -> Result<Peer, String> {
        let mut peer = self.trial(seed)?;
        observe(&mut peer)?;
        seen(&mut peer, Call::Step { command: self.motion()? })?;
        hold(&mut peer, 5)?;
        Ok(peer)
    }

    pub(super) fn behavior(&mut self) {
        self.verdict(CellPromise::FiniteNumbers, |check| {
            let joints = check.description()?.spec.robot.geometry.joint_count();
            let mut peer = check.moving(1)?;
            observe(&mut peer)?.check(joints).map_err(|field| format!("{field} is not"))
        });
        self.verdict(CellPromise::JointsInLimits, |check| {
            let q = observe(&mut check.moving(1)?)?.telemetry.q;
            let geometry = &check.description()?.spec.robot.geometry;
            holds(geometry.within_limits(&q), || format!("{q:?}"))
        });
        self.verdict(CellPromise::ToolPlace, |check| {
            let telemetry = observe(&mut check.moving(1)?)?.telemetry;
            let due = Pose::from(&check.description()?.spec.robot.geometry.tool_pose(&telemetry.q));
            let off = telemetry.tool.distance_m(&due);
            holds(off < NEAR_M, || format!("it is {off:.4} m off"))
        });
        self.verdict(CellPromise::GripperWidth, |check| {
            let width = observe(&mut check.trial(1)?)?.telemetry.gripper_width_m;
            let most = check.description()?.spec.robot.width_max_m;
            holds((-0.005..=most + 0.005).contains(&width), || format!("{width} m of {most} m"))
        });
        self.verdict(CellPromise::OneMoment, |check| {
            let seen = observe(&mut check.moving(1)?)?;
            let same =
                seen.observation.is_some_and(|o| o.q == seen.telemetry.q && o.tick == seen.telemetry.tick);
            holds(same, || "they differ".to_owned())
        });
        self.verdict(CellPromise::SensorsTrue, |check| {
            let seen = observe(&mut check.moving(1)?)?;
            let truth = seen.truth.ok_or("a trial cell tells no true state")?;
            let off = truth.joints.q.iter().zip(&seen.telemetry.q).map(|(a, b)| (a - b).abs());
            let most = off.fold(0.0, f64::max);
            holds(most < NEAR_RAD, || format!("a joint is {most} rad off"))
        });
        self.verdict(CellPromise::JointSpeed, |check| {
            let mut peer = check.trial(1)?;
            let before = observe(&mut peer)?.telemetry.q;
            seen(&mut peer, Call::Step { command: check.motion()? })?;
            hold(&mut peer, 23)?;
            let after = observe(&mut peer)?.telemetry.q;
            let moved = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let most = SPEED_RAD_S * 0.1 + NEAR_RAD;
            holds(moved > 1e-4 && moved <= most, || format!("{moved} rad in 24 ticks; up to {most} is due"))
        });
        self.verdict(CellPromise::StepIsTick, |check| {
            let mut peer = check.open(Role::Trial)?;
            let begun = check.reset(&mut peer, 1)?.tick;
            let next = seen(&mut peer, Call::Step { command: Command::Hold })?.tick;
            holds((begun, next) == (0, 1), || format!("{begun}, then {next}"))
        });
        self.verdict(CellPromise::OnlyStepsPassTicks, |check| {
            let mut peer = check.moving(1)?;
            let before = observe(&mut peer)?.tick;
            ask(&mut peer, Call::Scenery).map_err(told)?;
            ask(&mut peer, Call::Observed).map_err(told)?;
            seen(&mut peer, Call::EndTask)?;
            let after = observe(&mut peer)?.tick;
            holds(before == after, || format!("{before}, then {after}"))
        });
        self.verdict(CellPromise::ObservationWhenAsked, |check| {
            let mut peer = check.open(Role::Trial)?;
            let start = check.reset(&mut peer, 1)?.observation.is_some();
            let asked = observe(&mut peer)?.observation.is_some();
            let then = seen(&mut peer, Call::Step { command: Command::Hold })?.observation.is_some();
            holds((start, asked, then) == (false, true, true), || format!("{start}, {asked}, {then}"))
        });
        self.verdict(CellPromise::ObservationVerdict, |check| {
            let mut peer = check.trial(1)?;
            observe(&mut peer)?;
            let step = Call::Step { command: Command::Hold };
            let reply = peer.ask(Some(GuardVerdict::Denied), Vec::new(), step, None, WITHIN).map_err(told)?;
            let CellReply::Seen(seen) = reply else {
                return Err("a step is not answered by the state".to_owned());
            };
            let guard = seen.observation.map(|seen| seen.guard);
            holds(guard == Some(GuardVerdict::Denied), || format!("{guard:?}"))
        });
        self.verdict(CellPromise::ObservationDeclared, |check| {
            let mut peer = check.moving(1)?;
            // Long enough for a frame of every camera.
            hold(&mut peer, 24)?;
            let seen = observe(&mut peer)?;
            match seen.undeclared(&check.description()?.spec) {
                None => Ok(()),
                Some(name) => Err(format!("\"{}\" is not in it", Untrusted::new(name).line())),
            }
        });
        self.verdict(CellPromise::SeedRepeats, |check| {
            let mut peer = check.trial(3)?;
            let first = check.run(&mut peer)?;
            check.reset(&mut peer, 3)?;
            holds(check.run(&mut peer)? == first, || "the second run differs".to_owned())
        });
        self.verdict(CellPromise::EarlierEpisodeWithoutEffect, |check| {
            let (mut fresh, mut used) = (check.trial(3)?, check.moving(4)?);
            seen(&mut used, Call::Interrupt { interrupt: Interrupt::Stop })?;
            check.reset(&mut used, 3)?;
            holds(check.run(&mut fresh)? == check.run(&mut used)?, || "it has".to_owned())
        });
        self.verdict(CellPromise::CellsEqual, |check| {
            let (mut one, mut other) = (check.trial(3)?, check.trial(3)?);
            holds(check.run(&mut one)? == check.run(&mut other)?, || "it differs".to_owned())
        });
        self.verdict(CellPromise::SeedsDiffer, |check| {
            let mut peer = check.open(Role::Trial)?;
            let (one, other) = (check.reset(&mut peer, 3)?.object, check.reset(&mut peer, 4)?.object);
            holds(one != other, || "the object is at the same place".to_owned())
        });
        self.verdict(CellPromise::ResetClearsStop, |check| {
            let mut peer = check.moving(3)?;
            let stopped = seen(&mut peer, Call::Interrupt { interrupt: Interrupt::Stop })?.stop_declared;
            let reset = check.reset(&mut peer, 3)?.stop_declared;
            holds(stopped.is_some() && reset.is_none(), || format!("{stopped:?}, then {reset:?}"))
        });
        self.verdict(CellPromise::StoppedArmRests, |check| {
            let mut peer = check.moving(3)?;
            seen(&mut peer, Call::Interrupt { interrupt: Interrupt::Stop })?;
            hold(&mut peer, 48)?;
            let before = observe(&mut peer)?.telemetry.q;
            hold(&mut peer, 24)?;
            let after = observe(&mut peer)?.telemetry.q;
            let moved = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            holds(moved < 0.005, || format!("it moves {moved} rad in 24 ticks, 0.2 s after the stop"))
        });
    }

    /// A cell without the ability has to say so.
    fn unless_able(&self, is_able: bool, call: Call) -> Result<bool, String> {
        if is_able {
            return Ok(true);
        }
        let mut peer = self.trial(1)?;
        refused(ask(&mut peer, call), "the ability", |refusal| matches!(refusal, CellRefusal::Unable(_)))?;
        Ok(false)
    }

    /// A verdict that needs exported states.
    fn state_verdict(&mut self, promise: CellPromise, found: impl FnOnce(&Self) -> Found) {
        self.verdict(promise, |check| {
            let is_able = check.description()?.spec.abilities.export_state;
            if check.unless_able(is_able, Call::Export)? { found(check) } else { Ok(()) }
        });
    }

    pub(super) fn state(&mut self) {
        self.state_verdict(CellPromise::ForkTick, |check| {
            let mut peer = check.moving(5)?;
            let (_, tick) = fork(&mut peer)?;
            let now = observe(&mut peer)?.tick;
            holds(tick == now, || format!("{tick} at {now}"))
        });
        self.state_verdict(CellPromise::ForkContinues, |check| {
            let mut peer = check.moving(5)?;
            let (fork, _) = fork(&mut peer)?;
            let whole = run_on(&mut peer)?;
            seen(&mut peer, Call::GoOnFrom { fork })?;
            let first = run_on(&mut peer)?;
            seen(&mut peer, Call::GoOnFrom { fork })?;
            holds(first == whole && run_on(&mut peer)? == whole, || "it differs".to_owned())
        });
        self.state_verdict(CellPromise::ForkInOtherCell, |check| {
            let (mut peer, welcome) = check.greet(&hello(Role::Trial)).map_err(told)?;
            check.reset(&mut peer, 5)?;
            let (fork, _) = fork(&mut peer)?;
            let joining = Hello { session: Some(welcome.session), ..hello(Role::Trial) };
            let (mut other, _) = check.greet(&joining).map_err(told)?;
            seen(&mut other, Call::GoOnFrom { fork })?;
            holds(run_on(&mut other)? == run_on(&mut peer)?, || "it differs".to_owned())
        });
        self.state_verdict(CellPromise::ForkOfOtherSession, |check| {
            let (mut peer, mut other) = (check.trial(5)?, check.trial(5)?);
            let (fork, _) = fork(&mut peer)?;
            refused(ask(&mut other, Call::GoOnFrom { fork }), "the handle", is_unknown)
        });
        self.state_verdict(CellPromise::ForkReleased, |check| {
            let mut peer = check.trial(5)?;
            let (fork, _) = fork(&mut peer)?;
            let asked = peer.ask(None, vec![fork], Call::GoOnFrom { fork }, None, WITHIN);
            refused(asked, "the handle", is_unknown)
        });
        self.verdict(CellPromise::UnknownForkRefused, |check| {
            refused(ask(&mut check.trial(5)?, Call::GoOnFrom { fork: u64::MAX }), "the handle", is_unknown)
        });
        self.state_verdict(CellPromise::ExportRepeats, |check| {
            let mut peer = check.moving(6)?;
            holds(export(&mut peer)? == export(&mut peer)?, || "they differ".to_owned())
        });
        self.state_verdict(CellPromise::ImportExportedAgain, |check| {
            let bytes = export(&mut check.moving(6)?)?;
            let mut other = check.trial(7)?;
            import(&mut other, &bytes, Block::of(&bytes)).map_err(told)?;
            holds(export(&mut other)? == bytes, || "it differs".to_owned())
        });
        self.state_verdict(CellPromise::ImportContinues, |check| {
            let mut peer = check.moving(6)?;
            let bytes = export(&mut peer)?;
            let mut other = check.trial(7)?;
            import(&mut other, &bytes, Block::of(&bytes)).map_err(told)?;
            holds(run_on(&mut other)? == run_on(&mut peer)?, || "it differs".to_owned())
        });
        self.state_verdict(CellPromise::NoStateRefused, |check| {
            let mut peer = check.moving(6)?;
            let before = export(&mut peer)?;
            let asked = import(&mut peer, &[0xFF; 7], Block::of(&[0xFF; 7]));
            refused(asked, "the state", |refusal| matches!(refusal, CellRefusal::Snapshot(_)))?;
            holds(export(&mut peer)? == before, || "the state before is lost".to_owned())
        });
        self.state_verdict(CellPromise::OtherDigestRefused, |check| {
            let mut peer = check.moving(6)?;
            let bytes = export(&mut peer)?;
            let asked = import(&mut peer, &bytes, Block { sha256: "0".repeat(64), ..Block::of(&bytes) });
            refused(asked, "the digest", |refusal| matches!(refusal, CellRefusal::Malformed(_)))
        });
        self.verdict(CellPromise::FramesKept, |check| {
            let mut peer = check.open(Role::Trial)?;
            seen(&mut peer, Call::Film)?;
            check.reset(&mut peer, 1)?;
            hold(&mut peer, 4 * usize::try_from(FRAME_EVERY_TICKS).unwrap_or(8))?;
            let bytes = peer.ask_block(Call::TakeFilm, WITHIN).map_err(told)?;
            let frames: Vec<EpisodeFrame> = decode(&bytes).map_err(|error| error.to_string())?;
            let is_able = check.description()?.spec.abilities.film;
            let in_order = frames.windows(2).all(|pair| matches!(pair, [a, b] if a.tick < b.tick));
            holds(frames.is_empty() != is_able && in_order, || format!("{} frames", frames.len()))
        });
    }
}

fn is_unknown(refusal: &CellRefusal) -> bool {
    matches!(refusal, CellRefusal::UnknownFork(_))
}
