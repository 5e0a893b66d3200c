-- The user's words for a job, by which the list is searched: a JSON array.
ALTER TABLE jobs ADD COLUMN tags TEXT NOT NULL DEFAULT '[]';
