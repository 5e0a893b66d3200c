-- A video is a job of another kind: it shows the result of the job `video_of`, and goes with it. Its
-- options are its plan.
ALTER TABLE jobs ADD COLUMN video_of TEXT REFERENCES jobs (id) ON DELETE CASCADE;
-- The size of a video that is made.
ALTER TABLE jobs ADD COLUMN bytes INTEGER CHECK (bytes >= 0);
CREATE INDEX videos_by_job ON jobs (video_of) WHERE video_of IS NOT NULL;
DROP TABLE errands;
