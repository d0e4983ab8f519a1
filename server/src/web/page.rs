//! Every page: its method and its path. The authorisation table has a row for each, and `routes` a handler.

use axum::http::Method;

macro_rules! pages {
    ($($(#[$doc:meta])* $page:ident = $method:ident $path:literal,)*) => {
        /// A page, or something that is done on one.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub(crate) enum Page { $($(#[$doc])* $page,)* }

        impl Page {
            /// Every page.
            pub(crate) const ALL: &[Self] = &[$(Self::$page,)*];

            /// How it is asked for.
            pub(crate) fn method(self) -> Method {
                match self { $(Self::$page => Method::$method,)* }
            }

            /// Where it is; what stands in braces is a name or an id.
            pub(crate) fn path(self) -> &'static str {
                match self { $(Self::$page => $path,)* }
            }
        }
    };
}

pages! {
    /// For Prometheus.
    Metrics = GET "/metrics",
    /// For whoever keeps the server running.
    Health = GET "/healthz",
    /// Styles and scripts.
    Asset = GET "/assets/{name}",
    /// Where a browser shows its token.
    SignIn = GET "/sign-in",
    /// The token.
    SigningIn = POST "/sign-in",
    /// The end of a browser's request.
    SigningOut = POST "/sign-out",
    /// Every task, what runs, what is left of the disk.
    Overview = GET "/",
    /// What is served.
    Deployments = GET "/deployments",
    /// One name, and its sessions.
    Deployment = GET "/deployments/{name}",
    /// Its sessions alone, for a page that is open.
    LiveSessions = GET "/deployments/{name}/live",
    /// Points a name back at what it pointed at before.
    RollBack = POST "/deployments/{name}/roll-back",
    /// What a session's camera saw last.
    LiveFrame = GET "/sessions/{session}/frames/{camera}",
    /// A task's episodes.
    Episodes = GET "/tasks/{task}/episodes",
    /// A label for some of them.
    LabelEpisodes = POST "/tasks/{task}/labels",
    /// One episode.
    Episode = GET "/episodes/{id}",
    /// One of its steps as a camera saw it.
    EpisodeFrame = GET "/episodes/{id}/frames/{camera}/{step}",
    /// Its scores in a run.
    EpisodeScores = GET "/episodes/{id}/scores.json",
    /// Its recording.
    EpisodeRecording = GET "/episodes/{id}/recording.mcap",
    /// A task's score runs and policies.
    Runs = GET "/tasks/{task}/runs",
    /// One score run under a threshold.
    Run = GET "/runs/{id}",
    /// What a threshold would keep of it.
    WhatIf = GET "/runs/{id}/what-if",
    /// Makes what a threshold keeps a dataset.
    MakeDataset = POST "/runs/{id}/datasets",
    /// One snapshot.
    Snapshot = GET "/snapshots/{id}",
    /// One encoder.
    Encoder = GET "/encoders/{id}",
    /// One dataset.
    Dataset = GET "/datasets/{id}",
    /// One policy.
    Policy = GET "/policies/{id}",
    /// Jobs of all tasks.
    Jobs = GET "/jobs",
    /// One job.
    Job = GET "/jobs/{id}",
    /// How far it is, for a page that is open.
    JobCourse = GET "/jobs/{id}/course",
    /// What its workers said.
    JobLog = GET "/jobs/{id}/log",
    /// Ends it, and those that wait for it.
    CancelJob = POST "/jobs/{id}/cancel",
    /// Orders the same anew.
    RetryJob = POST "/jobs/{id}/retry",
}
