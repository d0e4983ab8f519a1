//! The cells of the table of scorings: each scorer, and the forms of the comparison of segments. Must not know studies.

use toml::Value;

use super::grid::Draft;

/// The paper's score with its features scaled and to the letter; the nearest neighbour of raw observations, of the last
/// step and of whole segments, without and with the local scale, then with the progress of matches in the form that was the
/// default once, with the pace of progress and a lead-in, the default after it, and with earliness, the default; the
/// classifier; mutual information; progress; and the vote.
pub(super) fn scorings() -> Vec<Draft> {
    let cell = |label: &str, set: &[(&str, &str)]| -> Draft {
        let flag = |text: &str| text.parse::<bool>().map_or_else(|_| Value::from(text), Value::from);
        (label.to_owned(), set.iter().map(|(key, value)| ((*key).to_owned(), flag(value))).collect())
    };
    let compared = |label: &str, set: &[(&str, &str)], [lookahead, lead_in, earliness]: [f64; 3]| -> Draft {
        let (label, mut set) = cell(label, set);
        set.push(("lookahead".to_owned(), lookahead.into()));
        set.push(("lead_in".to_owned(), lead_in.into()));
        set.push(("earliness".to_owned(), earliness.into()));
        (label, set)
    };
    let alone = [0.0; 3];
    let raw = |label: &str, (similarity, local_scale): (&str, &str)| {
        compared(label, &[("scorer", "raw"), ("local_scale", local_scale), ("similarity", similarity)], alone)
    };
    let progress = |label: &str, progress: &str, ahead: [f64; 3]| {
        let set = [("scorer", "raw"), ("local_scale", "true"), ("similarity", "segment_l2"), ("progress", progress)];
        compared(label, &set, ahead)
    };
    vec![
        cell("ssdf", &[("scorer", "ssdf")]),
        compared(
            "ssdf to the letter",
            &[("scorer", "ssdf"), ("feature_scale", "plain"), ("local_scale", "false")],
            alone,
        ),
        raw("raw", ("last_l2", "false")),
        raw("raw + local scale", ("last_l2", "true")),
        raw("raw segments", ("segment_l2", "false")),
        raw("raw segments + local scale", ("segment_l2", "true")),
        progress("raw segments + local scale + lookahead", "furthest", [0.5, 0.0, 0.0]),
        progress("raw segments + local scale + pace + lead-in", "pace", [0.5, 0.2, 0.0]),
        progress("raw segments + local scale + pace + lead-in + earliness", "pace", [0.5, 0.2, 0.2]),
        cell("classifier", &[("scorer", "classifier")]),
        cell("deminf", &[("scorer", "deminf")]),
        cell("progress", &[("scorer", "progress")]),
        cell("vote", &[("scorer", "vote")]),
    ]
}
