-- The groups of photographs that matches connect, if they do not connect all: a JSON object.
ALTER TABLE jobs ADD COLUMN overlap TEXT;
