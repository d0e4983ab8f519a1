//! Specs as earlier versions stored them, in rows and in checkpoints, and the identity of a run.
//!
//! Earlier versions nested groups (`optim`, `model`, `act`, `augmentation`), stored `threads`, and stored the settings
//! of every policy and scorer whether chosen or not.

use serde_json::{Value, json};

use crate::kinds::Family;
use crate::schema::Values;
use crate::settings::Words as _;
use crate::spec::{ActionToken, ImageEncoder};

/// A pretraining's settings in today's form.
pub(super) fn pretrain(values: Values) -> Values {
    complete(flat(values))
}

/// A training's settings in today's form. Those without a policy are of the one that was the default.
pub(super) fn train(mut values: Values) -> Values {
    values.entry(Family::Policy.as_str()).or_insert_with(|| "finetune".into());
    used(Family::Weighting, used(Family::Policy, of_training(complete(flat(values)))))
}

/// Adds the settings of policies and weightings that earlier versions lacked, with the values they used.
fn of_training(mut values: Values) -> Values {
    for (name, value) in [
        ("chunk_length", json!(10)),
        ("execute_length", json!(5)),
        ("chunk_network", json!("transformer")),
        ("chunk_execution", json!("ensembled")),
        ("prediction", json!("noise")),
        ("history_dropout", json!(0.5)),
        ("lambda", json!(0.1)),
        ("stretch", json!(8)),
        ("switch_weight", json!(1.0)),
        ("dropout", json!(0.0)),
        ("fresh_share", json!(0.0)),
        ("learning_rate", json!(1e-3)),
    ] {
        values.entry(name).or_insert(value);
    }
    values
}

/// Adds the settings that earlier versions lacked, with the values they used: they read the action from the
/// proprioception, drew the weights of keypoints like all others, and changed no inputs. Before a default changes, its old value is added
/// here.
fn complete(mut values: Values) -> Values {
    values.entry("action_token").or_insert_with(|| ActionToken::Proprioception.as_str().into());
    values.entry("image_encoder").or_insert_with(|| ImageEncoder::Keypoints.as_str().into());
    values.entry("keypoint_gain").or_insert_with(|| 1.0.into());
    // Off, before some policies or trainings had them by default.
    values.entry("validation_share").or_insert_with(|| 0.0.into());
    values.entry("shift_pixels").or_insert_with(|| 0.into());
    values.entry("proprioception_dropout").or_insert_with(|| 0.0.into());
    values
}

/// A scoring's settings in today's form. Versions that stored no scorer had one only, `ssdf`.
pub(super) fn score(mut values: Values) -> Values {
    values.entry(Family::Scorer.as_str()).or_insert_with(|| "ssdf".into());
    if let Some(word) = values.remove("yardstick") {
        values.insert("local_scale".to_owned(), json!(word != "none"));
    }
    if let Some(scale) = values.remove("modality_scale").filter(|scale| !scale.is_null()) {
        values.insert("scale".to_owned(), scale);
    }
    if values.get("normaliser").is_some_and(|word| word == "min_max") {
        values.insert("normaliser".to_owned(), "minmax".into());
    }
    // The only one of versions that stored none.
    values.entry("normaliser").or_insert_with(|| "minmax".into());
    // Similarity alone, in versions without these settings.
    values.entry("lookahead").or_insert(json!(0.0));
    values.entry("lead_in").or_insert(json!(0.0));
    values.entry("earliness").or_insert(json!(0.0));
    values.entry("progress").or_insert_with(|| "furthest".into());
    // One of them joined `raw` with `progress`, and like this one neither scored live nor was extended.
    if values.get(Family::Scorer.as_str()).is_some_and(|word| word == "blend") {
        values.insert(Family::Scorer.as_str().to_owned(), "progress".into());
    }
    used(Family::Scorer, flat(values))
}

/// Merges groups into the map that contains them.
fn flat(values: Values) -> Values {
    let mut flat = Values::new();
    for (name, value) in values {
        if let Value::Object(group) = value {
            flat.extend(group);
        } else if name != "threads" {
            // A worker sets its threads itself.
            flat.insert(name, value);
        }
    }
    flat
}

/// Removes the settings that the chosen kind lacks and another kind has.
fn used(family: Family, mut values: Values) -> Values {
    let Some(kind) = family.chosen(&values) else { return values };
    for (setting, _) in family.settings() {
        if kind.settings.iter().all(|own| own.name != setting.name) {
            values.remove(&setting.name);
        }
    }
    values
}

/// The settings that decide a run's result, as JSON: without those of its execution.
pub(super) fn identity(mut values: Values) -> String {
    for name in ["checkpoint_every", "device"] {
        values.remove(name);
    }
    Value::Object(values).to_string()
}
