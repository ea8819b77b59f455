-- Telemetry batches and kept cells, schema 2: what is kept has a message authentication code in place of a digest that
-- anyone can compute. Episodes of schema 1 have none, so they are no evidence and go.

DROP TABLE episode;

CREATE TABLE cell (
  key     TEXT PRIMARY KEY NOT NULL CHECK (length(key) = 64),
  mac     TEXT NOT NULL CHECK (length(mac) = 64),
  bytes   INTEGER NOT NULL CHECK (bytes = length(body)),
  used    INTEGER NOT NULL,
  body    BLOB NOT NULL
) STRICT;
CREATE INDEX cell_used ON cell (used);

ALTER TABLE usage RENAME COLUMN episode_bytes TO cell_bytes;
UPDATE usage SET cell_bytes = 0;
