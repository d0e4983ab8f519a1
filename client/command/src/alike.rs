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
    /// Equal for messages alike: their text without its numbers.
    key: Vec<String>,
    text: String,
    /// Each number of the text: as it stands there, and the least and the greatest of all messages.
    numbers: Vec<[Number; 2]>,
    recordings: Vec<String>,
}

#[derive(Clone, Debug)]
struct Number {
    text: String,
    value: f64,
}

impl Alike {
    /// Adds a message about a recording.
    pub(crate) fn add(&mut self, text: &str, recording: &str) {
        let name = recording.rsplit('/').next().unwrap_or_default();
        let text_alone = text.replace(recording, "");
        let (key, numbers) = parts(&if name.is_empty() { text_alone } else { text_alone.replace(name, "") });
        let Some(known) = self.messages.iter_mut().find(|known| known.key == key) else {
            let numbers = numbers.into_iter().map(|number| [number.clone(), number]).collect();
            self.messages.push(Message { key, text: text.to_owned(), numbers, recordings: vec![recording.to_owned()] });
            return;
        };
        known.recordings.push(recording.to_owned());
        for ([least, greatest], number) in known.numbers.iter_mut().zip(numbers) {
            if number.value < least.value {
                *least = number;
            } else if number.value > greatest.value {
                *greatest = number;
            }
        }
    }

    /// One line for each different message: `rejected: 105 recordings (a.mcap, b.mcap, c.mcap, …): reason`. Numbers that
    /// differ are ranges.
    pub(crate) fn lines(&self, kind: &str) -> Vec<String> {
        let line = |message: &Message| match message.recordings.as_slice() {
            [one] => format!("{kind}: {one}: {}", message.text),
            many => {
                let named: Vec<&str> = many.iter().take(NAMED).map(String::as_str).collect();
                let more = if many.len() > NAMED { ", …" } else { "" };
                format!("{kind}: {} recordings ({}{more}): {}", many.len(), named.join(", "), message.of_all())
            }
        };
        self.messages.iter().map(line).collect()
    }
}

impl Message {
    /// The text of several recordings, without a recording's name.
    fn of_all(&self) -> String {
        let mut text = String::new();
        for (at, part) in self.key.iter().enumerate() {
            text += part;
            match self.numbers.get(at) {
                Some([least, greatest]) if least.value < greatest.value => {
                    text += &format!("{} to {}", least.text, greatest.text);
                }
                Some([one, _]) => text += &one.text,
                None => {}
            }
        }
        text.trim_start_matches([':', ' ']).to_owned()
    }
}

/// A message without what differs between recordings with one problem: its numbers, which come between the parts of the
/// rest, and the id of the call. The numbers in topics and paths stay: `/joint1` and `/joint2` are two problems.
fn parts(text: &str) -> (Vec<String>, Vec<Number>) {
    let text = text.split(" (request ").next().unwrap_or_default();
    let (mut parts, mut numbers) = (vec![String::new()], Vec::new());
    let (mut named, mut last) = (false, ' ');
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let apart = |c: char| c.is_whitespace() || "\"'`(,;".contains(c);
        named = if c == '/' { named || apart(last) } else { named && !apart(c) };
        let length = if named { 0 } else { number(rest) };
        let (taken, left) = rest.split_at(if length == 0 { c.len_utf8() } else { length });
        match taken.parse() {
            Ok(value) if length > 0 => {
                numbers.push(Number { text: taken.to_owned(), value });
                parts.push(String::new());
            }
            _ => parts.last_mut().map_or((), |part| part.push_str(taken)),
        }
        last = taken.chars().next_back().unwrap_or(c);
        rest = left;
    }
    (parts, numbers)
}

/// Bytes of the number at the beginning of a text: digits, with decimals if there are some; 0 without one.
fn number(text: &str) -> usize {
    let digits = |text: &str| text.bytes().take_while(u8::is_ascii_digit).count();
    let whole = digits(text);
    match text.get(whole..).and_then(|rest| rest.strip_prefix('.')).map(digits) {
        Some(decimals) if whole > 0 && decimals > 0 => whole + 1 + decimals,
        _ => whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_that_differ_in_numbers_are_alike() {
        let mut alike = Alike::default();
        for at in 0..105 {
            alike.add(&format!("{at}.mcap: {} of 200 messages of /x are missing", 10 + at), &format!("x/{at}.mcap"));
        }
        for (topic, recording) in [("/joint1", "p.mcap"), ("/joint2", "q.mcap"), ("/joint1", "r.mcap")] {
            alike.add(&format!("\"{topic}\" ends after 12.5 s"), recording);
        }
        for recording in ["/data/ep_001/a.mcap", "/data/ep_002/a.mcap"] {
            alike.add(&format!("{recording}: permission denied"), recording);
        }
        for (late, recording) in [("0.32", "u.mcap"), ("0.3", "v.mcap"), ("12", "w.mcap")] {
            alike.add(&format!("/a begins {late} s late (request ab{late})"), recording);
        }
        alike.add("is empty", "z.mcap");
        assert_eq!(
            alike.lines("rejected"),
            [
                "rejected: 105 recordings (x/0.mcap, x/1.mcap, x/2.mcap, …): 10 to 114 of 200 messages of /x are missing",
                "rejected: 2 recordings (p.mcap, r.mcap): \"/joint1\" ends after 12.5 s",
                "rejected: q.mcap: \"/joint2\" ends after 12.5 s",
                "rejected: 2 recordings (/data/ep_001/a.mcap, /data/ep_002/a.mcap): permission denied",
                "rejected: 3 recordings (u.mcap, v.mcap, w.mcap): /a begins 0.3 to 12 s late",
                "rejected: z.mcap: is empty"
            ]
        );
    }
}
