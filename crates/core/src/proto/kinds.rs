//! The kinds of jobs, policies, weightings, objectives and scorers on the wire, with their settings.

use crate::{
    Setting, Shape, Values,
    kinds::{Family, Kind, Needs},
    proto,
    schema::WordAbout,
};
use gleaner_proto::v1;

/// Every kind that a client may choose.
pub fn list() -> v1::ListKindsResponse {
    let of = |family: Family| family.kinds().iter().cloned().map(kind).collect();
    v1::ListKindsResponse {
        jobs: crate::job_kinds().into_iter().map(kind).collect(),
        policies: of(Family::Policy),
        weightings: of(Family::Weighting),
        objectives: of(Family::Objective),
        scorers: of(Family::Scorer),
    }
}

fn kind(kind: Kind) -> v1::Kind {
    let Kind { name, title, about, needs: Needs { encoder, history, images, all_episodes }, settings } = kind;
    v1::Kind {
        name,
        title,
        about,
        needs_encoder: encoder,
        needs_history: history,
        needs_images: images,
        needs_all_episodes: all_episodes,
        settings: settings.into_iter().map(setting).collect(),
    }
}

fn setting(setting: Setting) -> v1::Setting {
    let Setting { name, about, shape, default } = setting;
    let default = proto::to_struct(&Values::from_iter([("default".to_owned(), default)])).fields.remove("default");
    let of = |r#type: &str| v1::Setting { r#type: r#type.to_owned(), ..v1::Setting::default() };
    let word = |WordAbout { word, about }: WordAbout| v1::Word { word, about };
    #[expect(clippy::cast_precision_loss, reason = "the schema's integers have exact doubles")]
    let shaped = match shape {
        Shape::Integer { least, most } => v1::Setting { least: least as f64, most: most as f64, ..of("integer") },
        Shape::Number { least, most } => v1::Setting { least, most, ..of("number") },
        Shape::Flag => of("flag"),
        Shape::Word { words } => v1::Setting { words: words.into_iter().map(word).collect(), ..of("word") },
        Shape::Words { words } => v1::Setting { words: words.into_iter().map(word).collect(), ..of("words") },
        Shape::Numbers { names, least, most } => v1::Setting { names, least, most, ..of("numbers") },
        Shape::Integers { most, count: _ } => v1::Setting { most: most as f64, ..of("integers") },
        Shape::Text => of("text"),
    };
    v1::Setting { name, about, default, ..shaped }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_is_listed_with_its_settings() {
        let v1::ListKindsResponse { jobs, policies, weightings, objectives, scorers } = list();
        let names = |kinds: &[v1::Kind]| kinds.iter().map(|kind| kind.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&jobs), ["pretrain", "score", "train", "evaluate"]);
        assert_eq!((names(&policies)[0].as_str(), names(&scorers)[0].as_str()), ("bc", "raw"));
        assert_eq!(
            (names(&weightings)[0].as_str(), &names(&objectives)[..]),
            ("quality", &["mtp", "tr", "aa"].map(str::to_owned)[..])
        );
        let chunk = policies.iter().flat_map(|kind| &kind.settings).find(|setting| setting.name == "chunk_length");
        let chunk = chunk.unwrap();
        assert_eq!((chunk.r#type.as_str(), chunk.least, chunk.most), ("integer", 1.0, 256.0));
        assert_eq!(chunk.default.clone().unwrap().kind, Some(prost_types::value::Kind::NumberValue(5.0)));
    }
}
