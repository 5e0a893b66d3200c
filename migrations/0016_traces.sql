-- The trace of the request that made the job, as W3C's `traceparent`: its attempts belong to it, on
-- whatever machine. NULL where nobody asked for traces.
ALTER TABLE jobs ADD COLUMN traceparent TEXT;
