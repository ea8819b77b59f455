-- Schema 4: the signed act by which an administrator with a protected key vouched for somebody enrolled without one. NULL
-- where nobody did, as in every row of schema 3.

ALTER TABLE person ADD COLUMN confirmed_seq INTEGER;
ALTER TABLE person ADD COLUMN confirmed TEXT
  CHECK ((confirmed IS NULL) = (confirmed_seq IS NULL) AND (confirmed IS NULL OR json_valid(confirmed)));

CREATE TRIGGER person_confirmed BEFORE UPDATE OF confirmed_seq, confirmed ON person WHEN OLD.confirmed IS NOT NULL
  BEGIN SELECT RAISE(ABORT, 'a person is confirmed once'); END;
