//! The code and the string literals of a Rust source, without a parser of the language.

/// A Rust source without its comments, split into code (`false`) and string literals (`true`), each with the line on which
/// it begins.
pub fn parts(text: &str) -> Vec<(usize, bool, String)> {
    let mut parts = vec![(1, false, String::new())];
    let (mut rest, mut line) = (text, 1);
    while let Some(c) = rest.chars().next() {
        let is_name = parts.last().and_then(|(_, _, code)| code.chars().next_back());
        let is_name = is_name.is_some_and(|before| before.is_alphanumeric() || before == '_');
        let hashes = rest.strip_prefix('r').map(|raw| raw.len() - raw.trim_start_matches('#').len());
        let raw = hashes.filter(|&hashes| !is_name && rest[1 + hashes..].starts_with('"'));
        let taken = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if let Some(hashes) = raw {
            let (begin, end) = (hashes + 2, format!("\"{}", "#".repeat(hashes)));
            let literal = &rest[begin..begin + rest[begin..].find(&end).unwrap_or(rest.len() - begin)];
            parts.extend([(line, true, literal.to_owned()), (line, false, String::new())]);
            begin + literal.len() + end.len()
        } else if c == '"' {
            let mut escaped = false;
            let end = rest[1..].find(|c| {
                let ends = c == '"' && !escaped;
                escaped = c == '\\' && !escaped;
                ends
            });
            let literal = &rest[1..=end.unwrap_or(rest.len() - 2)];
            parts.extend([(line, true, literal.to_owned()), (line, false, String::new())]);
            literal.len() + 2
        } else {
            // A character literal may be a quotation mark.
            let quoted = ["'\"'", "'\\''", "b'\"'", "'\\\\'"].into_iter().find(|quoted| rest.starts_with(quoted));
            let taken = quoted.map_or(c.len_utf8(), str::len);
            parts.last_mut().unwrap().2.push_str(&rest[..taken]);
            taken
        };
        line += rest[..taken].matches('\n').count();
        rest = &rest[taken..];
    }
    parts
}

/// A text as the program has it: a backslash at the end of a line continues it.
pub fn joined(literal: &str) -> String {
    let mut lines = literal.split("\\\n");
    let first = lines.next().unwrap_or_default().to_owned();
    lines.fold(first, |text, line| text + line.trim_start())
}
