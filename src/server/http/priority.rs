//! What goes first among the jobs that wait, as far as who asks may say.

use axum::http::StatusCode;
use serde_json::{Map, Number, Value};

use super::access::Visitor;
use super::problem::Problem;
use crate::token::Scope;

/// As far as it goes, up and down.
const MOST: i64 = 100;

/// How urgent a job is: of two that wait the one of the higher number is given to a worker first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Priority(i64);

impl Priority {
    /// Of the number in a request, which may have none. Everybody may let others go first; who
    /// could go before all others would, so that takes `admin` from the first token on.
    ///
    /// # Errors
    /// 422 for a number that is none of ours, 403 for one above 0 without `admin`.
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

    /// Of the field of a form.
    ///
    /// # Errors
    /// As [`Priority::asked`].
    pub(super) fn field(text: Option<&String>, visitor: &Visitor) -> Result<Self, Problem> {
        let text = text.map(|text| text.trim()).filter(|text| !text.is_empty());
        let number = text.map(|text| text.parse::<i64>().map_err(|_| bad(text)));
        let number = number.transpose()?.map(Number::from);
        Self::asked(number.as_ref(), visitor)
    }

    /// Of a job that there is.
    pub(super) fn of(stored: i64) -> Self {
        Self(stored)
    }

    /// As it is stored.
    pub(super) fn number(self) -> i64 {
        self.0
    }

    /// These options and the priority in one line that stands for no others. A request that asks
    /// for none is what it was before there were any: keys are remembered longer than a program.
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
    let detail = format!("`{shown}` is no priority.");
    Problem::unprocessable("bad_input", detail)
        .pointer("/priority")
        .hint(format!(
            "A whole number from -{MOST} to {MOST}; 0 when absent."
        ))
}

fn above_others() -> Problem {
    let admin = Scope::Admin.name();
    let detail = format!("A priority above 0 needs a token that allows `{admin}`.");
    Problem::new(StatusCode::FORBIDDEN, "missing_scope", detail)
        .pointer("/priority")
        .hint("Leave it out or say 0 or less, or ask whoever runs the server to start the job.")
}
