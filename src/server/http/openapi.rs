//! `/openapi.yaml`: generated from the handlers, checked in, and compared by a test.

mod complete;

use axum::http::header;
use axum::response::{IntoResponse, Redirect};
use serde_json::Value;
use utoipa::OpenApi as _;
use utoipa::openapi::path::{Operation, ParameterIn};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{Content, OpenApi, Ref, RefOr, Response, ResponseBuilder};
use utoipa_axum::router::OpenApiRouter;

use super::{login, rounds, routes};

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "fled",
        description = "Turns dark, noisy, shaken photographs of a place into a bright, sharp 3D scene.",
        license(name = "MIT OR Apache-2.0")
    ),
    servers((url = ".", description = "Where this document is, also below the path of a proxy")),
    // A schema used only in a query is not found automatically. The dashboard's login is not part
    // of the API, but its types are checked against this document.
    components(schemas(rounds::Form, login::Session))
)]
struct Api;

/// Name of the security scheme.
const TOKEN: &str = "token";

/// An error that every request may get.
const UNKNOWN_HOST: (&str, &str) = ("421", "The request does not use a name of this server");

/// An error for an invalid address, in any operation.
const BAD_TEXT: (&str, &str) = ("422", "The address has control characters");

/// Adds to every operation the errors that may occur before its handler.
fn add_refusals(api: &mut OpenApi) {
    let scheme = HttpBuilder::new().scheme(HttpAuthScheme::Bearer);
    let scheme = scheme.description(Some("Create tokens with `fled token create`."));
    let scheme = SecurityScheme::Http(scheme.build());
    api.components.get_or_insert_default().add_security_scheme(TOKEN, scheme);
    for (path, item) in &mut api.paths.paths {
        let operations = [
            &mut item.get,
            &mut item.put,
            &mut item.post,
            &mut item.patch,
            &mut item.delete,
            &mut item.head,
        ];
        for operation in operations.into_iter().flatten() {
            refuse(operation, path);
        }
        // Discovery is open to everyone.
        if let Some(operation) = &mut item.options {
            let answers = &mut operation.responses.responses;
            for (status, description) in [UNKNOWN_HOST, BAD_TEXT] {
                answers.insert(status.to_owned(), problem(description).into());
            }
        }
    }
}

fn refuse(operation: &mut Operation, path: &str) {
    let asks = |place: &ParameterIn| {
        let parameters = operation.parameters.iter().flatten();
        parameters.clone().any(|parameter| match parameter {
            RefOr::T(parameter) => parameter.parameter_in == *place,
            RefOr::Ref(_) => false,
        })
    };
    let has_body = operation.request_body.is_some();
    let mut refusals = vec![UNKNOWN_HOST];
    if has_body || asks(&ParameterIn::Query) || asks(&ParameterIn::Header) {
        refusals.push(("400", "A parameter, a header or the body cannot be read"));
    }
    if has_body {
        refusals.push(("413", "The body is too large"));
        refusals.push(("415", "The body has an unsupported type"));
    }
    if path.starts_with("/v1/") || path == "/metrics" {
        refusals.push(("401", "A valid token is required"));
        refusals.push(("403", "The token lacks the required scope"));
        refusals.push(("429", "Too many requests; `Retry-After` says when to try again"));
        let needs = SecurityRequirement::new::<_, [&str; 0], &str>(TOKEN, []);
        // No token is required while none exists.
        operation.security = Some(vec![SecurityRequirement::default(), needs]);
        refusals.push(("default", "Any other error"));
    }
    for (status, description) in refusals {
        let known = operation.responses.responses.entry(status.to_owned());
        known.or_insert_with(|| problem(description).into());
    }
}

fn problem(description: &str) -> Response {
    let schema = Ref::from_schema_name("Problem");
    ResponseBuilder::new()
        .description(description)
        .content("application/problem+json", Content::new(Some(schema)))
        .build()
}

fn completed() -> Value {
    let mut api = OpenApiRouter::with_openapi(Api::openapi()).merge(routes()).into_openapi();
    add_refusals(&mut api);
    let mut api = serde_json::to_value(api).expect("plain data can be written as JSON");
    complete::complete(&mut api);
    api
}

fn api() -> OpenApi {
    serde_json::from_value(completed()).expect("a test reads it")
}

/// Returns the OpenAPI document as YAML.
///
/// # Panics
/// Never: plain data can always be serialised.
pub fn document() -> String {
    api().to_yaml().expect("plain data can be written as YAML")
}

/// Returns this document as YAML.
#[utoipa::path(get, path = "/openapi.yaml", operation_id = "show_openapi", tag = "health",
    responses((status = 200, description = "OpenAPI 3.1", body = String, content_type = "application/yaml")))]
pub async fn show() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/yaml")], document())
}

/// Returns this document as JSON.
#[utoipa::path(get, path = "/openapi.json", operation_id = "show_openapi_json", tag = "health",
    responses((status = 200, description = "OpenAPI 3.1", body = Object, content_type = "application/json")))]
pub async fn show_json() -> impl IntoResponse {
    axum::Json(api())
}

/// Redirects to the API reference in the dashboard.
pub async fn docs() -> Redirect {
    Redirect::to("./#/api")
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::path::Path;

    use super::*;

    /// Every operation with its path and its method.
    fn operations(api: &Value) -> Vec<(String, String, Value)> {
        let paths = api["paths"].as_object().expect("paths");
        let of_path = |(path, item): (&String, &Value)| {
            let methods = item.as_object().expect("operations").clone();
            let path = path.clone();
            methods.into_iter().map(move |(method, operation)| (path.clone(), method, operation))
        };
        paths.iter().flat_map(of_path).collect()
    }

    /// Every `$ref` in a document.
    fn references(value: &Value, found: &mut Vec<String>) {
        match value {
            Value::Object(fields) => fields.iter().for_each(|(key, value)| match value {
                Value::String(target) if key == "$ref" => found.push(target.clone()),
                value => references(value, found),
            }),
            Value::Array(items) => items.iter().for_each(|item| references(item, found)),
            _ => {}
        }
    }

    #[test]
    fn the_document_is_consistent() {
        let api = serde_json::to_value(api()).expect("plain data");
        let mut ids = HashSet::new();
        for (path, method, operation) in operations(&api) {
            let name = format!("{method} {path}");
            let id = operation["operationId"].as_str().expect("an id");
            assert!(ids.insert(id.to_owned()), "{name}: {id} is another's id");
            let parameters = operation["parameters"].as_array().cloned();
            let parameters = parameters.unwrap_or_default();
            let mut in_path = HashSet::new();
            for parameter in &parameters {
                let named = parameter["name"].as_str().expect("a name").to_owned();
                if parameter["in"] == "path" {
                    assert!(path.contains(&format!("{{{named}}}")), "{name}: {named}");
                    in_path.insert(named);
                }
            }
            assert_eq!(in_path.len(), path.matches('{').count(), "{name}");
            let answers = operation["responses"].as_object().expect("answers");
            let has_body = operation["requestBody"].is_object();
            let is_asked = parameters.iter().any(|parameter| parameter["in"] == "query");
            assert!(!has_body || answers.contains_key("415"), "{name}");
            assert!(!(has_body || is_asked) || answers.contains_key("400"), "{name}");
        }
        let mut found = Vec::new();
        references(&api, &mut found);
        for target in found {
            let target = target.strip_prefix('#').expect("a reference into the document");
            assert!(api.pointer(target).is_some(), "{target} does not exist");
        }
    }

    #[test]
    fn the_document_keeps_its_completed_parts() {
        let completed = completed();
        let kept = serde_json::to_value(api()).expect("plain data");
        let (mut left, mut right) = (completed.to_string(), kept.to_string());
        if let Some(at) = left.bytes().zip(right.bytes()).position(|(a, b)| a != b) {
            left.drain(..left.floor_char_boundary(at.saturating_sub(200)));
            right.drain(..right.floor_char_boundary(at.saturating_sub(200)));
        }
        assert!(completed == kept, "{left:.400}\n{right:.400}");
    }

    #[test]
    fn every_operation_has_an_example() {
        let api = serde_json::to_value(api()).expect("plain data");
        for (path, method, operation) in operations(&api) {
            let bodies = ["/requestBody", "/responses/200", "/responses/201", "/responses/202"];
            let bodies = bodies.map(|body| operation.pointer(body));
            let contents = bodies.iter().flatten().filter_map(|body| body["content"].as_object());
            let contents: Vec<&Value> = contents.flat_map(|content| content.values()).collect();
            let parameters = operation["parameters"].as_array();
            let parameters: Vec<&Value> = parameters.into_iter().flatten().collect();
            let has = |all: &[&Value], name| all.iter().any(|one| one.get(name).is_some());
            let has_nothing_to_show = contents.is_empty() && parameters.is_empty();
            assert!(
                has_nothing_to_show || has(&contents, "examples") || has(&parameters, "example"),
                "{method} {path}"
            );
        }
    }

    /// `FLED_WRITE_OPENAPI=1 cargo test --release -p fled-server openapi` writes the file.
    #[test]
    fn the_checked_in_document_matches_the_handlers() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../openapi.yaml");
        if std::env::var_os("FLED_WRITE_OPENAPI").is_some() {
            std::fs::write(&path, document()).expect("write");
        }
        let checked_in = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(
            checked_in == document(),
            "openapi.yaml is out of date: FLED_WRITE_OPENAPI=1 cargo test --release -p fled-server openapi"
        );
    }
}
