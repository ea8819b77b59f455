"""What people were shown: the lines and facts on record are those that were signed, and the facts are what the records before
them say."""

import json

from form import PROFILES, ROLES, body_text, digest, digits, fields, listed, number, text, version, word

# The kinds of records that are read here.
KINDS = ("version-registered", "approval-requested", "shown")
ASKED = ("id", "row_version", "evidence_digest", "policy_digest", "needed")


def lines_digest(lines):
    return digest("holdpoint/question-lines/v1", *(text(line) for line in lines))


def facts_digest(facts):
    return digest("holdpoint/question-facts/v1", text(facts))


def bound_facts(written):
    """The facts that a decision repeats."""
    facts = json.loads(written)
    asked = facts["asked"]
    text(asked["name"]), word(asked["role"], ROLES), text(facts["question"]), text(facts["purpose"])
    version(facts["version"]), word(facts["profile"], PROFILES)
    digits(facts["candidate"], 32), digits(facts["evidence"], 32), digits(facts["policy"], 32)
    number(facts["row_version"]), number(facts["needed"])
    return facts


class Shown:
    """What the records tell so far of versions, questions, and what was shown of them."""

    def __init__(self):
        self.registered, self.asked, self.kept = {}, {}, {}

    def take(self, record):
        kind, subject = record["kind"], record["subject"]
        if kind == "shown":
            self.take_shown(subject, record["body"])
            return
        # Of what earlier versions wrote no more is asked than that nothing speaks against it.
        try:
            change = json.loads(record["body"])["change"]
            if kind == "version-registered":
                digits(change["candidate_digest"], 32)
                self.registered[subject] = change["candidate_digest"]
            else:
                self.asked[change["id"]] = (subject, *(change[name] for name in ASKED))
        except (ValueError, KeyError, TypeError):
            pass

    def take_shown(self, subject, written):
        body = body_text(written)
        if isinstance(body, dict) and "text" in body:
            # Of earlier versions: the text of a screen, which nobody signed.
            return
        fields(body, "by", "facts", "lines", "nonce")
        for line in listed(body["lines"]):
            text(line)
        text(body["nonce"]), text(body["by"])
        facts = bound_facts(text(body["facts"]).decode())
        if facts["asked"]["name"] != body["by"] or facts["version"] != subject:
            raise ValueError("the displayed text belongs to another person or version")
        if self.registered.get(subject) != facts["candidate"]:
            raise ValueError("the displayed text differs in the candidate from the records before it")
        told = (
            subject, facts["question"], facts["row_version"], facts["evidence"], facts["policy"], facts["needed"],
        )
        # The emergency door asks nobody beforehand.
        if facts["purpose"] != "emergency" and self.asked.get(facts["question"]) != told:
            raise ValueError("the displayed text differs in the question from the records before it")
        if body["nonce"] in self.kept:
            raise ValueError("the displayed text of this decision is on record already")
        self.kept[body["nonce"]] = (lines_digest(body["lines"]), facts_digest(body["facts"]), facts)

    def check(self, approval, store_key):
        """Why a decision is not over what is on record as shown; nothing if it is."""
        said, kept = approval.said, self.kept.get(approval.nonce)
        shown = said.get("shown")
        if shown is None:
            return None if kept is None else "it was signed over nothing that was shown"
        if shown["store_key"] != store_key.hex():
            return "it was signed for a store with another key"
        if kept is None:
            return "no record has its displayed text"
        lines, facts, bound = kept
        if lines != digits(shown["lines"], 32):
            return "the lines on record are not those that it was signed over"
        if facts != digits(shown["facts"], 32):
            return "the facts on record are not those that it was signed over"
        told = (
            bound["asked"]["name"], bound["asked"]["role"], bound["version"], bound["candidate"], bound["row_version"],
            bound["evidence"], bound["policy"], bound["profile"], bound["purpose"] == "emergency",
        )
        repeated = (
            said["who"], said["role"], said["version"], said["candidate_digest"], said["row_version"],
            said["evidence_digest"], said["policy_digest"], said["profile"], said.get("break_glass", False),
        )
        return None if told == repeated else "its facts say otherwise than it does"


def parts_of(shown, break_glass):
    """What of it a decision is signed over."""
    fields(shown, "renderer", "lines", "facts", "store_key", "request")
    renderer = number(shown["renderer"])[:4]
    if shown["renderer"] >= 2**32:
        raise ValueError("its renderer is no version")
    digits(shown["request"], 16)
    return [
        b"break-glass" if break_glass else b"",
        renderer,
        digits(shown["lines"], 32),
        digits(shown["facts"], 32),
        text(shown["store_key"]),
        text(shown["request"]),
    ]


def told_of(shown):
    """What the record of a decision tells of it."""
    return None if shown is None else [shown[name] for name in ("renderer", "lines", "facts", "request")]
