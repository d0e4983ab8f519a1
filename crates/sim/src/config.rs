//! Settings of the simulator and their checks.

use serde::{Deserialize, Serialize};

use crate::error::SimError;

/// Smallest and largest camera size in pixels.
const IMAGE_RANGE: std::ops::RangeInclusive<u32> = 8..=512;
/// Smallest and largest step limit.
const STEP_RANGE: std::ops::RangeInclusive<u32> = 1..=10_000;

/// Settings of the simulator for one task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields, default)]
pub struct SimConfig {
    /// Height and width of both cameras in pixels.
    pub image: u32,
    /// Steps after which an attempt ends without success.
    pub max_steps: u32,
}

impl Default for SimConfig {
    fn default() -> Self {
        Self { image: 32, max_steps: 60 }
    }
}

impl SimConfig {
    /// Checks that each setting is in its range.
    ///
    /// # Errors
    /// [`SimError::Config`] names the setting and its range.
    pub fn validate(&self) -> Result<(), SimError> {
        in_range("image", self.image, IMAGE_RANGE)?;
        in_range("max_steps", self.max_steps, STEP_RANGE)
    }

    /// The camera size that is rendered: out-of-range settings are clamped, so that rendering cannot fail.
    pub(crate) fn image_size(&self) -> u32 {
        self.image.clamp(*IMAGE_RANGE.start(), *IMAGE_RANGE.end())
    }
}

fn in_range(field: &'static str, value: u32, range: std::ops::RangeInclusive<u32>) -> Result<(), SimError> {
    if range.contains(&value) {
        return Ok(());
    }
    let (low, high) = (range.start(), range.end());
    Err(SimError::Config { field, detail: format!("{value} is out of range; choose {low} to {high}") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn setting_out_of_range_is_named_with_its_range() {
        let config = SimConfig { image: 4, ..SimConfig::default() };
        let error = config.validate().unwrap_err().to_string();
        assert_eq!(error, "config.image: 4 is out of range; choose 8 to 512");
        assert!(SimConfig::default().validate().is_ok());
    }
}
