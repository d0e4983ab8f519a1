//! Messages about many recordings, equal ones once with their count.
//!
//! Pure code.

/// Most recordings that a line names.
const NAMED: usize = 3;

/// Messages in the order of their first recording, each with the recordings that have it.
#[derive(Debug, Default)]
pub(crate) struct Alike {
    messages: Vec<Message>,
}

#[derive(Debug)]
struct Message {
    /// Equal for messages alike.
    key: String,
    text: String,
    recordings: Vec<String>,
}

impl Alike {
    /// Adds a message about a recording.
    pub(crate) fn add(&mut self, text: &str, recording: &str) {
        let name = recording.rsplit('/').next().unwrap_or_default();
        let text_alone = text.replace(recording, "");
        let key = key(&if name.is_empty() { text_alone } else { text_alone.replace(name, "") });
        match self.messages.iter_mut().find(|known| known.key == key) {
            Some(known) => known.recordings.push(recording.to_owned()),
            None => self.messages.push(Message { key, text: text.to_owned(), recordings: vec![recording.to_owned()] }),
        }
    }

    /// One line for each different message: `rejected: 105 recordings (a.mcap, b.mcap, c.mcap, …): reason`.
    pub(crate) fn lines(&self, kind: &str) -> Vec<String> {
        let line = |Message { text, recordings, .. }: &Message| match recordings.as_slice() {
            [one] => format!("{kind}: {one}: {text}"),
            many => {
                let named: Vec<&str> = many.iter().take(NAMED).map(String::as_str).collect();
                let more = if many.len() > NAMED { ", …" } else { "" };
                format!("{kind}: {} recordings ({}{more}): {text}", many.len(), named.join(", "))
            }
        };
        self.messages.iter().map(line).collect()
    }
}

/// A message without what differs between recordings with one problem: its numbers, and the id of the call. The numbers
/// in topics and paths stay: `/joint1` and `/joint2` are two problems.
fn key(text: &str) -> String {
    let text = text.split(" (request ").next().unwrap_or_default();
    let mut key = String::new();
    let (mut named, mut last) = (false, ' ');
    for c in text.chars() {
        let apart = |c: char| c.is_whitespace() || "\"'`(,;".contains(c);
        named = if c == '/' { named || apart(last) } else { named && !apart(c) };
        match c {
            '0'..='9' if !named && last.is_ascii_digit() => {}
            '0'..='9' if !named => key.push('0'),
            other => key.push(other),
        }
        last = c;
    }
    key
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_that_differ_in_numbers_are_alike() {
        let mut alike = Alike::default();
        for at in 0..105 {
            alike.add(&format!("{at}.mcap: {} messages of /x are missing", 10 + at), &format!("x/{at}.mcap"));
        }
        for (topic, recording) in [("/joint1", "p.mcap"), ("/joint2", "q.mcap"), ("/joint1", "r.mcap")] {
            alike.add(&format!("\"{topic}\" ends after 12.5 s"), recording);
        }
        for recording in ["/data/ep_001/a.mcap", "/data/ep_002/a.mcap"] {
            alike.add(&format!("{recording}: permission denied"), recording);
        }
        alike.add("is empty", "z.mcap");
        assert_eq!(
            alike.lines("rejected"),
            [
                "rejected: 105 recordings (x/0.mcap, x/1.mcap, x/2.mcap, …): 0.mcap: 10 messages of /x are missing",
                "rejected: 2 recordings (p.mcap, r.mcap): \"/joint1\" ends after 12.5 s",
                "rejected: q.mcap: \"/joint2\" ends after 12.5 s",
                "rejected: 2 recordings (/data/ep_001/a.mcap, /data/ep_002/a.mcap): /data/ep_001/a.mcap: permission denied",
                "rejected: z.mcap: is empty"
            ]
        );
    }
}
