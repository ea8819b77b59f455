-- Registry, evidence, approvals and audit chain, schema 1.
-- Digests are 64 hexadecimal digits; times in *_ms are virtual, except wall_ms. JSON is kept as the bytes given.

CREATE TABLE meta (
  key   TEXT PRIMARY KEY NOT NULL,
  value TEXT NOT NULL
) STRICT, WITHOUT ROWID;
INSERT INTO meta (key, value) VALUES ('store_id', lower(hex(randomblob(16))));

CREATE TABLE context (
  id            INTEGER PRIMARY KEY CHECK (id = 1),
  profile       TEXT NOT NULL,
  policy_digest TEXT NOT NULL CHECK (length(policy_digest) = 64),
  json          TEXT NOT NULL CHECK (json_valid(json)),
  seq           INTEGER NOT NULL
) STRICT;

CREATE TABLE version (
  id                INTEGER PRIMARY KEY,
  name              TEXT NOT NULL UNIQUE,
  family            TEXT NOT NULL,
  version           TEXT NOT NULL,
  sort_key          TEXT NOT NULL,
  parent            TEXT,
  state             TEXT NOT NULL CHECK (state IN ('registered', 'validated', 'sandboxed', 'shadowed', 'active',
                      'demoted', 'rejected', 'rolled-back', 'superseded')),
  row_version       INTEGER NOT NULL CHECK (row_version >= 1),
  running           TEXT CHECK (running IN ('validation', 'sandbox', 'shadow', 'activation')),
  paused            INTEGER NOT NULL DEFAULT 0 CHECK (paused IN (0, 1)),
  awaiting_approval INTEGER NOT NULL DEFAULT 0 CHECK (awaiting_approval IN (0, 1)),
  provisional       INTEGER NOT NULL DEFAULT 0 CHECK (provisional IN (0, 1)),
  restricted        INTEGER NOT NULL DEFAULT 0 CHECK (restricted IN (0, 1)),
  rollback_pending  INTEGER NOT NULL DEFAULT 0 CHECK (rollback_pending IN (0, 1)),
  kappa_i           REAL CHECK (kappa_i BETWEEN 0 AND 1),
  kappa_p           REAL CHECK (kappa_p BETWEEN 0 AND 1),
  kappa_b           REAL CHECK (kappa_b BETWEEN 0 AND 1),
  kappa_r           REAL CHECK (kappa_r BETWEEN 0 AND 1),
  signature         TEXT CHECK (signature IS NULL OR json_valid(signature)),
  baseline          INTEGER NOT NULL CHECK (baseline IN (0, 1)),
  candidate_digest  TEXT NOT NULL CHECK (length(candidate_digest) = 64),
  manifest_digest   TEXT NOT NULL CHECK (length(manifest_digest) = 64),
  bundle_digest     TEXT NOT NULL CHECK (length(bundle_digest) = 64),
  author            TEXT NOT NULL,
  provenance        TEXT NOT NULL,
  risk              TEXT NOT NULL,
  permissions       TEXT NOT NULL CHECK (json_valid(permissions)),
  environments      TEXT NOT NULL CHECK (json_valid(environments)),
  manifest          TEXT NOT NULL CHECK (json_valid(manifest)),
  submission        TEXT NOT NULL CHECK (json_valid(submission)),
  registered_ms     INTEGER NOT NULL,
  changed_ms        INTEGER NOT NULL,
  UNIQUE (family, version)
) STRICT;

-- At most one active version per family, whatever the program does.
CREATE UNIQUE INDEX one_active ON version (family) WHERE state = 'active';
-- Lists read this index alone.
CREATE INDEX version_list ON version (family, sort_key, name, state, row_version, running, paused, awaiting_approval,
  provisional, restricted, rollback_pending, kappa_i, kappa_p, kappa_b, kappa_r, baseline, author, provenance, risk,
  changed_ms);
CREATE INDEX version_busy ON version (id)
  WHERE running IS NOT NULL OR provisional = 1 OR rollback_pending = 1;

CREATE TRIGGER version_terminal BEFORE UPDATE OF state ON version
  WHEN OLD.state IN ('rejected', 'rolled-back')
  BEGIN SELECT RAISE(ABORT, 'a rejected or rolled-back version is final'); END;
CREATE TRIGGER version_kept BEFORE DELETE ON version
  BEGIN SELECT RAISE(ABORT, 'versions are never deleted'); END;
CREATE TRIGGER version_identity BEFORE UPDATE OF name, family, version, parent, baseline, candidate_digest,
  manifest_digest, bundle_digest, manifest, submission ON version
  BEGIN SELECT RAISE(ABORT, 'what was registered never changes'); END;

CREATE TABLE family (
  name         TEXT PRIMARY KEY NOT NULL,
  active       TEXT REFERENCES version (name),
  pinned       TEXT REFERENCES version (name),
  bootstrapped INTEGER NOT NULL CHECK (bootstrapped IN (0, 1)),
  safe_stopped INTEGER NOT NULL CHECK (safe_stopped IN (0, 1)),
  reason       TEXT NOT NULL,
  void_seq     INTEGER NOT NULL,
  standing     TEXT CHECK (standing IS NULL OR json_valid(standing)),
  CHECK (pinned IS NULL OR pinned <> active)
) STRICT, WITHOUT ROWID;

CREATE TABLE activation (
  seq              INTEGER PRIMARY KEY,
  family           TEXT NOT NULL,
  active           TEXT REFERENCES version (name),
  pinned           TEXT REFERENCES version (name),
  cause            TEXT NOT NULL CHECK (cause IN ('bootstrap', 'gate', 'restore', 'vacate', 'rearm')),
  gate_digest      TEXT CHECK (length(gate_digest) = 64),
  approvals_needed INTEGER NOT NULL CHECK (approvals_needed >= 0),
  at_ms            INTEGER NOT NULL,
  CHECK ((cause = 'gate') = (gate_digest IS NOT NULL)),
  CHECK ((cause = 'vacate') = (active IS NULL))
) STRICT;
CREATE INDEX activation_family ON activation (family, seq);

CREATE TABLE evidence (
  seq           INTEGER PRIMARY KEY,
  version       TEXT NOT NULL REFERENCES version (name),
  kind          TEXT NOT NULL CHECK (kind IN ('compat', 'sandbox', 'shadow', 'gate', 'activation', 'monitor',
                  'rollback', 'drill')),
  row_version   INTEGER NOT NULL,
  profile       TEXT NOT NULL,
  policy_digest TEXT NOT NULL,
  digest        TEXT NOT NULL CHECK (length(digest) = 64),
  json          TEXT NOT NULL CHECK (json_valid(json)),
  at_ms         INTEGER NOT NULL
) STRICT;
CREATE INDEX evidence_version ON evidence (version, kind, seq);

CREATE TABLE approval_request (
  id              TEXT PRIMARY KEY NOT NULL,
  version         TEXT NOT NULL REFERENCES version (name),
  row_version     INTEGER NOT NULL,
  evidence_digest TEXT NOT NULL CHECK (length(evidence_digest) = 64),
  policy_digest   TEXT NOT NULL CHECK (length(policy_digest) = 64),
  profile         TEXT NOT NULL,
  needed          INTEGER NOT NULL CHECK (needed >= 0),
  asked_ms        INTEGER NOT NULL,
  deadline_ms     INTEGER NOT NULL,
  state           TEXT NOT NULL CHECK (state IN ('open', 'granted', 'refused', 'expired', 'void')),
  json            TEXT NOT NULL CHECK (json_valid(json))
) STRICT, WITHOUT ROWID;
CREATE INDEX approval_request_open ON approval_request (deadline_ms) WHERE state = 'open';

CREATE TABLE approval (
  nonce           TEXT PRIMARY KEY NOT NULL CHECK (length(nonce) = 32),
  seq             INTEGER NOT NULL,
  version         TEXT NOT NULL REFERENCES version (name),
  who             TEXT NOT NULL,
  decision        TEXT NOT NULL CHECK (decision IN ('approve', 'reject')),
  row_version     INTEGER NOT NULL,
  not_after_ms    INTEGER NOT NULL,
  claim           TEXT NOT NULL CHECK (length(claim) = 64),
  consumed_seq    INTEGER,
  at_ms           INTEGER NOT NULL,
  -- Not chained: they differ between stores of equal runs. The verifier checks the signature over the claim.
  signed          TEXT NOT NULL CHECK (json_valid(signed))
) STRICT, WITHOUT ROWID;
CREATE INDEX approval_version ON approval (version, seq);
CREATE TRIGGER approval_once BEFORE UPDATE ON approval WHEN OLD.consumed_seq IS NOT NULL
  BEGIN SELECT RAISE(ABORT, 'an approval is used once'); END;
CREATE TRIGGER approval_kept BEFORE DELETE ON approval
  BEGIN SELECT RAISE(ABORT, 'approvals are never deleted'); END;

CREATE TABLE alarm (
  id         TEXT PRIMARY KEY NOT NULL,
  subject    TEXT NOT NULL,
  state      TEXT NOT NULL,
  priority   TEXT NOT NULL,
  json       TEXT NOT NULL CHECK (json_valid(json)),
  changed_ms INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE command (
  id        TEXT PRIMARY KEY NOT NULL,
  digest    TEXT NOT NULL CHECK (length(digest) = 64),
  last_seq  INTEGER NOT NULL,
  receipt   TEXT NOT NULL CHECK (json_valid(receipt))
) STRICT, WITHOUT ROWID;

CREATE TABLE audit (
  seq     INTEGER PRIMARY KEY CHECK (seq >= 1),
  prev    BLOB NOT NULL CHECK (length(prev) = 32),
  hash    BLOB NOT NULL CHECK (length(hash) = 32),
  at_ms   INTEGER NOT NULL CHECK (at_ms >= 0),
  kind    TEXT NOT NULL,
  subject TEXT NOT NULL,
  body    TEXT NOT NULL CHECK (json_valid(body)),
  wall_ms INTEGER NOT NULL
) STRICT;
CREATE INDEX audit_subject ON audit (subject, seq);
CREATE INDEX audit_kind ON audit (kind, seq);
CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit
  BEGIN SELECT RAISE(ABORT, 'the audit chain is append-only'); END;
CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit
  BEGIN SELECT RAISE(ABORT, 'the audit chain is append-only'); END;
CREATE TRIGGER audit_in_order BEFORE INSERT ON audit
  WHEN NEW.seq <> (SELECT seq + 1 FROM audit_head)
  BEGIN SELECT RAISE(ABORT, 'the audit chain has no gaps'); END;

-- The chain's end, so that a record cut off at the end is missed.
CREATE TABLE audit_head (
  id   INTEGER PRIMARY KEY CHECK (id = 1),
  seq  INTEGER NOT NULL,
  hash BLOB NOT NULL CHECK (length(hash) = 32)
) STRICT;
INSERT INTO audit_head (id, seq, hash) VALUES (1, 0, zeroblob(32));
