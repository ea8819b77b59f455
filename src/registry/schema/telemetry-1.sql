-- Telemetry batches and cached episodes, schema 1. Everything here may be pruned; digests of sealed batches are in
-- the audit chain of the store.

CREATE TABLE batch (
  id      INTEGER PRIMARY KEY AUTOINCREMENT,
  version TEXT NOT NULL,
  stream  TEXT NOT NULL,
  from_ms INTEGER NOT NULL,
  to_ms   INTEGER NOT NULL CHECK (to_ms >= from_ms),
  rows    INTEGER NOT NULL CHECK (rows > 0),
  digest  TEXT NOT NULL CHECK (length(digest) = 64),
  bytes   INTEGER NOT NULL CHECK (bytes = length(body)),
  body    BLOB NOT NULL
) STRICT;
CREATE INDEX batch_version ON batch (version, id);

CREATE TABLE episode (
  key     TEXT PRIMARY KEY NOT NULL CHECK (length(key) = 64),
  digest  TEXT NOT NULL CHECK (length(digest) = 64),
  bytes   INTEGER NOT NULL CHECK (bytes = length(body)),
  used    INTEGER NOT NULL,
  body    BLOB NOT NULL
) STRICT;
CREATE INDEX episode_used ON episode (used);

CREATE TABLE usage (
  id            INTEGER PRIMARY KEY CHECK (id = 1),
  batch_bytes   INTEGER NOT NULL,
  episode_bytes INTEGER NOT NULL,
  tick          INTEGER NOT NULL
) STRICT;
INSERT INTO usage (id, batch_bytes, episode_bytes, tick) VALUES (1, 0, 0, 0);
