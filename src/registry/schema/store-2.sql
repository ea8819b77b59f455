-- Schema 2: with which robot a version was made active, as the digest of its description. NULL in rows of schema 1.

ALTER TABLE family ADD COLUMN robot TEXT CHECK (robot IS NULL OR length(robot) = 16);
ALTER TABLE activation ADD COLUMN robot TEXT CHECK (robot IS NULL OR length(robot) = 16);
