-- What whoever shows a token may have: bytes of captures and results, and jobs that wait or run.
-- NULL for no limit but the server's own.
ALTER TABLE tokens ADD COLUMN quota_bytes INTEGER CHECK (quota_bytes >= 0);
ALTER TABLE tokens ADD COLUMN quota_jobs  INTEGER CHECK (quota_jobs >= 0);
