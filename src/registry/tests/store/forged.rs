//! Makes an edited export consistent again, as an attacker with the keys of the store and its people can: then no hash
//! and no signature shows the edit.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use ed25519_dalek::{Signer as _, SigningKey};
use holdpoint_approvals::keyfile::read_secret;
use holdpoint_governance::ids::Digest;
use holdpoint_text::hex::{hex, unhex};
use sha2::{Digest as _, Sha256};

use crate::tree::{JsonNode, Letters};

/// The keys of a store and of its people.
pub struct Keys {
    store: SigningKey,
    people: BTreeMap<String, SigningKey>,
}

/// The parts of an edited export that are made consistent again.
#[derive(Clone, Copy, Debug)]
pub struct RepairedParts {
    /// Numbers and hashes of the records, and the values derived from them.
    pub chain: bool,
    /// Which checkpoint follows which.
    pub links: bool,
    /// Every signature.
    pub signatures: bool,
}

impl Keys {
    pub fn of(store: &Path) -> Self {
        let mut people = BTreeMap::new();
        for entry in fs::read_dir(store.join("keys/identities")).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|ending| ending == "key")
                && let Ok(key) = read_secret(&path)
            {
                people.insert(path.file_stem().unwrap().to_str().unwrap().to_owned(), key);
            }
        }
        assert!(!people.is_empty());
        Self { store: read_secret(&store.join("keys/store.key")).unwrap(), people }
    }

    /// The key of a person, or of another person if there is none.
    fn of_person(&self, name: Option<&str>) -> &SigningKey {
        let own = name.and_then(|name| self.people.get(name));
        own.or_else(|| self.people.values().next()).unwrap()
    }
}

fn text(text: impl Into<String>) -> JsonNode {
    JsonNode::Text(text.into())
}

/// The bytes of texts; `None` where one is none.
fn texts<'a>(node: &'a JsonNode, names: &[&str]) -> Option<Vec<&'a [u8]>> {
    names.iter().map(|name| node.text(&[name]).map(str::as_bytes)).collect()
}

fn digits(node: &JsonNode, path: &[&str]) -> Option<[u8; 32]> {
    unhex(node.text(path)?)
}

/// Signs `digest` with `key`, and sets the signature and the public key in `node`.
fn sign(node: &mut JsonNode, key: &SigningKey, digest: Digest) {
    node.set(&["public_key"], text(hex(key.verifying_key().as_bytes())));
    node.set(&["signature"], text(hex(&key.sign(digest.bytes()).to_bytes())));
}

/// The digest of an act about a person, after another.
fn of_act(act: &JsonNode) -> Option<Digest> {
    let first = texts(act, &["store_id"])?;
    let follows = digits(act, &["follows"])?;
    let middle = texts(act, &["act", "name", "role", "key"])?;
    let unprotected: &[u8] = if act.is_true(&["unprotected"]) { b"unprotected" } else { b"" };
    let last = texts(act, &["by", "reason", "nonce"])?;
    let mut parts = [first, vec![&follows], middle, vec![unprotected], last].concat();
    if act.is_true(&["guarded"]) {
        parts.push(b"guarded");
    }
    Some(Digest::of_parts("holdpoint/person-act/v1", &parts))
}

fn of_witness_act(act: &JsonNode) -> Option<Digest> {
    let after = digits(act, &["after"])?;
    let flag = |name: &'static str| if act.is_true(&[name]) { name.as_bytes() } else { b"" };
    let parts = [
        texts(act, &["store_id"])?,
        vec![&after],
        texts(act, &["folder"])?,
        vec![flag("present")],
        texts(act, &["by", "reason"])?,
        vec![flag("guarded")],
    ];
    Some(Digest::of_parts("holdpoint/witness-act/v1", &parts.concat()))
}

fn of_approval(approval: &JsonNode) -> Option<Digest> {
    let number = |name| approval.number(&[name]).map(u64::to_le_bytes);
    let (row_version, not_after) = (number("row_version")?, number("not_after_ms")?);
    let digests = |name| digits(approval, &[name]);
    let candidate = digests("candidate_digest")?;
    let (evidence, policy) = (digests("evidence_digest")?, digests("policy_digest")?);
    let mut parts = [
        texts(approval, &["store_id", "who", "role", "decision", "reason", "version"])?,
        vec![&candidate, &row_version, &evidence, &policy],
        texts(approval, &["profile", "nonce"])?,
        vec![&not_after],
    ]
    .concat();
    let alone = approval.is_true(&["break_glass"]);
    let Some(renderer) = approval.number(&["shown", "renderer"]) else {
        if alone {
            parts.push(b"break-glass");
        }
        return Some(Digest::of_parts("holdpoint/approval/v1", &parts));
    };
    let renderer = u32::try_from(renderer).ok()?.to_le_bytes();
    let (lines, facts) = (digits(approval, &["shown", "lines"])?, digits(approval, &["shown", "facts"])?);
    let shown_bytes = |name| approval.text(&["shown", name]).map(str::as_bytes);
    let over: [&[u8]; 4] = [if alone { b"break-glass" } else { b"" }, &renderer, &lines, &facts];
    parts.extend(over);
    parts.extend([shown_bytes("store_key")?, shown_bytes("request")?]);
    Some(Digest::of_parts("holdpoint/approval/v2", &parts))
}

fn of_record(record: &JsonNode) -> Option<Digest> {
    let prev = digits(record, &["prev"])?;
    let number = |name| record.number(&[name]).map(u64::to_le_bytes);
    let (seq, at_ms) = (number("seq")?, number("at_ms")?);
    let parts = [vec![prev.as_slice(), &seq, &at_ms], texts(record, &["kind", "subject", "body"])?].concat();
    Some(Digest::of_parts("holdpoint/audit/v1", &parts))
}

fn of_head(head: &JsonNode) -> Option<Digest> {
    let number = |path: &[&str]| head.number(path).map(u64::to_le_bytes);
    let (seq, at_ms, hash) = (number(&["seq"])?, number(&["at_ms"])?, digits(head, &["head"])?);
    let end = [texts(head, &["store_id"])?, vec![&seq, &at_ms, &hash]].concat();
    let fold = digits(head, &["fold"]);
    let fold: &[u8] = fold.as_ref().map_or(&[], |fold| fold);
    if head.at(&["link"]).is_none() {
        let domain = if fold.is_empty() { "holdpoint/checkpoint/v1" } else { "holdpoint/checkpoint/v2" };
        let fold = if fold.is_empty() { vec![] } else { vec![fold] };
        return Some(Digest::of_parts(domain, &[end, fold].concat()));
    }
    let (nth, previous) = (number(&["link", "number"])?, digits(head, &["link", "previous"])?);
    let gap = [u8::from(head.is_true(&["link", "gap"]))];
    let linked = vec![nth.as_slice(), &previous, &gap];
    match digits(head, &["root"]) {
        None => Some(Digest::of_parts("holdpoint/checkpoint/v3", &[end, linked, vec![fold]].concat())),
        Some(root) => {
            let earlier = head.number(&["link", "earlier"]).unwrap_or(0).to_le_bytes();
            let mut parts = [end, linked, vec![&earlier, &root, fold]].concat();
            let Some(JsonNode::Raw(wall_ms)) = head.at(&["wall_ms"]) else {
                return Some(Digest::of_parts("holdpoint/checkpoint/v4", &parts));
            };
            let wall_ms = wall_ms.parse::<i64>().ok()?.to_le_bytes();
            parts.push(&wall_ms);
            Some(Digest::of_parts("holdpoint/checkpoint/v5", &parts))
        }
    }
}

/// The root of the tree of RFC 9162 over these hashes.
fn root(hashes: &[Digest]) -> [u8; 32] {
    let joined = |parts: &[&[u8]]| -> [u8; 32] { Sha256::digest(parts.concat()).into() };
    match hashes {
        [] => joined(&[]),
        [one] => joined(&[&[0], one.bytes()]),
        more => {
            let (left, right) = more.split_at(more.len().next_power_of_two() / 2);
            joined(&[&[1], &root(left), &root(right)])
        }
    }
}

/// Repairs the lines of an export as far as they can be parsed.
pub fn repair_export(lines: &mut [JsonNode], keys: &Keys, parts: RepairedParts) {
    let store_id = lines[0].text(&["export", "store_id"]).unwrap_or_default().to_owned();
    let mut follows = Digest::of_parts("holdpoint/persons/v1", &[store_id.as_bytes()]);
    let (mut hashes, mut prev) = (Vec::new(), Digest::from_bytes([0; 32]));
    for record in lines.iter_mut().filter_map(|line| line.at_mut(&["record"])) {
        if parts.chain {
            record.set(&["seq"], JsonNode::Raw((hashes.len() + 1).to_string()));
            record.set(&["prev"], text(prev.to_string()));
        }
        repair_body(record, keys, parts, (&mut follows, prev));
        let hash = of_record(record);
        if let Some(hash) = hash.filter(|_| parts.chain) {
            record.set(&["hash"], text(hash.to_string()));
        }
        prev = hash.unwrap_or(prev);
        hashes.push(prev);
    }
    if parts.chain {
        lines[0].set(&["export", "records"], JsonNode::Raw(hashes.len().to_string()));
    }
    let (mut number, mut previous) = (0, Digest::from_bytes([0; 32]));
    for line in &mut *lines {
        let Some(name) = ["head", "end"].into_iter().find(|name| line.at(&[name]).is_some()) else {
            continue;
        };
        let Some(head) = line.at_mut(&[name]) else { continue };
        let seq = head.number(&["seq"]).and_then(|seq| usize::try_from(seq).ok());
        if let Some(upto) = seq.and_then(|seq| hashes.get(..seq)).filter(|_| parts.chain)
            && let Some(last) = upto.last()
        {
            head.set(&["head"], text(last.to_string()));
            head.set(&["root"], text(hex(&root(upto))));
        }
        if parts.links {
            head.set(&["link", "number"], JsonNode::Raw((number + 1).to_string()));
            head.set(&["link", "previous"], text(previous.to_string()));
        }
        let Some(digest) = of_head(head) else { continue };
        if parts.signatures {
            head.set(&["signature"], text(hex(&keys.store.sign(digest.bytes()).to_bytes())));
        }
        if head.at(&["link"]).is_some() {
            number = head.number(&["link", "number"]).unwrap_or(number);
        }
        let signature = head.text(&["signature"]).unwrap_or_default().as_bytes();
        previous = Digest::of_parts("holdpoint/checkpoint-digest/v1", &[digest.bytes(), signature]);
    }
    for approval in lines.iter_mut().filter_map(|line| line.at_mut(&["approval"])) {
        if let Some(digest) = approval.at(&["approval"]).and_then(of_approval).filter(|_| parts.signatures) {
            let key = keys.of_person(approval.text(&["approval", "who"]));
            sign(approval, key, digest);
        }
    }
}

/// Repairs the acts in a record's body.
fn repair_body(
    record: &mut JsonNode,
    keys: &Keys,
    parts: RepairedParts,
    (follows, prev): (&mut Digest, Digest),
) {
    let Some(kind) = record.text(&["kind"]).map(str::to_owned) else { return };
    let Some(mut body) = record.text(&["body"]).and_then(JsonNode::parse) else { return };
    let is_person = kind.starts_with("person-");
    let path: &[&str] = if is_person { &["change"] } else { &["change", "act"] };
    let Some(change) = body.at_mut(path).filter(|_| is_person || kind == "witness-set") else { return };
    let Some(act) = change.at_mut(&["act"]) else { return };
    if parts.chain {
        let (name, value) = if is_person { ("follows", *follows) } else { ("after", prev) };
        act.set(&[name], text(value.to_string()));
    }
    let digest = if is_person { of_act(act) } else { of_witness_act(act) };
    let by = act.text(&["by"]).map(str::to_owned);
    if let Some(digest) = digest {
        if parts.signatures {
            sign(change, keys.of_person(by.as_deref()), digest);
        }
        if is_person {
            *follows = digest;
        }
    }
    record.set(&["body"], text(body.written(Letters::All)));
}
