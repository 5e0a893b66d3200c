-- Which looks for blobs that no file has were this database's own: the store of files has the id of
-- the last, whoever made it. The newest, and the one that was found there last.
CREATE TABLE collections (
    id TEXT NOT NULL PRIMARY KEY,
    begun_at BIGINT NOT NULL,
    -- The mark that it found in the store.
    found TEXT
);
-- Until when who asks waits for it, unless it says so again.
ALTER TABLE errands ADD COLUMN wanted_until BIGINT NOT NULL DEFAULT 0;
