//! The draft of a task from the description of another program's dataset: its features are the fields.

use gleaner_inspector::{Description, FieldOrigin};
use gleaner_recording::{CameraSource, FieldSource, Mapping, RecordedSize};

use super::Draft;
use super::cameras::{Camera, step_size};
use super::candidate::LeftOut;
use super::fields::{self, Field};
use crate::words::counted;

/// Most names of values in a comment.
const NAMES_SHOWN: usize = 16;

/// Drafts a task with this name.
pub(crate) fn of_description(description: &Description, name: String) -> Draft {
    let mut spec = description.spec.clone();
    spec.name = name;
    let mapping = spec.mappings.first().cloned();
    let mapping = mapping.as_ref();
    let mut cameras = Vec::new();
    for (camera, origin) in spec.cameras.iter_mut().zip(&description.cameras) {
        let mut reasons = vec![format!("{origin}.")];
        let (height, width) = (camera.height, camera.width);
        (camera.height, camera.width) = step_size(height, width);
        if (camera.height, camera.width) != (height, width) {
            camera.recorded = Some(RecordedSize { height, width, crop: None });
            reasons.push(format!(
                "Models read it scaled to {}×{}; larger ones show more and train slower.",
                camera.height, camera.width
            ));
        }
        let own = |source: &&CameraSource| source.camera == camera.name;
        let sources = mapping.into_iter().flat_map(|mapping| &mapping.cameras).filter(own).cloned().collect();
        cameras.push(Camera { spec: camera.clone(), sources, reasons });
    }
    let states = spec.proprioception.len();
    let all = spec.proprioception.iter_mut().chain(&mut spec.action).zip(&description.fields);
    let mut drafted = Vec::new();
    for (at, (field, origin)) in all.enumerate() {
        let mut reasons = vec![reason(origin)];
        let action = at >= states;
        let range = origin.range.filter(|_| action);
        let observed = range.is_some_and(|range| fields::bound(field, &[range], &origin.values, &mut reasons));
        drafted.push(Field {
            spec: field.clone(),
            action,
            open: false,
            meaning: None,
            is_aside: false,
            observed,
            stamped: vec![true],
            sources: sources(mapping, &field.name),
            reasons,
        });
    }
    let rate = if description.rate_stated {
        format!("The dataset states {} steps per second.", spec.rate_hz)
    } else {
        format!("The dataset states no rate; {} is a guess: give the true one with --rate.", spec.rate_hz)
    };
    let left_out = description.left_out.iter();
    let left_out = left_out.map(|left| LeftOut { what: left.what.clone(), reason: left.reason.clone() });
    Draft {
        origin: format!(
            "{} of a dataset, {}",
            counted(description.episodes, "episode", "episodes"),
            description.format
        ),
        rate,
        cameras,
        fields: drafted,
        left_out: left_out.collect(),
        spec,
    }
}

fn reason(origin: &FieldOrigin) -> String {
    match origin.names.as_slice() {
        [] => format!("{}.", origin.feature),
        names => {
            let shown: Vec<&str> = names.iter().take(NAMES_SHOWN).map(String::as_str).collect();
            let more = if names.len() > NAMES_SHOWN { ", …" } else { "" };
            format!("{}: {}{more}.", origin.feature, shown.join(", "))
        }
    }
}

fn sources(mapping: Option<&Mapping>, field: &str) -> Vec<FieldSource> {
    mapping.into_iter().flat_map(|mapping| &mapping.fields).filter(|source| source.field == field).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_recording::{Bound, CameraSpec, FieldSpec, TaskSpec, ValueRange, validate, written_mapping};

    #[test]
    fn features_are_fields_with_their_names_and_ranges() {
        let mut spec: TaskSpec = serde_json::from_value(serde_json::json!({
            "name": "dataset", "rate_hz": 30.0, "mappings": [],
            "proprioception": [{ "name": "pan", "size": 1 }], "action": [{ "name": "action_pan", "size": 1 }],
        }))
        .unwrap();
        spec.cameras = vec![CameraSpec { name: "top".into(), height: 480, width: 640, depth: false, recorded: None }];
        spec.mappings = vec![written_mapping(&spec)];
        let field = |feature: &str, range| FieldOrigin {
            feature: feature.into(),
            names: vec!["pan.pos".into()],
            range,
            values: Vec::new(),
        };
        let range = ValueRange { minimum: -0.98, maximum: 0.4 };
        let description = Description {
            format: "LeRobot v3.0".into(),
            episodes: 2,
            steps: 20,
            rate_stated: true,
            environment: None,
            spec,
            fields: vec![field("observation.state", None), field("action", Some(range))],
            cameras: vec!["observation.images.top, video".into()],
            left_out: Vec::new(),
        };
        let draft = of_description(&description, "pick".into());
        validate(&draft.spec).unwrap();
        let camera = &draft.spec.cameras[0];
        assert_eq!((camera.height, camera.width, camera.sizes().recorded()), (96, 128, (480, 640)));
        assert_eq!(
            draft.spec.action[0],
            FieldSpec {
                minimum: Some(Bound::All(-1.0)),
                maximum: Some(Bound::All(1.0)),
                ..FieldSpec::new("action_pan", 1)
            }
        );
        let text = draft.to_string();
        for part in
            ["2 episodes of a dataset, LeRobot v3.0", "observation.state: pan.pos.", "states 30 steps per second"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert_eq!(toml::from_str::<TaskSpec>(&text).unwrap(), draft.spec);
    }
}
