-- Uploads in pieces (tus 1.0) of which no capture is made yet. The bytes of one lie in uploads/<id>
-- of the data directory, and as many as lie there have come: a row exists only once its file does.
CREATE TABLE uploads (
    id         TEXT    NOT NULL PRIMARY KEY,
    owner      TEXT,
    filename   TEXT    NOT NULL,
    metadata   TEXT    NOT NULL,
    length     INTEGER NOT NULL CHECK (length >= 0),
    -- While a piece with a checksum comes: where it begins. What lies behind that is not judged yet.
    judged     INTEGER CHECK (judged BETWEEN 0 AND length),
    created_at INTEGER NOT NULL,
    expires_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE INDEX uploads_by_owner ON uploads (owner, expires_at);
