//! Training on the wire.

use crate::{PretrainSpec, TrainSpec, Values, kinds::Family, proto};
use gleaner_proto::v1;

use super::settings;
use crate::{
    error::{Error, Result},
    id::{DatasetId, EncoderId, SnapshotId},
    order::{JobOrder, TrainData, needs_encoder},
};

pub(super) fn order(at: &str, spec: v1::TrainSpec) -> Result<JobOrder> {
    let (data, spec) = from_proto(at, spec)?;
    let data = match data {
        Some(v1::train_spec::Data::DatasetId(id)) => {
            TrainData::Dataset(DatasetId::parse(&format!("{at}.dataset_id"), &id)?)
        }
        Some(v1::train_spec::Data::ExpertsOf(id)) => {
            TrainData::ExpertsOf(EncoderId::parse(&format!("{at}.experts_of"), &id)?)
        }
        Some(v1::train_spec::Data::ExpertsIn(id)) => {
            TrainData::ExpertsIn(SnapshotId::parse(&format!("{at}.experts_in"), &id)?)
        }
        None => {
            return Err(Error::invalid(
                &format!("{at}.data"),
                "must be set: a dataset_id, experts_of an encoder, or experts_in a snapshot",
            ));
        }
    };
    if matches!(data, TrainData::ExpertsIn(_)) && needs_encoder(&spec) {
        let policy = &spec.policy.name;
        return Err(Error::invalid(
            &format!("{at}.experts_in"),
            format!("names no encoder, which {policy} starts from; use experts_of, or a policy that needs none"),
        ));
    }
    Ok(JobOrder::Train { data, spec })
}

pub(super) fn from_proto(at: &str, spec: v1::TrainSpec) -> Result<(Option<v1::train_spec::Data>, TrainSpec)> {
    let v1::TrainSpec { data, settings } = spec;
    Ok((data, settings::from_proto(at, settings, TrainSpec::from_values)?))
}

/// A pipeline's training, whose encoder comes from this pretraining: a policy that takes over the encoder's size may
/// repeat it.
pub(super) fn without_repeats(spec: v1::TrainSpec, pretrain: &PretrainSpec) -> v1::TrainSpec {
    let v1::TrainSpec { data, settings } = spec;
    let mut values = proto::from_struct(settings);
    if let Some(kind) = Family::Policy.chosen(&values) {
        let of_encoder: Values = pretrain.values();
        let own = |name: &str| kind.settings.iter().any(|setting| setting.name == name);
        for repeated in ["preset", "segment_length"].into_iter().filter(|name| !own(name)) {
            if values.get(repeated) == of_encoder.get(repeated) {
                values.remove(repeated);
            }
        }
    }
    v1::TrainSpec { data, settings: settings::to_proto(&values) }
}

pub(super) fn to_proto(spec: &TrainSpec, data: Option<v1::train_spec::Data>) -> v1::TrainSpec {
    v1::TrainSpec { data, settings: settings::to_proto(&spec.values()) }
}
