//! The words that options and experiment files choose from, and what each is on the wire. One word per choice,
//! everywhere the same.

use clap::ValueEnum;
use gleaner_proto::v1;
use serde::{Deserialize, Serialize};

macro_rules! choice {
    ($(#[$about:meta])* $name:ident => $wire:ident { $($(#[$doc:meta])* $word:ident),+ $(,)? }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        #[value(rename_all = "snake_case")]
        pub(crate) enum $name {
            $($(#[$doc])* $word),+
        }

        impl From<$name> for v1::$wire {
            fn from(chosen: $name) -> Self {
                match chosen {
                    $($name::$word => Self::$word),+
                }
            }
        }

        impl From<$name> for i32 {
            fn from(chosen: $name) -> Self {
                v1::$wire::from(chosen).into()
            }
        }
    };
}

choice! {
    /// How large a model is.
    PresetWord => Preset { #[default] Tiny, Small, Base }
}
choice! {
    /// Where a job computes.
    DeviceWord => Device { #[default] Cpu, Cuda }
}
choice! {
    /// A self-supervised objective of pretraining.
    ObjectiveWord => Objective {
        /// Masked transition prediction.
        #[default]
        Mtp,
        /// Transition reconstruction.
        Tr,
        /// Action autoregression.
        Aa,
    }
}
choice! {
    /// What gives segments their score.
    ScorerWord => Scorer {
        /// The nearest expert segment in the encoder's features.
        #[default]
        Ssdf,
        /// A baseline: the nearest expert step in the observations themselves.
        Raw,
        /// A baseline: a network that tells experts' segments from imperfect ones.
        Classifier,
    }
}
choice! {
    /// How two segments' features are compared.
    SimilarityWord => Similarity { #[default] LastL2, LastCosine, SegmentL2, SegmentCosine }
}
choice! {
    /// What features are measured in before they are compared.
    FeatureScaleWord => FeatureScale {
        /// Every direction by how much it varies over the pretraining data.
        #[default]
        Whitened,
        /// As the transformer gives them.
        Plain,
    }
}
choice! {
    /// What a similarity is measured against before it is normalised.
    YardstickWord => Yardstick {
        /// How near experts are to one another around the match.
        #[default]
        Local,
        /// Nothing.
        None,
    }
}
choice! {
    /// How similarities become qualities in [0, 1].
    NormaliserWord => Normaliser {
        /// The smallest and largest similarity become 0 and 1.
        #[default]
        Minmax,
        /// The share of segments that are less similar.
        Quantile,
    }
}
choice! {
    /// Which policy is trained.
    PolicyWord => PolicyKind {
        /// The pretrained transformer, finetuned.
        #[default]
        Finetune,
        /// The same transformer from scratch.
        TfBc,
        /// No history, from scratch.
        Bc,
        /// Action chunking with transformers, from scratch.
        Act,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words<C: ValueEnum + Serialize>() -> Vec<String> {
        let word = |choice: &C| {
            let on_the_line = choice.to_possible_value().unwrap().get_name().to_owned();
            assert_eq!(serde_json::to_value(choice).unwrap(), on_the_line);
            on_the_line
        };
        C::value_variants().iter().map(word).collect()
    }

    #[test]
    fn a_word_is_the_same_on_the_command_line_and_in_a_file() {
        assert_eq!(words::<SimilarityWord>(), ["last_l2", "last_cosine", "segment_l2", "segment_cosine"]);
        assert_eq!(words::<PolicyWord>(), ["finetune", "tf_bc", "bc", "act"]);
        assert_eq!(words::<NormaliserWord>(), ["minmax", "quantile"]);
        assert_eq!(words::<ScorerWord>(), ["ssdf", "raw", "classifier"]);
        assert_eq!(words::<ObjectiveWord>(), ["mtp", "tr", "aa"]);
    }

    #[test]
    fn a_word_is_its_wire_value() {
        assert_eq!(i32::from(SimilarityWord::SegmentL2), i32::from(v1::Similarity::SegmentL2));
        assert_eq!(v1::PolicyKind::from(PolicyWord::TfBc).as_str_name(), "POLICY_KIND_TF_BC");
    }
}
