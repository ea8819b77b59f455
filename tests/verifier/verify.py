#!/usr/bin/env python3
"""Verifies files of `holdpoint store export` without Holdpoint.

    verify.py FILE... [--key store.pub] [--json]

Needs Python 3.9 or newer and the package `cryptography`. Ends with 0 if every file is sound, with 1 if one is not, and with
2 if one cannot be read. It follows the form that the guide describes (src/guide/reference/record-format.md) and looks at the same things in
the same order: records with the acts about persons among them, signed heads, signed end, approvals. `form.py` beside it has
the form of lines and bodies, `curve.py` the rule for signatures.
"""

import argparse
import hashlib
import json
import os
import stat
import sys

# Whoever verifies leaves nothing beside the verifier.
sys.dont_write_bytecode = True

import shown
from curve import is_signed
from form import (
    DECISIONS, NAME, PROFILES, RECORD, REASON_BYTES_MAX, ROLES, Bad, body_of, digest, digits, fields, is_reason, lines,
    listed, number, public_key, reaches, set_field, signature_of, text, truth, version, whole, word,
)

HEADS_KEPT_MAX = 1000
# The most heads that a file may have.
HEADS_MAX = 10_000
PERSONS_MAX = 1000
KEY_FILE_BYTES_MAX = 1024
# Kinds of records whose bodies are read; those about persons with what their change and their act are called.
ACTS = {
    "person-enrolled": ("enrol-person", "enrol"),
    "person-confirmed": ("confirm-person", "confirm"),
    "person-revoked": ("revoke-person", "revoke"),
}
TAKEN = ("approval-put", "witness-set", "profile-allowed", "context-set", "store-rebuilt", *ACTS)
ZEROS = bytes(32)


def check_id(store_id, key):
    """Whether a store with this id signs with this key, as far as the id says: earlier versions drew theirs."""
    of_key = "key-" + digest("holdpoint/store-id/v1", key).hex()[:32]
    if store_id.startswith("key-") and store_id != of_key:
        raise Bad("line", 1, f"the store {store_id!r} does not sign with this key: it would be {of_key!r}")


class Tree:
    """The Merkle tree of RFC 9162: the roots of its complete subtrees, the largest first."""

    def __init__(self):
        self.size, self.peaks = 0, []

    def push(self, record_hash):
        right = hashlib.sha256(b"\x00" + record_hash).digest()
        size = self.size
        while size & 1:
            right = hashlib.sha256(b"\x01" + self.peaks.pop() + right).digest()
            size >>= 1
        self.peaks.append(right)
        self.size += 1

    def root(self):
        if not self.peaks:
            return hashlib.sha256(b"").digest()
        right = self.peaks[-1]
        for left in reversed(self.peaks[:-1]):
            right = hashlib.sha256(b"\x01" + left + right).digest()
        return right


class Head:
    """A signed head: the end of the chain at some moment."""

    def __init__(self, value, line):
        fields(value, "store_id", "seq", "at_ms", "head", "fold?", "link?", "root?", "wall_ms?", "signature")
        self.line, self.store_id, self.seq = line, value["store_id"], value["seq"]
        self.hash = digits(value["head"], 32)
        self.root = digits(value["root"], 32) if "root" in value else None
        self.wall_ms = whole(value["wall_ms"]) if "wall_ms" in value else None
        self.signature = signature_of(value["signature"])
        self.written = text(value["signature"])
        fold = digits(value["fold"], 32) if "fold" in value else None
        end = [text(self.store_id), number(self.seq), number(value["at_ms"]), self.hash]
        self.link = value.get("link")
        if "link" in value:
            link = fields(self.link, "number", "previous", "gap?", "earlier?")
            self.number, self.previous = link["number"], digits(link["previous"], 32)
            self.gap, self.earlier = truth(set_field(link, "gap", False)), set_field(link, "earlier", 0)
            linked = [number(self.number), self.previous, bytes([self.gap])]
            earlier = number(self.earlier)
            if self.root is not None:
                tree = [*end, *linked, earlier, self.root, fold or b""]
                if self.wall_ms is not None:
                    self.signed = digest("holdpoint/checkpoint/v5", *tree, self.wall_ms.to_bytes(8, "little", signed=True))
                else:
                    self.signed = digest("holdpoint/checkpoint/v4", *tree)
            else:
                self.signed = digest("holdpoint/checkpoint/v3", *end, *linked, fold or b"")
        else:
            self.number, self.previous, self.gap, self.earlier = 0, None, False, 0
            if fold is not None:
                self.signed = digest("holdpoint/checkpoint/v2", *end, fold)
            else:
                self.signed = digest("holdpoint/checkpoint/v1", *end)

    def digest(self):
        return digest("holdpoint/checkpoint-digest/v1", self.signed, self.written)

    def follows(self, before):
        """Why it does not follow from the one before, if it does not."""
        if self.root is None and self.wall_ms is not None:
            return "it has a wall time, and no tree head with which it is signed"
        if self.root is None and before is not None and before.root is not None:
            return "it has no tree head, although the one before has"
        if self.link is None:
            if before is not None and before.link is not None:
                return "it follows from no other"
            return None
        expected = (before.number if before else 0) + 1
        if self.gap or (self.number, self.previous) == (expected, before.digest() if before else ZEROS):
            return None
        if self.number > expected:
            return f"checkpoint number {self.number - 1}, which was before it, is missing"
        return f"checkpoint number {self.number} does not follow from the one before"


# What the record of an approval tells of it.
TOLD = (
    "change", "decision", "evidence_digest", "nonce", "not_after_ms", "policy_digest", "profile", "reason", "role",
    "row_version", "shown?", "who",
)


def told_of(subject, change):
    """What a record tells of an approval, in a few bytes."""
    told = [change[name] for name in TOLD if not name.endswith("?")]
    told.append(shown.told_of(change.get("shown")))
    return hashlib.sha256(json.dumps([subject, *told]).encode()).digest()


class Approval:
    """A person's decision, signed with a key that it carries."""

    def __init__(self, value):
        fields(value, "approval", "public_key", "signature")
        self.public_key, self.signature = text(value["public_key"]), signature_of(value["signature"])
        approval = fields(
            value["approval"], "who", "role", "decision", "reason", "version", "candidate_digest", "row_version",
            "evidence_digest", "policy_digest", "profile", "store_id", "nonce", "not_after_ms", "break_glass?",
            "shown?",
        )
        self.said = approval
        self.nonce, self.store_id, self.reason = approval["nonce"], approval["store_id"], approval["reason"]
        digits(self.nonce, 16)
        self.parts = [
            text(self.store_id),
            text(approval["who"]),
            text(word(approval["role"], ROLES)),
            text(word(approval["decision"], DECISIONS)),
            text(self.reason),
            version(approval["version"]),
            digits(approval["candidate_digest"], 32),
            number(approval["row_version"]),
            digits(approval["evidence_digest"], 32),
            digits(approval["policy_digest"], 32),
            text(word(approval["profile"], PROFILES)),
            text(self.nonce),
            number(approval["not_after_ms"]),
        ]
        alone = truth(set_field(approval, "break_glass", False))
        self.domain = "holdpoint/approval/v1"
        if set_field(approval, "shown", None) is not None:
            self.domain = "holdpoint/approval/v2"
            self.parts.extend(shown.parts_of(approval["shown"], alone))
        elif alone:
            self.parts.append(b"break-glass")
        self.told = told_of(approval["version"], {"change": "put-approval", **approval})

    def is_signed(self):
        try:
            key = public_key(self.public_key.decode())
        except ValueError:
            return False
        if len(text(self.reason)) > REASON_BYTES_MAX:
            return False
        return is_signed(key, self.signature, digest(self.domain, *self.parts))


class Persons:
    """Whose keys may decide, by the acts on record so far."""

    def __init__(self, store_id):
        self.store_id, self.follows = text(store_id), digest("holdpoint/persons/v1", text(store_id))
        self.keys, self.roles, self.revoked, self.confirmed = {}, {}, set(), set()
        # The profile in force and its rules; the rules that an administrator authorized and that are in force since; the last
        # authorization, its record and what it is for; whether authorizations of a class, or of rules, were asked for yet;
        # whether anybody but a script used the store where robots or people are at risk.
        self.profile, self.rules, self.authorized, self.allowed = None, None, None, None
        self.asked, self.ruled, self.was_live = False, False, False

    def take(self, record, change):
        """Takes an act: signed by an administrator who is enrolled, following from the act before."""
        fields(change, "act", "change", "public_key", "signature")
        act = fields(
            change["act"], "act", "by", "follows", "guarded?", "key", "name", "nonce", "reason", "role", "store_id",
            "unprotected",
        )
        guarded, name, by, kind, role, key = (
            truth(set_field(act, "guarded", False)), act["name"], act["by"], act["act"], act["role"], act["key"],
        )
        word(kind, [called for _, called in ACTS.values()])
        digits(act["nonce"], 16)
        signed = digest(
            "holdpoint/person-act/v1",
            text(act["store_id"]),
            digits(act["follows"], 32),
            text(kind),
            text(name),
            text(word(role, ROLES)),
            text(key),
            b"unprotected" if truth(act["unprotected"]) else b"",
            text(by),
            text(act["reason"]),
            text(act["nonce"]),
            *([b"guarded"] if guarded else []),
        )
        text(change["change"]), text(change["public_key"])
        signature = signature_of(change["signature"])
        if ACTS[record["kind"]] != (change["change"], kind) or record["subject"] != name:
            raise Bad("person", name, "the act differs from its record")
        if not NAME.fullmatch(name) or not is_reason(act["reason"]):
            raise Bad("person", name, "its name, or the reason of the act, is none")
        try:
            signer = public_key(change["public_key"])
            public_key(key)
        except ValueError as error:
            raise Bad("person", name, "a key of the act is none") from error
        if not is_signed(signer, signature, signed):
            raise Bad("person", name, f"the signature of {by!r} does not match the act")
        if text(act["store_id"]) != self.store_id or digits(act["follows"], 32) != self.follows:
            raise Bad("person", name, "the act does not follow from the one before it in this store")
        if not self.keys:
            if (kind, role, by, change["public_key"]) != ("enrol", "admin", name, key):
                raise Bad("person", name, "the first act enrols an administrator by that key itself")
        elif by in self.revoked or self.keys.get(by) != change["public_key"] or self.roles[by] != "admin":
            raise Bad("person", name, f"{by!r}, who signed, is no administrator who is enrolled")
        if kind == "enrol":
            if name in self.keys or key in self.keys.values():
                raise Bad("person", name, "a name and a key are used once")
            if len(self.keys) >= PERSONS_MAX:
                raise Bad("person", name, f"the store has {PERSONS_MAX} persons already")
            if not self.keys or (guarded and by in self.confirmed):
                self.confirmed.add(name)
            self.keys[name], self.roles[name] = key, role
        elif name in self.revoked or (self.keys.get(name), self.roles.get(name)) != (key, role):
            raise Bad("person", name, "nobody like that is enrolled")
        elif kind == "confirm":
            if name in self.confirmed or by not in self.confirmed or not guarded:
                raise Bad("person", name, "a confirmed administrator with a protected key confirms others, once")
            self.confirmed.add(name)
        else:
            administrators = [one for one, is_a in self.roles.items() if is_a == "admin" and one not in self.revoked]
            if administrators == [name]:
                raise Bad("person", name, "the last administrator cannot be revoked")
            self.revoked.add(name)
        self.follows = signed

    def take_witness(self, record, change):
        """Looks at an administrator's word on a witness, which earlier records do not have."""
        fields(change, "act?", "by", "change", "folder", "present")
        word(change["change"], ["set-witness"])
        text(change["by"]), text(change["folder"]), truth(change["present"])
        if "act" not in change:
            return
        said = fields(change["act"], "act", "public_key", "signature")
        act = fields(said["act"], "after", "by", "folder", "guarded", "present", "reason", "store_id")
        about = [text(act["folder"]), b"present" if truth(act["present"]) else b""]
        told = (act["folder"], act["present"]) == (change["folder"], change["present"])
        self.take_word(record, said, "holdpoint/witness-act/v1", about, told)

    def take_profile(self, record, change):
        """Looks at an administrator's authorization of a change of profile."""
        fields(change, "act", "by", "change", "profile")
        word(change["change"], ["allow-profile"])
        text(change["by"]), word(change["profile"], PROFILES)
        said = fields(change["act"], "act", "public_key", "signature")
        act = fields(said["act"], "after", "by", "guarded", "profile", "reason", "rules?", "store_id")
        told = word(act["profile"], PROFILES) == change["profile"]
        about, domain, after, human = [text(act["profile"])], "holdpoint/profile-act/v1", [], [self.profile]
        rules = set_field(act, "rules", None)
        if rules is not None:
            fields(rules, "from?", "loosened", "to")
            before = set_field(rules, "from", None)
            domain, human = "holdpoint/profile-act/v2", [self.profile, act["profile"]]
            after = [digits(before, 32) if before is not None else b"", digits(rules["to"], 32)]
            after += loosened_of(rules["loosened"])
        self.take_word(record, said, domain, about, told, after)
        if any(reaches(one, "human") for one in human) and not (act["guarded"] and act["by"] in self.confirmed):
            raise Bad("person", act["by"], "where people decide the key that signed has to be guarded")
        self.allowed, self.asked = (record["seq"], change["profile"], rules), True

    def take_context(self, record, change):
        """Takes a profile that comes into force; a change that takes one has an administrator's authorization right before it."""
        fields(change, "change", "json?", "looser_by_word?", "policy_digest", "profile", "rules?")
        word(change["change"], ["set-context"])
        if "json" in change:
            text(change["json"])
        digits(change["policy_digest"], 32), word(change["profile"], PROFILES)
        # What earlier versions wrote counts until the first record of one that asks for authorizations.
        asks = truth(set_field(change, "looser_by_word", False))
        rules = set_field(change, "rules", None)
        last, profile = self.profile, change["profile"]
        at_risk = [reaches(one, "real") for one in (last, profile)]
        seq, allowed_for, change_of_rules = self.allowed or (0, None, None)
        is_right_before = seq == record["seq"] - 1 and allowed_for == profile
        if rules is None:
            if self.ruled and any(at_risk):
                raise Bad("record", record["seq"], "it does not name its rules")
            is_looser = last is not None and PROFILES.index(profile) < PROFILES.index(last)
            if (self.asked or asks) and is_looser and not is_right_before:
                raise Bad("record", record["seq"], f"nobody signed that {profile} may come after {last}")
            scripted, name, needed = False, None, False
        else:
            fields(rules, "digest", "loosened", "scripted?", "settings")
            scripted, name = truth(set_field(rules, "scripted", False)), rules["digest"]
            digits(name, 32), loosened_of(rules["loosened"])
            settings = rules["settings"]
            if not isinstance(settings, dict):
                raise ValueError("its settings are none")
            for setting in settings.values():
                text(setting)
            looser = at_risk[1] and bool(rules["loosened"])
            if scripted and self.was_live:
                raise Bad("record", record["seq"], "a script uses a store that was used under real or human")
            if scripted:
                needed = False
            elif last is not None and self.rules == name:
                needed = looser and self.authorized != name
            else:
                needed = at_risk[0] or looser
            signed = {"from": self.rules, "loosened": rules["loosened"], "to": name}
            if self.rules is None:
                del signed["from"]
            if needed and not (is_right_before and change_of_rules == signed):
                raise Bad("record", record["seq"], f"no administrator authorized these rules of {profile}")
        if needed:
            self.authorized = name
        elif self.authorized != name:
            self.authorized = None
        self.profile, self.rules = profile, name
        self.asked, self.ruled = self.asked or asks, self.ruled or rules is not None
        self.was_live = self.was_live or (at_risk[1] and not scripted)

    def take_word(self, record, said, domain, about, told, after=()):
        """Looks at an administrator's word: what it is about, whether that is what the record says, whose it is."""
        act = said["act"]
        by = act["by"]
        signed = digest(
            domain,
            text(act["store_id"]),
            digits(act["after"], 32),
            *about,
            text(by),
            text(act["reason"]),
            b"guarded" if truth(act["guarded"]) else b"",
            *after,
        )
        text(said["public_key"])
        signature = signature_of(said["signature"])
        if not is_reason(act["reason"]):
            raise Bad("person", by, "the reason of the word is none")
        try:
            signer = public_key(said["public_key"])
        except ValueError as error:
            raise Bad("person", by, "a key of the word is none") from error
        if not is_signed(signer, signature, signed):
            raise Bad("person", by, "the signature does not match the word")
        if not told or (text(act["store_id"]), act["after"]) != (self.store_id, record["prev"]):
            raise Bad("person", by, "the word is of something else, or another end of the chain")
        if by in self.revoked or self.keys.get(by) != said["public_key"] or self.roles[by] != "admin":
            raise Bad("person", by, "who signed is no administrator who is enrolled")

    def key_of(self, who, role):
        """The key of somebody who is enrolled in that role; none before anybody was."""
        if self.keys and (who in self.revoked or who not in self.keys):
            raise LookupError("its approver was not enrolled then")
        if self.keys and self.roles[who] != role:
            raise LookupError("its approver has another role")
        return self.keys.get(who)


def loosened_of(value):
    """The fields that get looser, as they are hashed."""
    parts = []
    for one in listed(value):
        fields(one, "before", "field", "now", "shipped")
        parts += [text(one[name]) for name in ("field", "before", "shipped", "now")]
    return parts


def lost_by(change):
    """Looks at what the record of a rebuild says."""
    fields(
        change, "by", "change", "differed", "from_hash", "from_seq", "kept_as", "lost", "problem", "unsigned?",
    )
    word(change["change"], ["store-rebuilt"])
    digits(change["from_hash"], 32), number(change["from_seq"]), text(change["kept_as"]), text(change["problem"])
    number(set_field(change, "unsigned", 0))
    for row in listed(change["differed"]):
        fields(row, "columns", "key", "problem", "table")
        for told in (*listed(row["columns"]), row["key"], row["problem"], row["table"]):
            text(told)
    for row in listed(change["lost"]):
        for told in listed(row, 2):
            text(told)


class Export:
    """What was read of the file. Records are let go once they were looked at."""

    def __init__(self, header):
        self.header = header
        self.heads, self.end = [], None
        self.seq, self.last, self.at_ms = 0, ZEROS, 0
        self.tree, self.seen, self.spoken_of = Tree(), {}, set()
        self.put, self.lost, self.approvals = {}, set(), []
        self.persons = Persons(header["store_id"])
        self.shown = shown.Shown()

    def take(self, line, value):
        if not isinstance(value, dict) or len(value) != 1:
            raise Bad("line", line, "it is none of an exported store")
        (kind, content), = value.items()
        if kind in ("head", "end") and (self.seq > 0 or self.end is not None):
            raise Bad("line", line, "it does not belong here")
        if kind == "head" and len(self.heads) >= HEADS_MAX:
            raise Bad("line", line, f"it is one checkpoint more than {HEADS_MAX}, and so many are allowed")
        # One more than there can be: it is there twice, or no record names it.
        if kind == "approval" and len(self.approvals) > len(self.put):
            raise Bad("line", line, "no record names this further approval")
        try:
            if kind == "head":
                self.heads.append(Head(content, line))
                self.spoken_of.add(self.heads[-1].seq)
            elif kind == "end":
                self.end = Head(content, line)
                self.spoken_of.add(self.end.seq)
            elif kind == "record" and not self.approvals:
                self.take_record(content)
            elif kind == "approval":
                self.approvals.append(Approval(content))
            else:
                raise Bad("line", line, "it does not belong here")
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise Bad("line", line, str(error)) from error

    def take_record(self, record):
        seq = self.seq + 1
        fields(record, *RECORD)
        found, prev = digits(record["hash"], 32), digits(record["prev"], 32)
        hashed = [
            prev,
            number(record["seq"]),
            number(record["at_ms"]),
            text(record["kind"]),
            text(record["subject"]),
            text(record["body"]),
        ]
        whole(record["wall_ms"])
        if record["seq"] != seq:
            raise Bad("record", seq, f"it is missing; the next one is {record['seq']}")
        if prev != self.last:
            raise Bad("record", seq, "it does not follow from the record before")
        if found != digest("holdpoint/audit/v1", *hashed):
            raise Bad("record", seq, "its content does not match its hash")
        if record["at_ms"] < self.at_ms:
            raise Bad("record", seq, "it is older than the record before")
        try:
            self.take_body(record)
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise Bad("record", seq, f"its body is not of its form: {error}") from error
        self.seq, self.last, self.at_ms = seq, found, record["at_ms"]
        self.tree.push(found)
        if seq in self.spoken_of:
            self.seen[seq] = (found, self.tree.root(), record["wall_ms"])

    def take_body(self, record):
        """What a record says of persons, approvals, and what was shown."""
        if record["kind"] in shown.KINDS:
            self.shown.take(record)
        if record["kind"] not in TAKEN:
            return
        body = body_of(record["body"])
        change = body["change"]
        if record["kind"] == "approval-put":
            self.take_put(record["subject"], fields(change, *TOLD))
        elif record["kind"] == "witness-set":
            self.persons.take_witness(record, change)
        elif record["kind"] == "profile-allowed":
            self.persons.take_profile(record, change)
        elif record["kind"] == "context-set":
            self.persons.take_context(record, change)
        elif record["kind"] == "store-rebuilt":
            lost_by(change)
            self.lost.update(key for table, key, _ in body["rows"] if table == "approval")
        else:
            self.persons.take(record, change)

    def take_put(self, subject, change):
        word(change["change"], ["put-approval"]), word(change["decision"], DECISIONS), word(change["role"], ROLES)
        word(change["profile"], PROFILES), digits(change["nonce"], 16), text(change["reason"]), text(change["who"])
        digits(change["evidence_digest"], 32), digits(change["policy_digest"], 32)
        number(change["not_after_ms"]), number(change["row_version"])
        if set_field(change, "shown", None) is not None:
            put = fields(change["shown"], "facts", "lines", "renderer", "request")
            digits(put["facts"], 32), digits(put["lines"], 32), digits(put["request"], 16)
            whole(put["renderer"], 0, 2**32 - 1)
        if change["nonce"] in self.put:
            raise Bad("approval", change["nonce"], "two records name it")
        try:
            key = self.persons.key_of(change["who"], change["role"])
        except LookupError as error:
            raise Bad("approval", change["nonce"], str(error)) from error
        self.put[change["nonce"]] = (key, told_of(subject, change))

    def check(self, key):
        if self.seq != self.header["records"]:
            raise Bad("record", self.seq + 1, f"it is missing; the first line names {self.header['records']} records")
        for head in self.heads:
            self.check_head("head", head, key)
        if self.end is not None:
            self.check_head("end", self.end, key)
            if self.end.seq != self.seq:
                raise Bad("end", None, f"no signature covers the records after {self.end.seq}")
        elif self.seq > 0:
            raise Bad("end", None, f"no signature covers the end of the audit chain, record {self.seq}")
        if not (self.end is not None and self.end.gap):
            self.check_links()
        self.check_approvals(key)

    def check_head(self, what, head, key):
        if head.store_id != self.header["store_id"]:
            raise Bad(what, head.line, f"it belongs to the store {head.store_id!r}")
        if not is_signed(key, head.signature, head.signed):
            raise Bad(what, head.line, "its signature does not match the public key")
        if head.seq == 0:
            return
        if head.seq not in self.seen:
            raise Bad(what, head.line, f"its record {head.seq} is missing")
        found, root, wall_ms = self.seen[head.seq]
        if found != head.hash:
            raise Bad(what, head.line, "its record is another one: history was rewritten")
        if head.root is not None and head.root != root:
            raise Bad(what, head.line, "its tree head is not the one of these records")
        if head.wall_ms is not None and head.wall_ms != wall_ms:
            raise Bad(what, head.line, "its wall time is not the one of its record")

    def check_links(self):
        heads = self.heads
        since = max((index for index, head in enumerate(heads) if head.gap), default=0)
        for index in range(since, len(heads)):
            if index == 0 and len(heads) >= HEADS_KEPT_MAX:
                continue
            problem = heads[index].follows(heads[index - 1] if index else None)
            if problem:
                raise Bad("head", heads[index].line, problem)
        earlier = sum(head.link is None for head in heads)

        def counted(head):
            if head.gap or earlier >= head.earlier or len(heads) >= HEADS_KEPT_MAX:
                return None
            return f"there are {earlier} checkpoints of earlier versions; one is missing of {head.earlier}"

        linked = [head for head in heads if head.link is not None]
        if linked and (problem := counted(linked[-1])):
            raise Bad("head", linked[-1].line, problem)
        if self.end is None:
            return
        newest = heads[-1] if heads else None
        same = newest and (newest.link, newest.seq, newest.hash) == (self.end.link, self.end.seq, self.end.hash)
        problem = (None if same else self.end.follows(newest)) or counted(self.end)
        if problem:
            raise Bad("end", None, problem)

    def check_approvals(self, key):
        found = set()
        for approval in self.approvals:
            nonce = approval.nonce
            if not approval.is_signed():
                raise Bad("approval", nonce, "its signature does not match the decision")
            if approval.store_id != self.header["store_id"]:
                raise Bad("approval", nonce, "it was made for another store")
            if nonce not in self.put:
                raise Bad("approval", nonce, "no record names it")
            own, told = self.put[nonce]
            if own is not None and text(own) != approval.public_key:
                raise Bad("approval", nonce, "it was signed with another key than its approver's")
            if told != approval.told:
                raise Bad("approval", nonce, "it differs from its record")
            if problem := self.shown.check(approval, key):
                raise Bad("approval", nonce, problem)
            if nonce in found:
                raise Bad("approval", nonce, "it is there twice")
            found.add(nonce)
        missing = sorted(set(self.put) - found - self.lost)
        if missing:
            raise Bad("approval", missing[0], "it is missing")


def verify(file, key):
    rest = lines(file)
    _, first = next(rest, (1, None))
    try:
        header = fields(fields(first, "export")["export"], "format", "version", "store_id", "records", "public_key")
        if (header["format"], whole(header["version"])) != ("holdpoint-store-export", 1):
            raise ValueError
        number(header["records"])
        text(header["store_id"])
        named = None if header["public_key"] is None else public_key(header["public_key"])
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise Bad("line", 1, "it does not say that the file is an exported store of version 1, and of which key") from error
    if key is None and named is None:
        raise Bad("line", 1, "it names no public key, and none was given")
    if key is not None and named is not None and key != named:
        raise Bad("line", 1, "it names another public key than the one that was given")
    key = key or named
    check_id(header["store_id"], key)
    export = Export(header)
    for line, value in rest:
        export.take(line, value)
    export.check(key)
    return export


def opened(path):
    """A regular file: a pipe would be waited for."""
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(f"{path} is no regular file, and only those are read")
    return file


def key_in(path):
    """The public key in a file: its digits, and a note behind a blank."""
    with opened(path) as file:
        read = file.read(KEY_FILE_BYTES_MAX + 1)
    if len(read) > KEY_FILE_BYTES_MAX:
        raise ValueError(f"{path} has more than {KEY_FILE_BYTES_MAX} bytes, and so many are allowed for a key")
    return public_key(read.decode().rstrip().split(" ")[0])


def judge(path, key, as_json):
    """Tells of one file, and with which code that ends."""
    try:
        with opened(path) as file:
            export = verify(file, key)
    except Bad as bad:
        record = bad.which if bad.what == "record" else None
        answer = {"sound": False, "what": bad.what, "record": record, "problem": bad.sentence()}
        print(json.dumps(answer) if as_json else f"not sound: {bad.sentence()}")
        return 1
    answer = {
        "sound": True,
        "store_id": export.header["store_id"],
        "records": export.seq,
        "head": export.last.hex(),
        "root": export.tree.root().hex(),
        "heads": len(export.heads) + (export.end is not None),
        "approvals": len(export.approvals),
        "persons": len(export.persons.keys),
        "confirmed": len(export.persons.confirmed),
        "key_given": key is not None,
    }
    print(json.dumps(answer) if as_json else f"sound: {export.seq} records, head {export.last.hex()}")
    return 0


def main():
    parser = argparse.ArgumentParser(description="Verifies files of `holdpoint store export`.")
    parser.add_argument("file", nargs="+")
    parser.add_argument("--key", help="the store's public key, kept elsewhere")
    parser.add_argument("--json", action="store_true", help="one line of JSON for each file")
    options = parser.parse_args()
    try:
        key = key_in(options.key) if options.key else None
        return max(judge(path, key, options.json) for path in options.file)
    except (OSError, ValueError) as error:
        print(f"cannot read it: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
