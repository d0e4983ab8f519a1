//! Text from outside made safe to show: control, bidirectional and invisible characters become visible escapes.
//!
//! File names, topics, schemas, labels and messages come from untrusted sources. A terminal executes the control
//! characters in them, and bidirectional controls make any viewer reorder the text. This is the only definition of those
//! characters; it is applied where text is written to a terminal, a page or a log.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io::{self, Write};

/// Whether a character is shown as it is: neither a control (C0, DEL, C1), nor a line or paragraph separator, nor a
/// bidirectional control, nor invisible (zero width, byte order mark, filler, annotation, tag).
#[must_use]
pub fn is_printable(character: char) -> bool {
    !(character.is_control()
        || matches!(
            character,
            '\u{ad}'
                | '\u{61c}'
                | '\u{115f}'..='\u{1160}'
                | '\u{17b4}'..='\u{17b5}'
                | '\u{180b}'..='\u{180f}'
                | '\u{200b}'..='\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}'
                | '\u{3164}'
                | '\u{feff}'
                | '\u{ffa0}'
                | '\u{fff9}'..='\u{fffb}'
                | '\u{1bca0}'..='\u{1bca3}'
                | '\u{1d173}'..='\u{1d17a}'
                | '\u{e0000}'..='\u{e0fff}'
        ))
}

/// The form of escapes, and the line breaks that stay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Escape {
    /// One name or message: line breaks and tabs are escaped too, so that it stays on its line.
    Field,
    /// Text of several lines: line breaks and tabs stay.
    Lines,
    /// A JSON document or lines of them: `\uXXXX`, which readers decode to the character.
    Json,
}

impl Escape {
    /// The text with its unprintable characters escaped.
    #[must_use]
    pub fn apply(self, text: &str) -> Cow<'_, str> {
        let Some(first) = text.find(|character| !self.keeps(character)) else { return Cow::Borrowed(text) };
        let (clean, rest) = text.split_at(first);
        let mut escaped = String::with_capacity(text.len() + 16);
        escaped.push_str(clean);
        for character in rest.chars() {
            if self.keeps(character) {
                escaped.push(character);
            } else {
                self.write(character, &mut escaped);
            }
        }
        Cow::Owned(escaped)
    }

    fn keeps(self, character: char) -> bool {
        is_printable(character)
            || match self {
                Self::Field => false,
                Self::Lines => matches!(character, '\n' | '\t'),
                Self::Json => character == '\n',
            }
    }

    fn write(self, character: char, out: &mut String) {
        if self == Self::Json {
            for unit in character.encode_utf16(&mut [0; 2]) {
                // Writing to a string cannot fail.
                let _ = write!(out, "\\u{unit:04x}");
            }
            return;
        }
        match character {
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            _ => out.extend(character.escape_unicode()),
        }
    }
}

/// One name or message from outside, with its unprintable characters escaped.
#[must_use]
pub fn field(text: &str) -> Cow<'_, str> {
    Escape::Field.apply(text)
}

/// A writer that escapes text before it writes it. Bytes that are not UTF-8 become U+FFFD. With [`Escape::Field`] each write
/// is one line: the break at its end stays, those within are escaped.
#[derive(Debug)]
pub struct EscapingWriter<W> {
    inner: W,
    escape: Escape,
    colours: bool,
    /// The first bytes of a character whose other bytes are in a later write.
    partial: Vec<u8>,
}

impl<W: Write> EscapingWriter<W> {
    /// A writer to `inner`.
    pub fn new(inner: W, escape: Escape) -> Self {
        Self { inner, escape, colours: false, partial: Vec::new() }
    }

    /// Keeps sequences that only set a colour or a style (`ESC [ … m`), for terminals. Callers must escape the ESC of any
    /// other text before they write it.
    #[must_use]
    pub fn with_colours(self, colours: bool) -> Self {
        Self { colours, ..self }
    }

    fn escaped(&self, text: &str) -> String {
        match text.strip_suffix('\n') {
            Some(line) if self.escape == Escape::Field => format!("{}\n", self.with_colours_kept(line)),
            Some(_) | None => self.with_colours_kept(text).into_owned(),
        }
    }

    fn with_colours_kept<'a>(&self, text: &'a str) -> Cow<'a, str> {
        if !self.colours || !text.contains('\u{1b}') {
            return self.escape.apply(text);
        }
        let mut out = String::with_capacity(text.len());
        let mut rest = text;
        while let Some(at) = rest.find('\u{1b}') {
            let (before, sequence) = rest.split_at(at);
            out.push_str(&self.escape.apply(before));
            let length = colour(sequence).unwrap_or(1);
            let (sequence, after) = sequence.split_at(length);
            if length > 1 {
                out.push_str(sequence);
            } else {
                out.push_str(&self.escape.apply(sequence));
            }
            rest = after;
        }
        out.push_str(&self.escape.apply(rest));
        Cow::Owned(out)
    }
}

/// The length of the sequence that a text begins with, if it sets a colour or a style.
fn colour(text: &str) -> Option<usize> {
    let parameters = text.strip_prefix("\u{1b}[")?;
    let end = parameters.find(|character: char| !matches!(character, '0'..='9' | ';'))?;
    parameters[end..].starts_with('m').then_some(2 + end + 1)
}

impl<W: Write> Write for EscapingWriter<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let whole;
        let mut left = if self.partial.is_empty() {
            bytes
        } else {
            self.partial.extend_from_slice(bytes);
            whole = std::mem::take(&mut self.partial);
            &whole[..]
        };
        let mut text = String::with_capacity(left.len());
        while !left.is_empty() {
            match std::str::from_utf8(left) {
                Ok(valid) => {
                    text.push_str(valid);
                    break;
                }
                Err(error) => {
                    let (valid, rest) = left.split_at(error.valid_up_to());
                    text.push_str(std::str::from_utf8(valid).unwrap_or_default());
                    let Some(length) = error.error_len() else {
                        self.partial = rest.to_vec();
                        break;
                    };
                    text.push(char::REPLACEMENT_CHARACTER);
                    left = &rest[length..];
                }
            }
        }
        self.inner.write_all(self.escaped(&text).as_bytes())?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if !self.partial.is_empty() {
            self.partial.clear();
            self.inner.write_all(char::REPLACEMENT_CHARACTER.encode_utf8(&mut [0; 4]).as_bytes())?;
        }
        self.inner.flush()
    }
}

#[cfg(test)]
mod tests;
