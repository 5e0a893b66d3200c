-- Whose a capture is, and so its jobs: a token's name. NULL where nobody was asked for a token.
ALTER TABLE captures ADD COLUMN owner TEXT;

CREATE INDEX captures_by_owner ON captures (owner, id);
