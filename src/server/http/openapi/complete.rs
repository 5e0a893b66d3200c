//! Completes the document by rules that hold for all operations: the core's types, the formats of
//! times and ids, and examples.

use std::sync::LazyLock;

use fled_core::capture::Assessment;
use fled_core::metrics::Report;
use fled_core::poses::overlap::Overlap;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

/// Examples: of bodies by schema or else by operation, of parameters by operation, name or
/// collection.
static EXAMPLES: LazyLock<Value> = LazyLock::new(|| {
    serde_json::from_str(include_str!("examples.json")).expect("checked in and tested")
});

/// Location of the schemas in the document.
const SCHEMAS: &str = "/components/schemas";
/// Collections whose items have UUIDs.
const COLLECTIONS: [&str; 3] = ["captures", "jobs", "uploads"];
/// Names of fields and parameters that are UUIDs.
const UUIDS: [&str; 7] =
    ["add_to", "capture_id", "job_id", "cursor", "next_cursor", "uploads", "video"];
/// Schemas whose `id` is a UUID.
const OF_UUID: [&str; 3] = ["Capture", "Job", "Video"];

/// Completes the document.
pub(super) fn complete(api: &mut Value) {
    add_report(api);
    open_objects(api);
    let routes = api["paths"].as_object_mut().map(std::mem::take).unwrap_or_default();
    // OpenAPI has no sign for a parameter that may contain slashes.
    let paths = routes.into_iter().map(|(route, item)| (route.replace("{*", "{"), item));
    api["paths"] = Value::Object(paths.collect());
    for (name, schema) in members(&mut api["components"]["schemas"]) {
        let is_of_uuid = OF_UUID.contains(&name.as_str());
        add_formats(schema, is_of_uuid);
    }
    let mut used = Map::new();
    for (path, item) in members(&mut api["paths"]) {
        for (_, operation) in members(item) {
            complete_operation(operation, path, &mut used);
        }
    }
    api["components"]["examples"] = Value::Object(used);
}

fn members(value: &mut Value) -> impl Iterator<Item = (&String, &mut Value)> {
    value.as_object_mut().into_iter().flatten()
}

/// Adds the types of the core: those of `metrics.json`, of assessments and of a job's overlap. The
/// rounds response has the fields of the first, most of them once the file exists.
fn add_report(api: &mut Value) {
    let mut generator = SchemaSettings::draft2020_12()
        .with(|settings| settings.definitions_path = SCHEMAS.into())
        .into_generator();
    generator.subschema_for::<Report>();
    generator.subschema_for::<Overlap>();
    generator.subschema_for::<Assessment>();
    let mut schemas = generator.take_definitions(true);
    let mut report = schemas.remove("Report").unwrap_or_default();
    let answer = &mut api["components"]["schemas"]["Rounds"]["properties"];
    for (name, schema) in members(&mut report["properties"]) {
        if answer.get(name).is_none() {
            answer[name.as_str()] = schema.take();
        }
        as_openapi(&mut answer[name.as_str()]);
    }
    for (name, mut schema) in schemas {
        as_openapi(&mut schema);
        api["components"]["schemas"][name] = schema;
    }
}

/// Rewrites a schema in the style of the other types.
fn as_openapi(schema: &mut Value) {
    if *schema == json!(true) {
        *schema = json!({});
    }
    let has_kind = ["type", "$ref", "oneOf", "anyOf"].iter().any(|kind| schema.get(kind).is_some());
    if !has_kind {
        // JSON of any form, which is always an object in the core.
        schema["type"] = "object".into();
    }
    let words = schema["oneOf"].as_array().map(|all| {
        let words = all.iter().map(|one| match one.get("const") {
            Some(word) => vec![word.clone()],
            None => one["enum"].as_array().cloned().unwrap_or_default(),
        });
        words.flatten().collect::<Vec<_>>()
    });
    if let Some(words) = words
        && !words.is_empty()
        && let Some(fields) = schema.as_object_mut()
    {
        fields.remove("oneOf");
        fields.insert("type".to_owned(), "string".into());
        fields.insert("enum".to_owned(), words.into());
    }
    if let Some(fields) = schema.as_object_mut() {
        fields.retain(|name, value| name != "default" || !value.is_null());
    }
    for (_, property) in schema.get_mut("properties").into_iter().flat_map(members) {
        as_openapi(property);
    }
}

/// Allows any fields in objects for which the document lists none: otherwise a generated client
/// takes them for empty.
fn open_objects(part: &mut Value) {
    match part {
        Value::Object(fields) => {
            let kinds = fields.get("type").map(Value::to_string);
            let names_fields = |name| fields.contains_key(name);
            if kinds.is_some_and(|kinds| kinds.contains("\"object\"") && !kinds.contains(':'))
                && !names_fields("properties")
                && !names_fields("additionalProperties")
            {
                fields.insert("additionalProperties".to_owned(), true.into());
            }
            fields.values_mut().for_each(open_objects);
        }
        Value::Array(items) => items.iter_mut().for_each(open_objects),
        _ => {}
    }
}

/// Adds the formats of times and ids to the fields of a schema.
fn add_formats(schema: &mut Value, is_of_uuid: bool) {
    let parts = schema.get_mut("allOf").and_then(Value::as_array_mut);
    for part in parts.into_iter().flatten() {
        add_formats(part, is_of_uuid);
    }
    for (name, field) in schema.get_mut("properties").into_iter().flat_map(members) {
        if name == "now" || name.ends_with("_at") {
            set_format(field, "date-time");
        } else if UUIDS.contains(&name.as_str()) || (is_of_uuid && name == "id") {
            set_format(field, "uuid");
        }
    }
}

/// Sets the format of a text, or of the texts in a list.
fn set_format(schema: &mut Value, format: &str) {
    match schema.get_mut("items") {
        Some(items) => set_format(items, format),
        None => schema["format"] = format.into(),
    }
}

/// Adds formats to the parameters and examples of an operation, and records the bodies for which it
/// has one.
fn complete_operation(operation: &mut Value, path: &str, used: &mut Map<String, Value>) {
    let id = operation["operationId"].as_str().unwrap_or_default().to_owned();
    let collection = path.split('/').nth(2).unwrap_or_default();
    let parameters = operation.get_mut("parameters");
    let parameters = parameters.and_then(Value::as_array_mut);
    for parameter in parameters.into_iter().flatten() {
        let name = parameter["name"].as_str().unwrap_or_default().to_owned();
        let is_member = name == "id" && COLLECTIONS.contains(&collection);
        if is_member || UUIDS.contains(&name.as_str()) {
            set_format(&mut parameter["schema"], "uuid");
        }
        let known = &EXAMPLES["parameters"];
        let keys = [format!("{id}.{name}"), name.clone(), format!("{collection}.{name}")];
        if let Some(example) = keys.iter().find_map(|key| known.get(key)) {
            parameter["example"] = example.clone();
        }
    }
    let mut bodies: Vec<&mut Value> = Vec::new();
    for (field, value) in members(operation) {
        match field.as_str() {
            "requestBody" => bodies.push(value),
            "responses" => {
                let answers = members(value).filter(|(status, _)| status.starts_with('2'));
                bodies.extend(answers.map(|(_, answer)| answer));
            }
            _ => {}
        }
    }
    let contents = bodies.into_iter().filter_map(|body| body.get_mut("content"));
    for (_, content) in contents.flat_map(members) {
        // A file of any type: an empty schema adds nothing.
        if content["schema"] == json!({})
            && let Some(fields) = content.as_object_mut()
        {
            fields.remove("schema");
        }
        let schema = content["schema"]["$ref"].as_str();
        let name = schema.and_then(|schema| schema.rsplit('/').next());
        let name = name.unwrap_or(&id).to_owned();
        if let Some(example) = EXAMPLES["bodies"].get(&name) {
            let reference = format!("#/components/examples/{name}");
            content["examples"] = json!({ &name: { "$ref": reference } });
            used.insert(name, json!({ "value": example }));
        }
    }
}
