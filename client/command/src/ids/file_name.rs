//! Episodes by their id, or by the file name of their recording as it was pushed.
//!
//! Pure functions on listings.

use gleaner_proto::v1::Episode;

use super::{Kind, SHOWN};
use crate::words;

/// A file name as people and episodes have it in common.
pub(crate) fn stem(name: &str) -> &str {
    name.strip_suffix(".mcap").unwrap_or(name)
}

/// The id of the episode that a text names: by its beginning, as the newest, or by the file name of its recording. `None`
/// for the beginning of an id that no episode has, which the server rejects. A path is refused, because recordings in
/// several folders often share a name.
pub(super) fn choose(text: &str, episodes: &[Episode]) -> Result<Option<String>, String> {
    let ids: Vec<String> = episodes.iter().map(|episode| episode.id.clone()).collect();
    if let Some(id) = super::choose(Kind::Episode, text, &ids)? {
        return Ok(Some(id));
    }
    if text.contains('/') {
        return Err(format!("{text}: give the file name without its folder, or an id; `gleaner episodes` lists both"));
    }
    let name = stem(text);
    let named: Vec<&Episode> = episodes.iter().filter(|episode| stem(&episode.file_name) == name).collect();
    match named.as_slice() {
        [] if text.starts_with(Kind::Episode.prefix()) => Ok(None),
        [] => Err(format!("{text}: no episode has this id or file name; `gleaner episodes` lists them")),
        [one] => Ok(Some(one.id.clone())),
        many => {
            let shown = |episode: &&Episode| format!("{} ({})", episode.id, words::outcome(episode.outcome()));
            let ids: Vec<String> = many.iter().take(SHOWN).map(shown).collect();
            let more = if many.len() > SHOWN { ", …" } else { "" };
            let count = many.len();
            Err(format!("{text}: {count} episodes have this file name: {}{more}; give an id", ids.join(", ")))
        }
    }
}

#[cfg(test)]
mod tests {
    use gleaner_proto::v1::Outcome;

    use super::*;

    fn episode(id: &str, file_name: &str) -> Episode {
        let outcome = Outcome::Failure.into();
        Episode { id: id.into(), file_name: file_name.into(), outcome, ..Episode::default() }
    }

    #[test]
    fn an_id_comes_before_a_file_name() {
        let episodes = [episode("ep_1", "x.mcap"), episode("ep_2", "ep_1.mcap")];
        for (text, id) in [("ep_1", "ep_1"), ("latest", "ep_2"), ("ep_1.mcap", "ep_2")] {
            assert_eq!(choose(text, &episodes), Ok(Some(id.into())), "{text}");
        }
    }

    #[test]
    fn a_file_name_is_one_episode() {
        let episodes = [
            episode("ep_1", "a.mcap"),
            episode("ep_2", "b.mcap"),
            episode("ep_3", "b.mcap"),
            episode("ep_4", "ep_0001.mcap"),
        ];
        assert!(choose("recordings/a.mcap", &episodes).unwrap_err().contains("without its folder"));
        for text in ["a.mcap", "a"] {
            assert_eq!(choose(text, &episodes), Ok(Some("ep_1".into())), "{text}");
        }
        assert_eq!(choose("ep_0001.mcap", &episodes), Ok(Some("ep_4".into())));
        assert_eq!(choose("ep_7", &episodes), Ok(None));
        let several = choose("b.mcap", &episodes).unwrap_err();
        assert_eq!(several, "b.mcap: 2 episodes have this file name: ep_2 (failure), ep_3 (failure); give an id");
        assert!(choose("c.mcap", &episodes).unwrap_err().contains("no episode has this id or file name"));
    }
}
