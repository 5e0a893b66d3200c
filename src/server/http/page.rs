//! Page sizes of lists.

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
    Err(
        Problem::unprocessable("bad_input", format!("`limit` must be from 1 to {most}."))
            .pointer("/limit"),
    )
}
