//! The topics that the writer uses, and the mapping that reads them.

use gleaner_core::{CameraSource, CameraSpec, FieldSource, FieldSpec, Mapping, TaskSpec};

pub(super) const STATE_TOPIC: &str = "/robot/state";
pub(crate) const ACTION_TOPIC: &str = "/robot/action";
/// Name of the mapping that reads what is written here.
const MAPPING: &str = "gleaner";

/// The mapping that reads what [`EpisodeWriter`](crate::EpisodeWriter) writes for this task.
pub fn written_mapping(spec: &TaskSpec) -> Mapping {
    let fields = |specs: &[FieldSpec], topic: &str| -> Vec<FieldSource> {
        let source = |field: &FieldSpec| FieldSource {
            field: field.name.clone(),
            topic: topic.to_owned(),
            paths: vec![field.name.clone()],
            names: Vec::new(),
            transform: None,
        };
        specs.iter().map(source).collect()
    };
    let cameras = spec.cameras.iter().map(|camera| CameraSource {
        camera: camera.name.clone(),
        color: color_topic(camera),
        depth: camera.depth.then(|| depth_topic(camera)),
    });
    Mapping {
        name: MAPPING.to_owned(),
        cameras: cameras.collect(),
        fields: [fields(&spec.proprioception, STATE_TOPIC), fields(&spec.action, ACTION_TOPIC)].concat(),
        clock: Some(ACTION_TOPIC.to_owned()),
    }
}

pub(super) fn color_topic(camera: &CameraSpec) -> String {
    format!("/camera/{}/color", camera.name)
}

pub(super) fn depth_topic(camera: &CameraSpec) -> String {
    format!("/camera/{}/depth", camera.name)
}
