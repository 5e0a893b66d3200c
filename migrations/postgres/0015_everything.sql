-- All that the numbered files beside this folder come to, in the words of PostgreSQL. Times are
-- milliseconds since 1970; flags are 0 or 1, as on SQLite, so that one text of SQL serves both.

CREATE TABLE captures (
    id TEXT NOT NULL PRIMARY KEY,
    name TEXT NOT NULL,
    accepted BIGINT NOT NULL CHECK (accepted >= 0),
    report TEXT NOT NULL CHECK (CAST(report AS JSON) IS NOT NULL),
    created_at BIGINT NOT NULL,
    owner TEXT,
    expires_at BIGINT
);

CREATE TABLE jobs (
    id TEXT NOT NULL PRIMARY KEY,
    name TEXT NOT NULL,
    capture_id TEXT NOT NULL REFERENCES captures (id),
    preset TEXT NOT NULL,
    options TEXT NOT NULL CHECK (CAST(options AS JSON) IS NOT NULL),
    state TEXT NOT NULL DEFAULT 'queued' CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    stage TEXT CHECK (stage IN ('poses', 'enhance', 'deblur', 'reconstruct', 'render', 'match', 'evaluate')),
    round BIGINT NOT NULL DEFAULT 0,
    rounds BIGINT NOT NULL DEFAULT 0,
    progress DOUBLE PRECISION NOT NULL DEFAULT 0 CHECK (progress BETWEEN 0 AND 1),
    steps_per_second DOUBLE PRECISION,
    eta_seconds DOUBLE PRECISION,
    error_code TEXT,
    error_detail TEXT,
    error_hint TEXT,
    best_round BIGINT,
    attempts BIGINT NOT NULL DEFAULT 0,
    failures BIGINT NOT NULL DEFAULT 0,
    failed_at DOUBLE PRECISION NOT NULL DEFAULT 0,
    not_before BIGINT NOT NULL DEFAULT 0,
    cancel_requested BIGINT NOT NULL DEFAULT 0 CHECK (cancel_requested IN (0, 1)),
    epoch BIGINT NOT NULL DEFAULT 0,
    lease_owner TEXT,
    lease_until BIGINT NOT NULL DEFAULT 0,
    created_at BIGINT NOT NULL,
    started_at BIGINT,
    finished_at BIGINT,
    pinned BIGINT NOT NULL DEFAULT 0 CHECK (pinned IN (0, 1)),
    expires_at BIGINT,
    files_version BIGINT NOT NULL DEFAULT 0,
    told BIGINT NOT NULL DEFAULT 0,
    needs_gpu BIGINT NOT NULL DEFAULT 0 CHECK (needs_gpu IN (0, 1)),
    needs_memory BIGINT NOT NULL DEFAULT 0 CHECK (needs_memory >= 0),
    priority BIGINT NOT NULL DEFAULT 0
);

CREATE TABLE events (
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    seq BIGINT NOT NULL CHECK (seq > 0),
    at BIGINT NOT NULL,
    kind TEXT NOT NULL,
    data TEXT NOT NULL CHECK (CAST(data AS JSON) IS NOT NULL),
    PRIMARY KEY (job_id, seq)
);

CREATE TABLE rounds (
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    round BIGINT NOT NULL CHECK (round > 0),
    metrics TEXT NOT NULL CHECK (CAST(metrics AS JSON) IS NOT NULL),
    PRIMARY KEY (job_id, round)
);

CREATE TABLE stages (
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    stage TEXT NOT NULL,
    round BIGINT NOT NULL,
    seconds DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (job_id, stage, round)
);

CREATE TABLE warnings (
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    code TEXT NOT NULL,
    message TEXT NOT NULL,
    at BIGINT NOT NULL,
    PRIMARY KEY (job_id, code, message)
);

CREATE TABLE idempotency (
    key TEXT NOT NULL PRIMARY KEY,
    fingerprint TEXT NOT NULL,
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    created_at BIGINT NOT NULL
);

CREATE TABLE artifacts (
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    name TEXT NOT NULL,
    bytes BIGINT NOT NULL,
    modified_ns BIGINT NOT NULL,
    sha256 TEXT NOT NULL,
    PRIMARY KEY (job_id, name)
);

CREATE TABLE tokens (
    id TEXT NOT NULL PRIMARY KEY,
    name TEXT NOT NULL,
    digest BYTEA NOT NULL UNIQUE CHECK (length(digest) = 32),
    scopes TEXT NOT NULL CHECK (length(scopes) > 0),
    created_at BIGINT NOT NULL,
    expires_at BIGINT,
    revoked_at BIGINT,
    last_used_at BIGINT,
    quota_bytes BIGINT CHECK (quota_bytes >= 0),
    quota_jobs BIGINT CHECK (quota_jobs >= 0),
    job_id TEXT REFERENCES jobs (id) ON DELETE CASCADE,
    made_by TEXT REFERENCES tokens (id)
);

CREATE TABLE sessions (
    digest BYTEA NOT NULL PRIMARY KEY CHECK (length(digest) = 32),
    token_id TEXT NOT NULL REFERENCES tokens (id) ON DELETE CASCADE,
    created_at BIGINT NOT NULL,
    expires_at BIGINT NOT NULL
);

CREATE TABLE uploads (
    id TEXT NOT NULL PRIMARY KEY,
    owner TEXT,
    filename TEXT NOT NULL,
    metadata TEXT NOT NULL,
    length BIGINT NOT NULL CHECK (length >= 0),
    judged BIGINT CHECK (judged BETWEEN 0 AND length),
    created_at BIGINT NOT NULL,
    expires_at BIGINT NOT NULL
);

CREATE TABLE webhooks (
    id TEXT NOT NULL PRIMARY KEY,
    url TEXT NOT NULL,
    secret BYTEA NOT NULL CHECK (length(secret) >= 24),
    types TEXT NOT NULL CHECK (CAST(types AS JSON) IS NOT NULL),
    owner TEXT,
    sees_all BIGINT NOT NULL CHECK (sees_all IN (0, 1)),
    made_by TEXT REFERENCES tokens (id),
    created_at BIGINT NOT NULL,
    gone_at BIGINT
);

CREATE TABLE deliveries (
    id TEXT NOT NULL PRIMARY KEY,
    webhook_id TEXT NOT NULL REFERENCES webhooks (id) ON DELETE CASCADE,
    type TEXT NOT NULL,
    body TEXT NOT NULL CHECK (CAST(body AS JSON) IS NOT NULL),
    created_at BIGINT NOT NULL,
    attempts BIGINT NOT NULL DEFAULT 0,
    next_at BIGINT,
    delivered_at BIGINT,
    answer TEXT
);

CREATE TABLE workers (
    id TEXT NOT NULL PRIMARY KEY,
    about TEXT NOT NULL CHECK (CAST(about AS JSON) IS NOT NULL),
    draining BIGINT NOT NULL DEFAULT 0 CHECK (draining IN (0, 1)),
    started_at BIGINT NOT NULL,
    seen_at BIGINT NOT NULL
);

CREATE TABLE capture_files (
    capture_id TEXT NOT NULL REFERENCES captures (id) ON DELETE CASCADE,
    path TEXT NOT NULL,
    digest TEXT NOT NULL,
    bytes BIGINT NOT NULL CHECK (bytes >= 0),
    PRIMARY KEY (capture_id, path)
);

CREATE TABLE job_files (
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    path TEXT NOT NULL,
    digest TEXT NOT NULL,
    bytes BIGINT NOT NULL CHECK (bytes >= 0),
    PRIMARY KEY (job_id, path)
);

CREATE INDEX jobs_by_state ON jobs (state, not_before, created_at);
CREATE INDEX jobs_by_capture ON jobs (capture_id);
CREATE INDEX captures_by_owner ON captures (owner, id);
CREATE INDEX uploads_by_owner ON uploads (owner, expires_at);
CREATE INDEX tokens_by_job ON tokens (job_id, created_at) WHERE job_id IS NOT NULL;
CREATE INDEX deliveries_due ON deliveries (next_at) WHERE next_at IS NOT NULL;
CREATE INDEX deliveries_by_webhook ON deliveries (webhook_id, created_at);
