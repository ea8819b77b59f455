-- Schema 3: whose keys may decide, with the signed acts that enrolled and revoked them. Without a row where an earlier
-- schema kept people in files alone: these become persons by an administrator's act.

CREATE TABLE person (
  name        TEXT PRIMARY KEY NOT NULL,
  seq         INTEGER NOT NULL UNIQUE,
  role        TEXT NOT NULL CHECK (role IN ('operator', 'engineer', 'safety', 'admin')),
  public_key  TEXT NOT NULL UNIQUE CHECK (length(public_key) = 64),
  state       TEXT NOT NULL CHECK (state IN ('enrolled', 'revoked')),
  unprotected INTEGER NOT NULL CHECK (unprotected IN (0, 1)),
  enrolled_by TEXT NOT NULL,
  enrolled    TEXT NOT NULL CHECK (json_valid(enrolled)),
  revoked_seq INTEGER UNIQUE,
  revoked_by  TEXT,
  revoked     TEXT CHECK (revoked IS NULL OR json_valid(revoked)),
  changed_ms  INTEGER NOT NULL,
  CHECK ((state = 'revoked') = (revoked_seq IS NOT NULL)),
  CHECK ((revoked_seq IS NULL) = (revoked IS NULL) AND (revoked IS NULL) = (revoked_by IS NULL))
) STRICT;

CREATE TRIGGER person_kept BEFORE DELETE ON person
  BEGIN SELECT RAISE(ABORT, 'persons are never deleted'); END;
CREATE TRIGGER person_identity BEFORE UPDATE OF name, seq, role, public_key, unprotected, enrolled_by, enrolled ON person
  BEGIN SELECT RAISE(ABORT, 'what was enrolled never changes'); END;
CREATE TRIGGER person_revoked BEFORE UPDATE ON person WHEN OLD.state = 'revoked'
  BEGIN SELECT RAISE(ABORT, 'a revoked person stays revoked'); END;
