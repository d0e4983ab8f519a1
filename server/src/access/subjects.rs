//! The subjects of an audit entry: names and ids as `field=value`, limited and escaped. Must not depend on any message.

/// The most subjects of one entry.
const MOST: usize = 32;
/// The most characters of one value.
const LONGEST: usize = 160;

/// The subjects of one entry, each once.
#[derive(Debug, Default)]
pub(crate) struct Subjects(Vec<String>);

/// A value with names and ids: a message, or a field of one.
pub(crate) trait Named {
    /// Adds the names and ids in this value, which is the field `path` of its message; empty for the message itself.
    fn name_in(&self, path: &str, subjects: &mut Subjects);
}

impl Named for String {
    fn name_in(&self, path: &str, subjects: &mut Subjects) {
        if self.is_empty() || subjects.0.len() >= MOST {
            return;
        }
        // Escaped for display: control characters would reach a terminal.
        let subject = format!("{path}={}", self.escape_debug().take(LONGEST).collect::<String>());
        if !subjects.0.contains(&subject) {
            subjects.0.push(subject);
        }
    }
}

impl Named for Vec<String> {
    fn name_in(&self, path: &str, subjects: &mut Subjects) {
        self.iter().take(MOST).for_each(|name| name.name_in(path, subjects));
    }
}

impl<T: Named> Named for Option<T> {
    fn name_in(&self, path: &str, subjects: &mut Subjects) {
        self.iter().for_each(|named| named.name_in(path, subjects));
    }
}

impl From<Subjects> for Vec<String> {
    fn from(subjects: Subjects) -> Self {
        subjects.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subjects_are_limited_escaped_and_listed_once() {
        let mut subjects = Subjects::default();
        Some("arm".to_owned()).name_in("task", &mut subjects);
        for (path, name) in [("task", "arm"), ("cohort", ""), ("job.id", "job_1")] {
            name.to_owned().name_in(path, &mut subjects);
        }
        assert_eq!(subjects.0, ["task=arm", "job.id=job_1"]);

        let ids: Vec<String> = (0..500).map(|n| format!("ep_{n}\u{1b}[2J{}", "x".repeat(1000))).collect();
        ids.name_in("episode_ids", &mut subjects);
        assert_eq!(subjects.0.len(), MOST);
        assert!(subjects.0.iter().all(|subject| subject.len() < 200 && !subject.contains('\u{1b}')));
    }
}
