//! Migrations of both databases.

/// Applied in order to SQLite, each once, never edited after release.
pub(super) const SQLITE: &[(i64, &str, &str)] = &[
    (1, "captures", include_str!("../../../migrations/0001_captures.sql")),
    (2, "jobs", include_str!("../../../migrations/0002_jobs.sql")),
    (3, "events", include_str!("../../../migrations/0003_events.sql")),
    (4, "results", include_str!("../../../migrations/0004_results.sql")),
    (5, "idempotency", include_str!("../../../migrations/0005_idempotency.sql")),
    (6, "artifacts", include_str!("../../../migrations/0006_artifacts.sql")),
    (7, "tokens", include_str!("../../../migrations/0007_tokens.sql")),
    (8, "sessions", include_str!("../../../migrations/0008_sessions.sql")),
    (9, "owners", include_str!("../../../migrations/0009_owners.sql")),
    (10, "quotas", include_str!("../../../migrations/0010_quotas.sql")),
    (11, "retention", include_str!("../../../migrations/0011_retention.sql")),
    (12, "uploads", include_str!("../../../migrations/0012_uploads.sql")),
    (13, "shares", include_str!("../../../migrations/0013_shares.sql")),
    (14, "webhooks", include_str!("../../../migrations/0014_webhooks.sql")),
    (15, "machines", include_str!("../../../migrations/0015_machines.sql")),
    (16, "traces", include_str!("../../../migrations/0016_traces.sql")),
    (17, "errands", include_str!("../../../migrations/0017_errands.sql")),
    (18, "collections", include_str!("../../../migrations/0018_collections.sql")),
    (19, "videos", include_str!("../../../migrations/0019_videos.sql")),
    (20, "tags", include_str!("../../../migrations/0020_tags.sql")),
    (21, "overlap", include_str!("../../../migrations/0021_overlap.sql")),
    (22, "detail", include_str!("../../../migrations/0022_detail.sql")),
];

/// The same for PostgreSQL: its first one equals all of SQLite's up to then, and has the same
/// number.
pub(super) const POSTGRES: &[(i64, &str, &str)] = &[
    (15, "everything", include_str!("../../../migrations/postgres/0015_everything.sql")),
    (16, "traces", include_str!("../../../migrations/postgres/0016_traces.sql")),
    (17, "errands", include_str!("../../../migrations/postgres/0017_errands.sql")),
    (18, "collections", include_str!("../../../migrations/postgres/0018_collections.sql")),
    (19, "videos", include_str!("../../../migrations/postgres/0019_videos.sql")),
    (20, "tags", include_str!("../../../migrations/postgres/0020_tags.sql")),
    (21, "overlap", include_str!("../../../migrations/postgres/0021_overlap.sql")),
    (22, "detail", include_str!("../../../migrations/postgres/0022_detail.sql")),
];
