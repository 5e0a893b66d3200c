//! All rows of a database: read as they are at one moment, and taken into an empty one.

use fled_blobs::Kept;
use futures::StreamExt;
use serde_json::{Map, Value, json};
use sqlx::any::AnyRow;
use sqlx::{Any, Row, Transaction};

use super::effects::{Settlement, settle};
use super::engine::{Cells, Tx};
use super::tables::{Column, Kind, TABLES, Table, columns};
use super::{Engine, Store, files};
use crate::error::{Result, ServerError};

/// What is in the database at one moment.
#[derive(Debug)]
pub struct Snapshot {
    tx: Transaction<'static, Any>,
    engine: Engine,
}

/// Rows that come into an empty database: all of them, or none where it is dropped.
#[derive(Debug)]
pub struct Intake {
    tx: Tx,
}

impl Store {
    /// The rows as they are now, whatever others write meanwhile.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn snapshot(&self) -> Result<Snapshot> {
        let begin = match self.engine {
            // What is read first decides of which moment it is.
            Engine::Sqlite => "BEGIN",
            Engine::Postgres => "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY",
        };
        let tx = self.pool.begin_with(begin).await?;
        Ok(Snapshot {
            tx,
            engine: self.engine,
        })
    }

    /// The name of a table that has rows, if there is one.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn has_rows(&self) -> Result<Option<&'static str>> {
        let mut tx = self.begin().await?;
        has_rows(&mut tx).await
    }

    /// Begins to take rows in; `Err` with the name of a table that has some already.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn take_in(&self) -> Result<std::result::Result<Intake, &'static str>> {
        let mut tx = self.write().await?;
        Ok(match has_rows(&mut tx).await? {
            Some(table) => Err(table),
            None => Ok(Intake { tx }),
        })
    }
}

impl Snapshot {
    /// Which columns a table has, by name.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn columns(&mut self, table: &Table) -> Result<Vec<String>> {
        let columns = columns(&mut self.tx, self.engine, table.name).await?;
        Ok(columns.into_iter().map(|column| column.name).collect())
    }

    /// How many rows a table has.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn count(&mut self, table: &Table) -> Result<u64> {
        let count = format!("SELECT COUNT(*) FROM {}", table.name);
        let count: i64 = sqlx::query_scalar(sqlx::AssertSqlSafe(count))
            .fetch_one(&mut *self.tx)
            .await?;
        Ok(count.unsigned_abs())
    }

    /// Tells every row of a table, with the names of its columns.
    ///
    /// # Errors
    /// When the database refuses, or what `tell` says.
    pub async fn each(
        &mut self,
        table: &Table,
        mut tell: impl FnMut(Map<String, Value>) -> Result<()>,
    ) -> Result<()> {
        let columns = columns(&mut self.tx, self.engine, table.name).await?;
        let all = format!("SELECT * FROM {} ORDER BY {}", table.name, table.order);
        let mut rows = sqlx::query(sqlx::AssertSqlSafe(all)).fetch(&mut *self.tx);
        while let Some(row) = rows.next().await {
            let row = row?;
            let cell = |column: &Column| Ok((column.name.clone(), cell(&row, column)?));
            tell(columns.iter().map(cell).collect::<Result<_>>()?)?;
        }
        Ok(())
    }
}

impl Intake {
    /// Which columns a table has, by name.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn columns(&mut self, table: &Table) -> Result<Vec<String>> {
        let engine = self.tx.engine;
        let columns = columns(&mut self.tx, engine, table.name).await?;
        Ok(columns.into_iter().map(|column| column.name).collect())
    }

    /// Takes rows of a table, as [`Snapshot::each`] tells them.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn insert(&mut self, table: &Table, rows: &[Value]) -> Result<()> {
        let engine = self.tx.engine;
        let columns = columns(&mut self.tx, engine, table.name).await?;
        let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
        let names = names.join(", ");
        let name = table.name;
        let insert = match engine {
            Engine::Postgres => format!(
                "INSERT INTO {name} ({names})
                 SELECT {names} FROM json_populate_recordset(NULL::{name}, CAST($1 AS JSON))"
            ),
            Engine::Sqlite => {
                let cells: Vec<String> = columns.iter().map(from_json).collect();
                format!(
                    "INSERT INTO {name} ({names}) SELECT {} FROM json_each($1)",
                    cells.join(", ")
                )
            }
        };
        sqlx::query(sqlx::AssertSqlSafe(insert))
            .bind(json!(rows).to_string())
            .execute(&mut *self.tx)
            .await?;
        Ok(())
    }

    /// Names the files of a capture, which are in the store of files.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn name_of_capture(&mut self, id: &str, files: &[Kept]) -> Result<()> {
        files::insert_of_capture(&mut self.tx, id, files).await
    }

    /// Names the files of a job, which are in the store of files.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn name_of_job(&mut self, id: &str, files: &[Kept]) -> Result<()> {
        files::change(&mut self.tx, id, files, &[]).await
    }

    /// Queues again what ran where the rows come from, or, where that was asked, cancels it, and
    /// makes it all true. How many that are.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn finish(mut self) -> Result<usize> {
        let running = "SELECT id, cancel_requested FROM jobs WHERE state = 'running' ORDER BY id";
        let running = sqlx::query(running).fetch_all(&mut *self.tx).await?;
        for row in &running {
            let id: String = row.try_get("id")?;
            let settlement = match row.flag("cancel_requested")? {
                true => Settlement::Stopped,
                false => Settlement::Released,
            };
            settle(&mut self.tx, &id, &settlement).await?;
            sqlx::query("UPDATE jobs SET epoch = epoch + 1 WHERE id = $1")
                .bind(&id)
                .execute(&mut *self.tx)
                .await?;
        }
        self.tx.commit().await?;
        Ok(running.len())
    }
}

async fn has_rows(tx: &mut Tx) -> Result<Option<&'static str>> {
    let names = TABLES.iter().map(|table| table.name);
    // A server that was only started leaves its mark; marks of two are those of both.
    let names = names.filter(|name| *name != "collections");
    for name in names.chain(super::tables::PASSING) {
        let any = format!("SELECT COUNT(*) FROM (SELECT 1 AS one FROM {name} LIMIT 1) AS found");
        let any: i64 = sqlx::query_scalar(sqlx::AssertSqlSafe(any))
            .fetch_one(&mut **tx)
            .await?;
        if any > 0 {
            return Ok(Some(name));
        }
    }
    Ok(None)
}

/// A cell as JSON: bytes are a text that begins with `\x`, as PostgreSQL writes them.
fn cell(row: &AnyRow, column: &Column) -> Result<Value> {
    let name = column.name.as_str();
    Ok(match column.kind {
        Kind::Text => json!(row.try_get::<Option<String>, _>(name)?),
        Kind::Whole => json!(row.try_get::<Option<i64>, _>(name)?),
        Kind::Number => {
            let number: Option<f64> = row.try_get(name)?;
            if number.is_some_and(|number| !number.is_finite()) {
                return Err(ServerError::Damaged {
                    what: "number",
                    detail: format!("{name} is not finite"),
                });
            }
            json!(number)
        }
        Kind::Bytes => {
            let bytes: Option<Vec<u8>> = row.try_get(name)?;
            let written = |bytes: Vec<u8>| {
                let digits = bytes.iter().map(|byte| format!("{byte:02x}"));
                format!("\\x{}", digits.collect::<String>())
            };
            json!(bytes.map(written))
        }
    })
}

/// The same cell out of a JSON object, in the words of SQLite.
fn from_json(column: &Column) -> String {
    let cell = format!("json_extract(value, '$.{}')", column.name);
    match column.kind {
        Kind::Bytes => format!("unhex(substr({cell}, 3))"),
        Kind::Text | Kind::Whole | Kind::Number => cell,
    }
}
