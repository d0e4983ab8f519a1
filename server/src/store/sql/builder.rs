//! Statements whose text depends on what is looked for.

use sqlx::{AssertSqlSafe, error::BoxDynError};

use super::{Argument, Statement, Value, query};

/// A value that has its kind already.
struct Bound(Value);

impl Argument for Bound {
    const NULL: Value = Value::Text(None);

    fn value(self) -> Result<Value, BoxDynError> {
        Ok(self.0)
    }
}

/// A statement that is put together. Only texts of this program are pushed; values are bound.
///
/// Each value is a `?`, which becomes `$N` for PostgreSQL alone: SQLite looks every `$N` up among all others, which takes
/// most of the time of an insertion of thousands of values.
#[derive(Debug)]
pub(in crate::store) struct QueryBuilder {
    text: String,
    arguments: Result<Vec<Value>, BoxDynError>,
}

impl QueryBuilder {
    pub(in crate::store) fn new(text: &str) -> Self {
        Self { text: text.to_owned(), arguments: Ok(Vec::new()) }
    }

    /// Adds text of this program.
    pub(in crate::store) fn push(&mut self, text: &str) -> &mut Self {
        self.text.push_str(text);
        self
    }

    /// Adds a value.
    pub(in crate::store) fn push_bind(&mut self, argument: impl Argument) -> &mut Self {
        self.text.push('?');
        if let Ok(arguments) = &mut self.arguments {
            match argument.value() {
                Ok(value) => arguments.push(value),
                Err(error) => self.arguments = Err(error),
            }
        }
        self
    }

    /// Adds values that have a kind already, separated by commas.
    pub(in crate::store) fn push_values(&mut self, values: impl IntoIterator<Item = Value>) -> &mut Self {
        self.push_list(values.into_iter().map(Bound))
    }

    /// Adds the values of some items, separated by commas.
    pub(in crate::store) fn push_list<A: Argument>(&mut self, items: impl IntoIterator<Item = A>) -> &mut Self {
        for (place, item) in items.into_iter().enumerate() {
            self.push(if place == 0 { "" } else { ", " }).push_bind(item);
        }
        self
    }

    /// The text up to here.
    #[cfg(test)]
    pub(in crate::store) fn text(&self) -> &str {
        &self.text
    }

    /// The statement.
    pub(in crate::store) fn build(self) -> Statement {
        let statement = query(AssertSqlSafe(self.text));
        Statement { arguments: self.arguments, numbered: false, ..statement }
    }
}

/// The text of a built statement with its values numbered.
pub(super) fn numbered(text: &str) -> String {
    let mut parts = text.split('?');
    let mut numbered = parts.next().unwrap_or_default().to_owned();
    for (place, part) in (1..).zip(parts) {
        let place: u32 = place;
        numbered += &format!("${place}{part}");
    }
    numbered
}
