//! What a client reads: metadata once, then actions with the time that they took.
//!
//! Must not know requests.

use gleaner_core::TaskSpec;
use rmpv::Value;

use crate::array::numbers;

/// What a client receives when it connects.
#[derive(Debug, Clone)]
pub struct Metadata<'a> {
    /// The deployment that acts.
    pub deployment: &'a str,
    /// The id of its policy.
    pub policy_id: &'a str,
    /// The task: cameras, values and rate.
    pub task: &'a TaskSpec,
}

/// Actions for one observation.
#[derive(Debug, Clone)]
pub struct Reply<'a> {
    /// Actions, one for each control period, of equal lengths.
    pub actions: &'a [Vec<f32>],
    /// Milliseconds from the message to this reply.
    pub infer_ms: f64,
    /// Milliseconds in the model.
    pub policy_ms: f64,
    /// Milliseconds from the message before to the end of its reply, if there was one.
    pub previous_ms: Option<f64>,
    /// q and w of the newest scored segment, where the deployment has a score run.
    pub score: Option<(f32, f64)>,
}

/// The first message to a client, a msgpack map.
#[must_use]
pub fn metadata(metadata: &Metadata<'_>) -> Vec<u8> {
    let Metadata { deployment, policy_id, task } = metadata;
    let cameras = task.cameras.iter().map(|camera| {
        let (height, width) = camera.recorded.map_or((camera.height, camera.width), |size| (size.height, size.width));
        map([
            ("name", camera.name.as_str().into()),
            ("height", height.into()),
            ("width", width.into()),
            ("depth", camera.depth.into()),
        ])
    });
    let fields = |fields: &[gleaner_core::FieldSpec]| {
        let field =
            |field: &gleaner_core::FieldSpec| map([("name", field.name.as_str().into()), ("size", field.size.into())]);
        Value::Array(fields.iter().map(field).collect())
    };
    encoded(&map([
        ("deployment", (*deployment).into()),
        ("policy_id", (*policy_id).into()),
        ("task", task.name.as_str().into()),
        ("control_rate_hz", task.rate_hz.into()),
        ("cameras", Value::Array(cameras.collect())),
        ("state", fields(&task.proprioception)),
        ("action", fields(&task.action)),
    ]))
}

/// The reply to an observation, a msgpack map.
#[must_use]
pub fn reply(reply: &Reply<'_>) -> Vec<u8> {
    let Reply { actions, infer_ms, policy_ms, previous_ms, score } = reply;
    let shape = [actions.len(), actions.first().map_or(0, Vec::len)];
    let mut server = vec![("infer_ms", Value::from(*infer_ms))];
    server.extend(previous_ms.map(|previous| ("prev_total_ms", Value::from(previous))));
    let mut entries = vec![
        ("actions", numbers(&shape, actions.iter().flatten().copied())),
        ("server_timing", map(server)),
        ("policy_timing", map([("infer_ms", Value::from(*policy_ms))])),
    ];
    entries.extend(score.map(|(q, w)| ("gleaner", map([("q", q.into()), ("w", w.into())]))));
    encoded(&map(entries))
}

fn map<'a>(entries: impl IntoIterator<Item = (&'a str, Value)>) -> Value {
    Value::Map(entries.into_iter().map(|(key, value)| (key.into(), value)).collect())
}

fn encoded(value: &Value) -> Vec<u8> {
    let mut message = Vec::new();
    // Writing to memory cannot fail.
    let _ = rmpv::encode::write_value(&mut message, value);
    message
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::array::Array;
    use crate::named::Named;

    #[test]
    fn a_reply_has_actions_and_times() {
        let actions = [vec![1.0, 2.0], vec![3.0, 4.0], vec![5.0, 6.0]];
        let written = reply(&Reply {
            actions: &actions,
            infer_ms: 2.5,
            policy_ms: 2.0,
            previous_ms: None,
            score: Some((0.5, -1.0)),
        });
        let value = rmpv::decode::read_value(&mut &written[..]).unwrap();
        let named = Named::of(&value);
        let read = Array::of("actions", named.first(&["actions"]).unwrap()).unwrap().unwrap();
        assert_eq!((read.shape.as_slice(), read.numbers()), ([3, 2].as_slice(), vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        assert_eq!(named.first(&["server_timing/infer_ms"]).unwrap().as_f64(), Some(2.5));
        assert_eq!(named.first(&["policy_timing/infer_ms"]).unwrap().as_f64(), Some(2.0));
        assert_eq!(named.first(&["gleaner/q"]).unwrap().as_f64(), Some(0.5));
        assert!(named.first(&["server_timing/prev_total_ms"]).is_none());
    }
}
