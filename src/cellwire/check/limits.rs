//! Verdicts on commands that are refused, on order, sizes and deadlines, and on the watchdog.

use std::thread;
use std::time::Duration;

use holdpoint_body::{BodyError, Command, GuardVerdict, Interrupt, JointVec};
use holdpoint_cell::InjectedFault;
use serde::Serialize;

use super::{CellPromise, Check, Found, WITHIN, ask, closes, hello, holds, refused, seen, told};
use crate::client::Peer;
use crate::messages::{
    Answer, BLOCK_BYTES_MAX, Block, Call, CellReply, CellRequest, Hello, MESSAGE_BYTES_MAX, RELEASED_MAX,
    Role,
};
use crate::refusal::CellRefusal;

/// The watchdog of a check, ms, and a silence that is longer.
const WATCHDOG: u32 = 250;
const SILENCE: Duration = Duration::from_millis(700);

/// Within this time a server gives a silent connection up.
const GIVEN_UP_WITHIN: Duration = Duration::from_secs(6);

/// A request of a call that no version has.
#[derive(Serialize)]
struct UnknownRequest {
    sequence: u64,
    call: &'static str,
}

/// The answer to bytes that are no request in order.
fn answered(peer: &mut Peer, due: &str, is_due: impl FnOnce(&CellRefusal) -> bool) -> Found {
    let answer: Answer = peer.line().receive(WITHIN).map_err(|error| error.to_string())?;
    match answer.reply {
        CellReply::Refused(refusal) if is_due(&refusal) => closes(peer, WITHIN),
        CellReply::Refused(refusal) => {
            Err(format!("it refuses for another reason than {due}: {}", refusal.into_body_error()))
        }
        _ => Err(format!("{due} is due, and it is taken")),
    }
}

fn is_malformed(refusal: &CellRefusal) -> bool {
    matches!(refusal, CellRefusal::Malformed(_))
}

fn is_command(refusal: &CellRefusal) -> bool {
    matches!(refusal, CellRefusal::Body(BodyError::Command(_)))
}

impl Check {
    /// Whether a command is refused, and passes no tick.
    fn refuses(&self, command: Command) -> Found {
        let mut peer = self.trial(1)?;
        refused(ask(&mut peer, Call::Step { command }), "the command", is_command)?;
        let next = seen(&mut peer, Call::Step { command: Command::Hold })?.tick;
        holds(next == 1, || format!("the tick after it is {next}"))
    }

    fn sequence(&self, sequences: [u64; 2]) -> Found {
        let mut peer = self.open(Role::Trial)?;
        let of = |sequence| CellRequest { sequence, guard: None, release: Vec::new(), call: Call::Scenery };
        let line = peer.line();
        let [first, second] = sequences;
        line.send(&of(first)).map_err(|error| error.to_string())?;
        let answer: Answer = line.receive(WITHIN).map_err(|error| error.to_string())?;
        holds(answer.sequence == first, || format!("{first} is answered as {}", answer.sequence))?;
        line.send(&of(second)).map_err(|error| error.to_string())?;
        answered(&mut peer, "the sequence", |refusal| matches!(refusal, CellRefusal::Sequence { .. }))
    }

    fn bytes(&self, bytes: &[u8]) -> Found {
        let mut peer = self.open(Role::Trial)?;
        peer.line().send_bytes(bytes).map_err(|error| error.to_string())?;
        answered(&mut peer, "the message", is_malformed)
    }

    pub(super) fn commands(&mut self) {
        let joints = |check: &Self, change: fn(&mut JointVec)| {
            let mut q = check.description()?.spec.robot.home.clone();
            change(&mut q);
            Ok::<Command, String>(Command::Joints { q, max_speed_rad_s: 0.5 })
        };
        self.verdict(CellPromise::JointNoNumberRefused, |check| {
            check.refuses(joints(check, |q| q.iter_mut().for_each(|value| *value = f64::NAN))?)
        });
        self.verdict(CellPromise::JointInfiniteRefused, |check| {
            check.refuses(joints(check, |q| q.iter_mut().for_each(|value| *value = f64::INFINITY))?)
        });
        self.verdict(CellPromise::JointMissingRefused, |check| {
            check.refuses(joints(check, |q| {
                q.pop();
            })?)
        });
        self.verdict(CellPromise::SpeedZeroRefused, |check| {
            let q = check.description()?.spec.robot.home.clone();
            check.refuses(Command::Joints { q, max_speed_rad_s: 0.0 })
        });
        self.verdict(CellPromise::ForceNoNumberRefused, |check| {
            check.refuses(Command::Gripper { width_m: 0.04, speed_m_s: 0.1, force_n: f64::NAN })
        });
        self.verdict(CellPromise::UnknownJointRefused, |check| {
            let call = Call::Inject { fault: InjectedFault::JointStuck { joint: 99 } };
            refused(ask(&mut check.trial(1)?, call), "the joint", is_command)
        });
    }

    pub(super) fn limits(&mut self) {
        self.verdict(CellPromise::MissingRequestEnds, |check| check.sequence([1, 3]));
        self.verdict(CellPromise::RepeatedRequestEnds, |check| check.sequence([1, 1]));
        self.verdict(CellPromise::EmptyMessageRefused, |check| check.bytes(&[0; 4]));
        self.verdict(CellPromise::LongMessageRefused, |check| {
            let length = u32::try_from(MESSAGE_BYTES_MAX + 1).unwrap_or(u32::MAX);
            check.bytes(&length.to_be_bytes())
        });
        self.verdict(CellPromise::NoMessageRefused, |check| check.bytes(&[0, 0, 0, 2, 0xC1, 0xC1]));
        self.verdict(CellPromise::UnknownCallRefused, |check| {
            let mut peer = check.open(Role::Trial)?;
            let unknown = UnknownRequest { sequence: 1, call: "open_door" };
            peer.line().send(&unknown).map_err(|error| error.to_string())?;
            answered(&mut peer, "the call", is_malformed)
        });
        self.verdict(CellPromise::LongBlockRefused, |check| {
            let mut peer = check.trial(1)?;
            let image = Block { bytes: BLOCK_BYTES_MAX as u64 + 1, sha256: "0".repeat(64) };
            refused(ask(&mut peer, Call::Import { image }), "the size", is_malformed)
        });
        self.verdict(CellPromise::LongReleasesRefused, |check| {
            let mut peer = check.open(Role::Trial)?;
            let asked = peer.ask(None, vec![0; RELEASED_MAX + 1], Call::Scenery, None, WITHIN);
            refused(asked, "the length", is_malformed)
        });
        self.verdict(CellPromise::SilentConnectionClosed, |check| {
            let stream = (check.connect)().map_err(|error| error.to_string())?;
            let mut line = crate::framing::Line::new(stream).map_err(|error| error.to_string())?;
            match line.receive_bytes(GIVEN_UP_WITHIN) {
                Err(crate::framing::WireError::Closed) => Ok(()),
                other => Err(format!("it is not: {other:?}")),
            }
        });
        self.verdict(CellPromise::EndlessMessageGivenUp, |check| {
            let mut peer = check.open(Role::Trial)?;
            peer.line().send_bytes(&[0, 0, 0, 9, 1]).map_err(|error| error.to_string())?;
            answered(&mut peer, "the message", is_malformed)
        });
    }

    /// A live cell in motion, with a watchdog or without.
    fn live_in_motion(&self, watchdog_ms: Option<u32>) -> Result<Peer, String> {
        let asked = Hello { watchdog_ms, ..hello(Role::Live) };
        let (mut peer, welcome) = self.greet(&asked).map_err(told)?;
        holds(welcome.watchdog_ms == watchdog_ms, || "it sets another watchdog".to_owned())?;
        let [_, _, live] = &self.description()?.distributions;
        seen(&mut peer, Call::AwaitWork { conditions: Box::new(live.clone()), seed: 1 })?;
        seen(&mut peer, Call::Observe { guard: GuardVerdict::Allowed })?;
        // More than the latency of a live cell, and less than the motion takes.
        seen(&mut peer, Call::Step { command: self.motion()? })?;
        for _ in 0..40 {
            seen(&mut peer, Call::Step { command: Command::Hold })?;
        }
        Ok(peer)
    }

    pub(super) fn live(&mut self) {
        self.verdict(CellPromise::LiveOneClient, |check| {
            let _first = check.open(Role::Live)?;
            let second = Peer::greet(&check.connect, &hello(Role::Live));
            refused(second, "that it is taken", |refusal| matches!(refusal, CellRefusal::Taken))
        });
        self.verdict(CellPromise::LiveNoTrialCall, |check| {
            let mut peer = check.open(Role::Live)?;
            let reset = Call::Reset { setup: check.setup(1)? };
            refused(ask(&mut peer, reset), "the role", |refusal| matches!(refusal, CellRefusal::Role { .. }))
        });
        self.verdict(CellPromise::LiveWatchdogStops, |check| {
            let mut peer = check.live_in_motion(Some(WATCHDOG))?;
            thread::sleep(SILENCE);
            let step = ask(&mut peer, Call::Step { command: Command::Hold });
            refused(step, "the stop", |refusal| {
                matches!(refusal, CellRefusal::Stopped(stop)
                    if stop.silent_ms >= WATCHDOG && stop.standstill_ticks.is_some())
            })
        });
        self.verdict(CellPromise::LiveReleaseMoves, |check| {
            let mut peer = check.live_in_motion(Some(WATCHDOG))?;
            thread::sleep(SILENCE);
            for _ in 0..2 {
                let step = ask(&mut peer, Call::Step { command: Command::Hold });
                refused(step, "the stop", |refusal| matches!(refusal, CellRefusal::Stopped(_)))?;
            }
            seen(&mut peer, Call::Interrupt { interrupt: Interrupt::Release })?;
            seen(&mut peer, Call::Step { command: Command::Hold }).map(drop)
        });
        self.verdict(CellPromise::LiveLockstepTimeless, |check| {
            let mut peer = check.live_in_motion(None)?;
            thread::sleep(SILENCE);
            seen(&mut peer, Call::Step { command: Command::Hold }).map(drop)
        });
        self.verdict(CellPromise::LiveTaskOverIdle, |check| {
            let mut peer = check.live_in_motion(Some(WATCHDOG))?;
            seen(&mut peer, Call::EndTask)?;
            thread::sleep(SILENCE);
            seen(&mut peer, Call::Step { command: Command::Hold }).map(drop)
        });
        self.verdict(CellPromise::LiveStopNamed, |check| {
            let mut peer = check.live_in_motion(None)?;
            let stopped = seen(&mut peer, Call::Interrupt { interrupt: Interrupt::Stop })?;
            let is_told = stopped.stop_declared.is_some();
            holds(is_told, || "stop_declared is absent".to_owned())
        });
    }
}
