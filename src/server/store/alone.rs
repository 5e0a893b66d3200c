//! What one of all processes that share a database does at a time.

use sqlx::postgres::{PgConnectOptions, PgConnection};
use sqlx::{ConnectOptions, Connection, Executor};

use super::Store;
use crate::error::Result;

/// Held by who collects what nobody names.
const COLLECTING: i64 = 0x66_6c65_6402;

/// Nobody else does it, until this is dropped. It excludes nobody for sure: whoever loses the
/// database loses it without being told, so what is done under it is right when two do it, too.
#[derive(Debug)]
pub struct Alone(Option<PgConnection>);

impl Store {
    /// The turn to collect; `None` while another process has it. With SQLite there is no other.
    ///
    /// The lock is a session's, on a connection of its own and not one of the pool: that one would
    /// have to be unlocked on every way out, also when what is done under it is dropped halfway,
    /// and would come back with the lock where it is not. With this connection the lock goes,
    /// however it ends. One of a transaction would not do: no transaction may wait for a store of
    /// files for long.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn collecting(&self) -> Result<Option<Alone>> {
        let Some(url) = &self.url else {
            return Ok(Some(Alone(None)));
        };
        let options: PgConnectOptions = url.parse()?;
        let mut connection = options.connect().await?;
        // It says nothing for minutes, and a machine that is cut off must not keep the turn.
        let told = "SET tcp_keepalives_idle = 30; SET tcp_keepalives_interval = 10;
            SET tcp_keepalives_count = 3";
        connection.execute(told).await?;
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
    /// Lets another have it, at once; dropped, it is free as soon as the database notices.
    pub async fn end(self) {
        if let Some(connection) = self.0 {
            // One that is lost has lost the lock, too.
            let _ = connection.close().await;
        }
    }
}
