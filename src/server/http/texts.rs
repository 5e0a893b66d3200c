//! The rule for text from clients, checked before a handler or a database uses it: it must be
//! plain, since a database may refuse other text, and such text may mislead a reader.

use axum::extract::Request;
use axum::http::StatusCode;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use fled_core::plain::is_plain;
use fled_core::reading::below;
use percent_encoding::percent_decode_str;
use serde_json::Value;

use super::problem::Problem;

/// Refuses requests whose path is not plain text.
pub(super) async fn check_path(request: Request, next: Next) -> Response {
    let problem = match percent_decode_str(request.uri().path()).decode_utf8() {
        Ok(path) if is_plain(&path) => return next.run(request).await,
        Ok(_) => bad_text("The address"),
        Err(_) => Problem::new(StatusCode::BAD_REQUEST, "bad_request", "The address is not UTF-8."),
    };
    problem.into_response()
}

/// Checks a text of a request.
///
/// # Errors
/// 422 if it is not plain, with `pointer` to it.
pub(super) fn check_text(text: &str, pointer: &str) -> Result<(), Problem> {
    if is_plain(text) {
        return Ok(());
    }
    let name: String = pointer.trim_start_matches('/').escape_debug().collect();
    Err(bad_text(&format!("`{name}`")).pointer(pointer))
}

/// Checks every text in a JSON value at `pointer`.
///
/// # Errors
/// As [`check_text`].
pub(super) fn check_value(value: &Value, pointer: &str) -> Result<(), Problem> {
    match value {
        Value::String(text) => check_text(text, pointer),
        Value::Array(items) => items
            .iter()
            .enumerate()
            .try_for_each(|(at, item)| check_value(item, &format!("{pointer}/{at}"))),
        Value::Object(fields) => fields.iter().try_for_each(|(key, value)| {
            let pointer = format!("{pointer}{}", below(key, ""));
            check_text(key, &pointer)?;
            check_value(value, &pointer)
        }),
        Value::Null | Value::Bool(_) | Value::Number(_) => Ok(()),
    }
}

fn bad_text(what: &str) -> Problem {
    let detail = format!(
        "{what} contains a control character or one that turns the direction of the text around it."
    );
    Problem::unprocessable("bad_text", detail).hint("Send it without such characters.")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn every_text_of_a_body_is_checked() {
        let refused = |value: &Value| {
            let problem = check_value(value, "").expect_err("not plain");
            let problem = serde_json::to_value(problem).expect("plain data");
            (problem["code"].clone(), problem["pointer"].clone())
        };
        check_value(&json!({ "name": "Küche", "options": { "a": [1, "b", null] } }), "")
            .expect("plain");
        for (value, pointer) in [
            (json!("a\0"), ""),
            (json!({ "name": "a\u{202e}gpj" }), "/name"),
            (json!({ "options": { "a": ["b", "\u{1b}[2J"] } }), "/options/a/1"),
            (json!({ "a~/\n": 1 }), "/a~0~1\n"),
        ] {
            assert_eq!(refused(&value), (json!("bad_text"), json!(pointer)));
        }
    }
}
