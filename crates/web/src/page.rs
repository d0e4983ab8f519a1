//! Every page by name, method, path and access rule: the pages' counterpart to the rpcs of the protos. A page without a
//! rule does not build; `routes` has a handler for each. Must not know what a page shows.

use gleaner_core::access::Role;
use http::Method;

/// Who may request a page, and whether the request is audited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// Public, also where tokens are required.
    Open,
    /// Reads data: for this role and higher ones.
    Reads(Role),
    /// Changes data: for this role and higher ones, and recorded in the audit log.
    Changes(Role),
}

macro_rules! rule {
    (open) => {
        Rule::Open
    };
    (reads $role:ident) => {
        Rule::Reads(Role::$role)
    };
    (changes $role:ident) => {
        Rule::Changes(Role::$role)
    };
}

macro_rules! pages {
    ($($(#[$doc:meta])* $page:ident = $method:ident $path:literal $kind:ident $($role:ident)?,)*) => {
        /// A page, or an action on one.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Page { $($(#[$doc])* $page,)* }

        impl Page {
            /// Every page.
            pub const ALL: &[Self] = &[$(Self::$page,)*];

            /// Its HTTP method.
            pub fn method(self) -> Method {
                match self { $(Self::$page => Method::$method,)* }
            }

            /// Its path; braces contain a name or an id.
            pub fn path(self) -> &'static str {
                match self { $(Self::$page => $path,)* }
            }

            /// Its access rule.
            pub fn rule(self) -> Rule {
                match self { $(Self::$page => rule!($kind $($role)?),)* }
            }
        }
    };
}

impl Page {
    /// Whether it is public.
    pub fn is_open(self) -> bool {
        self.rule() == Rule::Open
    }

    /// Whether its response is a recording, which takes as long as the reader does.
    pub fn is_download(self) -> bool {
        matches!(self, Self::EpisodeRecording | Self::ScoredEpisode)
    }

    /// Whether a request for it changes data.
    pub fn changes(self) -> bool {
        matches!(self.rule(), Rule::Changes(_))
    }
}

pages! {
    /// For Prometheus.
    Metrics = GET "/metrics" reads Viewer,
    /// For a supervisor.
    Health = GET "/healthz" open,
    /// Styles and scripts.
    Asset = GET "/assets/{name}" open,
    /// The sign-in form.
    SignIn = GET "/sign-in" open,
    /// Signs in with a token.
    SigningIn = POST "/sign-in" open,
    /// Signs the browser out.
    SigningOut = POST "/sign-out" open,
    /// Tasks, running jobs and free disk space.
    Overview = GET "/" reads Viewer,
    /// All deployments.
    Deployments = GET "/deployments" reads Viewer,
    /// One deployment and its sessions.
    Deployment = GET "/deployments/{name}" reads Viewer,
    /// Its sessions alone, for an open page.
    LiveSessions = GET "/deployments/{name}/live" reads Viewer,
    /// Rolls a deployment back.
    RollBack = POST "/deployments/{name}/roll-back" changes Trainer,
    /// A session's last camera image.
    LiveFrame = GET "/sessions/{session}/frames/{camera}" reads Viewer,
    /// A task's episodes.
    Episodes = GET "/tasks/{task}/episodes" reads Viewer,
    /// Labels episodes.
    LabelEpisodes = POST "/tasks/{task}/labels" changes Contributor,
    /// One episode.
    Episode = GET "/episodes/{id}" reads Viewer,
    /// One of its steps from one camera.
    EpisodeFrame = GET "/episodes/{id}/frames/{camera}/{step}" reads Viewer,
    /// Its scores in a run.
    EpisodeScores = GET "/episodes/{id}/scores.json" reads Viewer,
    /// Its recording.
    EpisodeRecording = GET "/episodes/{id}/recording.mcap" reads Viewer,
    /// Its recording with the scores of a run.
    ScoredEpisode = GET "/episodes/{id}/scored.mcap" reads Viewer,
    /// A task's score runs and policies.
    Runs = GET "/tasks/{task}/runs" reads Viewer,
    /// One score run under a threshold.
    Run = GET "/runs/{id}" reads Viewer,
    /// The counts of a threshold.
    WhatIf = GET "/runs/{id}/what-if" reads Viewer,
    /// Makes a dataset of a threshold.
    MakeDataset = POST "/runs/{id}/datasets" changes Trainer,
    /// One snapshot.
    Snapshot = GET "/snapshots/{id}" reads Viewer,
    /// One encoder.
    Encoder = GET "/encoders/{id}" reads Viewer,
    /// One dataset.
    Dataset = GET "/datasets/{id}" reads Viewer,
    /// One policy.
    Policy = GET "/policies/{id}" reads Viewer,
    /// Jobs of all tasks.
    Jobs = GET "/jobs" reads Viewer,
    /// One job.
    Job = GET "/jobs/{id}" reads Viewer,
    /// Its progress, for an open page.
    JobCourse = GET "/jobs/{id}/course" reads Viewer,
    /// Its workers' log.
    JobLog = GET "/jobs/{id}/log" reads Viewer,
    /// Kinds of jobs, policies, weightings, objectives and scorers, with their settings.
    Kinds = GET "/kinds" reads Viewer,
    /// Cancels it and the jobs that wait for it.
    CancelJob = POST "/jobs/{id}/cancel" changes Trainer,
    /// Submits the same order again.
    RetryJob = POST "/jobs/{id}/retry" changes Trainer,
}
