//! An engine at work in another process, as if it were here: what it shows comes in on one thread, what is asked goes out on
//! another, and a stop waits for neither.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use tokio::sync::{mpsc, watch};

use super::elsewhere::{code, stop};
use super::update::{EndFault, OUTSTANDING_MAX, Update};
use super::{NotTaken, take_place};
use crate::door::{Attachment, Client, DoorError, Doubt, Sayer, Shown, StopCall};
use holdpoint_approvals::Nonce;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::seat::Sitting;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_registry::Layout;
use holdpoint_text::Hint as _;

/// How long the reader waits for something before it looks whether anybody is left to be shown it.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// Where what is shown goes.
type Shows =
    (mpsc::Sender<Update>, watch::Sender<Option<Arc<Snapshot>>>, watch::Sender<Option<Arc<Picture>>>);

/// See the module's head.
pub(super) struct Attached {
    layout: Layout,
    requests: SyncSender<Request>,
    outstanding: Arc<AtomicUsize>,
    told: mpsc::Sender<Update>,
    /// What makes this seat's ids its own: every console counts from the same number.
    own: Nonce,
    seat: u64,
    process: i32,
    doubt: Option<Doubt>,
    sitting: Sitting,
    sayer: Sayer,
}

impl Attached {
    /// Sits down.
    pub(super) fn start(
        layout: &Layout,
        client: Client,
        sitting: Sitting,
        shows: Shows,
    ) -> Result<Self, DoorError> {
        let attachment = client.attach(sitting.clone())?;
        let (seat, process, sayer) = (attachment.seat(), attachment.process(), attachment.sayer()?);
        let doubt = attachment.doubt();
        let (requests, asked) = sync_channel(OUTSTANDING_MAX);
        let outstanding = Arc::new(AtomicUsize::new(0));
        let told = shows.0.clone();
        let thread = |name: &str| std::thread::Builder::new().name(name.to_owned());
        let path = layout.folder().to_owned();
        let failed = |source| DoorError::Io { what: "start a thread for", path: path.clone(), source };
        thread("attached-reader").spawn(move || read(attachment, &shows)).map_err(failed)?;
        let own = Nonce::random()?;
        let (folder, of) = (layout.clone(), own.clone());
        let (answers, places) = (told.clone(), Arc::clone(&outstanding));
        thread("attached-asker")
            .spawn(move || pass_on((&folder, &of, doubt), &asked, &answers, &places))
            .map_err(failed)?;
        Ok(Self {
            layout: layout.clone(),
            requests,
            outstanding,
            told,
            own,
            seat,
            process,
            doubt,
            sitting,
            sayer,
        })
    }

    /// Process id of the engine.
    pub(super) const fn process(&self) -> i32 {
        self.process
    }

    /// Why what is shown is not known to come from the engine.
    pub(super) const fn doubt(&self) -> Option<Doubt> {
        self.doubt
    }

    /// Says what is looked at, if it is something else than before. Gives back the number of the seat.
    pub(super) fn sit(&mut self, sitting: Sitting) -> u64 {
        if sitting != self.sitting {
            self.sitting = sitting.clone();
            self.sayer.say(sitting);
        }
        self.seat
    }

    /// As [`super::Host::ask`]. What stops the arm or tightens what acts goes over a connection of its own: what was asked
    /// before it may be answered late.
    pub(super) fn ask(&self, request: Request) -> Result<(), NotTaken> {
        let stops = matches!(request.command, Command::Stop { .. });
        let placed = take_place(&self.outstanding);
        if !placed && !stops {
            return Err(NotTaken::Busy(Box::new(request)));
        }
        if request.command.stops_what_acts() || request.command.stops_the_arm() {
            let (layout, told, places) =
                (self.layout.clone(), self.told.clone(), Arc::clone(&self.outstanding));
            let (alone, own, doubt) = (request.clone(), self.own.clone(), self.doubt);
            let spawned = std::thread::Builder::new().name("attached-stop".to_owned()).spawn(move || {
                answer(&mut None, (&layout, &own, doubt), alone, &told, placed.then_some(&*places));
            });
            if spawned.is_ok() {
                return Ok(());
            }
        }
        self.requests.try_send(request).map_err(|refused| {
            if placed {
                give_place_back(&self.outstanding);
            }
            match refused {
                TrySendError::Full(request) => NotTaken::Busy(Box::new(request)),
                TrySendError::Disconnected(request) => NotTaken::Ended(Box::new(request)),
            }
        })
    }
}

fn give_place_back(outstanding: &AtomicUsize) {
    let give = |count: usize| Some(count.saturating_sub(1));
    let _ = outstanding.fetch_update(Ordering::AcqRel, Ordering::Acquire, give);
}

/// Takes in what is shown until nobody looks or the engine is gone. A front end that is slow is waited for here: the engine
/// drops what this does not read, and says how much.
fn read(mut attachment: Attachment, (told, snapshots, pictures): &Shows) {
    let mut is_up = false;
    while !told.is_closed() {
        let shown = match attachment.next(LOOK_EVERY) {
            Ok(None) => continue,
            Ok(Some(shown)) => shown,
            Err(error) => {
                snapshots.send_replace(None);
                let fault = match error {
                    DoorError::Closed { text, .. } => EndFault::told(text),
                    error => EndFault::of(error.sentence()),
                };
                drop(told.blocking_send(Update::Ended(Err(fault))));
                return;
            }
        };
        let update = match shown {
            Shown::Event(event) => Update::Events(vec![*event]),
            Shown::Missed(missed) => Update::Lagged { missed },
            Shown::Snapshot(snapshot) => {
                // What is shown before the record was read is shown, and nothing can be asked yet.
                let comes_up = !is_up && snapshot.reading.is_none();
                snapshots.send_replace(Some(Arc::from(snapshot)));
                if !comes_up {
                    continue;
                }
                is_up = true;
                Update::Started
            }
            Shown::Picture(picture) => {
                pictures.send_replace(Some(Arc::from(picture)));
                continue;
            }
            Shown::Past { events, earlier } => Update::Past { events, earlier },
            Shown::Ended { by } => {
                let text = format!("it ended in good order: {by} ended it");
                drop(told.blocking_send(Update::Ended(Err(EndFault::orderly(text)))));
                return;
            }
        };
        if told.blocking_send(update).is_err() {
            return;
        }
    }
}

/// Asks one thing after the other, until nobody asks any more.
fn pass_on(
    to: (&Layout, &Nonce, Option<Doubt>),
    asked: &Receiver<Request>,
    told: &mpsc::Sender<Update>,
    places: &AtomicUsize,
) {
    let mut client = None;
    while let Ok(request) = asked.recv() {
        answer(&mut client, to, request, told, Some(places));
    }
}

fn answer(
    client: &mut Option<Client>,
    (layout, own, seat): (&Layout, &Nonce, Option<Doubt>),
    request: Request,
    told: &mpsc::Sender<Update>,
    places: Option<&AtomicUsize>,
) {
    let id = request.id.clone();
    let sent = Request { id: format!("{}-{id}", own.as_str()), ..request };
    let reply = if let Command::Stop { by, reason } = sent.command {
        stop(&StopCall::with_id(sent.id, by, reason), layout)
    } else {
        ask(client, (layout, seat), sent).unwrap_or_else(|error| Reply::refused(code(&error), &error))
    };
    if let Some(places) = places {
        give_place_back(places);
    }
    // Nobody may be left to be told.
    drop(told.blocking_send(Update::Answer { id, reply }));
}

/// Asks over the connection there is, or a new one. The engine closes what was silent for long: that is tried once more, and
/// carries out an id only once. The screen marks what is read where the seat itself is doubted; otherwise nothing is asked of
/// whoever is not known to be the engine.
fn ask(
    client: &mut Option<Client>,
    (layout, seat): (&Layout, Option<Doubt>),
    request: Request,
) -> Result<Reply, DoorError> {
    let ended = || DoorError::Ended { path: crate::door::socket_path(layout) };
    let mut connection = match client.take() {
        Some(connection) => connection,
        None => Client::connect(layout)?.ok_or_else(ended)?,
    };
    let (reads, takes) = (request.command.only_reads(), request.command.takes_authority_away());
    if let Some(doubt) = connection.doubt()
        && (seat.is_none() || !(reads || takes))
    {
        return Ok(doubt.unasked());
    }
    let reply = connection.ask_request(request)?;
    let doubt = connection.doubt();
    *client = Some(connection);
    // What is read is marked on the screen; what was to be done is not known to be done.
    Ok(match doubt.filter(|_| !reads) {
        Some(doubt) => doubt.in_place_of(&reply),
        None => reply,
    })
}
