-- What the option `detail=auto` became on the machine that trains, and why; NULL if the job's options
-- name it, and before a machine has decided.
ALTER TABLE jobs ADD COLUMN detail TEXT;
ALTER TABLE jobs ADD COLUMN detail_because TEXT;
