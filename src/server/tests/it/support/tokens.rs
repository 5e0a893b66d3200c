//! Tokens in the database of a running server.

use fled_server::store::{NewToken, Quotas, Store};
use fled_server::token::{Secret, new_id};

use super::Server;

/// Creates a token with these scopes in the server's database, like `fled token create`, and
/// returns its header and its id.
pub fn token(server: &Server, scopes: &str) -> (String, String) {
    token_of("", server, scopes)
}

/// Like [`token`], with a name.
pub fn token_of(name: &str, server: &Server, scopes: &str) -> (String, String) {
    token_with(server, name, scopes, Quotas::default())
}

/// Like [`token`], with a name and quotas.
pub fn token_with(server: &Server, name: &str, scopes: &str, quotas: Quotas) -> (String, String) {
    kept(server, name, scopes, quotas, None)
}

/// Like [`token`], with a name and an expiry in milliseconds since 1970.
pub fn token_until(server: &Server, name: &str, scopes: &str, ends: i64) -> (String, String) {
    kept(server, name, scopes, Quotas::default(), Some(ends))
}

fn kept(
    server: &Server,
    name: &str,
    scopes: &str,
    quotas: Quotas,
    expires_at: Option<i64>,
) -> (String, String) {
    let secret = Secret::new().expect("random");
    let token = NewToken {
        id: new_id().expect("random"),
        name: name.to_owned(),
        digest: secret.digest(),
        scopes: scopes.parse().expect("scopes"),
        expires_at,
        quotas,
    };
    with_store(server, async |store| {
        store.insert_token(&token).await.expect("kept");
    });
    (format!("Bearer {}", secret.reveal()), token.id)
}

pub fn with_store<T>(server: &Server, work: impl AsyncFnOnce(&Store) -> T) -> T {
    let path = server.data.path().join("data/fled.db");
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
    runtime.block_on(async {
        let store = Store::open(&path).await.expect("open");
        let outcome = work(&store).await;
        store.close().await;
        outcome
    })
}
