-- Who works, and which files there are: for machines that share a database and a store of files. A
-- server that keeps its files in its own directory names none here.
CREATE TABLE workers (
    id         TEXT    NOT NULL PRIMARY KEY,
    -- JSON: name, version, adapter, cores, bytes of memory, jobs at once.
    about      TEXT    NOT NULL CHECK (json_valid(about)),
    draining   INTEGER NOT NULL DEFAULT 0 CHECK (draining IN (0, 1)),
    started_at INTEGER NOT NULL,
    seen_at    INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- A file's bytes lie in the store under their digest (blake3).
CREATE TABLE capture_files (
    capture_id TEXT    NOT NULL REFERENCES captures (id) ON DELETE CASCADE,
    path       TEXT    NOT NULL,
    digest     TEXT    NOT NULL,
    bytes      INTEGER NOT NULL CHECK (bytes >= 0),
    PRIMARY KEY (capture_id, path)
) STRICT, WITHOUT ROWID;

CREATE TABLE job_files (
    job_id TEXT    NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    path   TEXT    NOT NULL,
    digest TEXT    NOT NULL,
    bytes  INTEGER NOT NULL CHECK (bytes >= 0),
    PRIMARY KEY (job_id, path)
) STRICT, WITHOUT ROWID;

-- Grows with every change of the job's files.
ALTER TABLE jobs ADD COLUMN files_version INTEGER NOT NULL DEFAULT 0;
-- The number of the last thing that the worker of this epoch has told: said again, because an answer
-- was lost, it does nothing.
ALTER TABLE jobs ADD COLUMN told INTEGER NOT NULL DEFAULT 0;
-- What a machine must have to be given the job.
ALTER TABLE jobs ADD COLUMN needs_gpu    INTEGER NOT NULL DEFAULT 0 CHECK (needs_gpu IN (0, 1));
ALTER TABLE jobs ADD COLUMN needs_memory INTEGER NOT NULL DEFAULT 0 CHECK (needs_memory >= 0);
-- Higher goes first.
ALTER TABLE jobs ADD COLUMN priority     INTEGER NOT NULL DEFAULT 0;
