//! Signed requests, from outside: under `real` and `human` only an enrolled person's signature grants authority,
//! once, for this engine and this request. A stop and every act that takes authority away need no signature.

use std::path::Path;
use std::thread::JoinHandle;

use holdpoint::approvals::keyfile::KeyEncoding;
use holdpoint::approvals::{Identity, KdfCost, Passphrase, SignedCall};
use holdpoint::governance::approval::Role;
use holdpoint::governance::profile::ProfileName;
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::approval_document::QuestionRefusal;
use holdpoint::protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint::protocol::signing_refusal::SigningRefusal;
use holdpoint::protocol::snapshot::{SigningView, Snapshot};
use holdpoint::registry::{Store, Views};
use holdpoint::service::control_socket::Client;
use holdpoint::store::{AuditFilter, Change, Layout, Transaction};
use holdpoint_wording::request::{refusal, signing_refusal};
use serde_json::Value;
use tempfile::TempDir;

use crate::quick_folder::quick_folder;
use crate::socket::prepared_engine;

const CANDIDATE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/manifests/candidates/grasp-tool-frame");

pub fn test_passphrase() -> Passphrase {
    Passphrase::new("under the oak".to_owned().into()).unwrap()
}

/// A store whose persons were enrolled before an engine runs on it: mara and omar, and the first administrator.
pub fn store() -> TempDir {
    let folder = quick_folder();
    let store = Store::open(folder.path()).unwrap();
    store.first_administrator(0).unwrap();
    for name in ["mara", "omar"] {
        person(&store, name, Role::Operator, KeyEncoding::Sealed(&test_passphrase(), KdfCost::LEAST));
    }
    person(&store, "open", Role::Engineer, KeyEncoding::Plain);
    folder
}

pub fn person(store: &Store, name: &str, role: Role, encoding: KeyEncoding<'_>) {
    let folder = store.layout().identities();
    let identity = Identity::create_encoded(&folder, name, role, encoding).unwrap();
    let persons = store.persons().unwrap();
    let plain = persons.unprotected_administrator(&folder).unwrap();
    plain.rewrite_key(&folder, KeyEncoding::Sealed(&test_passphrase(), KdfCost::LEAST)).unwrap();
    let admin = Identity::open(&folder, "admin").unwrap().unlock(Some(&test_passphrase())).unwrap();
    plain.rewrite_key(&folder, KeyEncoding::Plain).unwrap();
    let act = persons.enrolment(identity.info(), false, &admin, "a test").unwrap();
    write(store, format!("enrol-{name}"), Change::EnrolPerson(Box::new(act)));
}

fn write(store: &Store, command_id: String, change: Change) {
    let at_ms = store.views().unwrap().head().unwrap().at_ms;
    let transaction = Transaction { command_id, at_ms, wall_ms: 0, changes: vec![change], audit: Vec::new() };
    store.commit(transaction).unwrap();
}

/// An engine under a profile.
pub fn engine(folder: &Path, profile: ProfileName) -> JoinHandle<()> {
    prepared_engine(folder, profile, |_| ()).0
}

struct SigningClient {
    client: Client,
    folder: std::path::PathBuf,
}

impl SigningClient {
    fn connect(folder: &TempDir) -> Self {
        let client = Client::connect(&Layout::new(folder.path())).unwrap().expect("an engine answers");
        Self { client, folder: folder.path().to_owned() }
    }

    fn snapshot(&mut self) -> Snapshot {
        let Reply::Snapshot { snapshot } = self.client.send(Command::Snapshot).unwrap() else {
            panic!("none")
        };
        *snapshot
    }

    fn signing(&mut self) -> SigningView {
        self.snapshot().signing.expect("a running engine says what to sign")
    }

    fn key(&self, name: &str) -> Identity {
        let identity = Identity::open(&Layout::new(&self.folder).identities(), name).unwrap();
        let passphrase = test_passphrase();
        let plain = identity.protection() == holdpoint::approvals::keyfile::Protection::None;
        identity.unlock((!plain).then_some(&passphrase)).unwrap()
    }

    fn sign(&mut self, name: &str, command: &Command) -> SignedCall {
        self.signing().sign(&self.key(name), command).unwrap()
    }

    fn send_signed(&mut self, command: &Command, seal: &SignedCall) -> Reply {
        self.client.send_signed(command.clone(), Some(Box::new(seal.clone()))).unwrap()
    }

    #[track_caller]
    fn accepts(&mut self, command: &Command) {
        let reply = self.client.send(command.clone()).unwrap();
        assert!(matches!(reply, Reply::Accepted { .. } | Reply::Stopped { .. }), "{command:?}: {reply:?}");
    }

    #[track_caller]
    fn refuses(&mut self, command: &Command, seal: &SignedCall, code: Refusal, part: &str) {
        assert_refused(&self.send_signed(command, seal), code, part);
        assert!(self.snapshot().stopped.is_some(), "the cell stays stopped");
    }

    #[track_caller]
    fn refuses_signature(&mut self, command: &Command, seal: &SignedCall, why: &SigningRefusal) {
        self.refuses(command, seal, why.class(), &signing_refusal(why));
    }

    fn stop(&mut self) {
        self.accepts(&Command::Stop { by: "unknown-person".to_owned(), reason: String::new() });
        let stopped = self.snapshot().stopped.unwrap();
        STOPPED.set((stopped.since_ms, stopped.stops));
    }

    fn end(mut self, engine: JoinHandle<()>) {
        self.accepts(&Command::Shutdown);
        engine.join().unwrap();
    }
}

#[track_caller]
fn assert_refused(reply: &Reply, expected: Refusal, part: &str) {
    let Reply::Refused { code, text, hint } = reply else { panic!("{reply:?}") };
    let message = format!("{text} {}", hint.as_deref().unwrap_or_default());
    assert_eq!(*code, expected, "{message}");
    assert!(message.contains(part), "{part:?} is not in {message}");
}

thread_local! {
    /// The last standstill that this test requested: its start, virtual ms, and its stops.
    static STOPPED: std::cell::Cell<(u64, u64)> = const { std::cell::Cell::new((0, 0)) };
}

fn go(by: &str) -> Command {
    go_because(by, "the cell is empty")
}

fn go_because(by: &str, reason: &str) -> Command {
    let (since_ms, stops) = STOPPED.get();
    Command::Go { by: by.to_owned(), reason: reason.to_owned(), since_ms, stops }
}

fn operation(version: &str, by: &str) -> Operation {
    Operation { version: version.parse().unwrap(), by: by.to_owned(), reason: "a test".to_owned() }
}

fn register() -> Command {
    let package = holdpoint::runtime::capability::read(Path::new(CANDIDATE)).unwrap();
    Command::Register { package, name: "grasp-tool-frame".to_owned(), by: None }
}

/// The requesters on record, newest first.
fn request_records(folder: &TempDir) -> Vec<Value> {
    let filter = AuditFilter {
        kind: Some(RecordKind::Asked),
        newest_first: true,
        limit: 100,
        ..AuditFilter::default()
    };
    let views = Views::open(&Layout::new(folder.path()).database()).unwrap();
    views.audit(&filter).unwrap().iter().map(|record| serde_json::from_str(&record.body).unwrap()).collect()
}

fn check_single_use(profile: ProfileName) {
    let folder = store();
    let running = engine(folder.path(), profile);
    let mut client = SigningClient::connect(&folder);
    assert!(client.signing().required);
    client.stop();
    let unsigned = SigningRefusal::Unsigned { profile };
    for command in [go("mara"), register()] {
        let reply = client.client.send(command).unwrap();
        assert_refused(&reply, unsigned.class(), &signing_refusal(&unsigned));
    }

    // Only an enrolled person of a role that may let versions continue.
    let eve = Identity::create(&Layout::new(folder.path()).identities(), "eve", Role::Safety).unwrap();
    let view = client.signing();
    let by_eve = view.sign(&eve, &go("eve")).unwrap();
    let unknown = QuestionRefusal::NotEnrolled { name: "eve".to_owned(), administrator: "admin".to_owned() };
    client.refuses(&go("eve"), &by_eve, Refusal::NotAllowed, &refusal(&unknown));
    let by_admin = client.sign("admin", &go("admin"));
    let role = SigningRefusal::RoleGivesNothing { name: "admin".to_owned(), role: Role::Admin };
    client.refuses_signature(&go("admin"), &by_admin, &role);
    // Only the signed request, here and in time.
    let seal = client.sign("mara", &go("mara"));
    let other = go_because("mara", "another reason");
    let name = || "mara".to_owned();
    client.refuses_signature(&other, &seal, &SigningRefusal::OtherRequest { name: name() });
    let for_omar = client.sign("mara", &go("omar"));
    client.refuses_signature(&go("omar"), &for_omar, &SigningRefusal::OtherPerson { name: name() });
    let mara = client.key("mara");
    let elsewhere = SigningView { store_id: "another".to_owned(), ..view.clone() };
    let seal_of = |view: &SigningView| view.sign(&mara, &go("mara")).unwrap();
    let other_store = SigningRefusal::OtherStore { name: name() };
    client.refuses_signature(&go("mara"), &seal_of(&elsewhere), &other_store);
    let expired = SigningView { until_ms: 0, ..view.clone() };
    client.refuses_signature(&go("mara"), &seal_of(&expired), &SigningRefusal::Expired { name: name() });
    let for_ever = SigningView { until_ms: u64::MAX, ..view };
    let too_long = SigningRefusal::ValidTooLong { name: name(), max_s: 300 };
    client.refuses_signature(&go("mara"), &seal_of(&for_ever), &too_long);
    let mut forged = serde_json::to_value(&seal).unwrap();
    forged["claim"]["who"] = "omar".into();
    let forged: SignedCall = serde_json::from_value(forged).unwrap();
    client.refuses(&go("omar"), &forged, Refusal::NotAllowed, "another key");

    // An unencrypted key grants nothing where people are near.
    let by_open = client.sign("open", &go("open"));
    if profile == ProfileName::Human {
        let unprotected = QuestionRefusal::KeyUnprotected { name: "open".to_owned(), profile };
        client.refuses(&go("open"), &by_open, unprotected.class(), &refusal(&unprotected));
    } else {
        assert!(matches!(client.send_signed(&go("open"), &by_open), Reply::Accepted { .. }));
        // Her signature for that standstill is not valid for the next one.
        let before = go("mara");
        client.stop();
        client.refuses(&before, &seal, Refusal::NotNow, "stopped again");
    }

    // It counts once, and is on record.
    let mine = go("mara");
    let seal = client.sign("mara", &mine);
    let reply = client.send_signed(&mine, &seal);
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    assert_eq!(client.snapshot().stopped, None);
    let records = request_records(&folder);
    let newest = &records[0];
    assert_eq!(newest["asked"], "go");
    assert_eq!(
        newest["actor"],
        serde_json::json!({ "person": "mara", "role": "operator", "verified": true })
    );
    assert_eq!(newest["seal"], serde_json::to_value(&seal).unwrap());
    assert!(newest["caller"]["process"].is_number(), "{newest}");
    client.stop();
    client.refuses_signature(&mine, &seal, &SigningRefusal::UsedAlready { name: name() });

    // A second signature of hers is a different one; it submits a candidate, and resumes one.
    let by_mara = client.sign("mara", &register());
    let reply = client.send_signed(&register(), &by_mara);
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    client.accepts(&Command::Pause(operation("grasp@1.2.0", "unknown-person")));
    assert_eq!(request_records(&folder)[0].get("actor"), None, "a pause names no person");
    let resume = Command::Resume(operation("grasp@1.2.0", "mara"));
    let reply = client.client.send(resume.clone()).unwrap();
    assert_refused(&reply, unsigned.class(), &signing_refusal(&unsigned));
    let seal_of_resume = client.sign("mara", &resume);
    assert!(matches!(client.send_signed(&resume, &seal_of_resume), Reply::Accepted { .. }));

    // A signature for one session of an engine is invalid in the next, used or not.
    let later = go("mara");
    let unused = client.sign("mara", &later);
    client.end(running);
    let running = engine(folder.path(), profile);
    let mut client = SigningClient::connect(&folder);
    for (command, seal) in [(&mine, &seal), (&later, &unused)] {
        client.refuses_signature(command, seal, &SigningRefusal::EngineEnded { name: name() });
    }

    // A revoked key signs nothing any more.
    let persons = Views::open(&Layout::new(folder.path()).database()).unwrap().persons().unwrap();
    let admin = persons.unprotected_administrator(&Layout::new(folder.path()).identities()).unwrap();
    let act = persons.revocation(persons.named("omar").unwrap(), &admin, "left").unwrap();
    client.accepts(&Command::Person { signed: Box::new(act) });
    let by_omar = client.sign("omar", &go("omar"));
    let revoked = QuestionRefusal::KeyRevoked { name: "omar".to_owned(), by: "admin".to_owned() };
    client.refuses(&go("omar"), &by_omar, Refusal::NotAllowed, &refusal(&revoked));

    // An act that takes authority away needs no signature; a bad one does not block it.
    client.stop();
    let stop = Command::Stop { by: "omar".to_owned(), reason: "smoke".to_owned() };
    assert!(matches!(client.send_signed(&stop, &by_omar), Reply::Stopped { .. }));
    client.accepts(&Command::Pause(operation("grasp@1.2.0", "unknown-person")));
    client.accepts(&Command::Reject(operation("grasp@1.2.0", "unknown-person")));
    client.accepts(&Command::Restrict(operation("align@1.0.0", "unknown-person")));
    client.accepts(&Command::Vacate(operation("align@1.0.0", "unknown-person")));
    client.end(running);
}

#[test]
fn under_real_authority_needs_one_signature_of_an_enrolled_person() {
    check_single_use(ProfileName::Real);
}

#[test]
fn under_human_authority_needs_one_signature_of_an_enrolled_person() {
    check_single_use(ProfileName::Human);
}

#[test]
fn under_sim_a_signature_is_optional_and_counts_if_present() {
    let folder = store();
    let running = engine(folder.path(), ProfileName::Sim);
    let mut client = SigningClient::connect(&folder);
    assert!(!client.signing().required);
    client.stop();
    client.accepts(&go("unknown-person"));
    client.stop();
    let mine = go("mara");
    let seal = client.sign("mara", &mine);
    assert!(matches!(client.send_signed(&mine, &seal), Reply::Accepted { .. }));
    assert_eq!(request_records(&folder)[0]["actor"]["person"], "mara");
    client.stop();
    client.refuses_signature(&mine, &seal, &SigningRefusal::UsedAlready { name: "mara".to_owned() });
    client.end(running);
}

/// The verbs sign with `--as`, with a running engine or with one opened for the verb.
#[test]
fn the_verbs_sign_as_the_named_person() {
    use crate::old_stores::{holdpoint, text};
    use crate::reported_error::assert_error;
    let root = quick_folder();
    let oak = root.path().join("oak");
    std::fs::write(&oak, "under the oak\n").unwrap();
    std::fs::set_permissions(&oak, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    let oak = oak.to_str().unwrap();
    let data = root.path().join("store");
    let succeeds = |arguments: &[&str]| {
        let output = holdpoint(&root, arguments);
        let message = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {message}");
    };
    // The code of the error, and a command or an option that it advises.
    let fails = |arguments: &[&str], exit: i32, codes: &str, advice: &str| {
        let error = assert_error(&holdpoint(&root, &[arguments, &["--json"]].concat()), exit, codes);
        assert!(error.to_string().contains(advice), "{arguments:?}: {error}");
    };
    succeeds(&["identity", "new", "mara", "--passphrase-file", oak]);
    succeeds(&["identity", "new", "eve", "--unprotected"]);
    let running = engine(&data, ProfileName::Human);
    succeeds(&["stop"]);
    let go = ["go", "--stops", "1", "--reason", "empty", "--as"];
    fails(&[&go[..], &["eve"]].concat(), 3, "not-allowed", "identity passphrase eve");
    let go_mara = [&go[..], &["mara", "--passphrase-file", oak]].concat();
    // An unencrypted key enrolled her; the running engine receives the confirmation, and an enrollment, through its
    // socket.
    fails(&go_mara, 3, "not-allowed", "`holdpoint identity confirm mara --by admin --reason TEXT");
    let act = ["--by", "admin", "--reason", "known", "--passphrase-file", oak];
    let confirm = [&["identity", "confirm", "mara"][..], &act].concat();
    fails(&confirm[..7], 3, "not-allowed/no-passphrase", "identity passphrase admin");
    succeeds(&["identity", "passphrase", "admin", "--new-passphrase-file", oak]);
    succeeds(&confirm);
    fails(&confirm, 3, "exists/confirmed-already", "");
    succeeds(&["identity", "new", "omar", "--unprotected"]);
    succeeds(&[&["identity", "enrol", "omar"][..], &act].concat());
    let verified = holdpoint(&root, &["audit", "verify", "--json"]);
    let verified: Value = serde_json::from_slice(&verified.stdout).unwrap();
    assert_eq!((&verified["report"]["persons"], &verified["report"]["confirmed"]), (&4.into(), &3.into()));
    let output = holdpoint(&root, &["identity", "list", "--json"]);
    let people: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
    let row = |name: &str| people.iter().find(|one| one["name"] == name).unwrap();
    let by = |name: &str| row(name)["confirmed_by"].clone();
    assert_eq!((by("mara"), by("omar"), by("eve")), ("admin".into(), "admin".into(), Value::Null));
    assert_eq!((&row("omar")["role"], &row("omar")["state"]), (&"operator".into(), &"enrolled".into()));
    succeeds(&["identity", "list"]);
    succeeds(&go_mara);
    // Near people, your own name under a stop is not evidence that you read it.
    succeeds(&["stop", "--as", "mara"]);
    let go_unread = ["go", "--reason", "empty", "--as", "mara", "--passphrase-file", oak];
    fails(&go_unread, 3, "not-now", "names 0 stops");
    succeeds(&go_mara);
    fails(&["candidate", "register", CANDIDATE], 3, "not-allowed", "--as NAME");
    succeeds(&["identity", "new", "zoe", "--role", "admin", "--unprotected"]);
    fails(&[&["identity", "enrol", "zoe"][..], &act].concat(), 2, "usage", "`--role admin`");
    succeeds(&["stop"]);
    Client::connect(&Layout::new(&data)).unwrap().unwrap().send(Command::Shutdown).unwrap();
    running.join().unwrap();
    // Without an engine the store's last profile applies.
    fails(&["candidate", "register", CANDIDATE], 3, "not-allowed", "--as NAME");
    let register = ["candidate", "register", CANDIDATE, "--as", "mara", "--passphrase-file", oak];
    succeeds(&register);
    succeeds(&[&go[..], &["mara", "--passphrase-file", oak]].concat());
    succeeds(&["audit", "verify"]);
}
