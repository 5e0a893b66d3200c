-- What a job has shown so far. A rerun of a stage or a round replaces its row.
CREATE TABLE rounds (
    job_id  TEXT    NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    round   INTEGER NOT NULL CHECK (round > 0),
    metrics TEXT    NOT NULL CHECK (json_valid(metrics)),
    PRIMARY KEY (job_id, round)
) STRICT, WITHOUT ROWID;

CREATE TABLE stages (
    job_id  TEXT    NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    stage   TEXT    NOT NULL,
    round   INTEGER NOT NULL,
    seconds REAL    NOT NULL,
    PRIMARY KEY (job_id, stage, round)
) STRICT, WITHOUT ROWID;

CREATE TABLE warnings (
    job_id  TEXT    NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    code    TEXT    NOT NULL,
    message TEXT    NOT NULL,
    at      INTEGER NOT NULL,
    PRIMARY KEY (job_id, code, message)
) STRICT, WITHOUT ROWID;
