//! Pages of lists.

use uuid::Uuid;

use super::problem::Problem;

/// Maximum captures or jobs on a page.
pub(super) const LARGEST_PAGE: u32 = 200;
/// Default items on a page.
const PAGE: u32 = 50;

/// The number of items to return.
///
/// # Errors
/// 422 for zero or too many: a client that relies on its number would miss the rest.
pub(super) fn page_size(limit: Option<u32>) -> Result<u32, Problem> {
    let limit = limit.unwrap_or(PAGE);
    within(limit as usize, LARGEST_PAGE as usize)?;
    Ok(limit)
}

/// # Errors
/// 422 for a `limit` outside of `1..=most`.
pub(super) fn within(limit: usize, most: usize) -> Result<(), Problem> {
    if (1..=most).contains(&limit) {
        return Ok(());
    }
    Err(Problem::unprocessable("bad_input", format!("`limit` must be from 1 to {most}."))
        .pointer("/limit"))
}

/// An id in a query, in the form stored in the database.
///
/// # Errors
/// 422 for an invalid id: an empty list would hide the mistake.
pub(super) fn id(asked: Option<&str>, name: &str) -> Result<Option<String>, Problem> {
    let id = asked.map(str::parse::<Uuid>).transpose();
    let id = id.map_err(|_| {
        Problem::unprocessable("bad_input", format!("`{name}` must be a UUID."))
            .pointer(format!("/{name}"))
    })?;
    Ok(id.map(|id| id.to_string()))
}
