//! One connection of a server: hello, then one answer for each request, in order.

use std::time::Duration;

use holdpoint_body::{BodyError, GuardVerdict, Interrupt};
use holdpoint_cell::{CellError, InjectedFault, LiveCell, RobotCell, StateImage, TrialCell, WorkCall};
use serde::Deserialize;

use super::watchdog::Watchdog;
use super::{CellServer, ConnectionSlot};
use crate::framing::{FRAME_WITHIN, Line, WireError, WireStream, decode, encode};
use crate::messages::{
    Answer, Block, CLIENT_BYTES_MAX, Call, CellReply, CellRequest, CellState, Greeting, Hello, PROTOCOL,
    RELEASED_MAX, Role, Truth, WATCHDOG_MS, Welcome,
};
use crate::refusal::{CellRefusal, WatchdogStop};

/// Within this time a connection has to say hello.
const HELLO_WITHIN: Duration = Duration::from_secs(2);

/// What every hello has, of any version.
#[derive(Deserialize)]
struct AnyHello {
    protocol: u32,
}

/// The cell of a connection.
enum ConnectionCell {
    Nothing,
    Live(Box<dyn LiveCell>),
    Trial(Box<dyn TrialCell>),
}

impl ConnectionCell {
    fn of(server: &CellServer, role: Role) -> Result<Self, CellError> {
        match role {
            Role::Control => Ok(Self::Nothing),
            Role::Live => server.factory.live().map(Self::Live),
            Role::Trial => server.factory.trial().map(Self::Trial),
        }
    }

    fn robot(&mut self) -> Option<&mut dyn RobotCell> {
        match self {
            Self::Nothing => None,
            Self::Live(cell) => Some(cell.as_mut()),
            Self::Trial(cell) => Some(cell.as_mut()),
        }
    }

    fn truth(&self) -> Option<Truth> {
        match self {
            Self::Nothing => None,
            Self::Live(cell) => cell.truth().map(Truth::from),
            Self::Trial(cell) => Some(Truth::from(cell.true_state())),
        }
    }
}

struct Connection<'a, S> {
    server: &'a CellServer,
    line: Line<S>,
    cell: ConnectionCell,
    watchdog: Watchdog,
    /// A stop of the watchdog that stands.
    stopped: Option<WatchdogStop>,
    /// The last reported state of the guard; absent since a start.
    guard: Option<GuardVerdict>,
    /// The number of the next request.
    due: u64,
    /// Given back last.
    place: ConnectionSlot<'a>,
}

/// Works for a connection until it ends.
pub(super) fn attend<S: WireStream>(server: &CellServer, stream: S) -> Result<(), WireError> {
    let mut line = Line::new(stream)?;
    let hello = line.receive_bytes(HELLO_WITHIN)?;
    let opened = read_hello(&hello).and_then(|hello| {
        let place = server.admit(hello.role, hello.session)?;
        let cell = ConnectionCell::of(server, hello.role).map_err(CellRefusal::of_cell)?;
        Ok((hello, place, cell))
    });
    let (hello, place, cell) = match opened {
        Ok(opened) => opened,
        Err(refusal) => {
            line.send(&Greeting::Refused(refusal))?;
            return Ok(());
        }
    };
    line.send(&Greeting::Welcome(Welcome {
        protocol: PROTOCOL,
        session: place.session,
        description: server.digest.clone(),
        build: server.factory.build_digest().to_owned(),
        rate_hz: server.factory.spec().rate_hz,
        watchdog_ms: hello.watchdog_ms,
        bounds: CellServer::bounds(),
    }))?;
    let watchdog = Watchdog::new(hello.watchdog_ms);
    let mut connection =
        Connection { server, line, cell, watchdog, stopped: None, guard: None, due: 1, place };
    let ended = connection.run();
    connection.stop_arm(Duration::ZERO);
    ended
}

fn read_hello(bytes: &[u8]) -> Result<Hello, CellRefusal> {
    let malformed = |error: WireError| CellRefusal::Malformed(error.to_string());
    let refuse = |field: &str, allowed: String| Err(CellRefusal::Hello { field: field.to_owned(), allowed });
    let any: AnyHello = decode(bytes).map_err(malformed)?;
    if any.protocol != PROTOCOL {
        return Err(CellRefusal::Version { server: PROTOCOL });
    }
    let hello: Hello = decode(bytes).map_err(malformed)?;
    let [least, most] = WATCHDOG_MS;
    match hello.watchdog_ms {
        Some(_) if hello.role != Role::Live => {
            return refuse("watchdog_ms", "a watchdog of a live cell alone".to_owned());
        }
        Some(ms) if !(least..=most).contains(&ms) => {
            return refuse("watchdog_ms", format!("{least} to {most}, or none in lockstep"));
        }
        Some(_) | None => {}
    }
    if hello.client.len() > CLIENT_BYTES_MAX {
        return refuse("client", format!("a name of at most {CLIENT_BYTES_MAX} bytes"));
    }
    Ok(hello)
}

impl<S: WireStream> Connection<'_, S> {
    fn run(&mut self) -> Result<(), WireError> {
        loop {
            let wait = self.watchdog.wait();
            let request = match self.line.receive::<CellRequest>(wait) {
                Ok(request) => request,
                Err(WireError::Deadline { .. }) => {
                    self.stop_arm(wait);
                    continue;
                }
                Err(
                    error @ (WireError::Malformed(_) | WireError::TooLarge { .. } | WireError::Torn { .. }),
                ) => {
                    // The other side may be gone already.
                    let _ = self.refuse(self.due, CellRefusal::Malformed(error.to_string()));
                    return Err(error);
                }
                Err(error) => return Err(error),
            };
            let sequence = request.sequence;
            if sequence != self.due {
                return self.refuse(sequence, CellRefusal::Sequence { due: self.due, came: sequence });
            }
            self.due += 1;
            match self.carry_out(request) {
                Ok((reply, block)) => {
                    self.line.send(&Answer { sequence, reply })?;
                    self.line.send_block(&block)?;
                }
                Err(refusal) => {
                    let closes = refusal.closes();
                    self.refuse(sequence, refusal)?;
                    if closes {
                        return Ok(());
                    }
                }
            }
        }
    }

    fn refuse(&mut self, sequence: u64, refusal: CellRefusal) -> Result<(), WireError> {
        self.line.send(&Answer { sequence, reply: CellReply::Refused(refusal) })
    }

    /// Stops the arm of a live cell that moves, and says so.
    fn stop_arm(&mut self, silent: Duration) {
        let ConnectionCell::Live(cell) = &mut self.cell else { return };
        if let Some(stop) = self.watchdog.stop(cell.as_mut(), silent) {
            self.stopped = Some(stop);
            self.server.note(&stop.told());
        }
    }

    /// What a request asks; the bytes are those of an announced block.
    fn carry_out(&mut self, request: CellRequest) -> Result<(CellReply, Vec<u8>), CellRefusal> {
        let CellRequest { guard, release, call, .. } = request;
        if release.len() > RELEASED_MAX {
            return Err(CellRefusal::Malformed(format!("{} handles; at most {RELEASED_MAX}", release.len())));
        }
        if !release.is_empty() {
            self.place.release(&release);
        }
        if let (Some(guard), Some(cell)) = (guard, self.cell.robot()) {
            cell.observe(guard);
            self.guard = Some(guard);
        }
        match call {
            Call::Describe => return Ok(announced(self.server.description.clone())),
            Call::Drift { of, drift } => {
                let drifted = self.server.factory.with_drift(&of, &drift).map_err(CellRefusal::of_cell)?;
                return Ok((CellReply::Distribution(Box::new(drifted)), Vec::new()));
            }
            Call::Scenery => {
                let cell = self.robot()?;
                let (fixtures, contacts) = (cell.fixtures(), cell.contact_points());
                return Ok((CellReply::Scenery { fixtures, contacts }, Vec::new()));
            }
            Call::Observed => {
                let observed = self.robot()?.observed().map(Box::new);
                return Ok((CellReply::Observed(observed), Vec::new()));
            }
            Call::Fork => {
                let copy = self.robot()?.copy().map_err(CellRefusal::of_cell)?;
                let tick = copy.tick();
                return Ok((CellReply::Fork { fork: self.place.keep(copy)?, tick }, Vec::new()));
            }
            Call::Export => {
                let image = self.robot()?.export().map_err(CellRefusal::of_cell)?;
                return Ok(announced(image.bytes().to_vec()));
            }
            Call::TakeFilm => {
                let frames = self.trial()?.take_film();
                let bytes = encode(&frames).map_err(|error| CellRefusal::Snapshot(error.to_string()))?;
                return Ok(announced(bytes));
            }
            call => self.change(call)?,
        }
        Ok((CellReply::Seen(Box::new(self.seen()?)), Vec::new()))
    }

    /// A call that changes the cell, or only looks at it.
    fn change(&mut self, call: Call) -> Result<(), CellRefusal> {
        match call {
            Call::Observe { guard } => {
                // The cell learns of it when the state is read.
                self.robot()?;
                self.guard = Some(guard);
            }
            Call::Step { command } => {
                if let Some(stop) = self.stopped {
                    return Err(CellRefusal::Stopped(stop));
                }
                let cell = self.cell.robot().ok_or(CellRefusal::Role { needs: Role::Trial })?;
                cell.step(&command).map_err(CellRefusal::Body)?;
                self.watchdog.stepped(cell);
            }
            Call::Interrupt { interrupt } => {
                self.robot()?.interrupt(interrupt);
                match interrupt {
                    Interrupt::Stop => self.watchdog.rest(),
                    Interrupt::Release => self.stopped = None,
                }
            }
            Call::BeginTask { task } => {
                self.robot()?.begin_task(task);
                self.started();
            }
            Call::EndTask => {
                match &mut self.cell {
                    ConnectionCell::Nothing => return Err(CellRefusal::Role { needs: Role::Live }),
                    ConnectionCell::Live(cell) => cell.end_task(),
                    ConnectionCell::Trial(cell) => cell.end_task(),
                }
                self.watchdog.rest();
            }
            Call::Inject { fault } => self.inject(fault)?,
            Call::AwaitWork { conditions, seed } => {
                conditions.check("conditions").map_err(CellRefusal::of_cell)?;
                let ConnectionCell::Live(cell) = &mut self.cell else {
                    return Err(CellRefusal::Role { needs: Role::Live });
                };
                let call = WorkCall { conditions: &conditions, seed };
                cell.await_work(&call).map_err(CellRefusal::of_cell)?;
                self.stopped = None;
                self.started();
            }
            Call::Reset { setup } => {
                self.trial()?.reset(&setup).map_err(CellRefusal::of_cell)?;
                self.started();
            }
            Call::GoOnFrom { fork } => {
                let copy = self.place.fork(fork)?;
                self.trial()?.go_on_from(&copy).map_err(CellRefusal::of_cell)?;
                self.started();
            }
            Call::Import { image } => {
                let image = self.receive_image(&image)?;
                self.trial()?.import(&image).map_err(CellRefusal::of_cell)?;
                self.started();
            }
            Call::SetTo { observed } => {
                self.trial()?.set_to(&observed).map_err(CellRefusal::of_cell)?;
                self.started();
            }
            Call::Film => self.trial()?.film(),
            // Answered before.
            Call::Describe
            | Call::Drift { .. }
            | Call::Scenery
            | Call::Observed
            | Call::Fork
            | Call::Export
            | Call::TakeFilm => {}
        }
        Ok(())
    }

    fn inject(&mut self, fault: InjectedFault) -> Result<(), CellRefusal> {
        let joints = self.server.factory.spec().robot.geometry.joint_count();
        if let InjectedFault::JointStuck { joint } | InjectedFault::JointRunaway { joint } = fault
            && joint >= joints
        {
            let problem = format!("joint \"{joint}\" is none of the {joints}");
            return Err(CellRefusal::Body(BodyError::Command(problem)));
        }
        match &mut self.cell {
            ConnectionCell::Nothing => Err(CellRefusal::Role { needs: Role::Live }),
            ConnectionCell::Live(cell) => cell.inject(fault).map_err(CellRefusal::of_cell),
            ConnectionCell::Trial(cell) => {
                cell.inject(fault);
                Ok(())
            }
        }
    }

    /// The bytes of a state, which follow their announcement whatever comes of it.
    fn receive_image(&mut self, image: &Block) -> Result<StateImage, CellRefusal> {
        let malformed = |error: WireError| CellRefusal::Malformed(error.to_string());
        let bytes = self.line.receive_block(image, FRAME_WITHIN).map_err(malformed)?;
        StateImage::new(bytes).map_err(CellRefusal::of_cell)
    }

    /// A task, an episode or work begins: the verdict of the guard is not known.
    fn started(&mut self) {
        self.guard = None;
        self.watchdog.rest();
    }

    fn robot(&mut self) -> Result<&mut dyn RobotCell, CellRefusal> {
        self.cell.robot().ok_or(CellRefusal::Role { needs: Role::Trial })
    }

    fn trial(&mut self) -> Result<&mut dyn TrialCell, CellRefusal> {
        match &mut self.cell {
            ConnectionCell::Trial(cell) => Ok(cell.as_mut()),
            ConnectionCell::Nothing | ConnectionCell::Live(_) => {
                Err(CellRefusal::Role { needs: Role::Trial })
            }
        }
    }

    fn seen(&mut self) -> Result<CellState, CellRefusal> {
        let guard = self.guard;
        let cell = self.robot()?;
        let seen = CellState {
            tick: cell.tick(),
            observation: guard.map(|guard| cell.observe(guard)),
            telemetry: cell.telemetry(),
            done: cell.inspect(),
            stop_declared: cell.stop_declared(),
            object: cell.shown_object(),
            truth: None,
        };
        Ok(CellState { truth: self.cell.truth(), ..seen })
    }
}

fn announced(bytes: Vec<u8>) -> (CellReply, Vec<u8>) {
    (CellReply::Block(Block::of(&bytes)), bytes)
}
