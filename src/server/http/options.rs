//! `/v1/options`.

use axum::Json;
use fled_core::pipeline::config::{Options, Preset};
use serde_json::{Map, Value};

use super::problem::Problem;

/// Returns the options of a job as a JSON Schema (2020-12).
///
/// The key `presets` holds every preset.
#[utoipa::path(get, path = "/v1/options", operation_id = "show_options", tag = "jobs",
    responses((status = 200, description = "A JSON Schema with the additional key `presets`", body = Object)))]
pub async fn show() -> Result<Json<Value>, Problem> {
    let mut schema =
        serde_json::to_value(schemars::schema_for!(Options)).map_err(|_| Problem::internal())?;
    let mut presets = Map::new();
    for preset in Preset::ALL {
        let options = serde_json::to_value(preset.options()).map_err(|_| Problem::internal())?;
        presets.insert(preset.name().to_owned(), options);
    }
    // JSON Schema allows unknown keywords, and validators ignore them.
    schema["presets"] = Value::Object(presets);
    Ok(Json(schema))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_schema_names_its_draft_and_presets_set_every_option() {
        let Json(schema) = show().await.expect("schema");
        assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
        assert_eq!(schema["properties"]["rounds"]["anyOf"][0]["minimum"], 1);
        let keys = |value: &Value| {
            let mut keys: Vec<String> =
                value.as_object().expect("object").keys().cloned().collect();
            keys.sort();
            keys
        };
        for preset in Preset::ALL {
            assert_eq!(keys(&schema["presets"][preset.name()]), keys(&schema["properties"]));
        }
    }
}
