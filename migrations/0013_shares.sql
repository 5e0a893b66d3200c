-- Links that open one job to whoever has them: tokens that see that job alone. They go with the job,
-- and hold no longer than the token that made them is not revoked.
ALTER TABLE tokens ADD COLUMN job_id  TEXT REFERENCES jobs (id) ON DELETE CASCADE;
ALTER TABLE tokens ADD COLUMN made_by TEXT REFERENCES tokens (id);

CREATE INDEX tokens_by_job ON tokens (job_id, created_at) WHERE job_id IS NOT NULL;
