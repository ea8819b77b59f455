//! A program between a person and the engine that alters what goes over the socket: no altered message is accepted.
//! The request is for a release, which needs an approval at once.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use holdpoint::approvals::keyfile::KeyEncoding;
use holdpoint::approvals::{Identity, KdfCost, Nonce};
use holdpoint::engine::control_socket::Client;
use holdpoint::governance::approval::{ApprovalDecision, Requester, Role};
use holdpoint::governance::ids::{CapabilityId, canonical_json};
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::approval_document::{ApprovalDocument, ApprovalFacts};
use holdpoint::protocol::command::{Command, Operation, Refusal, Reply, Request};
use holdpoint::protocol::snapshot::RequestKind;
use holdpoint::protocol::wire::ClientMessage;
use holdpoint::registry::{AuditFilter, Layout, Store, Views, verify};
use holdpoint::wording::approval::render;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::signed::{engine, person, store, words};

/// A generous time limit.
const PATIENCE: Duration = Duration::from_mins(1);
const VERSION: &str = "grasp@1.0.0";

/// The altered part: of the person's requests, and of the answers.
type Alter = fn(&mut Value, &Known);

/// The earlier messages that the program in between has seen.
#[derive(Default)]
struct Known {
    /// Another person's request.
    of_ben: Value,
    /// The request that was answered before this one.
    older: Value,
}

struct Between {
    socket: PathBuf,
    alter: Arc<Mutex<(Alter, Alter)>>,
    known: Arc<Mutex<Known>>,
    _folder: TempDir,
}

const fn nothing(_: &mut Value, _: &Known) {}

impl Between {
    fn before(engine: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("engine.sock");
        let listener = UnixListener::bind(&socket).unwrap();
        let alter: Arc<Mutex<(Alter, Alter)>> = Arc::new(Mutex::new((nothing, nothing)));
        let known = Arc::new(Mutex::new(Known::default()));
        let (engine, of, seen) = (engine.to_owned(), Arc::clone(&alter), Arc::clone(&known));
        std::thread::spawn(move || {
            for client in listener.incoming() {
                let (client, real) = (client.unwrap(), UnixStream::connect(&engine).unwrap());
                let (of, seen) = (Arc::clone(&of), Arc::clone(&seen));
                std::thread::spawn(move || passes(client, real, &of, &seen));
            }
        });
        Self { socket, alter, known, _folder: folder }
    }
}

/// Passes lines on until one side ends; both directions are altered.
fn passes(
    mut client: UnixStream,
    mut real: UnixStream,
    alter: &Mutex<(Alter, Alter)>,
    known: &Mutex<Known>,
) -> Option<()> {
    let (mut asks, mut answers) =
        (BufReader::new(client.try_clone().ok()?).lines(), BufReader::new(real.try_clone().ok()?).lines());
    writeln!(client, "{}", answers.next()?.ok()?).ok()?;
    loop {
        let (of_asked, of_answered) = *alter.lock().unwrap();
        let mut asked: Value = serde_json::from_str(&asks.next()?.ok()?).ok()?;
        of_asked(&mut asked, &known.lock().unwrap());
        writeln!(real, "{asked}").ok()?;
        let mut answered: Value = serde_json::from_str(&answers.next()?.ok()?).ok()?;
        of_answered(&mut answered, &known.lock().unwrap());
        writeln!(client, "{answered}").ok()?;
    }
}

/// The approver's program, over any socket that it takes for the engine's.
struct Person {
    stream: UnixStream,
    answers: std::io::Lines<BufReader<UnixStream>>,
}

impl Person {
    fn at(socket: &Path) -> Self {
        let stream = UnixStream::connect(socket).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut answers = BufReader::new(stream.try_clone().unwrap()).lines();
        let hello = answers.next().unwrap().unwrap();
        assert!(hello.contains("\"hello\""), "{hello}");
        Self { stream, answers }
    }

    fn ask(&mut self, command: Command) -> Reply {
        let id = Nonce::random().unwrap().to_string();
        let call = ClientMessage::Ask { request: Box::new(Request::unsigned(id, command)) };
        writeln!(self.stream, "{}", serde_json::to_string(&call).unwrap()).unwrap();
        let answer: Value = serde_json::from_str(&self.answers.next().unwrap().unwrap()).unwrap();
        serde_json::from_value(answer["reply"].clone()).unwrap()
    }

    /// Gets the approval request and approves what is shown; an error is a finding of the approver's own program.
    fn approves(&mut self, who: &Identity) -> Result<Reply, String> {
        let (version, name) = (version(), who.info().name.clone());
        let asked =
            Command::Question { version: version.clone(), purpose: RequestKind::Release, who: name.clone() };
        let question = match self.ask(asked) {
            Reply::Question { question } => question,
            other => return Ok(other),
        };
        question.bound(&version, RequestKind::Release, &name).map_err(|error| error.to_string())?;
        let command =
            question.answer(who, ApprovalDecision::Approve, "read").map_err(|error| error.to_string())?;
        Ok(self.ask(command))
    }
}

fn version() -> CapabilityId {
    VERSION.parse().unwrap()
}

/// The approval request in a reply, as JSON; nothing for another reply.
fn question(answer: &mut Value) -> Option<&mut Value> {
    answer.get_mut("reply")?.get_mut("question")
}

fn facts(of: &Value) -> ApprovalFacts {
    serde_json::from_str(of["facts"].as_str().unwrap()).unwrap()
}

/// Alters the facts: only their text, and the lines that go with it.
fn lie(answer: &mut Value, whole: bool, lie: impl FnOnce(&mut ApprovalFacts)) {
    let Some(question) = question(answer) else { return };
    let mut told = facts(question);
    lie(&mut told);
    question["facts"] = json!(canonical_json(&told).unwrap());
    if whole {
        question["lines"] = json!(render(&told));
    }
}

fn line(answer: &mut Value, change: impl FnOnce(&mut Vec<Value>)) {
    if let Some(lines) = question(answer).and_then(|question| question["lines"].as_array_mut()) {
        change(lines);
    }
}

fn field(answer: &mut Value, name: &str, value: Value) {
    if let Some(question) = question(answer) {
        question[name] = value;
    }
}

/// A field of the decision on its way to the engine.
fn of_decision(asked: &mut Value, place: &[&str], value: Value) {
    let decided = asked.pointer_mut("/request/command/signed/approval");
    let Some(decided) = decided else { return };
    let (last, above) = place.split_last().unwrap();
    let mut at = decided;
    for name in above {
        at = at.get_mut(*name).unwrap();
    }
    assert!(at.get(*last).is_some(), "{place:?} in {at}");
    at[*last] = value;
}

/// The attacks of a program in between.
fn attacks() -> Vec<(&'static str, Alter, Alter)> {
    fn zeros(count: usize) -> Value {
        json!("0".repeat(count))
    }
    vec![
        ("author, facts alone", nothing, |a, _| {
            lie(a, false, |facts| facts.author.name = String::from("tuv-certified"));
        }),
        ("author, facts and lines", nothing, |a, _| {
            lie(a, true, |facts| facts.author.name = String::from("tuv"));
        }),
        ("requester", nothing, |a, _| lie(a, true, |facts| facts.requester = Requester::Script)),
        ("about", nothing, |a, _| lie(a, true, |facts| facts.about = String::from("a drill"))),
        ("why", nothing, |a, _| lie(a, true, |facts| facts.why.push("better in all".to_owned()))),
        ("untested", nothing, |a, _| lie(a, true, |facts| facts.untested.clear())),
        ("permissions", nothing, |a, _| lie(a, true, |facts| facts.new_permissions.push("none".to_owned()))),
        ("risk", nothing, |a, _| {
            use holdpoint::governance::submission::Risk;
            lie(a, true, |facts| facts.risk = if facts.risk == Risk::High { Risk::Low } else { Risk::High });
        }),
        ("people needed", nothing, |a, _| lie(a, true, |facts| facts.needed += 1)),
        ("deadline", nothing, |a, _| {
            lie(a, true, |facts| facts.until = Some(holdpoint_governance::wall_time::WallTime::default()));
        }),
        ("robot", nothing, |a, _| lie(a, true, |facts| facts.robot = String::from("another"))),
        ("evidence", nothing, |a, _| lie(a, true, |facts| facts.evidence = facts.policy)),
        ("candidate", nothing, |a, _| lie(a, true, |facts| facts.candidate = facts.policy)),
        ("policy", nothing, |a, _| lie(a, true, |facts| facts.policy = facts.candidate)),
        ("profile", nothing, |a, _| lie(a, true, |facts| facts.profile = ProfileName::Sim)),
        ("row version", nothing, |a, _| lie(a, true, |facts| facts.row_version += 1)),
        ("version", nothing, |a, _| lie(a, true, |facts| facts.version = "align@1.0.0".parse().unwrap())),
        ("purpose", nothing, |a, _| lie(a, true, |facts| facts.purpose = RequestKind::Review)),
        ("who is asked", nothing, |a, _| {
            lie(a, true, |facts| facts.asked.as_mut().unwrap().name = String::from("ben"));
        }),
        ("the role", nothing, |a, _| {
            lie(a, true, |facts| facts.asked.as_mut().unwrap().role = Role::Engineer);
        }),
        ("a line altered", nothing, |a, _| line(a, |lines| lines[2] = json!("All is well"))),
        ("lines removed", nothing, |a, _| {
            line(a, |lines| lines.retain(|line| !line.to_string().contains("Not")));
        }),
        ("lines in another order", nothing, |a, _| line(a, |lines| lines.swap(1, 2))),
        ("a blank in a line", nothing, |a, _| {
            line(a, |lines| lines[0] = json!(format!("{} ", lines[0].as_str().unwrap())));
        }),
        ("two lines made one", nothing, |a, _| {
            line(a, |lines| {
                let last = lines.pop().unwrap();
                let before = lines.pop().unwrap();
                lines.push(json!(format!("{}\n{}", before.as_str().unwrap(), last.as_str().unwrap())));
            });
        }),
        ("the renderer", nothing, |a, _| field(a, "renderer", json!(7))),
        ("the request", nothing, |a, _| field(a, "request", json!("7".repeat(32)))),
        ("the store's key", nothing, |a, _| field(a, "store_key", json!("0".repeat(64)))),
        ("the store", nothing, |a, _| field(a, "store_id", json!("another"))),
        ("a validity without end", nothing, |a, _| field(a, "valid_until", json!("9999-12-31T00:00:00Z"))),
        ("another's question", nothing, |a, known| {
            if let Some(question) = question(a) {
                question.clone_from(&known.of_ben);
            }
        }),
        ("another's lines", nothing, |a, known| field(a, "lines", known.of_ben["lines"].clone())),
        ("another's facts", nothing, |a, known| field(a, "facts", known.of_ben["facts"].clone())),
        ("an older question", nothing, |a, known| {
            if let Some(question) = question(a) {
                question.clone_from(&known.older);
            }
        }),
        ("an older question with the request of this one", nothing, |a, known| {
            field(a, "lines", known.older["lines"].clone());
            field(a, "facts", known.older["facts"].clone());
        }),
        (
            "asked for another person",
            |asked, _| {
                if let Some(who) = asked.pointer_mut("/request/command/who") {
                    *who = json!("ben");
                }
            },
            nothing,
        ),
        ("decision: who", |a, _| of_decision(a, &["who"], json!("ben")), nothing),
        ("decision: role", |a, _| of_decision(a, &["role"], json!("engineer")), nothing),
        ("decision: decision", |a, _| of_decision(a, &["decision"], json!("reject")), nothing),
        ("decision: reason", |a, _| of_decision(a, &["reason"], json!("as ordered")), nothing),
        ("decision: version", |a, _| of_decision(a, &["version"], json!("align@1.0.0")), nothing),
        ("decision: candidate", |a, _| of_decision(a, &["candidate_digest"], zeros(64)), nothing),
        ("decision: row version", |a, _| of_decision(a, &["row_version"], json!(99)), nothing),
        ("decision: evidence", |a, _| of_decision(a, &["evidence_digest"], zeros(64)), nothing),
        ("decision: policy", |a, _| of_decision(a, &["policy_digest"], zeros(64)), nothing),
        ("decision: profile", |a, _| of_decision(a, &["profile"], json!("sim")), nothing),
        ("decision: store", |a, _| of_decision(a, &["store_id"], json!("another")), nothing),
        ("decision: nonce", |a, _| of_decision(a, &["nonce"], zeros(32)), nothing),
        ("decision: validity", |a, _| of_decision(a, &["not_after_ms"], json!(1_u64 << 50)), nothing),
        ("decision: lines", |a, _| of_decision(a, &["shown", "lines"], zeros(64)), nothing),
        ("decision: facts", |a, _| of_decision(a, &["shown", "facts"], zeros(64)), nothing),
        ("decision: renderer", |a, _| of_decision(a, &["shown", "renderer"], json!(7)), nothing),
        ("decision: store key", |a, _| of_decision(a, &["shown", "store_key"], zeros(64)), nothing),
        ("decision: request", |a, _| of_decision(a, &["shown", "request"], zeros(32)), nothing),
        ("decision: nothing shown", |a, _| of_decision(a, &["shown"], Value::Null), nothing),
    ]
}

/// An engine under `human` that requests approvals for lifting a restriction, and all persons' keys.
struct Site {
    folder: TempDir,
    client: Client,
    engine: Receiver<()>,
}

impl Site {
    fn new() -> Self {
        let folder = store();
        let opened = Store::open(folder.path()).unwrap();
        for name in ["ann", "ben"] {
            person(&opened, name, Role::Safety, KeyEncoding::Sealed(&words(), KdfCost::LEAST));
        }
        drop(opened);
        let (ended, has_ended) = channel();
        let thread = engine(folder.path(), ProfileName::Human);
        std::thread::spawn(move || {
            thread.join().unwrap();
            ended.send(()).unwrap();
        });
        let client = Client::connect(&Layout::new(folder.path())).unwrap().expect("an engine answers");
        Self { folder, client, engine: has_ended }
    }

    fn key(&self, name: &str) -> Identity {
        let folder = Layout::new(self.folder.path()).identities();
        Identity::open(&folder, name).unwrap().unlock(Some(&words())).unwrap()
    }

    fn snapshot(&mut self) -> holdpoint::protocol::snapshot::Snapshot {
        let Reply::Snapshot { snapshot } = self.client.ask(Command::Snapshot).unwrap() else {
            panic!("none")
        };
        *snapshot
    }

    fn operation() -> Operation {
        Operation { version: version(), by: "mara".to_owned(), reason: "a test".to_owned() }
    }

    /// Approvers are asked to lift the restriction.
    fn asks(&mut self) {
        let command = Command::Release { operation: Self::operation(), profiles: Vec::new() };
        let mara = self.key("mara");
        let seal = self.snapshot().signing.unwrap().sign(&mara, &command).unwrap();
        let reply = self.client.ask_sealed(command, Some(Box::new(seal))).unwrap();
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    }

    fn question(&mut self, who: &str) -> ApprovalDocument {
        let asked =
            Command::Question { version: version(), purpose: RequestKind::Release, who: who.to_owned() };
        match self.client.ask(asked).unwrap() {
            Reply::Question { question } => *question,
            other => panic!("{other:?}"),
        }
    }

    /// The number of decisions on record.
    fn decisions(&self) -> usize {
        let views = Views::open(&Layout::new(self.folder.path()).database()).unwrap();
        let of = |kind| AuditFilter { kind: Some(kind), ..AuditFilter::default() };
        let shown = views.audit(&of(RecordKind::Shown)).unwrap().len();
        let put = views.audit(&of(RecordKind::ApprovalPut)).unwrap().len();
        assert!(shown <= put, "{shown} of {put}");
        put
    }

    fn ends(mut self) -> TempDir {
        let _ = self.client.ask(Command::Shutdown).unwrap();
        self.engine.recv_timeout(PATIENCE).unwrap();
        self.folder
    }
}

#[test]
fn whoever_stands_between_gets_nothing_accepted() {
    let mut site = Site::new();
    let reply = site.client.ask(Command::Restrict(Site::operation())).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    // An answered request: every listener knows its lines and facts.
    site.asks();
    let older = site.question("ann");
    let ben = site.key("ben");
    let refusal = site.question("ben").answer(&ben, ApprovalDecision::Reject, "not yet").unwrap();
    let reply = site.client.ask(refusal).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    site.asks();
    let before = site.decisions();
    let between = Between::before(&site.folder.path().join("engine.sock"));
    *between.known.lock().unwrap() = Known {
        of_ben: serde_json::to_value(site.question("ben")).unwrap(),
        older: serde_json::to_value(older).unwrap(),
    };
    let ann = site.key("ann");
    for (what, asked, answered) in attacks() {
        *between.alter.lock().unwrap() = (asked, answered);
        // A finding of the approver's own program is not even sent.
        if let Ok(reply) = Person::at(&between.socket).approves(&ann) {
            let Reply::Refused { code, .. } = &reply else { panic!("{what}: {reply:?}") };
            let found = matches!(code, Refusal::Stale | Refusal::NotAllowed | Refusal::NotFound);
            assert!(found, "{what}: {reply:?}");
        }
        let open = site.snapshot().prompts.remove(0);
        assert!(open.approved_by.is_empty(), "{what}: {:?}", open.approved_by);
        assert_eq!(site.decisions(), before, "{what}");
    }
    // Unaltered messages pass, with or without the program in between, and the signed content is on record.
    *between.alter.lock().unwrap() = (nothing, nothing);
    let reply = Person::at(&between.socket).approves(&ann).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    assert_eq!(site.decisions(), before + 1);
    let folder = site.ends();
    let report = verify(&Layout::new(folder.path()).database(), None).unwrap();
    assert_eq!(report.approvals, 2);
    let views = Views::open(&Layout::new(folder.path()).database()).unwrap();
    let filter = AuditFilter { kind: Some(RecordKind::Shown), ..AuditFilter::default() };
    let shown = views.audit(&filter).unwrap().pop().unwrap();
    let body: Value = serde_json::from_str(&shown.body).unwrap();
    assert!(body["lines"].to_string().contains("You are asked as ann, safety"), "{body}");
    let told: ApprovalFacts = serde_json::from_str(body["facts"].as_str().unwrap()).unwrap();
    assert_eq!(json!(render(&told)), body["lines"]);
}
