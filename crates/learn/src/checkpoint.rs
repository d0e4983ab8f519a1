//! Checkpoints: safetensors with a JSON header. Reading checks every bound and runs no code.
//! Independent of the storage of checkpoints.

use std::collections::{BTreeMap, HashMap};

use gleaner_core::kinds::Family;
use gleaner_core::{ActionToken, Group, ImageEncoder, ModelSpec, PretrainSpec, TrainSpec, Values, Words as _};
use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

use crate::batch::{int, values};
use crate::error::LearnError;
use crate::shape::TaskShape;

/// The version this program writes, and the only one it reads.
pub const FORMAT_VERSION: u32 = 1;

/// The header's key among the file's metadata. There is a single key, because the order of several, and so the file's
/// hash, would change from run to run.
const HEADER: &str = "gleaner";

/// The policy of headers without one.
const FIRST_POLICY: &str = "finetune";

/// The content of a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckpointKind {
    /// A pretrained transformer, from [`pretrain`](crate::pretrain).
    Encoder,
    /// A trained policy, from [`train_policy`](crate::train_policy).
    Policy,
}

/// The header of a checkpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckpointInfo {
    /// The file format.
    pub format_version: u32,
    /// The content.
    pub kind: CheckpointKind,
    /// Gradient steps done. With the seed in `spec` this is the whole state of the random numbers.
    pub step: u64,
    /// Whether training is done. If not, the file also holds the optimiser's state, and the weights kept for the end.
    pub finished: bool,
    /// The task's shape.
    pub shape: TaskShape,
    /// The model. A policy without history has segment length 0.
    pub model: ModelSpec,
    /// The policy's name; `None` in an encoder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// The policy's own settings; empty in an encoder.
    // Earlier versions had settings for ACT alone.
    #[serde(default, alias = "act", skip_serializing_if = "Values::is_empty")]
    pub settings: Values,
    /// The job's settings as a JSON text, without those of its execution (device, threads, checkpoint_every). A run
    /// resumes only under the same settings.
    pub spec: String,
}

impl CheckpointInfo {
    /// The policy's own settings, typed.
    pub(crate) fn settings<G: Group>(&self) -> Result<G, LearnError> {
        G::read(&self.settings).map_err(|problem| LearnError::Checkpoint(format!("header: {problem}")))
    }

    /// The seed of the run.
    pub(crate) fn seed(&self) -> Result<u64, LearnError> {
        let settings: serde_json::Result<Values> = serde_json::from_str(&self.spec);
        let settings = settings.map_err(|problem| LearnError::Checkpoint(format!("header: {problem}")))?;
        // Specifications without one are of its default.
        Ok(settings.get("seed").and_then(serde_json::Value::as_u64).unwrap_or_default())
    }

    /// Whether both are of runs with the same settings. An earlier version's text lacks settings, which
    /// are read with the values that it used; noise and dropout of proprioception were then drawn for each episode.
    pub(crate) fn is_of_the_run_of(&self, other: &Self) -> bool {
        let today = || match self.kind {
            CheckpointKind::Encoder => serde_json::from_str(&self.spec).map(|spec: PretrainSpec| spec.identity()),
            CheckpointKind::Policy => serde_json::from_str(&self.spec).map(|spec: TrainSpec| spec.identity()),
        };
        self.spec == other.spec || today().is_ok_and(|spec| spec == other.spec)
    }
}

/// The fields that every version has.
#[derive(Deserialize)]
struct AnyVersion {
    format_version: u32,
}

/// Reads the header of a checkpoint.
///
/// # Errors
/// [`LearnError::Checkpoint`] if `bytes` are not a checkpoint, [`LearnError::Version`] if they are a checkpoint of
/// another format.
pub fn inspect(bytes: &[u8]) -> Result<CheckpointInfo, LearnError> {
    let (_, metadata) = SafeTensors::read_metadata(bytes)?;
    let header = metadata
        .metadata()
        .as_ref()
        .and_then(|all| all.get(HEADER))
        .ok_or_else(|| LearnError::Checkpoint("has no gleaner header: it was not written by gleaner".into()))?;
    let unreadable = |error| LearnError::Checkpoint(format!("header: {error}"));
    let version: AnyVersion = serde_json::from_str(header).map_err(unreadable)?;
    if version.format_version != FORMAT_VERSION {
        return Err(LearnError::Version { found: version.format_version, supported: FORMAT_VERSION });
    }
    let mut header: serde_json::Value = serde_json::from_str(header).map_err(unreadable)?;
    if let Some(model) = header.get_mut("model").and_then(serde_json::Value::as_object_mut) {
        // Earlier versions had no other way.
        model.entry("action_token").or_insert_with(|| ActionToken::Proprioception.as_str().into());
        model.entry("image_encoder").or_insert_with(|| ImageEncoder::Keypoints.as_str().into());
        model.entry("keypoint_gain").or_insert_with(|| 1.0.into());
    }
    let mut info: CheckpointInfo = serde_json::from_value(header).map_err(unreadable)?;
    info.shape.validate()?;
    if info.kind == CheckpointKind::Policy {
        // The headers of the first policies have no kind, because there was only one.
        let policy = info.policy.get_or_insert_with(|| FIRST_POLICY.to_owned());
        complete(policy, &mut info.settings);
    }
    Ok(info)
}

/// Adds the settings that a policy of an earlier version lacks, with the values that it used; today's defaults are of
/// other networks and of another execution.
fn complete(policy: &str, settings: &mut Values) {
    let named = Values::from_iter([(Family::Policy.as_str().to_owned(), policy.into())]);
    // An unknown policy is rejected where it is opened.
    let Ok(used) = serde_json::from_value::<TrainSpec>(named.into()) else { return };
    for (name, value) in used.policy.settings {
        settings.entry(name).or_insert(value);
    }
}

/// Reads a checkpoint of `kind`: its header and its tensors by name.
pub(crate) fn read(
    bytes: &[u8],
    kind: CheckpointKind,
) -> Result<(CheckpointInfo, BTreeMap<String, Tensor>), LearnError> {
    let info = inspect(bytes)?;
    if info.kind != kind {
        return Err(LearnError::Checkpoint(format!("holds {:?}, {kind:?} is needed here", info.kind)));
    }
    let mut named = BTreeMap::new();
    for (name, view) in SafeTensors::deserialize(bytes)?.iter() {
        let tensor = tensor(&view).ok_or_else(|| LearnError::Checkpoint(format!("`{name}` is not f32")))?;
        named.insert(name.to_owned(), tensor);
    }
    Ok((info, named))
}

/// The tensor of a file; `None` unless it is of f32.
pub(crate) fn tensor(view: &TensorView<'_>) -> Option<Tensor> {
    if view.dtype() != Dtype::F32 {
        return None;
    }
    let (floats, _) = view.data().as_chunks::<4>();
    let floats: Vec<f32> = floats.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let size: Vec<i64> = view.shape().iter().map(|n| int(*n)).collect();
    Some(Tensor::from_slice(&floats).view(size.as_slice()))
}

/// Writes a checkpoint. The same header and tensors give the same bytes.
pub(crate) fn write(info: &CheckpointInfo, named: &[(String, Tensor)]) -> Result<Vec<u8>, LearnError> {
    let header = serde_json::to_string(info).map_err(|error| LearnError::Checkpoint(format!("header: {error}")))?;
    let mut stored = Vec::with_capacity(named.len());
    for (name, tensor) in named {
        debug_assert_eq!(tensor.kind(), Kind::Float, "{name}");
        let bytes: Vec<u8> = values(tensor).iter().flat_map(|x| x.to_le_bytes()).collect();
        let size: Vec<usize> = tensor.size().into_iter().map(|n| usize::try_from(n).unwrap_or(0)).collect();
        stored.push((name, size, bytes));
    }
    let views = stored
        .iter()
        .map(|(name, size, bytes)| Ok((name, TensorView::new(Dtype::F32, size.clone(), bytes)?)))
        .collect::<Result<Vec<_>, LearnError>>()?;
    let metadata = HashMap::from([(HEADER.to_owned(), header)]);
    Ok(serialize(views, Some(metadata))?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::CameraShape;

    fn info() -> CheckpointInfo {
        CheckpointInfo {
            format_version: FORMAT_VERSION,
            kind: CheckpointKind::Encoder,
            step: 3,
            finished: false,
            shape: TaskShape {
                cameras: vec![CameraShape { name: "top".into(), height: 16, width: 16, depth: false, recorded: None }],
                proprioception: 2,
                action: 1,
                ranges: gleaner_core::action::ActionRanges::default(),
            },
            model: ModelSpec::default(),
            policy: None,
            settings: Values::new(),
            spec: r#"{"seed":1}"#.into(),
        }
    }

    fn tensors() -> Vec<(String, Tensor)> {
        let odd = [0.1f32, -0.0, f32::MIN_POSITIVE / 4.0, 1e38, f32::EPSILON, 7.0];
        vec![
            ("b".into(), Tensor::from_slice(&odd).view([2, 3])),
            ("a".into(), Tensor::from_slice(&odd[..1]).view([1, 1, 1])),
        ]
    }

    #[test]
    fn a_round_trip_is_exact_and_the_bytes_repeat() {
        let bytes = write(&info(), &tensors()).unwrap();
        assert_eq!(bytes, write(&info(), &tensors()).unwrap());
        let (read_info, named) = read(&bytes, CheckpointKind::Encoder).unwrap();
        assert_eq!(read_info, info());
        for (name, tensor) in tensors() {
            let bits = |t: &Tensor| values(t).iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            assert_eq!(named[&name].size(), tensor.size());
            assert_eq!(bits(&named[&name]), bits(&tensor));
        }
    }

    #[test]
    fn another_version_is_named_with_the_supported_one_and_the_fix() {
        let bytes = write(&CheckpointInfo { format_version: 9, ..info() }, &tensors());
        let message = inspect(&bytes.unwrap()).unwrap_err().to_string();
        assert!(message.contains("version 9") && message.contains("version 1"), "{message}");
        assert!(message.contains("train it again"), "{message}");
    }

    #[test]
    fn a_checkpoint_of_an_earlier_version_is_of_the_same_run() {
        let today = |spec: &TrainSpec| CheckpointInfo { kind: CheckpointKind::Policy, spec: spec.identity(), ..info() };
        let spec = TrainSpec::default();
        let mut values: Values = serde_json::from_str(&spec.identity()).unwrap();
        assert!(values.remove("weighting").is_some());
        let before = CheckpointInfo { spec: serde_json::Value::Object(values).to_string(), ..today(&spec) };
        assert!(before.is_of_the_run_of(&today(&spec)) && before.spec != today(&spec).spec);
        let mut other = spec.clone();
        other.run.seed += 1;
        assert!(!before.is_of_the_run_of(&today(&other)));
        let unreadable = CheckpointInfo { spec: "{".to_owned(), ..before };
        assert!(!unreadable.is_of_the_run_of(&today(&spec)));
    }

    #[test]
    fn a_policy_whose_header_names_no_kind_is_finetuned() {
        let old = CheckpointInfo { kind: CheckpointKind::Policy, ..info() };
        let bytes = write(&old, &tensors()).unwrap();
        assert!(!String::from_utf8_lossy(&bytes).contains("finetune"));
        assert_eq!(inspect(&bytes).unwrap().policy, Some("finetune".to_owned()));
        assert_eq!(inspect(&write(&info(), &tensors()).unwrap()).unwrap().policy, None);
    }

    #[test]
    fn a_header_of_an_earlier_version_reads_actions_from_the_proprioception() {
        let query = ModelSpec { action_token: ActionToken::Query, ..ModelSpec::default() };
        let bytes = write(&CheckpointInfo { model: query, ..info() }, &tensors()).unwrap();
        assert_eq!(inspect(&bytes).unwrap().model.action_token, ActionToken::Query);
        // Blanks keep the file's length, which its first bytes hold.
        let setting = br#"\"action_token\":\"query\","#;
        let at = bytes.windows(setting.len()).position(|part| part == setting).unwrap();
        let mut earlier = bytes;
        earlier[at..at + setting.len()].fill(b' ');
        assert_eq!(inspect(&earlier).unwrap().model.action_token, ActionToken::Proprioception);
    }

    #[test]
    fn the_wrong_kind_is_refused() {
        let bytes = write(&info(), &tensors()).unwrap();
        let message = read(&bytes, CheckpointKind::Policy).unwrap_err().to_string();
        assert!(message.contains("holds Encoder"), "{message}");
    }

    #[test]
    fn damaged_bytes_give_an_error_and_never_a_panic() {
        let bytes = write(&info(), &tensors()).unwrap();
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length], CheckpointKind::Encoder).is_err());
        }
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x41;
            let _ = read(&damaged, CheckpointKind::Encoder);
        }
        assert!(inspect(b"\x80\x04pickle").is_err());
    }
}
