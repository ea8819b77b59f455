"""The form of an exported store: what its lines are made of, and what is read of them before their length is known.

Every value has one text. A line is what `json.dumps` writes of it without blanks, in ASCII, with the fields in the order of
their form; the body of a record that is judged is the same in UTF-8 with the fields in the order of their names. So a line
that says the same in other letters is none.
"""

import hashlib
import json
import re
from json.decoder import scanstring

import curve

# The longest line that is a record, and the longest other one, bytes.
LINE_BYTES_MAX = 32 << 20
SHORT_LINE_BYTES_MAX = 64 << 10
# Of the body of a record that is judged: commas and opening brackets, and brackets within each other.
BODY_MARKS_MAX = 1 << 20
BODY_DEPTH_MAX = 32
REASON_BYTES_MAX = 4096

RECORD = ("seq", "prev", "hash", "at_ms", "kind", "subject", "body", "wall_ms")
NUMBER = re.compile("-?[0-9]{1,20}")
NAME = re.compile("[a-z0-9][a-z0-9._-]{0,63}")
VERSION = re.compile(
    r"(0|[1-9][0-9]*)\.(0|[1-9][0-9]*)\.(0|[1-9][0-9]*)"
    r"(-(0|[1-9][0-9]*|[0-9]*[A-Za-z-][0-9A-Za-z-]*)(\.(0|[1-9][0-9]*|[0-9]*[A-Za-z-][0-9A-Za-z-]*))*)?"
    r"(\+[0-9A-Za-z-]+(\.[0-9A-Za-z-]+)*)?"
)
ROLES = ("operator", "engineer", "safety", "admin")
DECISIONS = ("approve", "reject")
# The least strict first: from "real" on the cell is at risk, from "human" on people.
PROFILES = ("sim", "real", "human")


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


def reaches(profile, class_):
    """Whether there is a profile, and of this class or a stricter one."""
    return profile is not None and PROFILES.index(profile) >= PROFILES.index(class_)


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
        raise ValueError(f"{str(value)[:80]} is no whole number of this form")
    return value


def number(value):
    """A whole number as it is hashed."""
    return whole(value, 0, 2**64 - 1).to_bytes(8, "little")


def text(value):
    """A text as it is hashed."""
    if not isinstance(value, str):
        raise ValueError(f"{str(value)[:80]} is no text")
    return value.encode()


def digits(value, count):
    """Bytes from hexadecimal digits in lower case."""
    if not isinstance(value, str) or not re.fullmatch("[0-9a-f]{%d}" % (2 * count), value):
        raise ValueError(f"{str(value)[:80]} is not {2 * count} hexadecimal digits")
    return bytes.fromhex(value)


def truth(value):
    if not isinstance(value, bool):
        raise ValueError(f"{str(value)[:80]} is neither true nor false")
    return value


def word(value, allowed):
    if not isinstance(value, str) or value not in allowed:
        raise ValueError(f"{str(value)[:80]} is none of {', '.join(allowed)}")
    return value


def version(value):
    """The name of a version, `family@1.2.3`, as it is hashed."""
    family, at, rest = text(value).decode().partition("@")
    found = VERSION.fullmatch(rest)
    if not at or not NAME.fullmatch(family) or not found or any(int(found[part]) >= 2**64 for part in (1, 2, 3)):
        raise ValueError(f"{value[:80]!r} is no version")
    return value.encode()


def is_reason(value):
    """Whether a reason has a length that is allowed, and more than blanks and what no terminal shows."""
    shown = any("\x20" < letter < "\x7f" or letter > "\xa0" for letter in value)
    return shown and len(value.encode()) <= REASON_BYTES_MAX


def signature_of(value):
    """The bytes of a signature, none of what cannot be one."""
    return bytes.fromhex(value) if re.fullmatch("[0-9a-f]{128}", text(value).decode()) else b""


def public_key(value):
    """The 32 bytes of a public key from its digits."""
    key = digits(value, 32)
    curve.public_key(key)
    return key


def fields(value, *form):
    """An object with the fields of its form and no others, in this order; what ends with `?` may be absent."""
    names = [name.rstrip("?") for name in form]
    needed = {name for name in form if not name.endswith("?")}
    if not isinstance(value, dict) or list(value) != [name for name in names if name in value] or needed - set(value):
        raise ValueError("its fields are not those of its form")
    return value


def set_field(value, name, absent):
    """A field that is written only where it is something else than `absent`."""
    found = value.get(name, absent)
    if name in value and found in (absent, None):
        raise ValueError(f"{name} is written although it says nothing")
    return found


def unique(pairs):
    """An object that has no field twice."""
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError("a field is there twice")
    return value


def no_number(written):
    raise ValueError(f"{written[:80]} is no whole number")


def plain(written):
    """A whole number of at most eight bytes."""
    if len(written) > 20:
        raise ValueError(f"{written[:80]} is no whole number of this form")
    return whole(int(written), -(2**63), 2**64 - 1)


def parsed(written):
    return json.loads(
        written, object_pairs_hook=unique, parse_constant=no_number, parse_float=no_number, parse_int=plain
    )


def record_of(line):
    """A line with a record, field by field: nothing of it is kept but what the form has."""
    found, at = {}, len('{"record":{')
    for name in RECORD:
        start = f',"{name}":' if found else f'"{name}":'
        if not line.startswith(start, at):
            raise ValueError("its fields are not those of its form")
        at += len(start)
        if line.startswith('"', at):
            found[name], at = scanstring(line, at + 1, True)
        elif match := NUMBER.match(line, at):
            found[name], at = int(match[0]), match.end()
        else:
            raise ValueError("its fields are not those of its form")
    if not line.endswith("}}\n") or at != len(line) - 3:
        raise ValueError("its fields are not those of its form")
    return {"record": found}


def is_unicode(value):
    """Whether a text has whole characters alone: JSON can escape the halves of one by themselves."""
    return not any("\ud800" <= letter <= "\udfff" for letter in value)


def lines(file):
    """Each line's number and what it says. No more of a line is read than it may have."""
    line = 0
    while True:
        line += 1
        most = SHORT_LINE_BYTES_MAX
        read = file.readline(most + 1)
        is_record = read.startswith(b'{"record":{')
        if is_record:
            most = LINE_BYTES_MAX
            if not read.endswith(b"\n"):
                read += file.readline(most + 1 - len(read))
        if not read:
            return
        if len(read) > most:
            raise Bad("line", line, f"it has more than {most} bytes, and so many are allowed")
        if not read.endswith(b"\n"):
            raise Bad("line", line, "the file is cut short in it")
        try:
            read = read.decode("ascii")
            if line == 1 and not read.startswith('{"export":'):
                raise ValueError("it is not the first of an exported store")
            value = record_of(read) if is_record else parsed(read)
            if json.dumps(value, separators=(",", ":")) + "\n" != read:
                raise ValueError("it is not as it was written")
            if "\\ud" in read and not is_unicode(json.dumps(value, ensure_ascii=False)):
                raise ValueError("it has half a character")
        except (ValueError, RecursionError) as error:
            raise Bad("line", line, str(error)) from error
        yield line, value


def depth(value):
    """How many brackets are within each other."""
    deepest, open_values = 0, [(value, 1)]
    while open_values:
        one, level = open_values.pop()
        if isinstance(one, (dict, list)):
            deepest = max(deepest, level)
            open_values.extend((inner, level + 1) for inner in (one.values() if isinstance(one, dict) else one))
    return deepest


def body_text(written):
    """The value of a body that is judged: it has one text."""
    if sum(map(written.count, ",[{")) > BODY_MARKS_MAX:
        raise ValueError(f"it has more than {BODY_MARKS_MAX} commas and brackets, and so many are allowed")
    value = parsed(written)
    if depth(value) > BODY_DEPTH_MAX:
        raise ValueError(f"it has brackets deeper than {BODY_DEPTH_MAX}")
    if json.dumps(value, separators=(",", ":"), ensure_ascii=False, sort_keys=True) != written:
        raise ValueError("it is not as it was written")
    return value


def body_of(written):
    """What the body of a record says that the store wrote itself."""
    value = body_text(written)
    fields(value, "change", "rows")
    if not isinstance(value["change"], dict) or not isinstance(value["rows"], list):
        raise ValueError("its fields are not those of its form")
    for row in value["rows"]:
        table, key, row_digest = listed(row, 3)
        text(table), text(key), digits(row_digest, 32)
    return value


def listed(value, count=None):
    """A list, of so many values."""
    if not isinstance(value, list) or (count is not None and len(value) != count):
        raise ValueError("it is no list of this form")
    return value
