//! The file of pretrained weights that an image encoder begins with: the setting, and the rules beside other settings.
//! Must not depend on the content of such files.

use serde::{Deserialize, Serialize};

use super::groups::{ImageEncoder, InitialWeights, ModelSpec, ObserverSpec};
use crate::id::BlobId;
use crate::schema::{Problem, Shape, Values};
use crate::settings::{Group as _, Words as _};

/// Longest name of a file, in bytes.
const LONGEST: usize = 200;

/// A file of weights, by its name; with its digest in a job, so that the job begins with no other content. By default
/// no file.
///
/// As text `name` or `name@digest`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ImageWeights {
    name: String,
    digest: Option<BlobId>,
}

crate::settings! {
    /// Pretrained weights of an image encoder.
    pub struct ImageWeightsSpec {
        /// Pretrained weights that the image encoder `resnet18` or `resnet34` begins with: the name of a safetensors
        /// file in the server's folder `--image-weights-dir`, with the names and shapes of torchvision. Each camera
        /// begins with a copy of its own. The server adds the BLAKE3 digest of the file (`name@digest`), so that a
        /// repeated job begins with the same weights. Empty: none, for the other image encoders.
        pub image_weights: ImageWeights = ImageWeights::default(), Shape::Text;
    }
}

impl ImageWeights {
    /// The file's name; `None` without a file.
    #[must_use]
    pub fn name(&self) -> Option<&str> {
        (!self.name.is_empty()).then_some(&self.name)
    }

    /// The BLAKE3 digest of its content, where that is chosen.
    #[must_use]
    pub fn digest(&self) -> Option<&BlobId> {
        self.digest.as_ref()
    }

    /// The file of that name with this content.
    #[must_use]
    pub fn with_digest(self, digest: BlobId) -> Self {
        Self { digest: Some(digest), ..self }
    }
}

impl TryFrom<String> for ImageWeights {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        if text.is_empty() {
            return Ok(Self::default());
        }
        let (name, digest) = match text.split_once('@') {
            Some((name, digest)) => (name, Some(digest)),
            None => (text.as_str(), None),
        };
        let plain = |letter: char| letter.is_ascii_alphanumeric() || ['.', '_', '-'].contains(&letter);
        if name.is_empty() || name.len() > LONGEST || name.starts_with('.') || !name.chars().all(plain) {
            return Err(format!(
                "{:?} is not the name of a file: use up to {LONGEST} letters, digits, `.`, `_` and `-`, without folders \
                 and without a dot at the start",
                name.chars().take(64).collect::<String>()
            ));
        }
        let digest = digest.map(|digest| BlobId::try_from(digest.to_owned())).transpose();
        let digest = digest.map_err(|problem| format!("what follows the @ {problem}"))?;
        Ok(Self { name: name.to_owned(), digest })
    }
}

impl From<ImageWeights> for String {
    fn from(ImageWeights { name, digest }: ImageWeights) -> Self {
        match digest {
            Some(digest) => format!("{name}@{}", digest.as_str()),
            None => name,
        }
    }
}

impl ImageWeightsSpec {
    /// Checks that the image encoder of `model` begins with weights if, and only if, it can.
    ///
    /// # Errors
    /// [`Problem`] names `image_weights`.
    pub(super) fn check(&self, model: ModelSpec) -> Result<(), Problem> {
        let encoder = model.image_encoder;
        let message = match (encoder.is_resnet(), self.image_weights.name()) {
            (true, Some(_)) | (false, None) => return Ok(()),
            (true, None) => format!(
                "is empty, but the norms of {} are fixed and need given weights; name a file of the server's \
                 --image-weights-dir, or use image_encoder residual, whose weights are drawn",
                encoder.as_str()
            ),
            (false, Some(_)) => format!(
                "has no effect: image_encoder {} does not begin with given weights, only resnet18 and resnet34; leave it \
                 out",
                encoder.as_str()
            ),
        };
        Err(Problem::new("image_weights", message))
    }

    /// As [`ImageWeightsSpec::check`], for the settings of a policy. One without such a setting reads no images, or
    /// begins from an encoder.
    ///
    /// # Errors
    /// [`Problem`] names the setting.
    pub(super) fn check_policy(settings: &Values) -> Result<(), Problem> {
        if !settings.contains_key("image_weights") {
            return Ok(());
        }
        let weights = Self::read(settings)?;
        if ObserverSpec::read(settings)?.initial_weights == InitialWeights::Random {
            return weights.check(ModelSpec::read(settings)?);
        }
        match weights.image_weights.name() {
            None => Ok(()),
            Some(_) => Err(Problem::new(
                "image_weights",
                "has no effect: with initial_weights encoder the encoder gives the weights; leave it out",
            )),
        }
    }
}

impl ImageEncoder {
    /// Whether it has torchvision's layers, which begin with given weights and never with drawn ones.
    #[must_use]
    pub fn is_resnet(self) -> bool {
        match self {
            Self::Resnet18 | Self::Resnet34 => true,
            Self::Keypoints | Self::Residual => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::{PretrainSpec, TrainSpec};

    fn values(json: serde_json::Value) -> Values {
        json.as_object().unwrap().clone()
    }

    #[test]
    fn a_name_and_a_digest_survive_as_text() {
        let digest = BlobId::from(blake3::hash(b"weights"));
        let named = ImageWeights::try_from("resnet18-v1.safetensors".to_owned()).unwrap();
        assert_eq!((named.name(), named.digest()), (Some("resnet18-v1.safetensors"), None));
        let chosen = named.with_digest(digest.clone());
        let text = String::from(chosen.clone());
        assert_eq!(text, format!("resnet18-v1.safetensors@{}", digest.as_str()));
        let again = ImageWeights::try_from(text).unwrap();
        assert_eq!((&again, again.digest()), (&chosen, Some(&digest)));
        assert_eq!(String::from(ImageWeights::default()), "");
    }

    #[test]
    fn a_path_and_a_wrong_digest_are_rejected() {
        let long = "a".repeat(201);
        for wrong in ["../a", "a/b", "a\\b", ".", "..", ".a", "@", "a b", "a@", "a@12", "a\n", "ä", &long] {
            assert!(ImageWeights::try_from(wrong.to_owned()).is_err(), "{wrong}");
        }
        let given = values(json!({"image_encoder": "resnet18", "image_weights": "../secret"}));
        let message = PretrainSpec::from_values(&given).unwrap_err().to_string();
        assert!(
            message.starts_with("image_weights: \"../secret\" is not the name of a file: use up to 200"),
            "{message}"
        );
    }

    #[test]
    fn weights_are_given_for_a_resnet_and_for_no_other_image_encoder() {
        let pretrain = |given| PretrainSpec::from_values(&values(given)).map(drop).map_err(|found| found.message);
        let train = |given| TrainSpec::from_values(&values(given)).map(drop).map_err(|found| found.message);
        let given = json!({"image_encoder": "resnet18", "image_weights": "a.safetensors"});
        assert_eq!(pretrain(given.clone()), Ok(()));
        for policy in ["bc", "tf_bc", "act", "flow", "diffusion"] {
            let with = |given: &serde_json::Value| {
                let mut given = given.clone();
                given["policy"] = policy.into();
                given
            };
            assert_eq!(train(with(&given)), Ok(()), "{policy}");
            let empty = train(with(&json!({"image_encoder": "resnet34"}))).unwrap_err();
            assert!(empty.starts_with("is empty, but the norms of resnet34 are fixed"), "{empty}");
            let other = train(with(&json!({"image_weights": "a.safetensors"}))).unwrap_err();
            assert!(other.starts_with("has no effect: image_encoder keypoints"), "{other}");
        }
        assert!(pretrain(json!({"image_encoder": "resnet18"})).is_err());
        assert!(pretrain(json!({"image_encoder": "residual", "image_weights": "a"})).is_err());
        let both = json!({"policy": "bc", "initial_weights": "encoder", "image_weights": "a"});
        assert!(train(both).unwrap_err().contains("the encoder gives the weights"));
        assert_eq!(train(json!({"policy": "bc", "initial_weights": "encoder", "image_encoder": "resnet18"})), Ok(()));
    }

    #[test]
    fn the_weights_of_a_spec_are_replaced() {
        let digest = BlobId::from(blake3::hash(b"weights"));
        let given = values(json!({"policy": "bc", "image_encoder": "resnet18", "image_weights": "a"}));
        let spec = TrainSpec::from_values(&given).unwrap();
        let chosen = spec.image_weights().unwrap().with_digest(digest);
        let spec = spec.with_image_weights(chosen.clone());
        assert_eq!(spec.image_weights(), Ok(chosen));
        assert_eq!(TrainSpec::from_values(&spec.values()), Ok(spec));
        assert_eq!(TrainSpec::default().image_weights(), Ok(ImageWeights::default()));
    }
}
