#!/usr/bin/env python3
"""Verifies a file of `holdpoint store export` without Holdpoint.

    verify.py FILE [--key store.pub] [--json]

Needs Python 3.9 or newer and the package `cryptography`. Ends with 0 if the file is sound, with 1 if it is not, and with 2
if it cannot be read. It follows the form that the guide describes (src/guide/records.md) and looks at the same things in the same order: records
with the acts about persons among them, signed heads, signed end, approvals.
"""

import argparse
import hashlib
import json
import re
import sys

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

LINE_BYTES_MAX = 32 << 20
HEADS_KEPT_MAX = 1000
# Kinds of records whose bodies are read.
TAKEN = ("approval-put", "person-enrolled", "person-confirmed", "person-revoked", "witness-set", "store-rebuilt")
ZEROS = bytes(32)


class Bad(Exception):
    """The first thing that is not sound: what kind of thing, which one, and why."""

    def __init__(self, what, which, problem):
        super().__init__(problem)
        self.what, self.which, self.problem = what, which, problem

    def sentence(self):
        return {
            "record": f"audit record {self.which} is bad: {self.problem}",
            "head": f"the checkpoint in line {self.which} is bad: {self.problem}",
            "end": f"the audit chain is not signed to its end: {self.problem}",
            "approval": f"the approval {self.which} is bad: {self.problem}",
            "person": f"the person {self.which!r} is bad: {self.problem}",
            "line": f"line {self.which} is bad: {self.problem}",
        }[self.what]


def digest(domain, *parts):
    """SHA-256 over every part behind its length, eight bytes with the lowest first; the domain is the first part."""
    hasher = hashlib.sha256()
    for part in (domain.encode(), *parts):
        hasher.update(len(part).to_bytes(8, "little"))
        hasher.update(part)
    return hasher.digest()


def whole(value, least=-(2**63), most=2**63 - 1):
    """A whole number within these bounds."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{value!r} is no whole number of this form")
    return value


def number(value):
    """A whole number as it is hashed."""
    return whole(value, 0, 2**64 - 1).to_bytes(8, "little")


def public_key(value):
    """A public key from its digits."""
    return Ed25519PublicKey.from_public_bytes(digits(value, 32))


def check_id(store_id, key):
    """Whether a store with this id signs with this key, as far as the id says: earlier versions drew theirs."""
    of_key = "key-" + digest("holdpoint/store-id/v1", key.public_bytes_raw()).hex()[:32]
    if store_id.startswith("key-") and store_id != of_key:
        raise Bad("line", 1, f"the store {store_id!r} does not sign with this key: it would be {of_key!r}")


def digits(text, count):
    """Bytes from hexadecimal digits in lower case."""
    if not isinstance(text, str) or not re.fullmatch("[0-9a-f]{%d}" % (2 * count), text):
        raise ValueError(f"{text!r} is not {2 * count} hexadecimal digits")
    return bytes.fromhex(text)


def signature_of(value):
    """The bytes of a signature, none of what cannot be one."""
    return bytes.fromhex(value) if re.fullmatch("[0-9a-f]{128}", text(value).decode()) else b""


def text(value):
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no text")
    return value.encode()


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


def fields(value, needed, optional=()):
    """The fields of an object, which has no others."""
    if not isinstance(value, dict) or set(value) - set(needed) - set(optional) or set(needed) - set(value):
        raise ValueError("its fields are not those of its form")
    return value


class Head:
    """A signed head: the end of the chain at some moment."""

    def __init__(self, value, line):
        fields(value, ("store_id", "seq", "at_ms", "head", "signature"), ("fold", "link", "root"))
        self.line, self.store_id, self.seq = line, value["store_id"], value["seq"]
        self.hash = digits(value["head"], 32)
        self.root = digits(value["root"], 32) if value.get("root") is not None else None
        self.signature = signature_of(value["signature"])
        self.link = value.get("link")
        fold = digits(value["fold"], 32) if value.get("fold") is not None else None
        end = [text(self.store_id), number(self.seq), number(value["at_ms"]), self.hash]
        if self.link is not None:
            link = fields(self.link, ("number", "previous"), ("gap", "earlier"))
            self.number, self.previous = link["number"], digits(link["previous"], 32)
            self.gap, self.earlier = link.get("gap", False), link.get("earlier", 0)
            if not isinstance(self.gap, bool):
                raise ValueError("a gap is true or false")
            linked = [number(self.number), self.previous, bytes([self.gap])]
            if self.root is not None:
                parts = [*end, *linked, number(self.earlier), self.root, fold or b""]
                self.signed = digest("holdpoint/checkpoint/v4", *parts)
            else:
                self.signed = digest("holdpoint/checkpoint/v3", *end, *linked, fold or b"")
        else:
            self.number, self.previous, self.gap, self.earlier = 0, None, False, 0
            if fold is not None:
                self.signed = digest("holdpoint/checkpoint/v2", *end, fold)
            else:
                self.signed = digest("holdpoint/checkpoint/v1", *end)

    def digest(self):
        return digest("holdpoint/checkpoint-digest/v1", self.signed, self.signature.hex().encode())

    def follows(self, before):
        """Why it does not follow from the one before, if it does not."""
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


class Approval:
    """A person's decision, signed with a key that it carries."""

    def __init__(self, value):
        fields(value, ("approval", "public_key", "signature"))
        self.public_key, self.signature = text(value["public_key"]), text(value["signature"])
        names = (
            "who", "role", "decision", "reason", "version", "candidate_digest", "row_version", "evidence_digest",
            "policy_digest", "profile", "store_id", "nonce", "not_after_ms",
        )
        approval = fields(value["approval"], names, ("break_glass",))
        self.nonce, self.store_id = approval["nonce"], approval["store_id"]
        digits(self.nonce, 16)
        self.parts = [
            text(self.store_id),
            text(approval["who"]),
            text(approval["role"]),
            text(approval["decision"]),
            text(approval["reason"]),
            text(approval["version"]),
            digits(approval["candidate_digest"], 32),
            number(approval["row_version"]),
            digits(approval["evidence_digest"], 32),
            digits(approval["policy_digest"], 32),
            text(approval["profile"]),
            text(self.nonce),
            number(approval["not_after_ms"]),
        ]
        if not isinstance(approval.get("break_glass", False), bool):
            raise ValueError("break_glass is true or false")
        if approval.get("break_glass", False):
            self.parts.append(b"break-glass")

    def is_signed(self):
        try:
            key = Ed25519PublicKey.from_public_bytes(digits(self.public_key.decode(), 32))
            signature = digits(self.signature.decode(), 64)
        except ValueError:
            return False
        return signed_by(key, signature, digest("holdpoint/approval/v1", *self.parts))


def signed_by(key, signature, message):
    try:
        key.verify(signature, message)
    except (InvalidSignature, ValueError):
        return False
    return True


class Persons:
    """Whose keys may decide, by the acts on record so far."""

    def __init__(self, store_id):
        self.store_id, self.follows = text(store_id), digest("holdpoint/persons/v1", text(store_id))
        self.keys, self.roles, self.revoked, self.confirmed = {}, {}, set(), set()

    def take(self, record, change):
        """Takes an act: signed by an administrator who is enrolled, following from the act before."""
        fields(change, ("change", "act", "public_key", "signature"))
        names = ("act", "name", "role", "key", "unprotected", "by", "reason", "store_id", "follows", "nonce")
        act = fields(change["act"], names, ("guarded",))
        guarded = act.get("guarded", False)
        name, by, kind, role, key = (act[field] for field in ("name", "by", "act", "role", "key"))
        kinds = {
            "person-enrolled": ("enrol-person", "enrol"),
            "person-confirmed": ("confirm-person", "confirm"),
            "person-revoked": ("revoke-person", "revoke"),
        }
        if kinds[record["kind"]] != (change["change"], kind) or record["subject"] != name:
            raise Bad("person", name, "the act is not what was recorded")
        if not isinstance(act["unprotected"], bool) or not isinstance(guarded, bool) or role not in ("operator", "engineer", "safety", "admin"):
            raise ValueError("an act about a person is not of its form")
        signed = digest(
            "holdpoint/person-act/v1",
            text(act["store_id"]),
            digits(act["follows"], 32),
            text(kind),
            text(name),
            text(role),
            text(key),
            b"unprotected" if act["unprotected"] else b"",
            text(by),
            text(act["reason"]),
            text(act["nonce"]),
            *([b"guarded"] if guarded else []),
        )
        try:
            signer = Ed25519PublicKey.from_public_bytes(digits(change["public_key"], 32))
            Ed25519PublicKey.from_public_bytes(digits(key, 32))
        except ValueError as error:
            raise Bad("person", name, "a key of the act is none") from error
        if not signed_by(signer, signature_of(change["signature"]), signed):
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
        if change.get("act") is None:
            return
        word = fields(change["act"], ("act", "public_key", "signature"))
        act = fields(word["act"], ("folder", "present", "by", "reason", "store_id", "after", "guarded"))
        by = act["by"]
        if not isinstance(act["present"], bool) or not isinstance(act["guarded"], bool):
            raise ValueError("a word on a witness is not of its form")
        signed = digest(
            "holdpoint/witness-act/v1",
            text(act["store_id"]),
            digits(act["after"], 32),
            text(act["folder"]),
            b"present" if act["present"] else b"",
            text(by),
            text(act["reason"]),
            b"guarded" if act["guarded"] else b"",
        )
        try:
            signer = Ed25519PublicKey.from_public_bytes(digits(word["public_key"], 32))
        except ValueError as error:
            raise Bad("person", by, "a key of the word is none") from error
        if not signed_by(signer, signature_of(word["signature"]), signed):
            raise Bad("person", by, "the signature does not match the word on a witness")
        told = (text(act["store_id"]), act["folder"], act["present"], act["after"])
        if told != (self.store_id, change["folder"], change["present"], record["prev"]):
            raise Bad("person", by, "the word on a witness is of another place, or another end of the chain")
        if by in self.revoked or self.keys.get(by) != word["public_key"] or self.roles[by] != "admin":
            raise Bad("person", by, "who signed is no administrator who is enrolled")

    def key_of(self, who):
        """The key of somebody who is enrolled; none before anybody was."""
        if self.keys and (who in self.revoked or who not in self.keys):
            raise LookupError
        return self.keys.get(who)


class Export:
    """What was read of the file. Records are let go once they were looked at."""

    def __init__(self, header):
        self.header = header
        self.heads, self.end = [], None
        self.seq, self.last, self.at_ms = 0, ZEROS, 0
        self.tree, self.seen, self.spoken_of = Tree(), {}, set()
        self.put, self.lost, self.approvals = {}, set(), []
        self.persons = Persons(header["store_id"])

    def take(self, line, value):
        if not isinstance(value, dict) or len(value) != 1:
            raise Bad("line", line, "it is none of an exported store")
        (kind, content), = value.items()
        if kind in ("head", "end") and (self.seq > 0 or self.end is not None):
            raise Bad("line", line, "it does not belong here")
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
        names = ("seq", "prev", "hash", "at_ms", "kind", "subject", "body", "wall_ms")
        fields(record, names)
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
            self.seen[seq] = (found, self.tree.root())

    def take_body(self, record):
        """What a record says of persons and approvals."""
        if record["kind"] not in TAKEN:
            return
        body = json.loads(record["body"], object_pairs_hook=unique, parse_constant=no_number, parse_int=plain)
        if record["kind"] == "approval-put":
            change = body["change"]
            text(change["nonce"])
            text(change["who"])
            try:
                self.put[change["nonce"]] = self.persons.key_of(change["who"])
            except LookupError as error:
                raise Bad("approval", change["nonce"], "whoever gave it was not enrolled then") from error
        if record["kind"] in ("person-enrolled", "person-confirmed", "person-revoked"):
            self.persons.take(record, body["change"])
        if record["kind"] == "witness-set":
            self.persons.take_witness(record, body["change"])
        if record["kind"] == "store-rebuilt":
            for table, key, row_digest in body["rows"]:
                digits(row_digest, 32)
                if table == "approval":
                    self.lost.add(text(key).decode())

    def check(self, key):
        if self.seq != self.header["records"]:
            raise Bad("record", self.seq + 1, f"it is missing; the file is said to have {self.header['records']}")
        for head in self.heads:
            self.check_head("head", head, key)
        if self.end is not None:
            self.check_head("end", self.end, key)
            if self.end.seq != self.seq:
                raise Bad("end", None, f"nobody signed the records after {self.end.seq}")
        elif self.seq > 0:
            raise Bad("end", None, f"nobody signed where the audit chain ends, at record {self.seq}")
        if not (self.end is not None and self.end.gap):
            self.check_links()
        self.check_approvals()

    def check_head(self, what, head, key):
        if head.store_id != self.header["store_id"]:
            raise Bad(what, head.line, f"it belongs to the store {head.store_id!r}")
        if not signed_by(key, head.signature, head.signed):
            raise Bad(what, head.line, "its signature does not match the public key")
        if head.seq == 0:
            return
        if head.seq not in self.seen:
            raise Bad(what, head.line, f"its record {head.seq} is missing")
        found, root = self.seen[head.seq]
        if found != head.hash:
            raise Bad(what, head.line, "its record is another one: history was rewritten")
        if head.root is not None and head.root != root:
            raise Bad(what, head.line, "its tree head is not the one of these records")

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

    def check_approvals(self):
        found = set()
        for approval in self.approvals:
            nonce = approval.nonce
            if not approval.is_signed():
                raise Bad("approval", nonce, "its signature does not match the decision")
            if approval.store_id != self.header["store_id"]:
                raise Bad("approval", nonce, "it was made for another store")
            if nonce not in self.put:
                raise Bad("approval", nonce, "no record speaks of it")
            if self.put[nonce] is not None and text(self.put[nonce]) != approval.public_key:
                raise Bad("approval", nonce, "it was signed with another key than that of who gave it")
            if nonce in found:
                raise Bad("approval", nonce, "it is there twice")
            found.add(nonce)
        missing = sorted(set(self.put) - found - self.lost)
        if missing:
            raise Bad("approval", missing[0], "it is missing")


def unique(pairs):
    """An object that has no field twice."""
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError("a field is there twice")
    return value


def no_number(word):
    raise ValueError(f"{word} is no number")


def plain(word):
    """A whole number as it is written: of zeros there is one."""
    if word == "-0":
        raise ValueError("-0 is no whole number")
    return int(word)


def lines(file):
    for line in range(1, sys.maxsize):
        read = file.readline(LINE_BYTES_MAX + 1)
        if not read:
            return
        if len(read) > LINE_BYTES_MAX:
            raise Bad("line", line, f"it has more than {LINE_BYTES_MAX} bytes")
        if not read.endswith(b"\n"):
            raise Bad("line", line, "the file is cut short in it")
        try:
            # As text: bytes would be taken for whatever encoding they look like.
            read = read.decode("utf-8")
            if line == 1 and not read.startswith('{"export":'):
                raise ValueError("it is not the first of an exported store")
            yield line, json.loads(read, object_pairs_hook=unique, parse_constant=no_number, parse_int=plain)
        except (ValueError, RecursionError) as error:
            raise Bad("line", line, str(error)) from error


def verify(file, key):
    rest = lines(file)
    _, first = next(rest, (1, None))
    try:
        header = fields(first["export"], ("format", "version", "store_id", "records", "public_key"))
        if (header["format"], whole(header["version"])) != ("holdpoint-store-export", 1):
            raise ValueError
        number(header["records"])
        text(header["store_id"])
        named = None if header["public_key"] is None else public_key(header["public_key"])
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise Bad("line", 1, "it does not say that the file is an exported store of version 1, and of which key") from error
    if key is None and named is None:
        raise Bad("line", 1, "it names no public key, and none was given")
    if key is not None and named is not None and key.public_bytes_raw() != named.public_bytes_raw():
        raise Bad("line", 1, "it names another public key than the one that was given")
    key = key or named
    check_id(header["store_id"], key)
    export = Export(header)
    for line, value in rest:
        export.take(line, value)
    export.check(key)
    return export


def main():
    parser = argparse.ArgumentParser(description="Verifies a file of `holdpoint store export`.")
    parser.add_argument("file")
    parser.add_argument("--key", help="the store's public key, kept elsewhere")
    parser.add_argument("--json", action="store_true", help="one line of JSON")
    options = parser.parse_args()
    try:
        key = None
        if options.key:
            with open(options.key, encoding="utf-8") as file:
                key = Ed25519PublicKey.from_public_bytes(digits(file.read().split()[0], 32))
        with open(options.file, "rb") as file:
            export = verify(file, key)
    except Bad as bad:
        record = bad.which if bad.what == "record" else None
        answer = {"sound": False, "what": bad.what, "record": record, "problem": bad.sentence()}
        print(json.dumps(answer) if options.json else f"not sound: {bad.sentence()}")
        return 1
    except (OSError, ValueError, IndexError) as error:
        print(f"cannot read it: {error}", file=sys.stderr)
        return 2
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
    print(json.dumps(answer) if options.json else f"sound: {export.seq} records, head {export.last.hex()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
