// Code for your own Rust program. Needs `base64`, `hmac` 0.12 and `sha2` 0.10.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, Mac as _};
use sha2::Sha256;

/// Tolerance of the timestamp, seconds; a request outside it may be a replay.
const TOLERANCE: u64 = 300;

/// Whether `body` was signed with the secret (`whsec_...`) according to the headers `webhook-id`,
/// `webhook-timestamp` and `webhook-signature`, and sent just now; `now` in seconds since 1970.
pub fn genuine(secret: &str, headers: [&str; 3], body: &[u8], now: i64) -> bool {
    let [id, sent, signatures] = headers;
    let is_now = sent.parse().is_ok_and(|sent: i64| now.abs_diff(sent) <= TOLERANCE);
    let Ok(key) = STANDARD.decode(secret.trim_start_matches("whsec_")) else {
        return false;
    };
    let signature = |text: &str| STANDARD.decode(text.strip_prefix("v1,")?).ok();
    is_now
        && signatures.split(' ').filter_map(signature).any(|shown| {
            let mut mac = Hmac::<Sha256>::new_from_slice(&key).expect("keys have any length");
            mac.update(format!("{id}.{sent}.").as_bytes());
            mac.update(body);
            // In constant time.
            mac.verify_slice(&shown).is_ok()
        })
}
