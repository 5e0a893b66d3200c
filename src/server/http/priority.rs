//! Job priorities, as far as the client may set them.

use axum::http::StatusCode;
use serde_json::{Map, Number, Value};

use super::access::Visitor;
use super::problem::Problem;
use crate::token::Scope;

/// Maximum absolute value of a priority.
const MOST: i64 = 100;

/// The priority of a job: of two queued jobs, a worker gets the one with the higher number first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Priority(i64);

impl Priority {
    /// Parses the optional number of a request. Everyone may lower a priority; raising it above 0
    /// requires `admin` once a token exists, since otherwise everyone would.
    ///
    /// # Errors
    /// 422 for a number out of range, 403 for one above 0 without `admin`.
    pub(super) fn asked(number: Option<&Number>, visitor: &Visitor) -> Result<Self, Problem> {
        let Some(number) = number else {
            return Ok(Self::default());
        };
        let within = number.as_i64().filter(|n| (-MOST..=MOST).contains(n));
        let priority = within.ok_or_else(|| bad(&number.to_string()))?;
        if priority > 0 && visitor.sees_only().is_some() {
            return Err(above_others());
        }
        Ok(Self(priority))
    }

    /// Parses the field of a form.
    ///
    /// # Errors
    /// As [`Priority::asked`].
    pub(super) fn field(text: Option<&String>, visitor: &Visitor) -> Result<Self, Problem> {
        let text = text.map(|text| text.trim()).filter(|text| !text.is_empty());
        let number = text.map(|text| text.parse::<i64>().map_err(|_| bad(text)));
        let number = number.transpose()?.map(Number::from);
        Self::asked(number.as_ref(), visitor)
    }

    /// The stored priority of a job.
    pub(super) fn of(stored: i64) -> Self {
        Self(stored)
    }

    /// The number as stored.
    pub(super) fn number(self) -> i64 {
        self.0
    }

    /// The options and the priority in one unambiguous line. Priority 0 adds nothing, because
    /// idempotency keys stored before priorities existed must still match.
    pub(super) fn beside(self, options: &Map<String, Value>) -> String {
        let options = Value::Object(options.clone());
        match self.0 {
            0 => options.to_string(),
            priority => format!("{options} {priority}"),
        }
    }
}

fn bad(shown: &str) -> Problem {
    let shown: String = shown.chars().take(40).collect();
    let detail = format!("`{shown}` is not a priority.");
    Problem::unprocessable("bad_input", detail)
        .pointer("/priority")
        .hint(format!("Send a whole number from -{MOST} to {MOST}; the default is 0."))
}

fn above_others() -> Problem {
    let admin = Scope::Admin.name();
    let detail = format!("A priority above 0 requires a token with the scope `{admin}`.");
    Problem::new(StatusCode::FORBIDDEN, "missing_scope", detail)
        .pointer("/priority")
        .hint("Leave it out, send 0 or less, or ask the server's administrator to start the job.")
}
