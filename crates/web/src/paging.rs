//! Pages of a long list: parsing the page number, and links to the neighbouring pages.

use gleaner_core::{Error, Result};
use maud::{Markup, html};

use super::page_request::PageRequest;

/// Reads `page` of an address, counted from 1; an empty one is the first.
///
/// # Errors
/// Invalid, naming the parameter.
pub(super) fn parse(page: &str) -> Result<usize> {
    if page.is_empty() {
        return Ok(1);
    }
    let number = page.parse().ok().filter(|&page| page > 0);
    number.ok_or_else(|| Error::invalid("page", "must be a whole number, counted from 1"))
}

/// The page that is shown and the number of pages, for a list of `count` entries. A page beyond the end is the last.
pub(super) fn within(page: usize, count: usize, per_page: usize) -> (usize, usize) {
    let pages = count.div_ceil(per_page).max(1);
    (page.min(pages), pages)
}

/// Links to the previous and the next page, if there are several.
pub(super) fn links(request: &PageRequest, what: &str, (page, pages): (usize, usize)) -> Markup {
    let to = |page: usize| request.with("page", Some(&page.to_string()));
    html! {
        @if pages > 1 {
            nav.pages aria-label=(what) {
                @if page > 1 { a rel="prev" href=(to(page - 1)) { "Previous" } }
                span { "Page " (page) " of " (pages) }
                @if page < pages { a rel="next" href=(to(page + 1)) { "Next" } }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_a_whole_number_from_1() {
        assert_eq!((parse("").unwrap(), parse("3").unwrap()), (1, 3));
        for wrong in ["0", "-1", "x", "1.5", "99999999999999999999999"] {
            assert!(parse(wrong).unwrap_err().message().starts_with("page: "), "{wrong}");
        }
    }

    #[test]
    fn a_page_beyond_the_end_is_the_last() {
        assert_eq!(
            [within(1, 0, 5), within(2, 5, 5), within(2, 6, 5), within(9, 11, 5)],
            [(1, 1), (1, 1), (2, 2), (3, 3)]
        );
    }
}
