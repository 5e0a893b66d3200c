//! How much of a list is asked for at a time.

use super::problem::Problem;

/// Most items of a page of captures or jobs.
pub(super) const LARGEST_PAGE: u32 = 200;
/// Items of a page where nobody says how many.
const PAGE: u32 = 50;

/// How many items of a list to answer.
///
/// # Errors
/// 422 for none or too many: a client that counts on its number would miss the rest.
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
    Err(
        Problem::unprocessable("bad_input", format!("`limit` is from 1 to {most}."))
            .pointer("/limit"),
    )
}
