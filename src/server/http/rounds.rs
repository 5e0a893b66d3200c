//! `/v1/jobs/{id}/rounds`: the metrics of finished rounds.

use std::fmt::Write;
use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use utoipa::openapi::{Array, Ref};
use utoipa::{IntoParams, ToSchema};

use super::extract::Query;
use super::problem::Problem;
use crate::app::App;
use crate::store::StageSeconds;

/// In which form.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct RoundsQuery {
    /// `json` (default) or `csv`.
    format: Option<Form>,
}

/// The format of a table.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// As `metrics.json`.
    Json,
    /// One row a record and one a view.
    Csv,
}

/// The metrics of every finished round, in the shape of `metrics.json`.
#[derive(Debug, Serialize, ToSchema)]
pub struct Rounds {
    /// One entry per finished round, with `records` by split, image, reference and brightness.
    #[schema(schema_with = of_rounds)]
    rounds: Vec<Value>,
    /// Delivered round of a finished job.
    best_round: Option<u32>,
    /// The rest of `metrics.json` once it exists, whose schemas the document takes from the core.
    #[serde(flatten)]
    #[schema(ignore)]
    facts: Map<String, Value>,
}

fn of_rounds() -> Array {
    Array::new(Ref::from_schema_name("RoundMetrics"))
}

/// Shows the metrics of every finished round.
#[utoipa::path(get, path = "/v1/jobs/{id}/rounds", operation_id = "show_rounds",
    tag = "results", params(("id" = String, Path), RoundsQuery),
    responses(
        (status = 200, description = "The finished rounds", content((Rounds = "application/json"), (String = "text/csv"))),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn show(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Query(query): Query<RoundsQuery>,
) -> Result<Response, Problem> {
    let job = app.store.job_details(&id).await?;
    let job = job.ok_or_else(|| Problem::not_found("job"))?;
    let rounds = app.store.rounds(&id).await?;
    if matches!(query.format, Some(Form::Csv)) {
        let csv = csv(&rounds);
        return Ok(([(header::CONTENT_TYPE, "text/csv; charset=utf-8")], csv).into_response());
    }
    let mut facts = facts(&app, &id).await;
    facts.insert("stages".to_owned(), stages(&job.stages));
    Ok(axum::Json(Rounds { rounds, best_round: job.row.best_round, facts }).into_response())
}

/// The fields of `metrics.json` other than the rounds. The file is written after every round and
/// does not exist before the first.
async fn facts(app: &App, id: &str) -> Map<String, Value> {
    let text = tokio::fs::read(app.data.output(id).metrics()).await.unwrap_or_default();
    let Ok(Value::Object(mut report)) = serde_json::from_slice(&text) else {
        return Map::new();
    };
    for ours in ["rounds", "best_round", "stages"] {
        report.remove(ours);
    }
    report
}

/// Seconds by stage, summed over rounds, as in `metrics.json`.
fn stages(stages: &[StageSeconds]) -> Value {
    let mut sums = Map::new();
    for stage in stages {
        let before = sums.get(&stage.stage).and_then(Value::as_f64).unwrap_or(0.0);
        sums.insert(stage.stage.clone(), json!(before + stage.seconds));
    }
    Value::Object(sums)
}

const COLUMNS: [&str; 13] = [
    "round",
    "split",
    "image",
    "reference",
    "brightness",
    "views",
    "psnr_db",
    "psnr_cc_db",
    "ssim",
    "lpips_squeeze",
    "view",
    "registered",
    "shake_px",
];

/// One row per record, then one per view, with the view's name in `view` and no view count. Every
/// value is a number or a fixed word, so nothing needs quoting.
fn csv(rounds: &[Value]) -> String {
    let mut text = COLUMNS.join(",") + "\n";
    for round in rounds {
        let records = round["records"].as_array().into_iter().flatten();
        let views = round["views"].as_array().into_iter().flatten();
        for row in records.cloned().chain(views.map(of_view)) {
            let cells = COLUMNS.map(|column| match column {
                "round" => round["round"].to_string(),
                _ => match &row[column] {
                    Value::Null => String::new(),
                    Value::String(word) => word.clone(),
                    other => other.to_string(),
                },
            });
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{}", cells.join(","));
        }
    }
    text
}

/// The row of a view's render at the target brightness.
fn of_view(view: &Value) -> Value {
    let mut row = view.clone();
    row["view"] = view["name"].clone();
    row["image"] = json!("render");
    row["brightness"] = json!("final");
    row
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_csv_has_one_row_per_record_and_view() {
        let rounds = [json!({ "round": 1, "records": [
            { "split": "train", "image": "render", "reference": "gt", "brightness": "final", "views": 17,
              "psnr_db": 21.5, "psnr_cc_db": 22.0, "ssim": 0.7 },
            { "split": "held_out", "image": "render", "reference": "gt", "brightness": "final", "views": 3,
              "psnr_db": 20.5, "psnr_cc_db": 21.0, "ssim": 0.6, "lpips_squeeze": 0.3 } ],
            "views": [
            { "name": "a", "registered": true, "split": "train", "reference": "gt", "psnr_db": 19.5,
              "psnr_cc_db": 20.0, "ssim": 0.5, "shake_px": 1.5 },
            { "name": "b", "registered": false, "split": null, "reference": null, "psnr_db": null,
              "psnr_cc_db": null, "ssim": null, "shake_px": null } ] })];
        let text = csv(&rounds);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[1], "1,train,render,gt,final,17,21.5,22.0,0.7,,,,");
        assert_eq!(lines[2], "1,held_out,render,gt,final,3,20.5,21.0,0.6,0.3,,,");
        assert_eq!(lines[3], "1,train,render,gt,final,,19.5,20.0,0.5,,a,true,1.5");
        assert_eq!(lines[4], "1,,render,,final,,,,,,b,false,");
        assert_eq!(lines.len(), 5);
    }
}
