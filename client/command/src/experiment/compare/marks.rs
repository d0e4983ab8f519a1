//! Marks of episodes: from which step on each went wrong, as `gleaner record` writes them or a person noted them.
//!
//! Must not depend on a server.

use std::collections::HashMap;
use std::path::Path;

use super::super::mark_rows::{self, MarkRow};
use crate::failure::Result;
use crate::quality::Mark;

/// The rows of a file.
#[derive(Clone, Debug)]
pub(super) struct Marks(Vec<MarkRow>);

impl Marks {
    pub(super) fn read(path: &Path) -> Result<Self> {
        Ok(Self(mark_rows::read(path)?))
    }

    /// The mark of each of these episodes (id, file name). Rows of other episodes have no effect.
    ///
    /// # Errors
    /// The row that cannot be used.
    pub(super) fn of_episodes(
        &self,
        episodes: &[(String, String)],
    ) -> std::result::Result<HashMap<String, Mark>, String> {
        let mut marks = HashMap::new();
        for row in &self.0 {
            let here = |problem: &str| format!("line {}: {problem}", row.line);
            let named: Vec<&String> = match (&row.episode, &row.file) {
                (Some(id), _) => episodes.iter().filter(|episode| episode.0 == *id).map(|(id, _)| id).collect(),
                (None, Some(file)) => episodes.iter().filter(|episode| episode.1 == *file).map(|(id, _)| id).collect(),
                (None, None) => return Err(here("has no column episode or file")),
            };
            if let [_, _, ..] = named[..] {
                let file = row.file.as_deref().unwrap_or_default();
                return Err(here(&format!("{} episodes are named {file}; name them in a column episode", named.len())));
            }
            for id in named {
                if marks.insert(id.clone(), row.mark).is_some() {
                    return Err(here(&format!("{id}: is duplicated")));
                }
            }
        }
        if marks.is_empty() {
            return Err("the file has no row of an imperfect episode of the snapshot".into());
        }
        Ok(marks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marks(text: &str) -> std::result::Result<Vec<(String, Option<u32>)>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("marks.csv");
        std::fs::write(&path, text).unwrap();
        let episodes = [("ep_1", "a.mcap"), ("ep_2", "b.mcap"), ("ep_3", "b.mcap")];
        let episodes = episodes.map(|(id, file)| (id.to_owned(), file.to_owned()));
        let read = Marks::read(&path).map_err(|failure| failure.to_string())?.of_episodes(&episodes)?;
        let mut read: Vec<_> = read.into_iter().map(|(id, mark)| (id, mark.went_wrong)).collect();
        read.sort();
        Ok(read)
    }

    #[test]
    fn episodes_are_marked_by_file_or_by_id() {
        let file = "file,agent,success,went_wrong\na.mcap,freeze,false,3\nz.mcap,freeze,false,1\n";
        assert_eq!(marks(file).unwrap(), [("ep_1".into(), Some(3))]);
        assert_eq!(
            marks("episode,went_wrong\nep_2,\nep_3,0\n").unwrap(),
            [("ep_2".into(), None), ("ep_3".into(), Some(0))]
        );
    }

    #[test]
    fn rows_that_cannot_be_used_are_named() {
        for (text, part) in [
            ("file,went_wrong\nb.mcap,1\n", "line 2: 2 episodes are named b.mcap"),
            ("file,went_wrong\na.mcap,late\n", "line 2: went_wrong: expected a step"),
            ("episode,went_wrong\nep_1,1\nep_1,2\n", "line 3: ep_1: is duplicated"),
            ("agent,went_wrong\nfreeze,1\n", "line 2: has no column"),
            ("file,went_wrong\n\na.mcap,1\n\n\na.mcap,2\n", "line 6: ep_1: is duplicated"),
            ("file,success\na.mcap,true\n", "went_wrong"),
            ("file,went_wrong\nz.mcap,1\n", "no row of an imperfect episode"),
        ] {
            let message = marks(text).unwrap_err();
            assert!(message.contains(part), "{message}");
        }
    }
}
