//! Sessions on the wire: the messages of a robot and of its session.

use gleaner_core::proto::action::ranges_to_proto;
use gleaner_proto::v1::{self, session_request, session_response};

use super::{
    episode::outcome_from_proto,
    field,
    policy::{action_steps, deadline, deployment_name, observation, timings},
    scoring::live_score,
};
use crate::{
    domain::{
        episode::Outcome,
        observation::{Acted, SessionInput, SessionOutput, SessionSettings},
    },
    error::{Error, Result},
};

pub(crate) fn session_input(request: v1::SessionRequest) -> Result<SessionInput> {
    let v1::SessionRequest { message } = request;
    match field::required("message", message)? {
        session_request::Message::Open(sent) => Ok(SessionInput::Open(settings(sent)?)),
        session_request::Message::Observation(sent) => Ok(SessionInput::Observation(observation("observation", sent)?)),
        session_request::Message::Close(v1::SessionClose { outcome }) => {
            let outcome = outcome_from_proto("close.outcome", outcome)?;
            Ok(SessionInput::Close { outcome: outcome.unwrap_or(Outcome::Unknown) })
        }
    }
}

fn settings(sent: v1::SessionOpen) -> Result<SessionSettings> {
    let v1::SessionOpen { deployment, control_rate_hz, deadline_us, record, cohort, seed } = sent;
    let deployment = deployment_name("open.deployment", deployment)?;
    let cohort = field::tag("open.cohort", cohort)?;
    if !record && !cohort.is_empty() {
        return Err(Error::invalid("open.cohort", "applies to a recorded session; set record too, or omit the cohort"));
    }
    let cohort = if cohort.is_empty() { deployment.clone() } else { cohort };
    Ok(SessionSettings {
        control_rate_hz: control_rate("open.control_rate_hz", control_rate_hz)?,
        deadline: deadline(deadline_us),
        record: record.then_some(cohort),
        deployment,
        seed,
        new_chunks: false,
    })
}

fn control_rate(field: &str, hertz: f64) -> Result<Option<f64>> {
    if !(0.0..=10_000.0).contains(&hertz) {
        return Err(Error::invalid(field, format!("is {hertz}, must be between 0 (the task's rate) and 10000")));
    }
    Ok((hertz > 0.0).then_some(hertz))
}

pub(crate) fn session_response(output: SessionOutput) -> v1::SessionResponse {
    let message = match output {
        SessionOutput::Opened { session_id, policy_id, task_id, ranges, execution } => {
            session_response::Message::Opened(v1::SessionOpened {
                session_id: session_id.into(),
                policy_id: policy_id.into(),
                task_id: task_id.into(),
                action_ranges: ranges_to_proto(&ranges),
                execute_length: execution.horizon(),
            })
        }
        SessionOutput::Action { acted, dropped, score } => {
            let Acted { stamp_ns, actions, policy_id: _, timings: spent } = acted;
            session_response::Message::Action(v1::SessionAction {
                observation_stamp_ns: stamp_ns,
                actions: action_steps(actions),
                dropped,
                timings: Some(timings(spent)),
                score: score.map(live_score),
            })
        }
        SessionOutput::Missed { stamp_ns, dropped, timings: spent, reason } => {
            session_response::Message::Missed(v1::SessionMissed {
                observation_stamp_ns: stamp_ns,
                dropped,
                timings: Some(timings(spent)),
                reason,
            })
        }
        SessionOutput::Draining { close_at } => {
            session_response::Message::Draining(v1::SessionDraining { close_time: Some(field::timestamp(close_at)) })
        }
        SessionOutput::Closed { observations, dropped, missed, episode_id } => {
            let episode_id = episode_id.map(Into::into).unwrap_or_default();
            session_response::Message::Closed(v1::SessionClosed { observations, dropped, missed, episode_id })
        }
    };
    v1::SessionResponse { message: Some(message) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opened(open: v1::SessionOpen) -> Result<SessionSettings> {
        let message = Some(session_request::Message::Open(open));
        match session_input(v1::SessionRequest { message })? {
            SessionInput::Open(settings) => Ok(settings),
            other @ (SessionInput::Observation(_) | SessionInput::Close { .. }) => panic!("{other:?}"),
        }
    }

    fn record(cohort: &str, record: bool) -> v1::SessionOpen {
        v1::SessionOpen { deployment: "arm@prod".into(), record, cohort: cohort.into(), ..Default::default() }
    }

    #[test]
    fn an_empty_session_message_is_rejected() {
        assert!(session_input(v1::SessionRequest { message: None }).is_err());
        let error = opened(v1::SessionOpen { control_rate_hz: f64::NAN, ..record("", false) }).unwrap_err();
        assert!(error.message().starts_with("open.control_rate_hz: "), "{error}");
    }

    #[test]
    fn an_opening_of_a_session_is_checked() {
        for (open, field) in [
            (v1::SessionOpen { deployment: String::new(), ..record("", false) }, "open.deployment: "),
            (v1::SessionOpen { deployment: "../x".into(), ..record("", false) }, "open.deployment: "),
            (v1::SessionOpen { control_rate_hz: -1.0, ..record("", false) }, "open.control_rate_hz: "),
            (v1::SessionOpen { control_rate_hz: 1e5, ..record("", false) }, "open.control_rate_hz: "),
            (record(&"x".repeat(256), true), "open.cohort: "),
            (record("a\u{7}", true), "open.cohort: "),
        ] {
            let error = opened(open).unwrap_err();
            assert!(error.message().starts_with(field), "{field} expected: {error}");
        }
    }

    #[test]
    fn a_recorded_session_without_a_cohort_takes_its_deployments_name() {
        for (open, expected) in
            [(record("", true), Some("arm@prod")), (record("night", true), Some("night")), (record("", false), None)]
        {
            assert_eq!(opened(open).unwrap().record.as_deref(), expected);
        }
        let error = opened(record("night", false)).unwrap_err();
        assert!(error.message().starts_with("open.cohort: "), "{error}");
    }

    #[test]
    fn a_close_without_an_outcome_has_the_outcome_unknown() {
        let close = |outcome| {
            let message = Some(session_request::Message::Close(v1::SessionClose { outcome }));
            session_input(v1::SessionRequest { message })
        };
        let outcome = |sent: v1::Outcome| {
            let SessionInput::Close { outcome } = close(sent.into()).unwrap() else { panic!("not close") };
            outcome
        };
        assert_eq!(outcome(v1::Outcome::Unspecified), Outcome::Unknown);
        assert_eq!(outcome(v1::Outcome::Failure), Outcome::Failure);
        assert!(close(77).unwrap_err().message().starts_with("close.outcome: "));
    }
}
