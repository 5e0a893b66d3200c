-- Whom to tell of jobs, and what they are still to be told: a delivery is written in the transaction
-- of the event that it tells of. Secrets are kept as they are, because every delivery is signed anew.
CREATE TABLE webhooks (
    id          TEXT    NOT NULL PRIMARY KEY,
    url         TEXT    NOT NULL,
    secret      BLOB    NOT NULL CHECK (length(secret) >= 24),
    -- JSON array of the types that are wanted.
    types       TEXT    NOT NULL CHECK (json_valid(types)),
    owner       TEXT,
    -- Whether it is told of everybody's jobs.
    sees_all    INTEGER NOT NULL CHECK (sees_all IN (0, 1)),
    -- It holds no longer than this token.
    made_by     TEXT    REFERENCES tokens (id),
    created_at  INTEGER NOT NULL,
    -- Since when its address says that it is gone.
    gone_at     INTEGER
) STRICT, WITHOUT ROWID;

CREATE TABLE deliveries (
    id           TEXT    NOT NULL PRIMARY KEY,
    webhook_id   TEXT    NOT NULL REFERENCES webhooks (id) ON DELETE CASCADE,
    type         TEXT    NOT NULL,
    body         TEXT    NOT NULL CHECK (json_valid(body)),
    created_at   INTEGER NOT NULL,
    attempts     INTEGER NOT NULL DEFAULT 0,
    -- When it is tried next; NULL when it arrived or was given up.
    next_at      INTEGER,
    delivered_at INTEGER,
    -- What the last attempt came to.
    answer       TEXT
) STRICT, WITHOUT ROWID;

CREATE INDEX deliveries_due ON deliveries (next_at) WHERE next_at IS NOT NULL;
CREATE INDEX deliveries_by_webhook ON deliveries (webhook_id, created_at);
