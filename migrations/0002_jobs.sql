-- Jobs, their lease and what is shown of their progress. Times are milliseconds since 1970.
CREATE TABLE jobs (
    id               TEXT    NOT NULL PRIMARY KEY,
    name             TEXT    NOT NULL,
    capture_id       TEXT    NOT NULL REFERENCES captures (id),
    preset           TEXT    NOT NULL,
    options          TEXT    NOT NULL CHECK (json_valid(options)),
    state            TEXT    NOT NULL DEFAULT 'queued'
                     CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    stage            TEXT    CHECK (stage IN ('poses', 'enhance', 'deblur', 'reconstruct', 'render', 'match', 'evaluate')),
    round            INTEGER NOT NULL DEFAULT 0,
    rounds           INTEGER NOT NULL DEFAULT 0,
    progress         REAL    NOT NULL DEFAULT 0 CHECK (progress BETWEEN 0 AND 1),
    steps_per_second REAL,
    eta_seconds      REAL,
    error_code       TEXT,
    error_detail     TEXT,
    error_hint       TEXT,
    best_round       INTEGER,
    attempts         INTEGER NOT NULL DEFAULT 0,
    -- Failures in a row without progress, and the progress at the last of them.
    failures         INTEGER NOT NULL DEFAULT 0,
    failed_at        REAL    NOT NULL DEFAULT 0,
    not_before       INTEGER NOT NULL DEFAULT 0,
    cancel_requested INTEGER NOT NULL DEFAULT 0 CHECK (cancel_requested IN (0, 1)),
    -- The epoch grows with every claim: a worker whose epoch is old writes nothing.
    epoch            INTEGER NOT NULL DEFAULT 0,
    lease_owner      TEXT,
    lease_until      INTEGER NOT NULL DEFAULT 0,
    created_at       INTEGER NOT NULL,
    started_at       INTEGER,
    finished_at      INTEGER
) STRICT;

CREATE INDEX jobs_by_state ON jobs (state, not_before, created_at);
CREATE INDEX jobs_by_capture ON jobs (capture_id);
