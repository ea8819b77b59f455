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
use holdpoint::governance::approval::{ApprovalDecision, Requester, Role};
use holdpoint::governance::ids::{CapabilityId, canonical_json};
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::approval_document::{ApprovalDocument, ApprovalFacts};
use holdpoint::protocol::command::{Command, Operation, Refusal, Reply, Request};
use holdpoint::protocol::snapshot::RequestKind;
use holdpoint::protocol::wire::ClientMessage;
use holdpoint::registry::{Store, Views, verify};
use holdpoint::service::control_socket::Client;
use holdpoint::store::{AuditFilter, Layout};
use holdpoint::wording::approval::render;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::quick_folder::quick_folder;
use crate::signed_requests::{engine, person, store, test_passphrase};

/// A generous time limit.
const PATIENCE: Duration = Duration::from_mins(1);
const VERSION: &str = "grasp@1.0.0";

/// The altered part: of the person's requests, and of the answers.
type Alter = fn(&mut Value, &EarlierMessages);

/// The earlier messages that the program in between has seen.
#[derive(Default)]
struct EarlierMessages {
    /// Another person's request.
    of_ben: Value,
    /// The request that was answered before this one.
    older: Value,
}

struct TamperingProxy {
    socket: PathBuf,
    alter: Arc<Mutex<(Alter, Alter)>>,
    known: Arc<Mutex<EarlierMessages>>,
    _folder: TempDir,
}

const fn nothing(_: &mut Value, _: &EarlierMessages) {}

impl TamperingProxy {
    fn start(engine: &Path) -> Self {
        let folder = quick_folder();
        let socket = folder.path().join("engine.sock");
        let listener = UnixListener::bind(&socket).unwrap();
        let alter: Arc<Mutex<(Alter, Alter)>> = Arc::new(Mutex::new((nothing, nothing)));
        let known = Arc::new(Mutex::new(EarlierMessages::default()));
        let (engine, shared_alter, shared_known) =
            (engine.to_owned(), Arc::clone(&alter), Arc::clone(&known));
        std::thread::spawn(move || {
            for client in listener.incoming() {
                let (client, real) = (client.unwrap(), UnixStream::connect(&engine).unwrap());
                let (connection_alter, connection_known) =
                    (Arc::clone(&shared_alter), Arc::clone(&shared_known));
                std::thread::spawn(move || forward(client, real, &connection_alter, &connection_known));
            }
        });
        Self { socket, alter, known, _folder: folder }
    }
}

/// Passes lines on until one side ends; both directions are altered.
fn forward(
    mut client: UnixStream,
    mut real: UnixStream,
    alter: &Mutex<(Alter, Alter)>,
    known: &Mutex<EarlierMessages>,
) -> Option<()> {
    let (mut requests, mut answers) =
        (BufReader::new(client.try_clone().ok()?).lines(), BufReader::new(real.try_clone().ok()?).lines());
    writeln!(client, "{}", answers.next()?.ok()?).ok()?;
    loop {
        let (alter_request, alter_answer) = *alter.lock().unwrap();
        let mut request: Value = serde_json::from_str(&requests.next()?.ok()?).ok()?;
        alter_request(&mut request, &known.lock().unwrap());
        writeln!(real, "{request}").ok()?;
        let mut answer: Value = serde_json::from_str(&answers.next()?.ok()?).ok()?;
        alter_answer(&mut answer, &known.lock().unwrap());
        writeln!(client, "{answer}").ok()?;
    }
}

/// The approver's program, over any socket that it takes for the engine's.
struct ApproverClient {
    stream: UnixStream,
    answers: std::io::Lines<BufReader<UnixStream>>,
}

impl ApproverClient {
    fn at(socket: &Path) -> Self {
        let stream = UnixStream::connect(socket).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut answers = BufReader::new(stream.try_clone().unwrap()).lines();
        let hello = answers.next().unwrap().unwrap();
        assert!(hello.contains("\"hello\""), "{hello}");
        Self { stream, answers }
    }

    fn send(&mut self, command: Command) -> Reply {
        let id = Nonce::random().unwrap().to_string();
        let call = ClientMessage::Ask { request: Box::new(Request::unsigned(id, command)) };
        writeln!(self.stream, "{}", serde_json::to_string(&call).unwrap()).unwrap();
        let answer: Value = serde_json::from_str(&self.answers.next().unwrap().unwrap()).unwrap();
        serde_json::from_value(answer["reply"].clone()).unwrap()
    }

    /// Gets the approval request and approves what is shown; an error is a finding of the approver's own program.
    fn approve(&mut self, who: &Identity) -> Result<Reply, String> {
        let (version, name) = (version(), who.info().name.clone());
        let request =
            Command::Question { version: version.clone(), purpose: RequestKind::Release, who: name.clone() };
        let question = match self.send(request) {
            Reply::Question { question } => question,
            other => return Ok(other),
        };
        question.bound(&version, RequestKind::Release, &name).map_err(|error| error.to_string())?;
        let command =
            question.answer(who, ApprovalDecision::Approve, "read").map_err(|error| error.to_string())?;
        Ok(self.send(command))
    }
}

fn version() -> CapabilityId {
    VERSION.parse().unwrap()
}

/// The approval request in a reply, as JSON; nothing for another reply.
fn question(answer: &mut Value) -> Option<&mut Value> {
    answer.get_mut("reply")?.get_mut("question")
}

fn facts(document: &Value) -> ApprovalFacts {
    serde_json::from_str(document["facts"].as_str().unwrap()).unwrap()
}

/// Alters the facts: only their text, and the lines that go with it.
fn lie(answer: &mut Value, whole: bool, lie: impl FnOnce(&mut ApprovalFacts)) {
    let Some(question) = question(answer) else { return };
    let mut false_facts = facts(question);
    lie(&mut false_facts);
    question["facts"] = json!(canonical_json(&false_facts).unwrap());
    if whole {
        question["lines"] = json!(render(&false_facts));
    }
}

fn change_lines(answer: &mut Value, change: impl FnOnce(&mut Vec<Value>)) {
    if let Some(lines) = question(answer).and_then(|question| question["lines"].as_array_mut()) {
        change(lines);
    }
}

fn set_field(answer: &mut Value, name: &str, value: Value) {
    if let Some(question) = question(answer) {
        question[name] = value;
    }
}

/// A field of the decision on its way to the engine.
fn change_decision(request: &mut Value, place: &[&str], value: Value) {
    let approval = request.pointer_mut("/request/command/signed/approval");
    let Some(approval) = approval else { return };
    let (last, above) = place.split_last().unwrap();
    let mut at = approval;
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
        ("a line altered", nothing, |a, _| change_lines(a, |lines| lines[2] = json!("All is well"))),
        ("lines removed", nothing, |a, _| {
            change_lines(a, |lines| lines.retain(|line| !line.to_string().contains("Not")));
        }),
        ("lines in another order", nothing, |a, _| change_lines(a, |lines| lines.swap(1, 2))),
        ("a blank in a line", nothing, |a, _| {
            change_lines(a, |lines| lines[0] = json!(format!("{} ", lines[0].as_str().unwrap())));
        }),
        ("two lines made one", nothing, |a, _| {
            change_lines(a, |lines| {
                let last = lines.pop().unwrap();
                let before = lines.pop().unwrap();
                lines.push(json!(format!("{}\n{}", before.as_str().unwrap(), last.as_str().unwrap())));
            });
        }),
        ("the renderer", nothing, |a, _| set_field(a, "renderer", json!(7))),
        ("the request", nothing, |a, _| set_field(a, "request", json!("7".repeat(32)))),
        ("the store's key", nothing, |a, _| set_field(a, "store_key", json!("0".repeat(64)))),
        ("the store", nothing, |a, _| set_field(a, "store_id", json!("another"))),
        ("a validity without end", nothing, |a, _| {
            set_field(a, "valid_until", json!("9999-12-31T00:00:00Z"));
        }),
        ("another's question", nothing, |a, known| {
            if let Some(question) = question(a) {
                question.clone_from(&known.of_ben);
            }
        }),
        ("another's lines", nothing, |a, known| set_field(a, "lines", known.of_ben["lines"].clone())),
        ("another's facts", nothing, |a, known| set_field(a, "facts", known.of_ben["facts"].clone())),
        ("an older question", nothing, |a, known| {
            if let Some(question) = question(a) {
                question.clone_from(&known.older);
            }
        }),
        ("an older question with the request of this one", nothing, |a, known| {
            set_field(a, "lines", known.older["lines"].clone());
            set_field(a, "facts", known.older["facts"].clone());
        }),
        (
            "asked for another person",
            |request, _| {
                if let Some(who) = request.pointer_mut("/request/command/who") {
                    *who = json!("ben");
                }
            },
            nothing,
        ),
        ("decision: who", |a, _| change_decision(a, &["who"], json!("ben")), nothing),
        ("decision: role", |a, _| change_decision(a, &["role"], json!("engineer")), nothing),
        ("decision: decision", |a, _| change_decision(a, &["decision"], json!("reject")), nothing),
        ("decision: reason", |a, _| change_decision(a, &["reason"], json!("as ordered")), nothing),
        ("decision: version", |a, _| change_decision(a, &["version"], json!("align@1.0.0")), nothing),
        ("decision: candidate", |a, _| change_decision(a, &["candidate_digest"], zeros(64)), nothing),
        ("decision: row version", |a, _| change_decision(a, &["row_version"], json!(99)), nothing),
        ("decision: evidence", |a, _| change_decision(a, &["evidence_digest"], zeros(64)), nothing),
        ("decision: policy", |a, _| change_decision(a, &["policy_digest"], zeros(64)), nothing),
        ("decision: profile", |a, _| change_decision(a, &["profile"], json!("sim")), nothing),
        ("decision: store", |a, _| change_decision(a, &["store_id"], json!("another")), nothing),
        ("decision: nonce", |a, _| change_decision(a, &["nonce"], zeros(32)), nothing),
        ("decision: validity", |a, _| change_decision(a, &["not_after_ms"], json!(1_u64 << 50)), nothing),
        ("decision: lines", |a, _| change_decision(a, &["shown", "lines"], zeros(64)), nothing),
        ("decision: facts", |a, _| change_decision(a, &["shown", "facts"], zeros(64)), nothing),
        ("decision: renderer", |a, _| change_decision(a, &["shown", "renderer"], json!(7)), nothing),
        ("decision: store key", |a, _| change_decision(a, &["shown", "store_key"], zeros(64)), nothing),
        ("decision: request", |a, _| change_decision(a, &["shown", "request"], zeros(32)), nothing),
        ("decision: nothing shown", |a, _| change_decision(a, &["shown"], Value::Null), nothing),
    ]
}

/// An engine under `human` that requests approvals for lifting a restriction, and all persons' keys.
struct RequestSite {
    folder: TempDir,
    client: Client,
    engine: Receiver<()>,
}

impl RequestSite {
    fn new() -> Self {
        let folder = store();
        let opened = Store::open(folder.path()).unwrap();
        for name in ["ann", "ben"] {
            person(&opened, name, Role::Safety, KeyEncoding::Sealed(&test_passphrase(), KdfCost::LEAST));
        }
        drop(opened);
        let (sender, receiver) = channel();
        let thread = engine(folder.path(), ProfileName::Human);
        std::thread::spawn(move || {
            thread.join().unwrap();
            sender.send(()).unwrap();
        });
        let client = Client::connect(&Layout::new(folder.path())).unwrap().expect("an engine answers");
        Self { folder, client, engine: receiver }
    }

    fn key(&self, name: &str) -> Identity {
        let folder = Layout::new(self.folder.path()).identities();
        Identity::open(&folder, name).unwrap().unlock(Some(&test_passphrase())).unwrap()
    }

    fn snapshot(&mut self) -> holdpoint::protocol::snapshot::Snapshot {
        let Reply::Snapshot { snapshot } = self.client.send(Command::Snapshot).unwrap() else {
            panic!("none")
        };
        *snapshot
    }

    fn operation() -> Operation {
        Operation { version: version(), by: "mara".to_owned(), reason: "a test".to_owned() }
    }

    /// Approvers are asked to lift the restriction.
    fn request_approval(&mut self) {
        let command = Command::Release { operation: Self::operation(), profiles: Vec::new() };
        let mara = self.key("mara");
        let seal = self.snapshot().signing.unwrap().sign(&mara, &command).unwrap();
        let reply = self.client.send_signed(command, Some(Box::new(seal))).unwrap();
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    }

    fn question(&mut self, who: &str) -> ApprovalDocument {
        let command =
            Command::Question { version: version(), purpose: RequestKind::Release, who: who.to_owned() };
        match self.client.send(command).unwrap() {
            Reply::Question { question } => *question,
            other => panic!("{other:?}"),
        }
    }

    /// The number of decisions on record.
    fn decisions(&self) -> usize {
        let views = Views::open(&Layout::new(self.folder.path()).database()).unwrap();
        let filter = |kind| AuditFilter { kind: Some(kind), ..AuditFilter::default() };
        let shown = views.audit(&filter(RecordKind::Shown)).unwrap().len();
        let put = views.audit(&filter(RecordKind::ApprovalPut)).unwrap().len();
        assert!(shown <= put, "{shown} of {put}");
        put
    }

    fn shut_down(mut self) -> TempDir {
        let _ = self.client.send(Command::Shutdown).unwrap();
        self.engine.recv_timeout(PATIENCE).unwrap();
        self.folder
    }
}

#[test]
fn no_altered_message_is_accepted() {
    let mut site = RequestSite::new();
    let reply = site.client.send(Command::Restrict(RequestSite::operation())).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    // An answered request: every listener knows its lines and facts.
    site.request_approval();
    let older = site.question("ann");
    let ben = site.key("ben");
    let refusal = site.question("ben").answer(&ben, ApprovalDecision::Reject, "not yet").unwrap();
    let reply = site.client.send(refusal).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    site.request_approval();
    let before = site.decisions();
    let proxy = TamperingProxy::start(&site.folder.path().join("engine.sock"));
    *proxy.known.lock().unwrap() = EarlierMessages {
        of_ben: serde_json::to_value(site.question("ben")).unwrap(),
        older: serde_json::to_value(older).unwrap(),
    };
    let ann = site.key("ann");
    for (what, alter_request, alter_answer) in attacks() {
        *proxy.alter.lock().unwrap() = (alter_request, alter_answer);
        // A finding of the approver's own program is not even sent.
        if let Ok(reply) = ApproverClient::at(&proxy.socket).approve(&ann) {
            let Reply::Refused { code, .. } = &reply else { panic!("{what}: {reply:?}") };
            let is_expected = matches!(code, Refusal::Stale | Refusal::NotAllowed | Refusal::NotFound);
            assert!(is_expected, "{what}: {reply:?}");
        }
        let open = site.snapshot().prompts.remove(0);
        assert!(open.approved_by.is_empty(), "{what}: {:?}", open.approved_by);
        assert_eq!(site.decisions(), before, "{what}");
    }
    // Unaltered messages pass, with or without the program in between, and the signed content is on record.
    *proxy.alter.lock().unwrap() = (nothing, nothing);
    let reply = ApproverClient::at(&proxy.socket).approve(&ann).unwrap();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    assert_eq!(site.decisions(), before + 1);
    let folder = site.shut_down();
    let report = verify(&Layout::new(folder.path()).database(), None).unwrap();
    assert_eq!(report.approvals, 2);
    let views = Views::open(&Layout::new(folder.path()).database()).unwrap();
    let filter = AuditFilter { kind: Some(RecordKind::Shown), ..AuditFilter::default() };
    let record = views.audit(&filter).unwrap().pop().unwrap();
    let body: Value = serde_json::from_str(&record.body).unwrap();
    let facts: ApprovalFacts = serde_json::from_str(body["facts"].as_str().unwrap()).unwrap();
    let asked = facts.asked.as_ref().unwrap();
    assert_eq!((asked.name.as_str(), asked.role.name()), ("ann", "safety"));
    assert_eq!(json!(render(&facts)), body["lines"]);
}
