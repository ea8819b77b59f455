//! Exports with the content of a sound one, in another notation or with signatures that only some verifiers accept:
//! neither verifier accepts one.

use std::fs;
use std::path::Path;
use std::process::Command;

use holdpoint_audit::export_file::verify_export;
use holdpoint_audit::history_error::HistoryError;

use crate::forged::{Keys, RepairedParts, repair_export};
use crate::quick_folder::quick_folder;
use crate::released::schema_1;
use crate::support::*;
use crate::tree::{JsonNode, Letters};
use crate::verifiers::{
    export_lines, has_python, problem_kind, python_and_script, sample_stores, verify_by_both,
    verify_contents_by_both,
};

const SIGNATURES_ONLY: RepairedParts = RepairedParts { chain: false, links: false, signatures: true };
const CHAIN_AND_SIGNATURES: RepairedParts = RepairedParts { chain: true, links: false, signatures: true };

fn raw(text: &str) -> JsonNode {
    JsonNode::Raw(text.to_owned())
}

fn text(text: &str) -> JsonNode {
    JsonNode::Text(text.to_owned())
}

/// The values of an object without their names: serde accepts that for a struct as well.
fn list_values(node: &mut JsonNode) {
    if let JsonNode::Object(fields) = node {
        *node = JsonNode::List(fields.drain(..).map(|(_, value)| value).collect());
    }
}

fn written(lines: &[JsonNode]) -> String {
    lines.iter().map(|line| line.written(Letters::Ascii) + "\n").collect()
}

/// Edits a node if the edit applies to it.
type NodeEdit<'a> = &'a dyn Fn(&mut JsonNode) -> Option<()>;

/// Edits the body of the first record of a kind.
fn edit_body(line: &mut JsonNode, kind: &str, edit: NodeEdit<'_>) -> Option<()> {
    if line.text(&["record", "kind"])? != kind {
        return None;
    }
    let mut body = JsonNode::parse(line.text(&["record", "body"])?)?;
    edit(&mut body)?;
    line.set(&["record", "body"], JsonNode::Text(body.written(Letters::All)));
    Some(())
}

fn turn_into_list(line: &mut JsonNode, path: &[&str]) -> Option<()> {
    line.at_mut(path).map(list_values)
}

fn add_field(line: &mut JsonNode, path: &[&str], name: &str, value: &str) -> Option<()> {
    let JsonNode::Object(fields) = line.at_mut(path)? else { return None };
    if fields.iter().any(|(field, _)| field == name) {
        return None;
    }
    fields.push((name.to_owned(), raw(value)));
    Some(())
}

fn duplicate_field(line: &mut JsonNode, path: &[&str]) -> Option<()> {
    let JsonNode::Object(fields) = line.at_mut(path)? else { return None };
    fields.push(fields.last()?.clone());
    Some(())
}

/// The first line that is edited, once for each store in which there is one; everything is signed again.
#[test]
fn other_notation_is_refused_by_both_verifiers() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    let sound_exports: Vec<(Vec<JsonNode>, Keys)> = sample_stores(root.path())
        .iter()
        .map(|store| {
            let lines =
                export_lines(store, &file).iter().map(|line| JsonNode::parse(line).unwrap()).collect();
            (lines, Keys::of(store))
        })
        .collect();
    let edits: Vec<(&str, NodeEdit<'_>)> = vec![
        ("a list for the first line", &|line| turn_into_list(line, &["export"])),
        ("a list for a record", &|line| turn_into_list(line, &["record"])),
        ("a list for a head", &|line| turn_into_list(line, &["head"])),
        ("a list for the end", &|line| turn_into_list(line, &["end"])),
        ("a list for a link", &|line| turn_into_list(line, &["head", "link"])),
        ("a list for an approval", &|line| turn_into_list(line, &["approval", "approval"])),
        ("a list for what is signed of it", &|line| turn_into_list(line, &["approval"])),
        ("a list for an act", &|line| {
            edit_body(line, "person-enrolled", &|body| turn_into_list(body, &["change", "act"]))
        }),
        ("a list for a change", &|line| {
            edit_body(line, "person-enrolled", &|body| turn_into_list(body, &["change"]))
        }),
        ("a list for a body", &|line| edit_body(line, "person-revoked", &|body| turn_into_list(body, &[]))),
        ("a list for a word", &|line| {
            edit_body(line, "witness-set", &|body| turn_into_list(body, &["change", "act", "act"]))
        }),
        ("a list for a put", &|line| {
            edit_body(line, "approval-put", &|body| turn_into_list(body, &["change"]))
        }),
        ("no gap", &|line| add_field(line, &["head", "link"], "gap", "false")),
        ("none earlier", &|line| add_field(line, &["end", "link"], "earlier", "0")),
        ("no fold", &|line| add_field(line, &["head"], "fold", "null")),
        ("no link", &|line| add_field(line, &["head"], "link", "null")),
        ("no emergency", &|line| add_field(line, &["approval", "approval"], "break_glass", "false")),
        ("not guarded", &|line| {
            edit_body(line, "person-enrolled", &|body| {
                add_field(body, &["change", "act"], "guarded", "false")
            })
        }),
        ("no word", &|line| {
            edit_body(line, "witness-set", &|body| {
                body.at_mut(&["change", "act"]).map(|act| *act = raw("null"))
            })
        }),
        ("a stray field", &|line| add_field(line, &["record"], "stray", "1")),
        ("a stray field of a body", &|line| {
            edit_body(line, "approval-put", &|body| add_field(body, &[], "stray", "1"))
        }),
        ("a stray field of a rebuild", &|line| {
            edit_body(line, "store-rebuilt", &|body| add_field(body, &["change"], "stray", "1"))
        }),
        ("a field twice", &|line| duplicate_field(line, &["record"])),
        ("a field of a body twice", &|line| {
            edit_body(line, "approval-put", &|body| duplicate_field(body, &["change"]))
        }),
        ("a fraction", &|line| line.at_mut(&["head", "seq"]).map(|seq| *seq = raw("1.0"))),
        ("a power", &|line| line.at_mut(&["record", "wall_ms"]).map(|wall| *wall = raw("1e3"))),
        ("no number", &|line| line.at_mut(&["record", "wall_ms"]).map(|wall| *wall = raw("NaN"))),
        ("minus nothing", &|line| line.at_mut(&["record", "wall_ms"]).map(|wall| *wall = raw("-0"))),
        ("too large", &|line| {
            line.at_mut(&["record", "wall_ms"]).map(|wall| *wall = raw("9223372036854775808"))
        }),
        ("a truth for a number", &|line| line.at_mut(&["export", "version"]).map(|one| *one = raw("true"))),
        ("a fraction in a body", &|line| {
            edit_body(line, "approval-put", &|body| {
                body.at_mut(&["change", "row_version"]).map(|version| *version = raw("4.0"))
            })
        }),
        ("other escapes", &|line| line.at_mut(&["record", "kind"]).map(|kind| *kind = raw("\"\\u0061\""))),
        ("half a character", &|line| {
            line.at_mut(&["record", "subject"]).map(|kind| *kind = raw("\"\\ud800\""))
        }),
        ("deep in a rebuild", &|line| {
            edit_body(line, "store-rebuilt", &|body| {
                body.at_mut(&["change", "by"]).map(|by| *by = raw(&("[".repeat(100) + &"]".repeat(100))))
            })
        }),
    ];
    let (mut cases, mut contents) = (Vec::new(), Vec::new());
    for (case, edit) in edits {
        let before = cases.len();
        for (lines, keys) in &sound_exports {
            let mut lines = lines.clone();
            if lines.iter_mut().find_map(edit).is_none() {
                continue;
            }
            repair_export(&mut lines, keys, CHAIN_AND_SIGNATURES);
            cases.push(case);
            contents.push(written(&lines));
        }
        assert!(cases.len() > before, "{case} is nowhere");
    }
    for (case, verdict) in cases.iter().zip(verify_contents_by_both(root.path(), &contents)) {
        assert!(verdict.is_err(), "{case}");
    }
}

#[test]
fn other_bytes_are_refused_by_both_verifiers() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    let store = sample_stores(root.path()).remove(0);
    let whole = export_lines(&store, &file).join("\n") + "\n";
    let cases = [
        ("a mark at the beginning", format!("\u{feff}{whole}")),
        ("a blank at the beginning", format!(" {whole}")),
        ("carriage returns", whole.replace('\n', "\r\n")),
        ("a blank in a line", whole.replacen("\"seq\":5,", "\"seq\": 5,", 1)),
        ("a blank behind a line", whole.replacen("}\n", "} \n", 1)),
        ("an empty line", format!("{whole}\n")),
        ("a word more", format!("{whole}null\n")),
        ("an end without a line feed", format!("{whole} ")),
        ("letters that are escapes", whole.replacen("grasp", "gr\u{e4}sp", 1)),
        ("an escape for a letter", whole.replacen("grasp", "gr\\u0061sp", 1)),
        ("two lines in one", whole.replacen("}\n", "} ", 1)),
    ];
    let mut contents: Vec<Vec<u8>> = cases.iter().map(|(_, text)| text.clone().into_bytes()).collect();
    let mut bytes = whole.into_bytes();
    let at = bytes.windows(5).position(|five| five == b"grasp").unwrap();
    bytes[at] = 0xff;
    contents.push(bytes);
    let mut verdicts = verify_contents_by_both(root.path(), &contents);
    assert!(matches!(verdicts.pop(), Some(Err(HistoryError::Line { .. }))), "no UTF-8");
    for ((case, _), verdict) in cases.iter().zip(verdicts) {
        assert!(verdict.is_err(), "{case}");
    }
}

/// A key of mixed order and its signature over the first approval of the released store, for which the digest of the
/// signature is a multiple of eight. A verifier that skips the check of the key's order accepts it, with OpenSSL as
/// with dalek.
const MIXED_ORDER_KEY: (&str, &str) = (
    "b392281631eb3c35c09b37c6803a41e4f7898c72ed48783796d90492d0e4ea62",
    "fa42cb126aad8e268eec40aeb06c908831c98b28ed7f565166a265a57cacda28\
     cae31e3ac35270c0ccabe9bcd3683f951eb41632b351524648d3def830c86501",
);
/// A key of small order with its signature over any text.
const SMALL_ORDER_KEY: (&str, &str) = (
    "0100000000000000000000000000000000000000000000000000000000000000",
    "0100000000000000000000000000000000000000000000000000000000000000\
     0000000000000000000000000000000000000000000000000000000000000000",
);

/// The released store, whose approvals have no person on record: an attacker with an editor signs them again.
fn released(root: &Path, file: &Path) -> (Vec<JsonNode>, Keys) {
    let store = schema_1(root);
    let opened = open(&store);
    opened.commit(transaction("one more", opened.opening().head.at_ms, Vec::new())).unwrap();
    drop(opened);
    let lines = export_lines(&store, file).iter().map(|line| JsonNode::parse(line).unwrap()).collect();
    (lines, Keys::of(&store))
}

#[test]
fn keys_of_small_or_mixed_order_are_refused_by_both_verifiers() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    let (lines, _) = released(root.path(), &file);
    verify_by_both(&file).unwrap();
    for (key, signature) in [MIXED_ORDER_KEY, SMALL_ORDER_KEY] {
        let mut lines = lines.clone();
        let approval = lines.iter_mut().find_map(|line| line.at_mut(&["approval"])).unwrap();
        approval.set(&["public_key"], text(key));
        approval.set(&["signature"], text(signature));
        fs::write(&file, written(&lines)).unwrap();
        let error = verify_by_both(&file).unwrap_err();
        assert!(matches!(error, HistoryError::Approval { .. }), "{error}");
    }
    // The equation alone accepts the first signature.
    let bytes = |digits: &str| holdpoint_text::hex::unhex::<32>(digits).unwrap();
    let mixed = ed25519_dalek::VerifyingKey::from_bytes(&bytes(MIXED_ORDER_KEY.0)).unwrap();
    assert!(!mixed.is_weak() && !mixed.to_edwards().is_torsion_free());
    // As the key of a whole store.
    for (key, _) in [MIXED_ORDER_KEY, SMALL_ORDER_KEY] {
        let mut lines = lines.clone();
        lines[0].set(&["export", "public_key"], text(key));
        fs::write(&file, written(&lines)).unwrap();
        assert!(matches!(verify_by_both(&file), Err(HistoryError::Line { line: 1, .. })));
    }
}

#[test]
fn approval_that_differs_from_its_record_is_refused() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    let (lines, keys) = released(root.path(), &file);
    let mut whole = lines.clone();
    repair_export(&mut whole, &keys, SIGNATURES_ONLY);
    fs::write(&file, written(&whole)).unwrap();
    verify_by_both(&file).unwrap();
    let long = "a".repeat(4097);
    let cases = [
        ("role", text("captain"), "line"),
        ("role", text("safety"), "approval"),
        ("decision", text("maybe"), "line"),
        ("profile", text("lab"), "line"),
        ("profile", text("real"), "approval"),
        ("version", text("align"), "line"),
        ("version", text("align@1.2"), "line"),
        ("version", text("align@01.2.0"), "line"),
        ("version", text("align@1.2.0-01"), "line"),
        ("version", text("Align@1.2.0"), "line"),
        ("version", text("align@1.2.18446744073709551616"), "line"),
        ("version", text("align@9.9.9"), "approval"),
        ("who", text("eve"), "approval"),
        ("reason", text("another"), "approval"),
        ("reason", text(&long), "approval"),
        ("row_version", raw("9"), "approval"),
        ("not_after_ms", raw("18446744073709551615"), "approval"),
        ("nonce", text("0123456789abcdef0123456789abcdef"), "approval"),
        ("nonce", text("ABCDEF0123456789abcdef0123456789"), "line"),
        ("evidence_digest", text(&"0".repeat(64)), "approval"),
    ];
    let edited = |(field, value, _): &(&str, JsonNode, &str)| {
        let mut lines = lines.clone();
        let approval = lines.iter_mut().find_map(|line| line.at_mut(&["approval", "approval"])).unwrap();
        approval.set(&[*field], value.clone());
        repair_export(&mut lines, &keys, SIGNATURES_ONLY);
        written(&lines)
    };
    let contents: Vec<String> = cases.iter().map(edited).collect();
    for ((field, value, kind), verdict) in cases.iter().zip(verify_contents_by_both(root.path(), &contents)) {
        let error = verdict.err().unwrap_or_else(|| panic!("{field} {value:?} is taken"));
        assert_eq!(problem_kind(&error), *kind, "{field} {value:?}: {error}");
    }
}

/// Python's address space, KiB: a fraction of the size of the files below.
const PYTHON_KIB: u64 = 700 * 1024;

#[test]
fn endless_line_is_refused_with_little_memory() {
    let root = quick_folder();
    let file = root.path().join("store.jsonl");
    let store = sample_stores(root.path()).remove(0);
    let first = export_lines(&store, &file).remove(0);
    let marks = "{\\\"a\\\":[[],[],".to_owned() + &"[],".repeat(9 << 20);
    let (short, long) = (64_u32 << 10, 32_u32 << 20);
    for (start, bytes, expected) in [
        (String::new(), 1_u64 << 30, &*short.to_string()),
        ("{\"export\":{\"format\":\"".to_owned(), 1 << 30, &short.to_string()),
        (format!("{first}\n{{\"head\":{{\"store_id\":\""), 1 << 30, &short.to_string()),
        (format!("{first}\n{{\"record\":[[["), 1 << 30, &short.to_string()),
        (format!("{first}\n{{\"record\":{{\"seq\":"), 1 << 30, &long.to_string()),
        (format!("{first}\n{{\"record\":{{\"seq\":1,\"body\":\"{marks}\"}}}}\n"), 0, "line 2"),
    ] {
        fs::write(&file, &start).unwrap();
        fs::OpenOptions::new()
            .write(true)
            .open(&file)
            .unwrap()
            .set_len(bytes.max(start.len() as u64))
            .unwrap();
        let error = verify_export(&file, None).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        if !has_python() {
            continue;
        }
        let (python, script) = python_and_script();
        let limited = format!("ulimit -v {PYTHON_KIB}; exec \"$0\" \"$@\"");
        let mut command = Command::new("sh");
        command.arg("-c").arg(limited).arg(python).arg(script).arg(&file).arg("--json");
        let output = command.output().unwrap();
        let theirs = String::from_utf8(output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(1), "{theirs}{}", String::from_utf8_lossy(&output.stderr));
        assert!(theirs.contains(expected), "{theirs}");
    }
}
