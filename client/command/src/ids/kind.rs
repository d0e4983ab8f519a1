//! Kinds of ids: their prefixes, the commands that make them, and the arguments that name them.

/// What an id names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Episode,
    /// An episode in the trash.
    Deleted,
    Snapshot,
    Job,
    Encoder,
    Run,
    Dataset,
    Policy,
    Evaluation,
    Schedule,
}

impl Kind {
    pub(super) fn prefix(self) -> &'static str {
        match self {
            Self::Episode | Self::Deleted => "ep_",
            Self::Snapshot => "snap_",
            Self::Job => "job_",
            Self::Encoder => "enc_",
            Self::Run => "run_",
            Self::Dataset => "ds_",
            Self::Policy => "pol_",
            Self::Evaluation => "eval_",
            Self::Schedule => "sch_",
        }
    }

    /// The noun, and the command that makes one.
    pub(super) fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Episode => ("episode", "gleaner push RECORDINGS"),
            Self::Deleted => ("deleted episode", "gleaner delete EPISODE"),
            Self::Snapshot => ("snapshot", "gleaner snapshot create"),
            Self::Job => ("job", "gleaner pretrain"),
            Self::Encoder => ("encoder", "gleaner pretrain --wait"),
            Self::Run => ("score run", "gleaner score --wait"),
            Self::Dataset => ("dataset", "gleaner dataset create"),
            Self::Policy => ("policy", "gleaner train --wait"),
            Self::Evaluation => ("evaluation", "gleaner evaluate --policy POLICY --wait"),
            Self::Schedule => ("schedule", "gleaner schedule create"),
        }
    }
}

/// What an argument of a command names; `None` for other arguments.
pub(super) fn kind(command: &str, argument: &str) -> Option<Kind> {
    Some(match (command, argument) {
        (_, "encoder" | "experts_of") | ("compare-scorers", "on") => Kind::Encoder,
        (_, "snapshot" | "experts_in") => Kind::Snapshot,
        (_, "dataset") | ("dataset", "id") => Kind::Dataset,
        // Of `train` and others it is a kind of policy.
        ("deploy" | "evaluate" | "evaluations" | "report-evaluation", "policy") => Kind::Policy,
        (_, "run" | "extends" | "score_run") | ("export" | "open", "scores") => Kind::Run,
        ("scores" | "export" | "open", "episode")
        | ("episode" | "download" | "labels", "id")
        | ("label" | "delete", "ids") => Kind::Episode,
        ("restore", "ids") => Kind::Deleted,
        ("job" | "metrics" | "watch" | "cancel", "id") => Kind::Job,
        ("snapshot", "id") => Kind::Snapshot,
        ("evaluation", "id") => Kind::Evaluation,
        ("schedule", "id") => Kind::Schedule,
        _ => return None,
    })
}
