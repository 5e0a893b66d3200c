//! The tables, as they move from one installation to another, and their columns as the database
//! itself describes them: one that is new cannot be forgotten.

use sqlx::{AnyConnection, Row};

use super::Engine;
use crate::error::{Result, ServerError};

/// A table.
#[derive(Debug)]
pub struct Table {
    /// Its name.
    pub name: &'static str,
    /// The order of its rows: none names one that comes after it.
    pub(super) order: &'static str,
    /// Whether its rows are true elsewhere, too.
    pub moves: bool,
}

const fn moves(name: &'static str, order: &'static str) -> Table {
    Table {
        name,
        order,
        moves: true,
    }
}

const fn stays(name: &'static str) -> Table {
    Table {
        name,
        order: "id",
        moves: false,
    }
}

/// All of them: none names rows of one that comes after it.
pub const TABLES: [Table; 16] = [
    moves("captures", "id"),
    moves("jobs", "id"),
    moves("events", "job_id, seq"),
    moves("rounds", "job_id, round"),
    moves("stages", "job_id, stage, round"),
    moves("warnings", "job_id, code, message"),
    moves("idempotency", "key"),
    moves("artifacts", "job_id, name"),
    // A link is a token that another one has made.
    moves("tokens", "CASE WHEN made_by IS NULL THEN 0 ELSE 1 END, id"),
    moves("sessions", "digest"),
    moves("webhooks", "id"),
    moves("deliveries", "id"),
    moves("capture_files", "capture_id, path"),
    moves("job_files", "job_id, path"),
    moves("collections", "begun_at, id"),
    // Their pieces lie on one machine.
    stays("uploads"),
];

/// Tables that are not moved: workers register again by themselves, and nothing writes errands any
/// more.
pub(super) const PASSING: [&str; 2] = ["workers", "errands"];

/// What a cell holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Text,
    Whole,
    Number,
    Bytes,
}

impl Kind {
    fn of(name: &str) -> Option<Self> {
        match name.to_ascii_lowercase().as_str() {
            "text" => Some(Self::Text),
            "integer" | "bigint" => Some(Self::Whole),
            "real" | "double precision" => Some(Self::Number),
            "blob" | "bytea" => Some(Self::Bytes),
            _ => None,
        }
    }
}

/// A column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Column {
    pub name: String,
    pub kind: Kind,
}

/// The columns of a table, by name.
pub(super) async fn columns(
    connection: &mut AnyConnection,
    engine: Engine,
    table: &str,
) -> Result<Vec<Column>> {
    let described = match engine {
        Engine::Sqlite => "SELECT name, type AS kind FROM pragma_table_info($1) ORDER BY name",
        Engine::Postgres => {
            "SELECT CAST(column_name AS TEXT) AS name, CAST(data_type AS TEXT) AS kind
             FROM information_schema.columns
             WHERE table_schema = current_schema() AND table_name = $1
             ORDER BY CAST(column_name AS TEXT) COLLATE \"C\""
        }
    };
    let rows = sqlx::query(described).bind(table);
    let rows = rows.fetch_all(connection).await?;
    let column = |row: &sqlx::any::AnyRow| {
        let kind: String = row.try_get("kind")?;
        Ok(Column {
            name: row.try_get("name")?,
            kind: Kind::of(&kind).ok_or_else(|| ServerError::Damaged {
                what: "schema",
                detail: format!("{table} has a column of type {kind}"),
            })?,
        })
    };
    rows.iter().map(column).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::store::tests::of_each;

    #[tokio::test]
    async fn every_table_of_both_databases_is_known_and_has_the_same_columns() {
        let [(_file, file), (_server, server)] = of_each().await;
        let mut known: BTreeSet<&str> = TABLES.iter().map(|table| table.name).collect();
        known.extend(PASSING);
        let mut described = Vec::new();
        for store in [&file, &server] {
            let all = match store.engine() {
                Engine::Sqlite => "SELECT name FROM sqlite_schema WHERE type = 'table'",
                Engine::Postgres => {
                    "SELECT CAST(table_name AS TEXT) FROM information_schema.tables
                     WHERE table_schema = current_schema()"
                }
            };
            let all: Vec<String> = sqlx::query_scalar(all)
                .fetch_all(&store.pool)
                .await
                .expect("tables");
            let all: BTreeSet<&str> = all
                .iter()
                .map(String::as_str)
                .filter(|name| !name.starts_with("_sqlx") && !name.starts_with("sqlite_"))
                .collect();
            assert_eq!(all, known, "{}", store.engine());
            let mut connection = store.pool.acquire().await.expect("a connection");
            let mut columns_of = Vec::new();
            for table in &known {
                let columns = columns(&mut connection, store.engine(), table).await;
                columns_of.push((*table, columns.expect("described")));
            }
            assert!(columns_of.iter().all(|(_, columns)| columns.len() > 2));
            described.push(columns_of);
        }
        assert_eq!(described[0], described[1]);
        let numbered: i64 = sqlx::query_scalar("SELECT COUNT(*) FROM pg_sequences")
            .fetch_one(&server.pool)
            .await
            .expect("counted");
        assert_eq!(numbered, 0, "a sequence has to be set after an import");
    }
}
