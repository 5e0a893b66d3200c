//! Work that only one of the processes sharing a database may do at a time.

use sqlx::postgres::{PgConnectOptions, PgConnection};
use sqlx::{ConnectOptions, Connection, Executor};

use super::Store;
use crate::error::Result;

/// Advisory lock of the process that collects unnamed blobs.
const COLLECTING: i64 = 0x66_6c65_6402;

/// The turn to collect, held until dropped. It is not a strict lock: a process can lose it
/// unnoticed with its connection, so the work must stay correct if two processes do it.
#[derive(Debug)]
pub struct Alone(Option<PgConnection>);

impl Store {
    /// Takes the turn to collect; `None` while another process has it. With SQLite there is no
    /// other process.
    ///
    /// The lock belongs to the session of a dedicated connection and goes with it, however it ends.
    /// On a pooled connection it would need an unlock on every exit path, even when the work is
    /// dropped halfway, and the connection could return to the pool with the lock still held. A
    /// transaction's lock would not do: no transaction may wait long for a blob store.
    ///
    /// # Errors
    /// When a database operation fails.
    pub async fn collecting(&self) -> Result<Option<Alone>> {
        let Some(url) = &self.url else {
            return Ok(Some(Alone(None)));
        };
        let options: PgConnectOptions = url.parse()?;
        let mut connection = options.connect().await?;
        // The connection is idle for minutes, and a machine that is cut off must not keep the turn.
        let settings = "SET tcp_keepalives_idle = 30; SET tcp_keepalives_interval = 10;
            SET tcp_keepalives_count = 3";
        connection.execute(settings).await?;
        let has_it = sqlx::query_scalar("SELECT pg_try_advisory_lock($1)")
            .bind(COLLECTING)
            .fetch_one(&mut connection)
            .await?;
        if has_it {
            return Ok(Some(Alone(Some(connection))));
        }
        connection.close().await?;
        Ok(None)
    }
}

impl Alone {
    /// Releases the turn at once. If dropped instead, it is free once the database notices.
    pub async fn end(self) {
        if let Some(connection) = self.0 {
            // A lost connection has lost the lock too.
            let _ = connection.close().await;
        }
    }
}
