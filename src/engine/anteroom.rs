//! Before the engine: the store is taken and the door is open, while the record is read on a thread of its own.
//!
//! Whoever is at the keyboard sees how things stand by the rows, marked as not verified, and can stop the cell; the
//! engine then comes up stopped, and the stop is the first thing it puts on record. Nothing is registered, approved,
//! bound or advanced here: such requests wait a moment for the engine, and are refused then. If the record is not what
//! it must be, there is no engine, and what was shown is withdrawn.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use holdpoint_governance::alarms::{Alarm, AlarmBook, AlarmChange};
use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::metrics::observed::ObservedCounts;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::{Caller, Command, Refusal, Reply, Request};
use holdpoint_protocol::snapshot::{FamilyView, LiveView, ReadingView, Snapshot, StoppedView};
use holdpoint_registry::{Layout, StopMarks, Store, StoreError, UnreadStore, VersionFilter, Views};

use holdpoint_text::Hint as _;

use crate::bound;
use crate::context::Context;
use crate::door::{Door, LiveViews, Scenes, Seats, Signals};
use crate::halt;
use crate::kept_clock;
use crate::view::snapshot::alarm_view;
use crate::wall_clock::wall_now;
use crate::world::scenery;
use crate::world::switch::{AskedStop, Controls, Switch};
use crate::{Config, Engine, StartError, StartRules};

/// How long a look at how things stand waits for the engine, before it gets the unverified rows.
pub const LOOK_PATIENCE: Duration = Duration::from_millis(250);

/// How long a request that changes something waits for the engine, before it is refused.
pub const CHANGE_PATIENCE: Duration = Duration::from_secs(2);

/// The most alarms that are shown.
const ALARMS_MAX: usize = 256;

/// Most time between two looks at the door.
const TURN: Duration = Duration::from_millis(2);

/// Is told, on the reading thread, how many records were read; the reading waits for it.
pub type ReadWatch = Box<dyn FnMut(u64) + Send>;

/// See the module's head.
pub struct Anteroom<'a> {
    config: Config<'a>,
    rules: StartRules,
    controls: Controls,
    marks: StopMarks,
    door: Door,
    shown: Snapshot,
    read: Arc<AtomicU64>,
    reading: Receiver<Result<Store, StoreError>>,
    store: Option<Result<Store, StoreError>>,
    ended: bool,
}

impl<'a> Anteroom<'a> {
    /// Takes the store, opens the door and begins to read the record; `watch` looks on.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn open(config: Config<'a>, signals: Signals, mut watch: ReadWatch) -> Result<Self, StartError> {
        let rules = StartRules::of(&config.profile)?;
        let taken = UnreadStore::take(config.data)?;
        let shown = shown(&config, &rules, &taken)?;
        let controls = Controls::default();
        let switch = Arc::clone(&controls.switch);
        let marks = taken.layout().stop_marks();
        let door = Door::open(taken.layout(), Arc::clone(&controls.cancel), switch, signals)?;
        let read = Arc::new(AtomicU64::new(0));
        let (tell, reading) = sync_channel(1);
        let told = Arc::clone(&read);
        let work = move || {
            let store = taken.read(&mut |so_far| {
                told.store(so_far, Ordering::Release);
                watch(so_far);
            });
            // Nobody is left who wants it: the store is let go.
            drop(tell.send(store));
        };
        std::thread::Builder::new()
            .name("record-reader".to_owned())
            .spawn(work)
            .map_err(StartError::Thread)?;
        Ok(Self { config, rules, controls, marks, door, shown, read, reading, store: None, ended: false })
    }

    /// Stops the cell, from any thread.
    #[must_use]
    pub fn switch(&self) -> Arc<Switch> {
        Arc::clone(&self.controls.switch)
    }

    /// Has everything shown to whoever attaches.
    pub fn show(&self, views: LiveViews) {
        self.door.show(views);
    }

    /// As [`Door::serve_seats`].
    ///
    /// # Errors
    /// [`StartError::Door`].
    pub fn serve_seats(&mut self, folder: &std::path::Path) -> Result<(), StartError> {
        Ok(self.door.serve_seats(folder)?)
    }

    /// Where it is put how the live scene is served.
    #[must_use]
    pub fn scenes(&self) -> Scenes {
        self.door.scenes()
    }

    /// Who looks.
    #[must_use]
    pub fn seats(&self) -> Arc<Seats> {
        self.door.seats()
    }

    /// Serves the door for a moment. Tells whether the record has been read, or will not be waited for.
    pub fn turn(&mut self) -> bool {
        if self.store.is_none() {
            match self.reading.recv_timeout(TURN) {
                Ok(store) => self.store = Some(store),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => self.store = Some(Err(StoreError::Unknown)),
            }
        }
        if self.store.is_some() {
            return true;
        }
        let (shown, controls, marks) = (now(&self.shown, &self.read), &self.controls, &self.marks);
        let mut ended = self.ended;
        self.door.poll_early(|request, caller, waited| {
            answer(request, caller, waited, (&shown, controls, marks), &mut ended)
        });
        self.ended = ended || self.door.endings_asked() > 0;
        self.ended
    }

    /// Answers a request of the program that holds it, which has waited for so long; `None` if it waits on.
    pub fn answer(&mut self, request: &Request, waited: Duration) -> Option<Reply> {
        let shown = now(&self.shown, &self.read);
        let with = (&shown, &self.controls, &self.marks);
        answer(request, &crate::caller::own(), waited, with, &mut self.ended)
    }

    /// How things stand by the rows; whoever stopped the cell meanwhile included.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let mut shown = now(&self.shown, &self.read);
        show_stop(&mut shown, &self.controls);
        shown
    }

    /// Whether there are rows to show.
    #[must_use]
    pub fn has_records(&self) -> bool {
        has_records(&self.shown)
    }

    /// Whether it was told to end before the record was read.
    #[must_use]
    pub const fn has_ended(&self) -> bool {
        self.ended
    }

    /// The engine, with the door that was open before it; waits for the end of the reading.
    ///
    /// # Errors
    /// [`StartError`]; the store is then as it was, but for the recovery that was written.
    pub fn enter(self) -> Result<(Engine, Door), StartError> {
        let Self { config, rules, controls, door, reading, store, .. } = self;
        let store = store.or_else(|| reading.recv().ok()).unwrap_or(Err(StoreError::Unknown));
        let engine =
            store.map_err(StartError::from).and_then(|store| Engine::on(config, rules, store, controls));
        match engine {
            Ok(engine) => Ok((engine, door)),
            Err(error) => {
                // The door closes with this, and nobody who sits at it is left to guess.
                door.seats().note_failure(error.sentence());
                Err(error)
            }
        }
    }
}

/// The rows with how far the record was read since.
fn now(shown: &Snapshot, read: &AtomicU64) -> Snapshot {
    let mut shown = shown.clone();
    if let Some(reading) = &mut shown.reading {
        reading.read = read.load(Ordering::Acquire);
    }
    shown
}

fn has_records(shown: &Snapshot) -> bool {
    shown.reading.is_some_and(|reading| reading.of > 0)
}

fn show_stop(shown: &mut Snapshot, controls: &Controls) {
    if shown.stopped.is_none()
        && let Some(AskedStop { by, reason, caller, .. }) = controls.switch.first_asked()
    {
        let since_ms = shown.at_ms;
        let stopped = StoppedView::first(by, caller, reason, since_ms);
        shown.stopped = Some(StoppedView { stood_after_ticks: Some(0), ..stopped });
    }
}

fn answer(
    request: &Request,
    caller: &Caller,
    waited: Duration,
    (shown, controls, marks): (&Snapshot, &Controls, &StopMarks),
    ended: &mut bool,
) -> Option<Reply> {
    let reading = shown.reading.map_or_else(String::new, |reading| reading.to_string());
    // A store that is made just now is there in a moment; there is nothing to show of it.
    let is_new = !has_records(shown);
    match &request.command {
        Command::Stop { by, reason } => {
            let (id, by, reason) = (request.id.clone(), by.clone(), reason.clone());
            let asked = AskedStop { id, by, reason, caller: caller.clone() };
            controls.switch.halt(asked.clone());
            let next = format!(
                "it stays so when the engine is up, and goes on record as soon as the record has been read ({reading})"
            );
            Some(halt::stopped_meanwhile(&asked, marks, &next))
        }
        Command::Shutdown => {
            *ended = true;
            let text = "the engine ends before it was up; nothing was carried out".to_owned();
            Some(Reply::Accepted { text, version: None })
        }
        Command::Snapshot if is_new || waited < LOOK_PATIENCE => None,
        Command::Snapshot => {
            let mut shown = shown.clone();
            show_stop(&mut shown, controls);
            Some(Reply::Snapshot { snapshot: Box::new(shown) })
        }
        _ if is_new || waited < CHANGE_PATIENCE => None,
        _ => Some(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("the record is being verified; nothing is carried out before that ({reading})"),
            hint: Some("try again in a moment; `holdpoint stop` works now".to_owned()),
        }),
    }
}

/// What the rows say, as far as it is shown unverified: who is in control, who stopped the cell, the alarms.
fn shown(config: &Config<'_>, rules: &StartRules, taken: &UnreadStore) -> Result<Snapshot, StartError> {
    let (profile, table) = (rules.profile.clone(), rules.table.clone());
    let context = Context::new(profile, table, rules.own.clone(), config.cell.clone())
        .map_err(|error| StartError::Fault(error.into()))?;
    let rows = taken.views()?.map(|views| UnheldRows::of(&views)).unwrap_or_default();
    let UnheldRows { at_ms, records, agent, families, alarms, stopped } = rows;
    Ok(Snapshot {
        at_ms,
        wall_ms: wall_now().map(WallTime::ms),
        time: wall_now().unwrap_or_default(),
        clock_doubt: None,
        profile: context.profile.name,
        site: context.profile.site.clone(),
        robot: context.cell.model.name.clone(),
        seed: config.seed,
        policy: context.digest,
        agent: agent.unwrap_or(Digest::from_bytes([0; 32])),
        reading: Some(ReadingView { read: 0, of: records }),
        signing: None,
        holding: None,
        stopped,
        unauthorized: None,
        families,
        candidates: Vec::new(),
        prompts: Vec::new(),
        emergencies: Vec::new(),
        questions: Vec::new(),
        alarm_summary: alarms.summary(),
        alarms: alarms.open().into_iter().map(|alarm| alarm_view(alarm, at_ms)).collect(),
        live: LiveView {
            sequences: 0,
            recent_success: None,
            recent: 0,
            last: Vec::new(),
            drift: None,
            fault: None,
            goal: String::new(),
            pace: None,
            outcomes: Vec::new(),
            monitors: Vec::new(),
        },
        scenery: scenery(&context.cell),
        thresholds: context.thresholds(),
        observed: ObservedCounts::default(),
        seats: Vec::new(),
        ends_alone_s: None,
    })
}

/// What is read of a store before its record is.
#[derive(Default)]
struct UnheldRows {
    at_ms: u64,
    records: u64,
    agent: Option<Digest>,
    families: Vec<FamilyView>,
    alarms: AlarmBook,
    stopped: Option<StoppedView>,
}

impl UnheldRows {
    /// What cannot be read is for the reading of the record to tell: it names what is wrong.
    fn of(views: &Views) -> Self {
        let Ok(head) = views.head() else { return Self::default() };
        let active = VersionFilter { state: Some(State::Active), ..VersionFilter::default() };
        let (active, _) = views.versions(&active).unwrap_or_default();
        let families = views.families().unwrap_or_default().into_iter().filter_map(|status| {
            let version = active.iter().find(|version| Some(&version.version) == status.active.as_ref());
            Some(FamilyView {
                family: Family::new(status.name).ok()?,
                flags: version.map(|version| version.flags),
                active: status.active,
                pinned: status.pinned,
                safe_stopped: status.safe_stopped,
                provisional: None,
                review: None,
            })
        });
        let mut alarms = AlarmBook::new();
        for entry in views.alarms().unwrap_or_default().iter().take(ALARMS_MAX) {
            let Ok(alarm) = serde_json::from_str::<Alarm>(&entry.json) else { continue };
            let from = alarm.state();
            alarms.absorb(&[AlarmChange::Set { alarm, from, annunciated: false, at_ms: head.at_ms }]);
        }
        let resumed_ms = views.folder().and_then(|folder| {
            // The engine's clock goes on from there, and so does what is shown before it.
            kept_clock::resumed_ms(&Layout::new(folder), views).ok()
        });
        Self {
            at_ms: resumed_ms.unwrap_or(head.at_ms),
            records: head.seq,
            agent: bound::agent(views).ok().flatten(),
            families: families.collect(),
            alarms,
            stopped: halt::recall(views).ok().flatten(),
        }
    }
}
