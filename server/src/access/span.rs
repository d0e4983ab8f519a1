//! Spans of time in flags. Must not depend on the flags.

use std::time::Duration;

use jiff::SpanRelativeTo;

/// A span such as 30d or 12h; a day has 24 hours.
///
/// # Errors
/// A message that names the text and the format.
pub(super) fn span(text: &str) -> Result<Duration, String> {
    let format = "must be a time such as 30d or 12h";
    let span: jiff::Span = text.parse().map_err(|_| format!("{text:?}: {format}"))?;
    let span = span.to_duration(SpanRelativeTo::days_are_24_hours()).map_err(|_| format!("{text:?}: {format}"))?;
    match Duration::try_from(span) {
        Ok(span) if !span.is_zero() => Ok(span),
        Ok(_) | Err(_) => Err(format!("{text:?}: {format}, above zero")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_parsed_with_their_units() {
        assert_eq!(span("30d").unwrap(), Duration::from_secs(30 * 86_400));
        assert_eq!(span("1h 30m").unwrap(), Duration::from_secs(5400));
        for text in ["", "soon", "0s", "-3d", "12"] {
            assert!(span(text).unwrap_err().contains("30d"), "{text}");
        }
    }
}
