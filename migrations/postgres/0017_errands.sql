-- What a replica asks a worker to do at once, besides jobs: views and videos of results. Who asks
-- waits, and removes its row.
CREATE TABLE errands (
    id TEXT NOT NULL PRIMARY KEY,
    -- Who is asked.
    worker TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('view', 'video')),
    -- JSON: files and task.
    errand TEXT NOT NULL CHECK (CAST(errand AS JSON) IS NOT NULL),
    asked_at BIGINT NOT NULL,
    -- Until when the worker that has taken it up is not taken for lost; NULL before.
    taken_until BIGINT,
    done BIGINT NOT NULL DEFAULT 0,
    total BIGINT NOT NULL DEFAULT 0,
    -- JSON: what came of it.
    outcome TEXT CHECK (outcome IS NULL OR CAST(outcome AS JSON) IS NOT NULL)
);
CREATE INDEX errands_of_worker ON errands (worker, kind, asked_at);
