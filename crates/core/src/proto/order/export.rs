//! Exports on the wire.

use gleaner_proto::v1;

use crate::{
    dataset::{ExportFormat, ExportSpec},
    error::{Error, Result},
    id::DatasetId,
    order::JobOrder,
};

/// Reads the order of an export.
///
/// # Errors
/// Invalid names the field and the remedy.
pub(super) fn order(field: &str, spec: v1::ExportSpec) -> Result<JobOrder> {
    let v1::ExportSpec { dataset_id, format, depth, video, whole } = spec;
    let format = match v1::ExportFormat::try_from(format) {
        Ok(v1::ExportFormat::Unspecified | v1::ExportFormat::Mcap) => ExportFormat::Mcap,
        Ok(v1::ExportFormat::Lerobot) => ExportFormat::Lerobot,
        Ok(v1::ExportFormat::Robomimic) => ExportFormat::Robomimic,
        Err(_) => {
            let known = ExportFormat::ALL.map(|format| format.as_str().to_uppercase()).join(", ");
            return Err(Error::invalid(&format!("{field}.format"), format!("unknown value; supported: {known}")));
        }
    };
    if depth && format == ExportFormat::Mcap {
        let problem = "is for LEROBOT and ROBOMIMIC; MCAP files always have every topic of their recording";
        return Err(Error::invalid(&format!("{field}.depth"), problem));
    }
    if video && format != ExportFormat::Lerobot {
        let problem = "is for LEROBOT; MCAP files have the pictures of their recording, and robomimic reads pixels";
        return Err(Error::invalid(&format!("{field}.video"), problem));
    }
    let dataset_id = DatasetId::parse(&format!("{field}.dataset_id"), &dataset_id)?;
    Ok(JobOrder::Export { dataset_id, spec: ExportSpec { format, depth, video, whole } })
}

/// A complete spec.
pub(super) fn to_proto(spec: ExportSpec, dataset_id: String) -> v1::ExportSpec {
    let format = match spec.format {
        ExportFormat::Mcap => v1::ExportFormat::Mcap,
        ExportFormat::Lerobot => v1::ExportFormat::Lerobot,
        ExportFormat::Robomimic => v1::ExportFormat::Robomimic,
    };
    let ExportSpec { depth, video, whole, .. } = spec;
    v1::ExportSpec { dataset_id, format: format.into(), depth, video, whole }
}
