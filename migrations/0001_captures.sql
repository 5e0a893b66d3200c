-- What was uploaded. The files lie under captures/<id>/ in the data directory; a row exists only
-- once they are complete and fsynced.
CREATE TABLE captures (
    id         TEXT    NOT NULL PRIMARY KEY,
    name       TEXT    NOT NULL,
    accepted   INTEGER NOT NULL CHECK (accepted >= 0),
    report     TEXT    NOT NULL CHECK (json_valid(report)),
    created_at INTEGER NOT NULL
) STRICT;
