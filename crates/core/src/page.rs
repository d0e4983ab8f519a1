//! Pages of a list.

/// A page of a list: the rows that follow the one with the key `after`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page<K> {
    /// The key of the last row of the page before; `None` for the first page.
    pub after: Option<K>,
    /// Most rows of the page, at least 1.
    pub size: u32,
}

impl<K> Page<K> {
    /// The one page that has every row.
    pub fn whole() -> Self {
        Self { after: None, size: u32::MAX }
    }

    /// The number of rows to read: one more than the page has shows whether there is a next page.
    pub fn rows(&self) -> i64 {
        i64::from(self.size) + 1
    }

    /// The rows of the page, out of those that were read, and the key that the next page follows; `None` on the last page.
    pub fn cut<T>(&self, mut read: Vec<T>, key: impl FnOnce(&T) -> K) -> (Vec<T>, Option<K>) {
        let size = usize::try_from(self.size).unwrap_or(usize::MAX);
        let more = read.len() > size;
        read.truncate(size);
        let next = if more { read.last().map(key) } else { None };
        (read, next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_a_next_one_when_one_more_row_was_read() {
        let page = Page { after: None, size: 2 };
        assert_eq!(page.rows(), 3);
        assert_eq!(page.cut(vec![7, 8, 9], |&row| row), (vec![7, 8], Some(8)));
        assert_eq!(page.cut(vec![7, 8], |&row| row), (vec![7, 8], None));
        assert_eq!(page.cut(Vec::new(), |&row: &i32| row), (Vec::new(), None));
        assert_eq!(Page::whole().cut(vec![7; 5], |&row| row), (vec![7; 5], None));
    }
}
