-- What the server deletes of itself, and when. Nothing goes that has not said so for a while, and no
-- job that somebody pinned.
ALTER TABLE jobs     ADD COLUMN pinned     INTEGER NOT NULL DEFAULT 0 CHECK (pinned IN (0, 1));
ALTER TABLE jobs     ADD COLUMN expires_at INTEGER;
ALTER TABLE captures ADD COLUMN expires_at INTEGER;
