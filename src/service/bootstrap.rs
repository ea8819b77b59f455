//! Before the engine: the bootstrap locks the store and opens the socket while a separate thread reads the record.
//!
//! The console shows the unverified state from the rows, and an operator can stop the cell. The engine then starts
//! stopped and records that stop first. The bootstrap registers, approves and advances nothing: such requests wait
//! briefly for the engine, and are then refused. If the record fails verification, no engine starts and the bootstrap
//! withdraws what it showed.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use holdpoint_governance::alarms::{Alarm, AlarmBook, AlarmChange};
use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::metrics::store_metrics::ObservedCounts;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::{Caller, Command, Refusal, Reply, Request};
use holdpoint_protocol::snapshot::{FamilyView, LiveView, Snapshot, StartupProgressView, StoppedView};
use holdpoint_registry::{Store, UnverifiedStore};
use holdpoint_store::{Layout, RecordViews, StopMarks, StoreError, VersionFilter};

use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

use crate::control_socket::{
    AccountRoles, ConsoleRegistry, ControlSocket, ControlSocketError, LiveViews, SceneServerSlot,
    SignalHandling,
};
use holdpoint_engine::decide::halt::{self, StopFollowUp};
use holdpoint_engine::decide::pipeline::snapshot::alarm_view;
use holdpoint_engine::decide::store_identity;
use holdpoint_engine::live::scenery;
use holdpoint_engine::live::stop_switch::{Controls, StopRequest, StopSwitch};
use holdpoint_engine::{Config, Engine, StartError, StartRules};
use holdpoint_record::context::Context;
use holdpoint_record::persisted_clock;
use holdpoint_record::wall_clock::wall_now;
use holdpoint_wording::program::engine::ENDS_BEFORE_START;
use holdpoint_wording::program::run::verifying;

/// How long a request for the state waits for the engine before the bootstrap answers with unverified rows.
pub const LOOK_PATIENCE: Duration = Duration::from_millis(250);

/// How long a request that changes something waits for the engine before it is refused.
pub const CHANGE_PATIENCE: Duration = Duration::from_secs(2);

const ALARMS_MAX: usize = 256;

/// The longest time between two polls of the socket.
const TURN: Duration = Duration::from_millis(2);

/// Receives, on the reading thread, the number of records read; reading waits for it.
pub type ReadProgressFn = Box<dyn FnMut(u64) + Send>;

/// Why a bootstrap could not begin.
#[derive(Debug, thiserror::Error)]
pub enum BootstrapError {
    /// The engine could not start either.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The socket cannot be served.
    #[error(transparent)]
    Socket(#[from] ControlSocketError),
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
}

impl Hint for BootstrapError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Start(error) => error.details(),
            Self::Socket(error) => error.details(),
            Self::Thread(_) => Some(ErrorReason::Environment.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Start(error) => error.hint(),
            Self::Socket(error) => error.hint(),
            Self::Thread(_) => None,
        }
    }
}

/// See the module comment.
pub struct EngineBootstrap<'a> {
    config: Config<'a>,
    rules: StartRules,
    controls: Controls,
    marks: StopMarks,
    socket: ControlSocket,
    preview: Snapshot,
    records_read: Arc<AtomicU64>,
    reading: Receiver<Result<Store, StoreError>>,
    store: Option<Result<Store, StoreError>>,
    ended: bool,
}

impl<'a> EngineBootstrap<'a> {
    /// Locks the store, opens the socket and begins to read the record; `watch` observes the progress.
    ///
    /// # Errors
    /// [`BootstrapError`].
    pub fn open(
        config: Config<'a>,
        signals: SignalHandling,
        mut watch: ReadProgressFn,
    ) -> Result<Self, BootstrapError> {
        let rules = StartRules::of(&config)?;
        let unverified = UnverifiedStore::take(config.data).map_err(StartError::from)?;
        let preview = unverified_snapshot(&config, &rules, &unverified)?;
        let controls = Controls::default();
        let switch = Arc::clone(&controls.switch);
        let marks = unverified.layout().stop_marks();
        let socket = ControlSocket::open(unverified.layout(), Arc::clone(&controls.cancel), switch, signals)?;
        let records_read = Arc::new(AtomicU64::new(0));
        let (sender, reading) = sync_channel(1);
        let counter = Arc::clone(&records_read);
        let work = move || {
            let store = unverified.read(&mut |so_far| {
                counter.store(so_far, Ordering::Release);
                watch(so_far);
            });
            // The receiver is gone: the store is released.
            drop(sender.send(store));
        };
        std::thread::Builder::new()
            .name("record-reader".to_owned())
            .spawn(work)
            .map_err(BootstrapError::Thread)?;
        Ok(Self {
            config,
            rules,
            controls,
            marks,
            socket,
            preview,
            records_read,
            reading,
            store: None,
            ended: false,
        })
    }

    /// Stops the cell, from any thread.
    #[must_use]
    pub fn switch(&self) -> Arc<StopSwitch> {
        Arc::clone(&self.controls.switch)
    }

    /// Shows these views to every console that attaches.
    pub fn show(&self, views: LiveViews) {
        self.socket.show(views);
    }

    /// As [`ControlSocket::serve_console_group`].
    ///
    /// # Errors
    /// [`ControlSocketError`].
    pub fn serve_console_group(
        &mut self,
        folder: &std::path::Path,
        roles: AccountRoles,
    ) -> Result<(), ControlSocketError> {
        self.socket.serve_console_group(folder, roles)
    }

    /// The slot for the function that serves the live scene.
    #[must_use]
    pub fn scenes(&self) -> SceneServerSlot {
        self.socket.scenes()
    }

    /// The attached consoles.
    #[must_use]
    pub fn consoles(&self) -> Arc<ConsoleRegistry> {
        self.socket.consoles()
    }

    /// Polls the socket once. Returns whether the record has been read, or the bootstrap has ended.
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
        let (preview, controls, marks) =
            (with_progress(&self.preview, &self.records_read), &self.controls, &self.marks);
        let mut ended = self.ended;
        self.socket.poll_early(|request, caller, waited| {
            answer(request, caller, waited, (&preview, controls, marks), &mut ended)
        });
        self.ended = ended || self.socket.end_signals() > 0;
        self.ended
    }

    /// Answers a request of this process that has waited for `waited`; `None` if it keeps waiting.
    pub fn answer(&mut self, request: &Request, waited: Duration) -> Option<Reply> {
        let preview = with_progress(&self.preview, &self.records_read);
        let with = (&preview, &self.controls, &self.marks);
        answer(request, &holdpoint_record::caller::own(), waited, with, &mut self.ended)
    }

    /// The state from the rows, including a stop made meanwhile.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let mut preview = with_progress(&self.preview, &self.records_read);
        show_stop(&mut preview, &self.controls);
        preview
    }

    /// Whether there are rows to show.
    #[must_use]
    pub fn has_records(&self) -> bool {
        has_records(&self.preview)
    }

    /// Whether a request ended the bootstrap before the record was read.
    #[must_use]
    pub const fn has_ended(&self) -> bool {
        self.ended
    }

    /// The engine, with the socket that was already open; waits until the record is read.
    ///
    /// # Errors
    /// [`StartError`]; the store is then unchanged, except for completed recovery.
    pub fn enter(self) -> Result<(Engine, ControlSocket), StartError> {
        let Self { config, rules, controls, socket, reading, store, .. } = self;
        let store = store.or_else(|| reading.recv().ok()).unwrap_or(Err(StoreError::Unknown));
        let engine = store
            .map_err(StartError::from)
            .and_then(|store| Engine::on(config, rules, Box::new(store), controls));
        match engine {
            Ok(engine) => Ok((engine, socket)),
            Err(error) => {
                // The socket closes with this, so attached consoles need the reason.
                socket.consoles().note_failure(error.sentence());
                Err(error)
            }
        }
    }
}

/// The rows with the current progress of reading.
fn with_progress(preview: &Snapshot, records_read: &AtomicU64) -> Snapshot {
    let mut preview = preview.clone();
    if let Some(reading) = &mut preview.reading {
        reading.read = records_read.load(Ordering::Acquire);
    }
    preview
}

fn has_records(preview: &Snapshot) -> bool {
    preview.reading.is_some_and(|reading| reading.of > 0)
}

fn show_stop(preview: &mut Snapshot, controls: &Controls) {
    if preview.stopped.is_none()
        && let Some(StopRequest { by, reason, caller, .. }) = controls.switch.first_stop()
    {
        let since_ms = preview.at_ms;
        let stopped = StoppedView::first(by, caller, reason, since_ms);
        preview.stopped = Some(StoppedView { stood_after_ticks: Some(0), ..stopped });
    }
}

fn answer(
    request: &Request,
    caller: &Caller,
    waited: Duration,
    (preview, controls, marks): (&Snapshot, &Controls, &StopMarks),
    ended: &mut bool,
) -> Option<Reply> {
    // A new store is ready in a moment and has nothing to show.
    let is_new = !has_records(preview);
    match &request.command {
        Command::Stop { by, reason } => {
            let (id, by, reason) = (request.id.clone(), by.clone(), reason.clone());
            let stop = StopRequest { id, by, reason, caller: caller.clone() };
            controls.switch.halt(stop.clone());
            Some(halt::stopped_meanwhile(&stop, marks, StopFollowUp::AfterStart(preview.reading)))
        }
        Command::Shutdown => {
            *ended = true;
            let text = ENDS_BEFORE_START.to_owned();
            Some(Reply::Accepted { text, version: None })
        }
        Command::Snapshot if is_new || waited < LOOK_PATIENCE => None,
        Command::Snapshot => {
            let mut preview = preview.clone();
            show_stop(&mut preview, controls);
            Some(Reply::Snapshot { snapshot: Box::new(preview) })
        }
        _ if is_new || waited < CHANGE_PATIENCE => None,
        _ => Some(Reply::Refused {
            code: Refusal::NotNow,
            text: verifying(preview.reading),
            hint: Some("try again in a moment; `holdpoint stop` works now".to_owned()),
        }),
    }
}

/// The state from the rows, shown unverified: active versions, the stop of the cell, the alarms.
fn unverified_snapshot(
    config: &Config<'_>,
    rules: &StartRules,
    unverified: &UnverifiedStore,
) -> Result<Snapshot, StartError> {
    let (profile, table) = (rules.profile.clone(), rules.table.clone());
    let context = Context::new(profile, table, rules.own.clone(), config.cell.clone())
        .map_err(|error| StartError::Fault(error.into()))?;
    let rows = unverified.views()?.map(|views| PreviewRows::of(&views)).unwrap_or_default();
    let PreviewRows { at_ms, records, agent, families, alarms, stopped } = rows;
    Ok(Snapshot {
        at_ms,
        wall_ms: wall_now().map(WallTime::ms),
        up_since_ms: None,
        time: wall_now().unwrap_or_default(),
        clock_doubt: None,
        profile: context.profile.name,
        site: context.profile.site.clone(),
        site_file: context.cell.site_file(),
        robot: context.cell.spec.robot.name.clone(),
        seed: config.seeds.of_run(),
        policy: context.digest,
        agent: agent.unwrap_or(Digest::from_bytes([0; 32])),
        reading: Some(StartupProgressView { read: 0, of: records }),
        signing: None,
        holding: None,
        stopped,
        unauthorized: None,
        families,
        candidates: Vec::new(),
        prompts: Vec::new(),
        emergencies: Vec::new(),
        questions: Vec::new(),
        alarm_summary: alarms.summary(at_ms),
        alarms: alarms.open().into_iter().map(|alarm| alarm_view(alarm, at_ms)).collect(),
        live: LiveView {
            sequences: 0,
            recent_success: None,
            recent: 0,
            last: Vec::new(),
            uncovered: 0,
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

/// The rows read from a store before its record is verified.
#[derive(Default)]
struct PreviewRows {
    at_ms: u64,
    records: u64,
    agent: Option<Digest>,
    families: Vec<FamilyView>,
    alarms: AlarmBook,
    stopped: Option<StoppedView>,
}

impl PreviewRows {
    /// Ignores rows that cannot be read; verification of the record reports the cause.
    fn of(views: &dyn RecordViews) -> Self {
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
        alarms.recount();
        let resumed_ms = views.folder().and_then(|folder| {
            // The engine's clock resumes there, and so does the preview.
            persisted_clock::resumed_ms(&Layout::new(folder), views).ok()
        });
        Self {
            at_ms: resumed_ms.unwrap_or(head.at_ms),
            records: head.seq,
            agent: store_identity::agent(views).ok().flatten(),
            families: families.collect(),
            alarms,
            stopped: halt::recall(views).ok().flatten(),
        }
    }
}
