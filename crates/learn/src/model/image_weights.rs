//! Weights of a ResNet that others trained, from a safetensors file with the names and shapes of torchvision.
//! Independent of the place that the file comes from.

use std::collections::{BTreeMap, BTreeSet};

use gleaner_core::{ImageEncoder, Words as _};
use safetensors::SafeTensors;
use safetensors::tensor::TensorView;
use tch::{Tensor, no_grad_guard};

use super::image_encoder::RESNET;
use crate::checkpoint;
use crate::error::LearnError;

/// The setting that names the file.
const FIELD: &str = "image_weights";
/// Tensors of such files that have no place here: the classifier of photographs, and counters of training.
const IGNORED: [(&str, &str); 2] = [("fc.", ""), ("", ".num_batches_tracked")];
/// Variances cannot be negative.
const VARIANCES: &str = ".running_var";
/// The one kernel that sees the channels of images.
const FIRST: &str = "conv1.weight";
/// Channels that weights are given for; those of a fourth channel, depth, are zero.
const COLOURS: i64 = 3;
/// Most names of one fault in a message.
const NAMED: usize = 5;

/// Gives every camera's ResNet among `parameters` the weights of the file `bytes`, where the model has such networks.
///
/// # Errors
/// [`LearnError::Invalid`] for a file that is missing, is not used or cannot be used.
pub(crate) fn give(
    image_encoder: ImageEncoder,
    parameters: &[(String, Tensor)],
    bytes: Option<&[u8]>,
) -> Result<(), LearnError> {
    let encoder = image_encoder.as_str();
    match (image_encoder.is_resnet(), bytes) {
        (false, None) => Ok(()),
        (true, Some(bytes)) => load(parameters, bytes),
        (true, None) => {
            Err(LearnError::invalid(FIELD, format!("is missing; image_encoder {encoder} begins with given weights")))
        }
        (false, Some(_)) => Err(LearnError::invalid(
            FIELD,
            format!("has no effect: image_encoder {encoder} begins with drawn weights; leave it out"),
        )),
    }
}

/// Copies the tensors of the file `bytes` into every camera's ResNet among `parameters`.
///
/// A camera with depth begins with weights of zero for it, so that its features are those of its colours until training
/// moves them.
///
/// # Errors
/// [`LearnError::Invalid`] names everything that is wrong with the file: tensors that are missing, unexpected, of another
/// shape or type, or with values that no network has.
fn load(parameters: &[(String, Tensor)], bytes: &[u8]) -> Result<(), LearnError> {
    let invalid = |message: String| LearnError::invalid(FIELD, message);
    let mut copies: BTreeMap<&str, Vec<&Tensor>> = BTreeMap::new();
    for (name, parameter) in parameters {
        if let Some((_, name)) = name.split_once(&format!(".{RESNET}.")) {
            copies.entry(name).or_default().push(parameter);
        }
    }
    if copies.is_empty() {
        return Err(invalid("has no effect: no camera of the task has a ResNet; leave it out".to_owned()));
    }
    let file = SafeTensors::deserialize(bytes).map_err(|error| {
        invalid(format!(
            "the file is not a whole safetensors file ({error}); store it again, or convert a .pth file with \
             scripts/convert_resnet.py"
        ))
    })?;
    let given: BTreeMap<String, TensorView<'_>> = file.iter().map(|(name, view)| (name.to_owned(), view)).collect();
    let mut faults = Faults::default();
    let unexpected = given.keys().filter(|name| !copies.contains_key(name.as_str()) && !is_ignored(name));
    unexpected.for_each(|name| faults.add("unexpected", name));
    let mut read = Vec::with_capacity(copies.len());
    for (name, parameters) in &copies {
        match given.get(*name).map(|view| tensor(name, view, parameters[0])) {
            None => faults.add("missing", name),
            Some(Err((fault, what))) => faults.add(fault, &what),
            Some(Ok(tensor)) => read.push((parameters, tensor)),
        }
    }
    if !faults.0.is_empty() {
        return Err(invalid(format!("the file does not have the weights of this network of torchvision: {faults}")));
    }
    let _no_grad = no_grad_guard();
    for (parameters, tensor) in read {
        for parameter in parameters {
            let mut parameter = parameter.shallow_clone();
            if parameter.size() == tensor.size() {
                parameter.copy_(&tensor);
            } else {
                let _ = parameter.zero_();
                parameter.narrow(1, 0, COLOURS).copy_(&tensor);
            }
        }
    }
    Ok(())
}

fn is_ignored(name: &str) -> bool {
    IGNORED.iter().any(|(start, end)| name.starts_with(start) && name.ends_with(end))
}

/// The tensor for this parameter, or its fault and a description.
fn tensor(name: &str, view: &TensorView<'_>, parameter: &Tensor) -> Result<Tensor, (&'static str, String)> {
    let mut size = parameter.size();
    if name == FIRST {
        size[1] = COLOURS;
    }
    let expected: Vec<usize> = size.iter().map(|side| usize::try_from(*side).unwrap_or(0)).collect();
    if view.shape() != expected {
        return Err(("of another shape", format!("{name} ({:?}, expected {expected:?})", view.shape())));
    }
    let Some(tensor) = checkpoint::tensor(view) else {
        return Err(("not F32", format!("{name} ({:?})", view.dtype())));
    };
    if tensor.isfinite().all().int64_value(&[]) == 0 {
        return Err(("with values that are not finite", name.to_owned()));
    }
    if name.ends_with(VARIANCES) && tensor.lt(0.0).any().int64_value(&[]) != 0 {
        return Err(("with negative variances", name.to_owned()));
    }
    Ok(tensor)
}

/// What is wrong with a file: the tensors of each fault.
#[derive(Default)]
struct Faults(BTreeMap<&'static str, BTreeSet<String>>);

impl Faults {
    fn add(&mut self, fault: &'static str, tensor: &str) {
        self.0.entry(fault).or_default().insert(tensor.to_owned());
    }
}

impl std::fmt::Display for Faults {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (place, (fault, tensors)) in self.0.iter().enumerate() {
            let named: Vec<&str> = tensors.iter().take(NAMED).map(String::as_str).collect();
            let separator = if place == 0 { "" } else { "; " };
            write!(f, "{separator}{fault}: {}", named.join(", "))?;
            if tensors.len() > NAMED {
                write!(f, " and {} more", tensors.len() - NAMED)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod made;
#[cfg(test)]
mod tests;
