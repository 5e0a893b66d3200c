//! Copy of all rows of an SQLite database into an empty PostgreSQL one.

use fled_blobs::Kept;
use futures::StreamExt;
use serde_json::{Map, Value, json};
use sqlx::any::{AnyRow, AnyTypeInfoKind};
use sqlx::{Column, Row, ValueRef};

use super::{Store, Tx};
use crate::error::{Result, ServerError};

/// Tables to copy, in an order in which none refers to a later one.
const COPIED: [&str; 14] = [
    "captures",
    "jobs",
    "events",
    "rounds",
    "stages",
    "warnings",
    "idempotency",
    "artifacts",
    "tokens",
    "sessions",
    "webhooks",
    "deliveries",
    "capture_files",
    "job_files",
];

/// Rows per insert.
const ROWS: usize = 500;

impl Store {
    /// Checks that this database is empty.
    ///
    /// # Errors
    /// [`ServerError::NotMoved`] if a table has rows; when a database operation fails.
    pub async fn expect_no_rows(&self) -> Result<()> {
        expect_no_rows(&mut self.begin().await?).await
    }

    /// Copies all rows of `source` and names the files of its captures and jobs, which are in the
    /// blob store, in one transaction. Returns the number of rows of `source`.
    ///
    /// # Errors
    /// [`ServerError::NotMoved`] if this database has rows; when an operation of either database
    /// fails. Nothing is copied then.
    pub async fn copy_from(
        &self,
        source: &Self,
        of_captures: &[(String, Kept)],
        of_jobs: &[(String, Kept)],
    ) -> Result<usize> {
        let (mut from, mut to) = (source.write().await?, self.write().await?);
        expect_no_rows(&mut to).await?;
        let mut copied = 0;
        for table in COPIED {
            // A share link refers to the token that created it, a video to its job.
            let order = match table {
                "jobs" => " ORDER BY video_of IS NOT NULL",
                "tokens" => " ORDER BY made_by IS NOT NULL",
                _ => "",
            };
            let all = sqlx::AssertSqlSafe(format!("SELECT * FROM {table}{order}"));
            let rows = sqlx::query(all).fetch(&mut *from);
            let mut rows = rows.map(|row| cells(&row?)).chunks(ROWS);
            while let Some(some) = rows.next().await {
                let some: Vec<_> = some.into_iter().collect::<Result<_>>()?;
                insert(&mut to, table, &some).await?;
                copied += some.len();
            }
        }
        for (table, owner, files) in
            [("capture_files", "capture_id", of_captures), ("job_files", "job_id", of_jobs)]
        {
            for some in files.chunks(ROWS) {
                let some: Vec<_> = some.iter().map(|(id, file)| name(owner, id, file)).collect();
                insert(&mut to, table, &some).await?;
            }
        }
        to.commit().await?;
        Ok(copied)
    }
}

async fn expect_no_rows(tx: &mut Tx) -> Result<()> {
    for table in COPIED {
        let any = format!("SELECT COUNT(*) FROM (SELECT 1 AS one FROM {table} LIMIT 1) AS found");
        let any: i64 = sqlx::query_scalar(sqlx::AssertSqlSafe(any)).fetch_one(&mut **tx).await?;
        if any > 0 {
            return Err(ServerError::NotMoved(format!(
                "the database already has rows in its table {table}; use an empty one"
            )));
        }
    }
    Ok(())
}

/// The row that names a file.
fn name(owner: &str, id: &str, file: &Kept) -> Map<String, Value> {
    Map::from_iter([
        (owner.to_owned(), json!(id)),
        ("path".to_owned(), json!(file.path)),
        ("digest".to_owned(), json!(file.blob.digest)),
        ("bytes".to_owned(), json!(file.blob.bytes)),
    ])
}

/// Inserts rows with the same columns.
async fn insert(tx: &mut Tx, table: &str, rows: &[Map<String, Value>]) -> Result<()> {
    let columns = rows.first().into_iter().flat_map(Map::keys);
    let columns: Vec<&str> = columns.map(String::as_str).collect();
    let columns = columns.join(", ");
    let insert = format!(
        "INSERT INTO {table} ({columns})
         SELECT {columns} FROM json_populate_recordset(NULL::{table}, CAST($1 AS JSON))"
    );
    sqlx::query(sqlx::AssertSqlSafe(insert))
        .bind(json!(rows).to_string())
        .execute(&mut **tx)
        .await?;
    Ok(())
}

/// A row by column, as PostgreSQL reads it from JSON.
fn cells(row: &AnyRow) -> Result<Map<String, Value>> {
    let mut cells = Map::new();
    for (at, column) in row.columns().iter().enumerate() {
        let cell = match row.try_get_raw(at)?.type_info().kind() {
            AnyTypeInfoKind::Null => Value::Null,
            AnyTypeInfoKind::Text => json!(row.try_get::<String, _>(at)?),
            AnyTypeInfoKind::Double => json!(row.try_get::<f64, _>(at)?),
            AnyTypeInfoKind::Blob => {
                let bytes: Vec<u8> = row.try_get(at)?;
                let digits = bytes.iter().map(|byte| format!("{byte:02x}"));
                json!(format!("\\x{}", digits.collect::<String>()))
            }
            _ => json!(row.try_get::<i64, _>(at)?),
        };
        cells.insert(column.name().to_owned(), cell);
    }
    Ok(cells)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::store::Engine;
    use crate::store::tests::of_each;

    /// Tables that are not copied: uploads and workers belong to one machine, an identity to one
    /// database.
    const LEFT: [&str; 3] = ["uploads", "workers", "collections"];

    #[tokio::test]
    async fn both_databases_have_the_same_tables_and_columns() {
        let mut known: BTreeSet<String> = COPIED.map(str::to_owned).into();
        known.extend(LEFT.map(str::to_owned));
        let mut described = Vec::new();
        for (_dir, store) in of_each().await {
            let columns = match store.engine() {
                Engine::Sqlite => {
                    "SELECT tables.name || '.' || columns.name FROM sqlite_schema AS tables
                     JOIN pragma_table_info(tables.name) AS columns WHERE tables.type = 'table'"
                }
                Engine::Postgres => {
                    "SELECT table_name || '.' || column_name FROM information_schema.columns
                     WHERE table_schema = current_schema()"
                }
            };
            let columns = sqlx::query_scalar(columns).fetch_all(&store.pool).await;
            let columns: Vec<String> = columns.expect("described");
            let ours =
                |column: &String| !column.starts_with("_sqlx") && !column.starts_with("sqlite_");
            let columns: BTreeSet<String> = columns.into_iter().filter(ours).collect();
            let tables = columns.iter().filter_map(|column| column.split_once('.'));
            let tables: BTreeSet<String> = tables.map(|(table, _)| table.to_owned()).collect();
            assert_eq!(tables, known, "{}", store.engine());
            described.push(columns);
        }
        assert_eq!(described[0], described[1]);
    }
}
