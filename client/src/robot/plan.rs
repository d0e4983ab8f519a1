//! The control loop's plan: deployment, rate and time limits.

use std::time::Duration;

use gleaner_proto::v1::SessionOpen;

use super::Ensembling;
use crate::error::{ClientError, Result};

/// Settings of a control run. [`ControlPlan::new`] derives all times from the control period.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ControlPlan {
    /// The deployment's name.
    pub deployment: String,
    /// The time between ticks: the task's control period.
    pub period: Duration,
    /// How long after its arrival the server may still answer an observation; later it reports the observation missed.
    /// Default: one period, when the next observation arrives.
    pub deadline: Duration,
    /// How far into a period the loop waits for the period's own answer before it commands the action due otherwise.
    /// Less than the period: the rest is for the robot to command and observe. Default: three quarters.
    pub answer_within: Duration,
    /// How long the robot holds after its last action before it is stopped. Default: five periods.
    pub hold_for: Duration,
    /// How long the server may leave a request without any response before the session is reopened. Default: the longer
    /// of 2 s and ten periods.
    pub lost_after: Duration,
    /// How long the loop tries to reopen a session before it ends with the error. Default: one minute.
    pub give_up_after: Duration,
    /// Where the predictions of several chunks are ensembled.
    pub ensembling: Ensembling,
    /// Record each session as an episode of the task, labelled by [`Robot::outcome`](super::Robot). A session lost in
    /// the middle becomes an episode of its own with an unknown outcome.
    pub record: bool,
    /// The cohort of these episodes; empty: the deployment's name.
    pub cohort: String,
    /// Seed of the numbers that a policy such as flow draws its actions from.
    pub seed: u64,
}

impl ControlPlan {
    /// A plan with the defaults for this control rate.
    ///
    /// # Errors
    /// [`ClientError::Invalid`] when the rate is not above 0 and at most 1000 Hz.
    pub fn new(deployment: impl Into<String>, rate_hz: f64) -> Result<Self> {
        if !(rate_hz > 0.0 && rate_hz <= 1000.0) {
            return Err(ClientError::Invalid(format!("control rate {rate_hz}: must be above 0 and at most 1000 Hz")));
        }
        let period = Duration::try_from_secs_f64(1.0 / rate_hz)
            .map_err(|error| ClientError::Invalid(format!("control rate {rate_hz}: {error}")))?;
        let plan = Self {
            deployment: deployment.into(),
            period,
            deadline: period,
            answer_within: period * 3 / 4,
            hold_for: period.saturating_mul(5),
            lost_after: Duration::from_secs(2).max(period.saturating_mul(10)),
            give_up_after: Duration::from_secs(60),
            ensembling: Ensembling::default(),
            record: false,
            cohort: String::new(),
            seed: 0,
        };
        plan.check()?;
        Ok(plan)
    }

    /// Checks that the times are consistent.
    pub(super) fn check(&self) -> Result<()> {
        let refuse = |problem: String| Err(ClientError::Invalid(problem));
        if self.period < Duration::from_millis(1) || self.period > Duration::from_secs(60) {
            return refuse(format!("period {:?}: must be from 1 ms to 60 s", self.period));
        }
        if self.answer_within >= self.period {
            return refuse(format!(
                "answer_within {:?}: must be below the period {:?}",
                self.answer_within, self.period
            ));
        }
        if self.deadline_us().is_none() {
            return refuse(format!("deadline {:?}: must be from 1 µs to an hour", self.deadline));
        }
        if !self.record && !self.cohort.is_empty() {
            return refuse(format!("cohort {:?}: applies to recorded episodes only; set record too", self.cohort));
        }
        if self.lost_after < self.deadline {
            return refuse(format!(
                "lost_after {:?}: must not be below the deadline {:?}",
                self.lost_after, self.deadline
            ));
        }
        Ok(())
    }

    /// The message that opens a session of this plan.
    pub(super) fn open(&self) -> SessionOpen {
        SessionOpen {
            deployment: self.deployment.clone(),
            control_rate_hz: 1.0 / self.period.as_secs_f64(),
            deadline_us: self.deadline_us().unwrap_or_default(),
            record: self.record,
            cohort: self.cohort.clone(),
            seed: self.seed,
        }
    }

    fn deadline_us(&self) -> Option<u32> {
        let hour = 3_600_000_000;
        u32::try_from(self.deadline.as_micros()).ok().filter(|us| (1..=hour).contains(us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_derived_from_the_control_period() {
        let plan = ControlPlan::new("a@b", 20.0).unwrap();
        assert_eq!((plan.period, plan.hold_for), (Duration::from_millis(50), Duration::from_millis(250)));
        let open = plan.open();
        assert_eq!((open.deployment.as_str(), open.deadline_us), ("a@b", 50_000));
        assert!((open.control_rate_hz - 20.0).abs() < 1e-9);
    }

    #[test]
    fn invalid_settings_are_rejected_by_name() {
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 2000.0, 1e-9] {
            assert!(ControlPlan::new("a", rate).is_err(), "{rate}");
        }
        let good = ControlPlan::new("a", 10.0).unwrap();
        let times = [
            (ControlPlan { answer_within: good.period, ..good.clone() }, "answer_within"),
            (ControlPlan { deadline: Duration::ZERO, ..good.clone() }, "deadline"),
            (ControlPlan { deadline: Duration::from_secs(4000), ..good.clone() }, "deadline"),
            (ControlPlan { period: Duration::ZERO, ..good.clone() }, "period"),
            (ControlPlan { cohort: "night".into(), ..good.clone() }, "cohort"),
            (ControlPlan { lost_after: Duration::from_millis(1), ..good }, "lost_after"),
        ];
        for (plan, name) in times {
            assert!(plan.check().unwrap_err().to_string().starts_with(name), "{plan:?}");
        }
    }
}
